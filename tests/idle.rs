//! Cameras that see nothing to reflect on rest, and wake when they do.

#[path = "common/pictures.rs"]
mod pictures;

use bevy::{
    camera::{ClearColorConfig, Viewport},
    math::UVec2,
    prelude::*,
    render::{RenderApp, render_resource::PollType, renderer::RenderDevice},
};
use bevy_glint::{
    RayTracedReflections, ReflectionBackend, ReflectionDebugView, ReflectionDenoiser, ReflectionStatus,
    ReflectionStatusReport, ReflectionTechnique, ReflectionTracerChoice, ShadingRateTileSize,
};
use core::f32::consts::PI;
use glint_scenes::{HeadlessApp, Output, SceneName, environment};
use pictures::{app, assert_flip, warm_up};

const BOTH: [ReflectionTracerChoice; 2] = [ReflectionTracerChoice::RayQuery, ReflectionTracerChoice::Bvh];
const SIZE: UVec2 = UVec2::new(96, 64);
const BEFORE_THE_WALL: Transform = Transform::from_xyz(0.0, 0.0, 3.0);

fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    let world = app.world();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// A metal wall that fills the picture of a camera three metres before it.
fn spawn_wall(app: &mut HeadlessApp, perceptual_roughness: f32, at: Transform) -> Entity {
    let metal = StandardMaterial {
        metallic: 1.0,
        perceptual_roughness,
        ..default()
    };
    spawn_mesh(app, Rectangle::new(12.0, 12.0), metal, at)
}

/// In white surroundings, where metal without its environment's light would be black.
fn spawn_camera(app: &mut HeadlessApp, at: Transform) -> Entity {
    let environment = environment(SceneName::Furnace, app.world());
    let camera = app.spawn_camera(at);
    environment.insert(&mut app.world().entity_mut(camera));
    camera
}

/// A camera before a rough wall, and behind the camera a red cube, which only a mirror would show.
fn stage(app: &mut HeadlessApp) -> Entity {
    spawn_wall(app, 1.0, Transform::IDENTITY);
    let red = StandardMaterial {
        base_color: Color::srgb_u8(255, 0, 0),
        unlit: true,
        ..default()
    };
    let behind = Transform::from_xyz(-2.5, 0.0, 6.0);
    spawn_mesh(app, Cuboid::from_length(2.0), red, behind);
    spawn_camera(app, BEFORE_THE_WALL)
}

/// Smooth surfaces reflect, without noise; the rough wall doesn't.
fn reflections() -> RayTracedReflections {
    RayTracedReflections {
        technique: ReflectionTechnique::Reference,
        denoiser: ReflectionDenoiser::OFF,
        full_resolution_mirrors: false,
        roughness_cutoff: 0.6,
        roughness_fade: 0.0,
        ..default()
    }
}

fn reflect(app: &mut HeadlessApp, camera: Entity) {
    app.world().entity_mut(camera).insert(reflections());
    warm_up(app);
}

fn change(app: &mut HeadlessApp, camera: Entity, change: impl FnOnce(&mut RayTracedReflections)) {
    change(&mut app.world().get_mut::<RayTracedReflections>(camera).unwrap());
}

/// Renders one frame and waits for the GPU, so that the next frame finds the report.
fn frame(app: &mut HeadlessApp) {
    app.step(1);
    let world = app.app().sub_app(RenderApp).world();
    let wait = PollType::Wait {
        submission_index: None,
        timeout: None,
    };
    world.resource::<RenderDevice>().poll(wait).unwrap();
}

fn report(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

/// Renders until exactly one camera rests.
#[track_caller]
fn until_one_rests(app: &mut HeadlessApp) {
    for _ in 0..30 {
        frame(app);
        if report(app).culled_views == 1 {
            return;
        }
    }
    panic!("after 30 frames: {:?}", report(app));
}

/// Renders some frames, in all of which so many cameras rest.
#[track_caller]
fn expect_resting(app: &mut HeadlessApp, what: &str, frames: u32, resting: usize) {
    for number in 0..frames {
        frame(app);
        assert_eq!(report(app).culled_views, resting, "{what}: frame {number}");
    }
}

fn differing_pixels(a: &[u8], b: &[u8], tolerance: u8) -> usize {
    let apart = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > tolerance);
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(apart).count()
}

fn red_pixels(picture: &[u8]) -> usize {
    let is_red = |pixel: &&[u8]| pixel[0] > 230 && pixel[1] < 25 && pixel[2] < 25;
    picture.chunks_exact(4).filter(is_red).count()
}

#[test]
fn a_camera_that_rests_shows_what_one_without_reflections_shows() {
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = stage(&mut app);
        app.warm_up(20_000).unwrap();
        app.step(2);
        let without = app.capture().unwrap();
        reflect(&mut app, camera);
        until_one_rests(&mut app);
        expect_resting(&mut app, "nothing changes", 10, 1);
        let picture = app.capture().unwrap();
        assert_eq!(differing_pixels(&without, &picture, 1), 0, "{tracer:?}");
        let status = report(&mut app);
        assert!(status.ready, "{status:?}");
        assert_eq!(status.active_backends, [(camera, ReflectionBackend::Compute)]);

        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        expect_resting(&mut app, "without the component", 2, 0);
    }
}

#[test]
fn a_mirror_that_comes_into_view_wakes_the_camera() {
    let mirror = Transform::from_xyz(0.0, 0.0, 0.1);
    for tracer in BOTH {
        let Some(mut never_at_rest) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = stage(&mut never_at_rest);
        spawn_wall(&mut never_at_rest, 0.0, mirror);
        reflect(&mut never_at_rest, camera);
        expect_resting(&mut never_at_rest, "with a mirror from the start", 12, 0);
        let expected = never_at_rest.capture().unwrap();
        drop(never_at_rest);

        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = stage(&mut app);
        reflect(&mut app, camera);
        until_one_rests(&mut app);
        assert_eq!(red_pixels(&app.capture().unwrap()), 0, "{tracer:?}: the wall is rough");
        spawn_wall(&mut app, 0.0, mirror);
        let mut frames = 0;
        loop {
            frame(&mut app);
            frames += 1;
            if report(&mut app).culled_views == 0 {
                break;
            }
            assert!(frames < 6, "{tracer:?}: still at rest after {frames} frames");
            let middle = 4 * (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
            let brightness = app.capture().unwrap()[middle];
            assert!(
                brightness > 100,
                "{tracer:?}: frame {frames} shows the environment as {brightness}"
            );
        }
        for _ in frames..12 {
            frame(&mut app);
        }
        assert_eq!(report(&mut app).culled_views, 0);
        let woken = app.capture().unwrap();
        let red = red_pixels(&woken);
        assert!(red > 25, "{tracer:?}: {red} pixels of the mirror show the cube");
        assert_flip(&format!("idle-woken-{tracer:?}"), SIZE, &expected, &woken, 0.01);
    }
}

#[test]
fn whoever_changes_something_wakes_the_camera_at_once() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Auto) else {
        return;
    };
    let app = &mut app;
    let camera = stage(app);
    reflect(app, camera);
    until_one_rests(app);

    change(app, camera, |settings| settings.roughness_cutoff = 1.0);
    expect_resting(app, "the rough wall reflects", 20, 0);
    change(app, camera, |settings| settings.roughness_cutoff = 0.6);
    until_one_rests(app);

    change(app, camera, |settings| settings.reset = true);
    expect_resting(app, "a cut", 1, 0);
    until_one_rests(app);

    app.world().entity_mut(camera).insert(ShadingRateTileSize::Tiles8);
    expect_resting(app, "other tiles", 1, 0);
    warm_up(app);
    until_one_rests(app);

    app.world().entity_mut(camera).insert(ReflectionDebugView::ShadingRates);
    expect_resting(app, "a debug view", 20, 0);
    app.world().entity_mut(camera).remove::<ReflectionDebugView>();
    until_one_rests(app);

    app.world().get_mut::<Camera>(camera).unwrap().viewport = Some(Viewport {
        physical_size: SIZE / 2,
        ..default()
    });
    // The size is known after it was decided who rests.
    frame(app);
    expect_resting(app, "another size", 1, 0);
    until_one_rests(app);

    change(app, camera, |settings| {
        settings.technique = ReflectionTechnique::Converged;
    });
    expect_resting(app, "the ground truth", 30, 0);
}

#[test]
fn cameras_rest_and_wake_for_themselves() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Auto) else {
        return;
    };
    let app = &mut app;
    let rough = stage(app);
    let facing_back = Transform::from_xyz(0.0, 0.0, 10.0).with_rotation(Quat::from_rotation_y(PI));
    spawn_wall(app, 0.0, facing_back);
    let turned = BEFORE_THE_WALL.looking_to(Vec3::Z, Vec3::Y);
    let smooth = spawn_camera(app, turned);
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    for (order, camera) in [rough, smooth].into_iter().enumerate() {
        let mut camera = app.world().get_mut::<Camera>(camera).unwrap();
        camera.order = order as isize;
        camera.viewport = Some(Viewport {
            physical_position: UVec2::new(order as u32 * half.x, 0),
            physical_size: half,
            ..default()
        });
        if order > 0 {
            camera.clear_color = ClearColorConfig::None;
        }
    }
    reflect(app, rough);
    reflect(app, smooth);
    until_one_rests(app);
    expect_resting(app, "one wall is rough", 20, 1);
    assert_eq!(report(app).active_backends.len(), 2);

    *app.world().get_mut::<Transform>(rough).unwrap() = turned;
    let awake = (0..6).any(|_| {
        frame(app);
        report(app).culled_views == 0
    });
    assert!(awake, "both cameras see the mirror");
    expect_resting(app, "both cameras see the mirror", 20, 0);

    *app.world().get_mut::<Transform>(smooth).unwrap() = BEFORE_THE_WALL;
    until_one_rests(app);
}
