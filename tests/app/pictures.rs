//! Renders scenes and compares images.

use crate::{
    common::{app, app_of, app_with},
    stage::{plain, report, settings_of, until},
};
use bevy::{
    diagnostic::FrameCount,
    light::{CascadeShadowConfig, DirectionalLightShadowMap, PointLightShadowMap},
    math::UVec2,
    prelude::*,
    render::settings::{WgpuFeatures, WgpuLimits, WgpuSettings},
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique, ReflectionTracerChoice, internals::restart_noise};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName, SceneOptions, note_left_out};
use std::{env, ops::Range, path::PathBuf};

/// Pixels per degree of the paper's display: 2,560 pixels over 0.5 m at 0.62 m.
pub const PIXELS_PER_DEGREE: f32 = 55.4;

/// Limit of frames for loading, compiling and building.
pub const PATIENCE: u32 = 20_000;

/// Few triangles and texels, for tests that compare a scene with itself: a CPU takes longer to bake and draw fine ones than to trace
/// all rays.
pub const COARSE: SceneOptions = SceneOptions {
    detail: 0.25,
    texture_size: 64,
};

pub const BOTH: [ReflectionTracerChoice; 2] = [ReflectionTracerChoice::RayQuery, ReflectionTracerChoice::Bvh];

/// Environment variable with the tracer of tests that any tracer can run: `bvh` (the default), `ray-query` or `all`.
const TRACER: &str = "GLINT_TEST_TRACER";

/// Tracers for a test of steps before or after tracing: only the BVH, since `tests/shaders/tracer` compares both ray by ray. The
/// long tests of `cargo xtask test --all` repeat it with ray queries.
pub fn any_tracer() -> impl Iterator<Item = ReflectionTracerChoice> {
    let word = env::var(TRACER).unwrap_or_else(|_| "bvh".to_owned());
    if word == "bvh" {
        note_left_out("ray-query");
    }
    let is_chosen = move |tracer: &ReflectionTracerChoice| word == "all" || Ok(*tracer) == word.parse();
    BOTH.into_iter().filter(is_chosen)
}

/// Apps for a test of steps before or after tracing, one after the other; see [`any_tracer`].
pub fn apps(size: UVec2, output: Output) -> impl Iterator<Item = (ReflectionTracerChoice, HeadlessApp)> {
    apps_with(size, output, |_| {})
}

/// Like [`apps`], with more plugins.
pub fn apps_with(
    size: UVec2,
    output: Output,
    add: impl Fn(&mut App),
) -> impl Iterator<Item = (ReflectionTracerChoice, HeadlessApp)> {
    any_tracer().filter_map(move |tracer| Some((tracer, app_with(size, output, tracer, &add)?)))
}

/// An app for each tracer that this machine supports, one after the other: for tests of ray hits.
pub fn apps_of_both(size: UVec2, output: Output) -> impl Iterator<Item = (ReflectionTracerChoice, HeadlessApp)> {
    BOTH.into_iter()
        .filter_map(move |tracer| Some((tracer, app(size, output, tracer)?)))
}

/// An app with a picture, for tests of one tracer.
pub fn picture_app(size: UVec2) -> Option<HeadlessApp> {
    app(size, Output::Picture, ReflectionTracerChoice::Bvh)
}

/// An app with linear light, for tests of one tracer.
pub fn linear_app(size: UVec2) -> Option<HeadlessApp> {
    app(size, Output::Linear, ReflectionTracerChoice::Bvh)
}

/// An app of pictures on a device with fewer features or lower limits, for tests of one tracer.
pub fn app_of_device(size: UVec2, device: WgpuSettings) -> Option<HeadlessApp> {
    let settings = HeadlessSettings {
        size,
        device,
        ..default()
    };
    app_of(settings, ReflectionTracerChoice::Bvh, |_| {}, |_| {})
}

pub fn limited(limits: WgpuLimits) -> WgpuSettings {
    WgpuSettings {
        constrained_limits: Some(limits),
        ..default()
    }
}

/// A device on which nothing can be traced.
pub fn weak_device() -> WgpuSettings {
    limited(WgpuLimits {
        max_storage_buffers_per_shader_stage: 7,
        ..default()
    })
}

pub fn device_without(features: WgpuFeatures) -> WgpuSettings {
    WgpuSettings {
        disabled_features: Some(features),
        ..default()
    }
}

/// Makes shadow maps coarse, for images that differ only in their reflections: a CPU takes longer to draw fine ones than to trace
/// all rays. Reflections trace shadow rays instead.
pub fn use_coarse_shadow_maps(app: &mut HeadlessApp) {
    let world = app.world();
    world.insert_resource(DirectionalLightShadowMap { size: 256 });
    world.insert_resource(PointLightShadowMap { size: 128 });
    world.add_observer(
        |sun: On<Add<CascadeShadowConfig>>, mut suns: Query<&mut CascadeShadowConfig>| {
            if let Ok(mut cascades) = suns.get_mut(sun.entity) {
                let all_but_last = ..cascades.bounds.len().saturating_sub(1);
                cascades.bounds.drain(all_but_last);
            }
        },
    );
}

/// Spawns a scene with a camera that reflects everything, and waits until rays can hit all of it.
pub fn spawn(app: &mut HeadlessApp, scene: SceneName, technique: ReflectionTechnique) -> Entity {
    let camera = app.spawn_scene(scene, &COARSE);
    reflect(app, camera, technique);
    camera
}

/// Switches reflections on without a cut-off and waits until the scene can be hit.
pub fn reflect(app: &mut HeadlessApp, camera: Entity, technique: ReflectionTechnique) {
    let settings = RayTracedReflections {
        technique,
        roughness_cutoff: 1.0,
        roughness_fade: 0.0,
        forward: true,
        ..plain()
    };
    app.world().entity_mut(camera).insert(settings);
    warm_up(app);
    settings_of(app, camera).reset = true;
}

/// Waits until pipelines are compiled and meshes are built, then begins the history anew.
pub fn warm_up(app: &mut HeadlessApp) {
    app.warm_up(PATIENCE).unwrap_or_else(|error| panic!("{error}"));
    until(app, "not ready", |app| {
        let report = report(app);
        report.ready && report.meshes_pending == 0
    });
    // Noise and histories that don't depend on how long the machine compiled.
    app.world().resource_mut::<FrameCount>().0 = 0;
    if let Ok(world) = app.render_world_mut() {
        restart_noise(world);
    }
    let mut views = app.world().query::<(&Camera, &mut RayTracedReflections)>();
    for (camera, mut settings) in views.iter_mut(app.world()) {
        if camera.is_active {
            settings.reset = true;
        }
    }
    // The last upload is traced in the next frame. Then histories grow as long as those of frames in which nothing compiles.
    app.step(6);
}

/// Returns the mean FLIP of two RGBA images. If it is above `limit`, both images and the error map are written and the test fails.
pub fn assert_flip(name: &str, size: UVec2, expected: &[u8], actual: &[u8], limit: f32) -> f32 {
    let mean = flip(size, expected, actual).0;
    println!("{name}: mean FLIP {mean:.5}, at most {limit}");
    if mean.is_nan() || mean > limit {
        let folder = dump(name, size, expected, actual);
        panic!("{name}: mean FLIP {mean:.5} is above {limit}; see {}", folder.display());
    }
    mean
}

/// Mean FLIP of two RGBA images and its map, one value for each pixel.
pub fn flip(size: UVec2, expected: &[u8], actual: &[u8]) -> (f32, Vec<f32>) {
    let map = nv_flip::flip(image(size, expected), image(size, actual), PIXELS_PER_DEGREE);
    let mean = nv_flip::FlipPool::from_image(&map).mean();
    (mean, map.to_vec())
}

fn image(size: UVec2, rgba: &[u8]) -> nv_flip::FlipImageRgb8 {
    let rgb: Vec<u8> = rgba
        .chunks_exact(4)
        .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
        .collect();
    nv_flip::FlipImageRgb8::with_data(size.x, size.y, &rgb)
}

/// Writes images for people to look at, and returns their folder.
pub fn dump(name: &str, size: UVec2, expected: &[u8], actual: &[u8]) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    for (suffix, bytes) in [("expected", expected), ("actual", actual)] {
        let path = folder.join(format!("{name}-{suffix}.png"));
        glint_scenes::save_picture(size, bytes.to_vec(), &path).unwrap_or_else(|error| panic!("{error}"));
    }
    let map = flip(size, expected, actual).1;
    let gray = map
        .iter()
        .map(|error| (error * 255.0) as u8)
        .flat_map(|gray| [gray, gray, gray, 255]);
    let path = folder.join(format!("{name}-difference.png"));
    glint_scenes::save_picture(size, gray.collect(), &path).unwrap_or_else(|error| panic!("{error}"));
    folder
}

/// Pixels with a channel that differs by more than `tolerance`.
pub fn differing_pixels(a: &[u8], b: &[u8], tolerance: u8) -> usize {
    let apart = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > tolerance);
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(apart).count()
}

/// Pixels with a colour that differs by at most `tolerance` in each channel.
pub fn pixels_like(picture: &[u8], color: [u8; 3], tolerance: u8) -> usize {
    let is_like = |pixel: &&[u8]| pixel[..3].iter().zip(color).all(|(a, b)| a.abs_diff(b) <= tolerance);
    picture.chunks_exact(4).filter(is_like).count()
}

pub fn red_pixels(picture: &[u8]) -> usize {
    let is_red = |pixel: &&[u8]| pixel[0] > 230 && pixel[1] < 25 && pixel[2] < 25;
    picture.chunks_exact(4).filter(is_red).count()
}

/// Columns of an image of this width.
pub fn crop(picture: &[u8], width: u32, columns: Range<usize>) -> Vec<u8> {
    let lines = picture.chunks_exact(4 * width as usize);
    lines
        .flat_map(|line| &line[4 * columns.start..4 * columns.end])
        .copied()
        .collect()
}
