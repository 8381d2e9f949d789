//! Views with a constantly changing size keep their history and their textures: dynamic resolution, and viewports that grow.

use crate::{
    pictures::{picture_app, reflect, warm_up},
    stage::{metal, report, spawn_camera, spawn_mesh, unlit},
};
use bevy::{
    camera::{MainPassResolutionOverride, Viewport},
    math::UVec2,
    prelude::*,
    render::{RenderApp, sync_world::RenderEntity},
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique};
use glint_scenes::{HeadlessApp, SceneName};

const SIZE: UVec2 = UVec2::new(128, 80);
/// A part of SIZE, and not a multiple of a tile.
const SMALL: UVec2 = UVec2::new(90, 58);
/// Frames between two steps.
const EVERY: u32 = 4;
/// Maximum error with a changing size, as a multiple of the error with a fixed one.
const LIMIT: f32 = 1.3;

/// A glossy floor before coloured cubes.
fn scene(app: &mut HeadlessApp) -> Entity {
    let floor = Plane3d::default().mesh().size(20.0, 20.0);
    spawn_mesh(app, floor, metal(0.45), Transform::IDENTITY);
    for index in 0..24_u8 {
        let (x, y) = (f32::from(index % 8) - 3.5, f32::from(index / 8));
        let color = [200 * (index % 2), 40 + 8 * index, 220 - 9 * index];
        let at = Transform::from_xyz(1.6 * x, 0.8 + 1.6 * y, -4.0);
        spawn_mesh(app, Cuboid::from_length(1.6), unlit(color), at);
    }
    let view = Transform::from_xyz(0.0, 1.2, 4.0).looking_at(Vec3::new(0.0, 0.4, -2.0), Vec3::Y);
    spawn_camera(app, view, SceneName::MirrorRoom)
}

/// Has a camera render at a lower resolution, into a corner of its target.
pub fn resize(app: &mut HeadlessApp, camera: Entity, size: UVec2) {
    let view = app.world().get::<RenderEntity>(camera).unwrap().id();
    let render_world = app.app().sub_app_mut(RenderApp).world_mut();
    render_world.entity_mut(view).insert(MainPassResolutionOverride(size));
}

/// Mean difference of the pixels that both sizes render.
fn error(frame: &[u8], truth: &[u8]) -> f32 {
    let mut sum = 0.0;
    for y in 0..SMALL.y {
        for x in 0..SMALL.x {
            let first = 4 * (y * SIZE.x + x) as usize;
            let channels = first..first + 3;
            sum += channels.map(|i| f32::from(frame[i].abs_diff(truth[i]))).sum::<f32>();
        }
    }
    sum / (3 * SMALL.x * SMALL.y) as f32
}

#[test]
fn dynamic_resolution_keeps_history_and_textures() {
    change_size(16);
}

#[test]
#[ignore = "long: 600 frames of each technique"]
fn dynamic_resolution_keeps_history_and_textures_for_long() {
    change_size(150);
}

fn change_size(steps: u32) {
    let Some(mut app) = picture_app(SIZE) else { return };
    let app = &mut app;
    let camera = scene(app);
    app.step(2);
    let sizes = [SIZE, SMALL];
    let truths = sizes.map(|size| {
        resize(app, camera, size);
        reflect(app, camera, ReflectionTechnique::Converged);
        app.step(96);
        app.capture().unwrap()
    });
    for (technique, half_resolution) in [
        (ReflectionTechnique::Variable, false),
        (ReflectionTechnique::Variable, true),
        (ReflectionTechnique::Reference, false),
    ] {
        let mut settings = RayTracedReflections { technique, ..default() };
        settings.denoiser.half_resolution = half_resolution;
        // Static with the noise of motion.
        settings.denoiser.converge_static_views = false;
        app.world().entity_mut(camera).insert(settings);
        let mut fixed = 0.0;
        for (size, truth) in sizes.iter().zip(&truths) {
            resize(app, camera, *size);
            warm_up(app);
            app.step(34);
            for _ in 0..8 {
                app.step(1);
                fixed += error(&app.capture().unwrap(), truth) / 16.0;
            }
        }
        let memory = report(app).view_memory[0].parts.clone();
        let (mut toggled, mut worst) = (0.0, 0.0_f32);
        for step in 0..steps {
            let index = (step % 2) as usize;
            resize(app, camera, sizes[index]);
            for _ in 0..EVERY {
                app.step(1);
                let now = error(&app.capture().unwrap(), &truths[index]);
                toggled += now / (steps * EVERY) as f32;
                worst = worst.max(now);
            }
            assert_eq!(report(app).view_memory[0].parts, memory, "{technique:?}: step {step}");
        }
        println!(
            "{technique:?}: error {fixed:.2} of fixed sizes, {toggled:.2} of changing ones, {worst:.2} in the worst frame"
        );
        assert!(
            toggled <= LIMIT * fixed && worst <= 1.5 * LIMIT * fixed,
            "{technique:?}: {toggled} of {fixed}, {worst} in the worst frame"
        );
    }
}

/// Like a window that is dragged, or a split screen that slides.
#[test]
fn a_viewport_that_grows_is_made_anew_a_few_times() {
    let size = UVec2::new(160, 96);
    let Some(mut app) = picture_app(size) else { return };
    let app = &mut app;
    let camera = scene(app);
    app.world().entity_mut(camera).insert(RayTracedReflections::default());
    let mut sizes = Vec::new();
    for width in (80..=size.x).chain((100..size.x).rev()) {
        app.world().get_mut::<Camera>(camera).unwrap().viewport = Some(Viewport {
            physical_size: UVec2::new(width, size.y),
            ..default()
        });
        if width == 80 {
            warm_up(app);
        }
        app.step(1);
        let memory = &report(app).view_memory[0];
        assert!(memory.pixels > 0, "{width}");
        sizes.push(memory.parts.clone());
    }
    sizes.dedup();
    assert!(sizes.len() <= 5, "{} times", sizes.len());
}
