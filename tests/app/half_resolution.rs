//! A denoiser at half the resolution shows what one at full resolution shows.

use crate::{
    pictures::{COARSE, assert_flip, differing_pixels, flip, picture_app, use_coarse_shadow_maps, warm_up},
    stage::{metal, spawn_camera, spawn_mesh, unlit},
};
use bevy::{math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionDebugView, ReflectionTechnique, ShadingRateHeuristic};
use core::f32::consts::FRAC_PI_4;
use glint_scenes::{HeadlessApp, SceneName};

/// Not a multiple of two: the last texels have a part of their pixels.
const SIZE: UVec2 = UVec2::new(183, 103);
/// Frames until a static view has hardly any noise.
const STILL_FRAMES: u32 = 64;
/// Largest mean FLIP beside full resolution: in a static view, of its reflections alone, and of exact mirrors, which keep their rays.
const LIMIT: f32 = 0.024;
const LIMIT_ALONE: f32 = 0.06;
const MIRROR_LIMIT: f32 = 0.002;
/// Smallest mean of a frame's channels, relative to full resolution.
const LEAST_LIGHT: f32 = 0.95;

fn open(scene: SceneName) -> Option<(HeadlessApp, Entity)> {
    let mut app = picture_app(SIZE)?;
    use_coarse_shadow_maps(&mut app);
    let camera = app.spawn_scene(scene, &COARSE);
    Some((app, camera))
}

fn settings(technique: ReflectionTechnique, half_resolution: bool) -> RayTracedReflections {
    let mut settings = RayTracedReflections { technique, ..default() };
    settings.denoiser.half_resolution = half_resolution;
    settings
}

/// The frame of a static view with these settings.
fn settled(app: &mut HeadlessApp, camera: Entity, settings: RayTracedReflections) -> Vec<u8> {
    settled_after(app, camera, settings, STILL_FRAMES)
}

fn settled_after(app: &mut HeadlessApp, camera: Entity, settings: RayTracedReflections, frames: u32) -> Vec<u8> {
    app.world().entity_mut(camera).insert(settings);
    warm_up(app);
    app.step(frames);
    app.capture().unwrap()
}

fn mean(frame: &[u8]) -> f32 {
    let sum: u64 = frame.iter().map(|byte| u64::from(*byte)).sum();
    sum as f32 / frame.len() as f32
}

/// Reflections on metal and stone, and on glass.
#[test]
fn half_resolution_shows_what_full_resolution_shows() {
    for (scene, technique) in [
        (SceneName::AtriumSmall, ReflectionTechnique::Variable),
        (SceneName::Glass, ReflectionTechnique::Quarter),
    ] {
        let Some((mut app, camera)) = open(scene) else { return };
        let app = &mut app;
        let full = settled(app, camera, settings(technique, false));
        let half = settled(app, camera, settings(technique, true));
        assert_flip(&format!("half-{scene:?}-{technique}"), SIZE, &full, &half, LIMIT);
        assert_ne!(full, half, "{technique}: nothing changed");
        let (before, after) = (mean(&full), mean(&half));
        assert!((after / before - 1.0).abs() < 1.0 - LEAST_LIGHT, "{before} -> {after}");
    }
}

/// Exact mirrors with rays of their own are as sharp as before, and rays of blocks as sharp as the texels.
#[test]
fn exact_mirrors_keep_their_rays() {
    let Some((mut app, camera)) = open(SceneName::MirrorRoom) else {
        return;
    };
    let app = &mut app;
    let mut shown = |half, own_rays| {
        let settings = RayTracedReflections {
            full_resolution_mirrors: own_rays,
            ..settings(ReflectionTechnique::Quarter, half)
        };
        settled(app, camera, settings)
    };
    let (full, half, shared) = (shown(false, true), shown(true, true), shown(true, false));
    assert_flip("half-mirrors", SIZE, &full, &half, MIRROR_LIMIT);
    let blurred = flip(SIZE, &full, &shared).0;
    assert!(blurred > 2.0 * MIRROR_LIMIT, "texels are as sharp as pixels: {blurred}");
}

/// At the edges of a slab that reflects black, before a wall that reflects white, no texel shows the reflection of the other surface.
#[test]
fn reflections_stay_on_their_surface() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let app = &mut app;
    let back = Cuboid::new(40.0, 40.0, 0.1);
    spawn_mesh(app, back, metal(0.2), Transform::from_xyz(0.0, 0.0, -8.0));
    let turn = Quat::from_rotation_y(FRAC_PI_4) * Quat::from_rotation_z(0.4);
    let slab = Transform::from_xyz(0.0, 0.0, -3.0).with_rotation(turn);
    spawn_mesh(app, Cuboid::new(0.8, 1.6, 0.02), metal(0.2), slab);
    let panel = Cuboid::new(0.1, 40.0, 40.0);
    spawn_mesh(app, panel, unlit([0; 3]), Transform::from_xyz(12.0, 0.0, -3.0));
    let camera = spawn_camera(app, Transform::IDENTITY, SceneName::Furnace);
    let full = settled(app, camera, settings(ReflectionTechnique::Quarter, false));
    let half = settled(app, camera, settings(ReflectionTechnique::Quarter, true));
    let dark = |image: &[u8]| image.chunks_exact(4).filter(|pixel| pixel[1] < 64).count();
    let (slab, pixels) = (dark(&full), (SIZE.x * SIZE.y) as usize);
    assert!(
        slab > pixels / 100 && slab < pixels / 2,
        "the slab has {slab} dark pixels"
    );
    let differing = differing_pixels(&full, &half, 32);
    println!("{differing} pixels differ, of {slab} of the slab");
    assert!(differing < slab / 50, "{differing} of {slab}");
}

/// A camera that switches keeps its reflections while the other passes are compiled, and debug views show texels in their place.
#[test]
#[ignore = "long: compiles for each size"]
fn switching_loses_no_reflection() {
    let Some((mut app, camera)) = open(SceneName::AtriumSmall) else {
        return;
    };
    let app = &mut app;
    // Its noise doesn't change its light.
    let plain = settings(ReflectionTechnique::Variable, false);
    let steady = mean(&settled_after(app, camera, plain, 16));
    app.world()
        .entity_mut(camera)
        .insert(ShadingRateHeuristic::PAPER_ROUGHNESS);
    for half in [true, false, true] {
        app.world()
            .entity_mut(camera)
            .insert(settings(ReflectionTechnique::Variable, half));
        for frame in 0..12 {
            app.step(1);
            let light = mean(&app.capture().unwrap()) / steady;
            assert!(light > LEAST_LIGHT, "half {half}, frame {frame}: {light} of the light");
        }
    }
    let view = |app: &mut HeadlessApp, half| {
        app.world().entity_mut(camera).insert(ReflectionDebugView::Reflection);
        settled(app, camera, settings(ReflectionTechnique::Quarter, half))
    };
    let (full, half) = (view(app, false), view(app, true));
    assert_flip("half-debug-view", SIZE, &full, &half, LIMIT_ALONE);
}
