//! Effects of Bevy that meet reflections on their way to the screen.

use crate::{
    common::app_with,
    pictures::reflect,
    stage::{
        BEFORE_THE_MIRROR, SIZE, begin_anew, clear_glass, denoised, metal, spawn_camera, spawn_mesh, spawn_mirror,
        unlit_color, wall,
    },
};
use bevy::{
    light::{FogVolume, VolumetricFog, VolumetricLight},
    pbr::{DistanceFog, FogFalloff, ScreenSpaceAmbientOcclusion},
    prelude::*,
};
use bevy_anti_alias::taa::{TemporalAntiAliasPlugin, TemporalAntiAliasing};
use bevy_glint::{
    NotReflected, ReflectionTechnique, ReflectionTracerChoice,
    internals::{Target, readback},
};
use bevy_post_process::bloom::{Bloom, BloomPlugin};
use glint_scenes::{HeadlessApp, Output, SceneName, decode_halves};

fn app() -> Option<HeadlessApp> {
    app_with(SIZE, Output::Linear, ReflectionTracerChoice::Bvh, |app| {
        app.add_plugins((BloomPlugin, TemporalAntiAliasPlugin));
    })
}

/// Green of each pixel.
fn capture(app: &mut HeadlessApp) -> Vec<f32> {
    let pixels = app.capture_linear().unwrap();
    assert!(pixels.iter().flatten().all(|value| value.is_finite()));
    pixels.into_iter().map(|[_, green, ..]| green).collect()
}

fn mean(values: impl IntoIterator<Item = f32>) -> f32 {
    let (sum, count) = values
        .into_iter()
        .fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// Mean of the differences, relative to the mean of the first image.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    mean(a.iter().zip(b).map(|(a, b)| (a - b).abs())) / mean(a.iter().copied())
}

fn renders_after(app: &mut HeadlessApp, camera: Entity, effect: impl Bundle, frames: u32) -> Vec<f32> {
    app.world().entity_mut(camera).insert(effect);
    app.warm_up(20_000).unwrap();
    app.step(frames);
    capture(app)
}

/// If all rays miss and the surroundings look the same everywhere, traced reflections equal the environment map's. An effect must treat
/// both in the same way.
#[test]
fn effects_treat_rays_as_they_treat_the_environment_map() {
    // Until converged reflections are free of noise.
    const FRAMES: u32 = 40;
    let Some(mut app) = app() else { return };
    let app = &mut app;
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
    // A corner, for occlusion.
    let turned = |angle: f32| Transform::from_rotation(Quat::from_rotation_y(angle));
    for angle in [0.8, -0.8] {
        let object = spawn_mesh(app, wall(), metal(0.4), turned(angle));
        app.world().entity_mut(object).insert(NotReflected);
    }
    let fog = || DistanceFog {
        color: Color::BLACK,
        falloff: FogFalloff::Linear { start: 1.0, end: 6.0 },
        ..default()
    };
    let plain = renders_after(app, camera, (), FRAMES);
    let mut without = vec![("nothing", plain.clone())];
    without.push(("fog", renders_after(app, camera, fog(), FRAMES)));
    app.world().entity_mut(camera).remove::<DistanceFog>();
    without.push(("ambient occlusion", renders_after(app, camera, occlusion(), FRAMES)));
    app.world().entity_mut(camera).remove::<ScreenSpaceAmbientOcclusion>();

    reflect(app, camera, ReflectionTechnique::Converged);
    let mut with = vec![renders_after(app, camera, (), FRAMES)];
    with.push(renders_after(app, camera, fog(), FRAMES));
    app.world().entity_mut(camera).remove::<DistanceFog>();
    with.push(renders_after(app, camera, occlusion(), FRAMES));

    // Bevy's split sum is an approximation, so each image is compared with that without the effect.
    let relative = |image: &[f32], plain: &[f32]| image.iter().zip(plain).map(|(a, b)| a / b).collect::<Vec<_>>();
    for ((name, without), image) in without.iter().zip(&with) {
        let effect = difference(&plain, without);
        let apart = difference(&relative(without, &plain), &relative(image, &with[0]));
        println!("{name}: changes the image by {effect:.4}; with rays it differs by {apart:.4}");
        assert!(*name == "nothing" || effect > 0.1, "{name} does nothing: {effect}");
        assert!(apart < 0.02, "{name}: with rays the image differs by {apart}");
    }
    let apart = difference(&plain, &with[0]);
    assert!(apart < 0.05, "with rays the image differs by {apart}");
}

fn occlusion() -> (Msaa, ScreenSpaceAmbientOcclusion) {
    (Msaa::Off, ScreenSpaceAmbientOcclusion::default())
}

/// Fog in front of the camera dims a lake's reflections as much as the objects behind the lake.
#[test]
fn volumetric_fog_covers_reflections_on_water() {
    let Some(mut app) = app() else { return };
    let app = &mut app;
    let place = Transform::from_xyz(0.0, 2.0, 6.0).looking_at(Vec3::new(0.0, 0.5, -4.0), Vec3::Y);
    let camera = spawn_camera(app, place, SceneName::MirrorRoom);
    app.world().entity_mut(camera).insert(VolumetricFog {
        ambient_intensity: 0.0,
        ..default()
    });
    let lake = Plane3d::default().mesh().size(20.0, 8.0);
    spawn_mesh(app, lake, clear_glass(), Transform::from_xyz(0.0, 0.0, -2.0));
    let at = Transform::from_xyz(0.0, 1.2, -8.0);
    spawn_mesh(app, Cuboid::new(6.0, 1.5, 0.1), unlit_color(Color::WHITE), at);
    app.world().spawn((DirectionalLight::default(), VolumetricLight));
    reflect(app, camera, ReflectionTechnique::Reference);
    app.warm_up(20_000).unwrap();
    let mut image = |fog: f32| {
        let volume = FogVolume {
            density_factor: fog,
            light_tint: Color::BLACK,
            ..default()
        };
        // Beyond it lie the lake and the panel.
        let at = Transform::from_xyz(0.0, 2.0, 4.0).with_scale(Vec3::new(20.0, 20.0, 1.0));
        let volume = app.world().spawn((volume, at)).id();
        app.warm_up(20_000).unwrap();
        app.step(4);
        let image = capture(app);
        app.world().despawn(volume);
        image
    };
    let (clear, foggy) = (image(0.0), image(1.5));
    let width = SIZE.x as usize;
    // Where the panel fills the image above the horizon, and its reflection below.
    let transmittance = |rows: core::ops::Range<usize>| {
        let pixels: Vec<_> = (rows.start * width..rows.end * width)
            .filter(|pixel| clear[*pixel] > 0.02)
            .collect();
        assert!(pixels.len() > 50, "{} pixels show the panel", pixels.len());
        mean(pixels.iter().map(|pixel| foggy[*pixel])) / mean(pixels.iter().map(|pixel| clear[*pixel]))
    };
    let half = SIZE.y as usize / 2;
    let (direct, reflected) = (transmittance(0..half), transmittance(half..SIZE.y as usize));
    println!("{direct:.3} of the light passes the fog, and {reflected:.3} of the lake's");
    assert!((0.1..0.8).contains(&direct), "{direct}");
    assert!((reflected / direct - 1.0).abs() < 0.08, "{direct} and {reflected}");
}

/// Bright objects glow even if only a mirror shows them.
#[test]
fn reflections_bloom() {
    let Some(mut app) = app() else { return };
    let app = &mut app;
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let lamp = unlit_color(Color::linear_rgb(20.0, 20.0, 20.0));
    spawn_mesh(app, Cuboid::from_length(1.0), lamp, Transform::from_xyz(0.0, 0.0, 6.0));
    let off = renders_after(app, camera, Bloom::NATURAL, 4);
    assert_eq!(
        off.iter().filter(|value| **value > 1e-3).count(),
        0,
        "only rays see the lamp"
    );
    app.world().entity_mut(camera).remove::<Bloom>();
    reflect(app, camera, ReflectionTechnique::Reference);
    app.step(4);
    let sharp = capture(app);
    let glowing = renders_after(app, camera, Bloom::NATURAL, 4);
    let around = sharp
        .iter()
        .zip(&glowing)
        .filter(|(sharp, glowing)| **sharp < 1e-4 && **glowing > 0.01)
        .count();
    println!("{around} pixels glow");
    assert!(around > 200, "{around} pixels glow");
}

/// Temporal anti-aliasing moves the camera by parts of a pixel. If nothing else moves, the image must be steady, and history must last as
/// long as without jitter.
#[test]
fn a_jittered_camera_keeps_its_history() {
    let Some(mut app) = app() else { return };
    let app = &mut app;
    let camera = app.spawn_scene(SceneName::EmissiveFloor, &default());
    reflect(app, camera, ReflectionTechnique::Variable);
    let settings = denoised(ReflectionTechnique::Variable);
    app.world().entity_mut(camera).insert(settings);
    let mut show = || {
        begin_anew(app, camera);
        app.step(24);
        let history = readback::copy(app.app(), camera, Target::HistoryRadiance).expect("the camera has a history");
        let texels = decode_halves(bytemuck::cast_slice(&history.words));
        let lengths = texels.into_iter().map(|[.., length]| length);
        let length = mean(lengths.filter(|length| *length > 0.0));
        let before = capture(app);
        app.step(1);
        let flicker = difference(&before, &capture(app));
        app.world()
            .entity_mut(camera)
            .insert((Msaa::Off, TemporalAntiAliasing::default()));
        (length, flicker)
    };
    let [(length, flicker), (jittered_length, jittered_flicker)] = [show(), show()];
    println!(
        "histories of {length} frames, {jittered_length} with jitter; flicker {flicker:.4}, {jittered_flicker:.4}"
    );
    assert!(
        length > 4.0 && jittered_length > 0.5 * length,
        "{length} frames, {jittered_length} with jitter"
    );
    assert!(
        jittered_flicker < 1.5 * flicker,
        "{flicker}, {jittered_flicker} with jitter"
    );
}
