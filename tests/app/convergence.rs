//! The whole chain over frames: the image of a static camera converges to the ground truth, and moving objects leave no ghost.

use crate::{
    common::app,
    pictures::{COARSE, linear_app, use_coarse_shadow_maps},
    stage::{
        self, BEFORE_THE_MIRROR, begin_anew, metal, settings_of, spawn_camera, spawn_mesh, spawn_mirror, unlit, wall,
    },
};
use bevy::{core_pipeline::tonemapping::Tonemapping, math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionTracerChoice, named_settings};
use glint_scenes::{HeadlessApp, Output, SceneName};
use std::sync::OnceLock;

const SIZE: UVec2 = UVec2::new(208, 117);
/// Size for the scene with slow shading.
const LIT_SIZE: UVec2 = UVec2::new(96, 54);
/// Tolerance of the mean of a static image, relative to the ground truth. The paper's recipe keeps clipping history in static views.
const MOST_BIAS: f32 = 0.01;
const MOST_BIAS_OF_THE_PAPER: f32 = 0.05;
/// Error of static images, as a display shows it: smooth surfaces are sharp.
const MOST_ERROR_AT_REST: f32 = 0.024;
/// Error of images of a moving camera, as a display shows it.
const MOST_ERROR_IN_MOTION: f32 = 0.03;
/// Frames of the truth, more of them for small lamps than under a sky, and frames that each technique has.
const TRUE_FRAMES: u32 = 384;
const TRUE_FRAMES_UNDER_A_SKY: u32 = 192;
const FRAMES: u32 = 64;
pub const TECHNIQUES: [&str; 9] = [
    "reference",
    "quarter",
    "quarter-inline",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-combined",
    "vrs-adaptive",
    "paper",
    "ultra",
];
/// Techniques that read textures as the ground truth does.
const LIT_TECHNIQUES: [&str; 4] = ["reference", "quarter", "vrs-combined", "vrs-adaptive"];

/// Switches to a technique without a cut-off and with its history empty.
pub fn switch(app: &mut HeadlessApp, camera: Entity, name: &str) {
    let (mut settings, heuristic) = named_settings(name).unwrap();
    settings.roughness_cutoff = 1.0;
    settings.roughness_fade = 0.0;
    app.world()
        .entity_mut(camera)
        .insert((settings, heuristic, Tonemapping::None));
    begin_anew(app, camera);
}

fn scene(app: &mut HeadlessApp, name: SceneName) -> Entity {
    use_coarse_shadow_maps(app);
    app.spawn_scene(name, &COARSE)
}

/// A static image of a scene without noise. Tests of the same scene share it.
fn truth(app: &mut HeadlessApp, camera: Entity, name: SceneName) -> &'static [f32] {
    static OF_LAMPS: OnceLock<Vec<f32>> = OnceLock::new();
    static UNDER_A_SKY: OnceLock<Vec<f32>> = OnceLock::new();
    let (shared, frames) = match name {
        SceneName::EmissiveFloor => (&OF_LAMPS, TRUE_FRAMES),
        SceneName::AtriumSmall => (&UNDER_A_SKY, TRUE_FRAMES_UNDER_A_SKY),
        _ => panic!("no test compares {name} with the truth"),
    };
    shared.get_or_init(|| {
        switch(app, camera, "converged");
        app.step(frames);
        capture(app, "converged")
    })
}

/// Returns the luminance of each pixel, and fails if one is not finite.
pub fn capture(app: &mut HeadlessApp, what: &str) -> Vec<f32> {
    let pixels = app.capture_linear().unwrap();
    for (index, pixel) in pixels.iter().enumerate() {
        assert!(
            pixel.iter().all(|c| c.is_finite()),
            "{what}: pixel {index} is {pixel:?}"
        );
    }
    // Values above this all look the same on a display, and would dominate the result.
    pixels
        .iter()
        .map(|[r, g, b, _]| (0.2126 * r + 0.7152 * g + 0.0722 * b).clamp(0.0, 4.0))
        .collect()
}

/// Root mean square error as a display shows it, and the bias of light, relative to the mean of the truth.
fn errors(truth: &[f32], picture: &[f32]) -> (f32, f32) {
    let count = truth.len() as f32;
    let mean = truth.iter().sum::<f32>() / count;
    // Otherwise a few bright pixels would decide the result, and they are noisy in the ground truth, too.
    let shown = |light: f32| (light / (1.0 + light)).powf(1.0 / 2.2);
    let square: f32 = picture
        .iter()
        .zip(truth)
        .map(|(a, b)| (shown(*a) - shown(*b)).powi(2))
        .sum();
    let bias: f32 = picture.iter().zip(truth).map(|(a, b)| a - b).sum();
    ((square / count).sqrt(), bias / count / mean)
}

/// Compares techniques with the ground truth of a scene; returns the failures.
fn compare_with_truth(name: SceneName, size: UVec2, techniques: &[&str]) -> Vec<String> {
    let mut wrong = Vec::new();
    let Some(mut app) = app(size, Output::Linear, ReflectionTracerChoice::Bvh) else {
        return wrong;
    };
    let camera = scene(&mut app, name);
    let truth = truth(&mut app, camera, name);
    for &technique in techniques {
        switch(&mut app, camera, technique);
        app.step(1);
        let (first, _) = errors(truth, &capture(&mut app, technique));
        app.step(FRAMES - 1);
        // Mean of a few frames, since no single one is free of noise.
        let (mut last, mut bias) = (0.0, 0.0);
        for _ in 0..4 {
            app.step(1);
            let (error, offset) = errors(truth, &capture(&mut app, technique));
            last += error / 4.0;
            bias += offset / 4.0;
        }
        println!("{name}, {technique}: error {first:.4} after 1 frame, {last:.4} after {FRAMES}; bias {bias:+.4}");
        let (most_bias, most_error) = if technique == "paper" {
            (MOST_BIAS_OF_THE_PAPER, 0.95 * first)
        } else {
            (MOST_BIAS, MOST_ERROR_AT_REST)
        };
        if !(last < most_error.min(0.95 * first) && bias.abs() < most_bias) {
            wrong.push(format!("{technique}: {first} to {last}, bias {bias}"));
        }
    }
    wrong
}

/// The hardest case: all light comes from small lamps in the dark. Borrowed rays of neighbours see the lamps in other places, and
/// histories are clipped to frames without a lamp. Both would lose light, and more of it with fewer pixels.
#[test]
#[ignore = "long: 384 frames of truth, 64 of each technique"]
fn a_still_picture_comes_to_rest_at_the_truth() {
    let wrong = compare_with_truth(SceneName::EmissiveFloor, SIZE, &TECHNIQUES);
    assert!(wrong.is_empty(), "{}", wrong.join("; "));
}

/// The usual case: light from everywhere, textures, and surfaces of all kinds.
#[test]
#[ignore = "long: 192 frames of truth, 64 of each technique"]
fn a_still_picture_under_a_sky_comes_to_rest_at_the_truth() {
    let wrong = compare_with_truth(SceneName::AtriumSmall, LIT_SIZE, &LIT_TECHNIQUES);
    assert!(wrong.is_empty(), "{}", wrong.join("; "));
}

/// A removed object must be gone from reflections within 8 frames, and a cut must leave no trace of the last scene.
#[test]
fn what_is_gone_leaves_no_ghost() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let camera = scene(&mut app, SceneName::EmissiveFloor);
    let lights: Vec<Entity> = {
        let world = app.world();
        let mut query = world.query::<(Entity, &MeshMaterial3d<StandardMaterial>)>();
        let materials = world.resource::<Assets<StandardMaterial>>();
        query
            .iter(world)
            .filter(|(_, material)| {
                materials
                    .get(&material.0)
                    .is_some_and(|m| m.emissive != LinearRgba::BLACK)
            })
            .map(|(entity, _)| entity)
            .collect()
    };
    assert!(!lights.is_empty());
    for name in ["quarter", "vrs-combined", "vrs-adaptive", "paper"] {
        switch(&mut app, camera, name);
        app.step(32);
        let lit = capture(&mut app, name);
        for &light in &lights {
            app.world().entity_mut(light).insert(Visibility::Hidden);
        }
        app.step(10);
        let dark = capture(&mut app, name);
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().reset = true;
        app.step(16);
        let fresh = capture(&mut app, name);
        let sum = |values: &[f32]| values.iter().sum::<f32>();
        let (lit, dark, fresh) = (sum(&lit), sum(&dark), sum(&fresh));
        println!("{name}: lit {lit}, dark after 8 frames {dark}, without a past {fresh}");
        // 2 frames pass until a change is traced; 8 for the history.
        assert!(
            (dark - fresh).abs() < 0.02 * (lit - fresh).abs(),
            "{name}: {dark} is left of {lit}, {fresh} without a past"
        );
        for &light in &lights {
            app.world().entity_mut(light).insert(Visibility::Visible);
        }
    }
}

/// While the camera moves, images are close to the truth, too, though not as close as static ones.
#[test]
#[ignore = "long: 677 frames"]
fn a_moving_camera_sees_about_the_truth() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let camera = scene(&mut app, SceneName::EmissiveFloor);
    let end = *app.world().get::<Transform>(camera).unwrap();
    let truth = truth(&mut app, camera, SceneName::EmissiveFloor);
    for name in ["reference", "quarter", "vrs-combined", "vrs-adaptive"] {
        switch(&mut app, camera, name);
        for frame in (0..FRAMES).rev() {
            let mut now = end;
            now.translation += end.right() * (0.004 * frame as f32);
            *app.world().get_mut::<Transform>(camera).unwrap() = now;
            app.step(1);
        }
        let (error, bias) = errors(truth, &capture(&mut app, name));
        println!("moving, {name}: error {error:.4}, bias {bias:+.4}");
        assert!(error < MOST_ERROR_IN_MOTION, "{name}: {error}");
    }
}

/// Images in a flat reflector move as if they lay behind it, and the history that follows them keeps them sharp.
#[test]
fn history_follows_reflected_images() {
    let Some(mut app) = linear_app(stage::SIZE) else { return };
    spawn_mesh(&mut app, wall(), metal(0.15), Transform::IDENTITY);
    for (column, row) in (-6..=6i8).flat_map(|column| (-4..=4i8).map(move |row| (column, row))) {
        let color = [stage::RED, stage::GREEN, [255; 3]][(column + 2 * row).rem_euclid(3) as usize];
        let place = Vec3::new(f32::from(column), f32::from(row), 8.0);
        let at = Transform::from_translation(place);
        spawn_mesh(&mut app, Cuboid::from_length(0.5), unlit(color), at);
    }
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    switch(&mut app, camera, "converged");
    app.step(96);
    let truth = capture(&mut app, "converged");
    let [with, without] = [true, false].map(|virtual_history| {
        switch(&mut app, camera, "reference");
        settings_of(&mut app, camera).denoiser.virtual_history = virtual_history;
        for frame in (0..24u8).rev() {
            let mut now = BEFORE_THE_MIRROR;
            now.translation.x += 0.06 * f32::from(frame);
            *app.world().get_mut::<Transform>(camera).unwrap() = now;
            app.step(1);
        }
        errors(&truth, &capture(&mut app, "reference")).0
    });
    println!("error {with:.4} with a history of images, {without:.4} without one");
    assert!(
        without > 1.08 * with,
        "{with} with a history of images, {without} without one"
    );
}

/// Mean difference between neighbours in a row. On a single surface it is noise.
fn grain(pixels: &[[f32; 4]], width: usize) -> f32 {
    let level = pixels.iter().map(|pixel| pixel[1]).sum::<f32>() / pixels.len() as f32;
    let rows = pixels.chunks_exact(width);
    let apart = rows.flat_map(|row| row.windows(2).map(|pair| (pair[0][1] - pair[1][1]).abs()));
    apart.sum::<f32>() / (pixels.len() as f32 * level)
}

/// The pass that shows young images blurs them where they have noise.
#[test]
fn young_pictures_are_blurred() {
    let size = UVec2::new(96, 64);
    let Some(mut app) = linear_app(size) else { return };
    let app = &mut app;
    let camera = spawn_mirror(app, 0.6, SceneName::Demo);
    let grains = [0.0, 3.0].map(|radius| {
        switch(app, camera, "quarter");
        let mut settings = app.world().get_mut::<RayTracedReflections>(camera).unwrap();
        settings.denoiser.blur_radius = radius;
        settings.denoiser.converge_static_views = false;
        begin_anew(app, camera);
        app.step(3);
        grain(&app.capture_linear().unwrap(), size.x as usize)
    });
    println!("grain {} without the blur, {} with it", grains[0], grains[1]);
    assert!(grains[0] > 0.005 && grains[1] < 0.8 * grains[0], "{grains:?}");
}
