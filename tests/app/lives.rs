//! Cameras that come and go: reflections exist in their first frame, and survive a frame without any camera.

mod pauses;
mod random;

use crate::{
    pictures::{differing_pixels, picture_app, red_pixels, warm_up},
    stage::{
        BEFORE_THE_MIRROR, RED, SIZE, clear_glass, frame, layer_bytes, metal, plain, report, settings_of, share_app,
        spawn_camera, spawn_mesh, unlit, until_at_rest, wall,
    },
};
use bevy::prelude::*;
use bevy_glint::{
    RayTracedReflections, ReflectionRetention, ReflectionTechnique, ReflectionTracerChoice, ShadingRateHeuristic,
    internals::readback,
};
use core::time::Duration;
use glint_scenes::{HeadlessApp, SceneName};
use std::time::Instant;

/// Longer than any test.
const FOREVER: ReflectionRetention = ReflectionRetention(Duration::from_secs(1_000_000));

/// A mirror, and behind the camera a red cube among other objects that are merged.
fn spawn_scene(app: &mut HeadlessApp) {
    spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
    for index in 0..9 {
        let at = Transform::from_xyz(index as f32 - 4.0, 0.0, 6.0);
        spawn_mesh(app, Cuboid::from_length(0.9), unlit(RED), at);
    }
}

/// In white surroundings, which a mirror shows without reflections.
fn spawn_reflecting(app: &mut HeadlessApp) -> Entity {
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
    app.world().entity_mut(camera).insert(plain());
    camera
}

fn activate(app: &mut HeadlessApp, camera: Entity, active: bool) {
    app.world().get_mut::<Camera>(camera).unwrap().is_active = active;
}

fn retain(app: &mut HeadlessApp, retention: ReflectionRetention) {
    app.world().insert_resource(retention);
}

fn red(app: &mut HeadlessApp) -> usize {
    red_pixels(&app.capture().unwrap())
}

#[test]
fn cameras_come_and_go() {
    share_app(&[
        a_camera_that_draws_every_other_frame_reflects,
        a_cut_shows_reflections_in_its_first_frame,
        a_cut_keeps_the_history_of_what_both_cameras_see,
        a_frame_without_a_camera_loses_nothing,
        a_change_in_a_pause_is_followed,
        pauses::glass_reflects_in_the_first_frame_after_a_pause,
        pauses::a_camera_that_moves_in_a_pause_finds_its_history,
        pauses::a_camera_that_draws_every_other_frame_gets_prepasses,
        pauses::a_converged_view_stays_so_across_a_cut,
        pauses::the_screen_before_a_pause_is_not_reused,
        after_a_time_without_a_camera_all_is_freed,
        a_reset_is_not_put_off_by_pipelines,
        images_of_rates_can_take_turns,
        cameras_that_reflect_later_have_the_hook_already,
        the_report_names_cameras_that_exist,
        a_front_layer_outlives_its_glass,
    ]);
}

fn a_camera_that_draws_every_other_frame_reflects(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    for retention in [FOREVER, ReflectionRetention(Duration::ZERO)] {
        retain(app, retention);
        spawn_scene(app);
        let monitor = spawn_reflecting(app);
        // Another camera, which sees nothing, keeps the scene.
        let away = BEFORE_THE_MIRROR.with_translation(Vec3::new(0.0, 500.0, 0.0));
        let main = spawn_camera(app, away, SceneName::Furnace);
        app.world().entity_mut(main).insert(plain());
        app.world().get_mut::<Camera>(main).unwrap().order = -1;
        activate(app, monitor, false);
        warm_up(app);
        let mut shown = Vec::new();
        for index in 0..12 {
            activate(app, monitor, index % 2 == 0);
            frame(app);
            if index % 2 == 0 {
                shown.push(red(app));
            }
        }
        assert!(
            shown.iter().all(|red| *red > 100),
            "{tracer:?}, {retention:?}: {shown:?} red pixels"
        );
        crate::stage::clear(app);
    }
}

fn a_cut_shows_reflections_in_its_first_frame(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let cameras = [(); 2].map(|()| spawn_reflecting(app));
    activate(app, cameras[1], false);
    warm_up(app);
    let expected = red(app);
    assert!(expected > 100, "{tracer:?}: {expected} red pixels");
    for cut in 0..4 {
        activate(app, cameras[cut % 2], false);
        activate(app, cameras[1 - cut % 2], true);
        frame(app);
        assert_eq!(red(app), expected, "{tracer:?}: cut {cut}");
        frame(app);
    }
    // A new camera that replaces a removed one, too.
    app.world().despawn(cameras[0]);
    spawn_reflecting(app);
    frame(app);
    assert_eq!(red(app), expected, "{tracer:?}: a new camera");
}

/// Mean difference of the channels of two images.
fn difference(a: &[u8], b: &[u8]) -> f64 {
    let sum: u64 = a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}

fn a_cut_keeps_the_history_of_what_both_cameras_see(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_mesh(app, wall(), metal(0.3), Transform::IDENTITY);
    // Their reflections stay near them, wherever the camera is.
    for index in 0..9 {
        let at = Transform::from_xyz(0.8 * index as f32 - 3.2, 0.0, 0.3);
        spawn_mesh(app, Cuboid::new(0.2, 4.0, 0.2), unlit(RED), at);
    }
    let places = [0.0, 0.3].map(|x| BEFORE_THE_MIRROR.with_translation(BEFORE_THE_MIRROR.translation + x * Vec3::X));
    let cameras = places.map(|at| {
        let camera = spawn_reflecting(app);
        let denoised = RayTracedReflections {
            reset: false,
            ..default()
        };
        app.world().entity_mut(camera).insert((denoised, at));
        activate(app, camera, false);
        camera
    });
    let first_frame = |app: &mut HeadlessApp, camera: Entity| {
        activate(app, camera, true);
        frame(app);
        app.capture().unwrap()
    };
    activate(app, cameras[0], true);
    warm_up(app);
    (0..40).for_each(|_| frame(app));
    let at_first = app.capture().unwrap();
    activate(app, cameras[0], false);
    let cut = first_frame(app, cameras[1]);
    (0..40).for_each(|_| frame(app));
    let at_second = app.capture().unwrap();
    // It moves while it draws nothing: Bevy's motion vectors don't lead to its last frame.
    activate(app, cameras[1], false);
    *app.world().get_mut::<Transform>(cameras[1]).unwrap() = places[0];
    (0..3).for_each(|_| frame(app));
    let back = first_frame(app, cameras[1]);
    app.world().get_mut::<RayTracedReflections>(cameras[1]).unwrap().reset = true;
    frame(app);
    let new = app.capture().unwrap();
    activate(app, cameras[1], false);
    let kept = first_frame(app, cameras[0]);
    let cut = difference(&cut, &at_second);
    let [back, new, kept] = [back, new, kept].map(|image| difference(&image, &at_first));
    println!(
        "{tracer:?}: mean difference {cut:.3} after a cut, {back:.3} after a pause, {kept:.3} in the first camera, {new:.3} without history"
    );
    assert!(
        1.5 * cut < new && 1.5 * back < new && 4.0 * kept < new,
        "{tracer:?}: {cut}, {back}, {kept} and {new}"
    );
}

fn a_frame_without_a_camera_loses_nothing(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_scene(app);
    let camera = spawn_reflecting(app);
    warm_up(app);
    until_at_rest(app);
    frame(app);
    let (before, picture) = (report(app), app.capture().unwrap());
    let held = readback::render_world_components(app.app(), camera);
    for frames in [1, 5] {
        activate(app, camera, false);
        (0..frames).for_each(|_| frame(app));
        let away = report(app);
        assert!(away.active_backends.is_empty() && !away.ready, "{tracer:?}: {away}");
        assert_eq!(away.view_memory, before.view_memory, "{tracer:?}");
        activate(app, camera, true);
        frame(app);
        let after = report(app);
        let parts = |report: &bevy_glint::ReflectionStatusReport| {
            (
                (
                    report.meshes,
                    report.instances,
                    report.merged_instances,
                    report.scene_bytes,
                ),
                (
                    report.blas_builds,
                    report.merge_builds,
                    report.meshes_pending,
                    report.merges_pending,
                ),
            )
        };
        assert_eq!(parts(&after), parts(&before), "{tracer:?}: {frames} frames");
        assert_eq!(readback::render_world_components(app.app(), camera), held);
        let differing = differing_pixels(&picture, &app.capture().unwrap(), 1);
        assert_eq!(differing, 0, "{tracer:?}: after {frames} frames");
    }
    // Changes in the meantime are visible in the first frame.
    activate(app, camera, false);
    frame(app);
    let at = Transform::from_xyz(0.0, 2.0, 5.5);
    let added = spawn_mesh(app, Cuboid::from_length(3.0), unlit(RED), at);
    // A thread builds it.
    let start = Instant::now();
    while report(app).meshes <= before.meshes {
        assert!(start.elapsed() < Duration::from_secs(30), "{tracer:?}: {}", report(app));
        frame(app);
    }
    activate(app, camera, true);
    frame(app);
    assert!(
        differing_pixels(&picture, &app.capture().unwrap(), 1) > 50,
        "{tracer:?}"
    );
    app.world().despawn(added);
}

/// A view at rest has a long history that isn't clipped. A change that no frame marked must end its rest.
fn a_change_in_a_pause_is_followed(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_mesh(app, wall(), metal(0.3), Transform::IDENTITY);
    let panel = spawn_mesh(
        app,
        Cuboid::new(6.0, 4.0, 0.1),
        unlit(RED),
        Transform::from_xyz(0.0, 0.0, 6.0),
    );
    let camera = spawn_reflecting(app);
    app.world().entity_mut(camera).insert(RayTracedReflections::default());
    warm_up(app);
    until_at_rest(app);
    (0..60).for_each(|_| frame(app));
    let before = app.capture().unwrap();
    activate(app, camera, false);
    frame(app);
    let material = app.world().get::<MeshMaterial3d<StandardMaterial>>(panel).unwrap().id();
    let mut materials = app.world().resource_mut::<Assets<StandardMaterial>>();
    materials.get_mut(material).unwrap().base_color = Color::BLACK;
    (0..24).for_each(|_| frame(app));
    activate(app, camera, true);
    (0..24).for_each(|_| frame(app));
    let after = app.capture().unwrap();
    settings_of(app, camera).reset = true;
    (0..40).for_each(|_| frame(app));
    let expected = app.capture().unwrap();
    let [before, after] = [before, after].map(|image| difference(&image, &expected));
    println!("{tracer:?}: mean difference {before:.3} before the change, {after:.3} after the pause");
    assert!(2.0 * after < before, "{tracer:?}: {after} and {before}");
}

fn after_a_time_without_a_camera_all_is_freed(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let camera = spawn_reflecting(app);
    warm_up(app);
    // A frame counts for a quarter of a second at most, so a slow machine can't pass the second time within two frames.
    for retention in [Duration::ZERO, Duration::from_secs(1)] {
        retain(app, ReflectionRetention(retention));
        activate(app, camera, true);
        warm_up(app);
        activate(app, camera, false);
        (0..2).for_each(|_| frame(app));
        let is_freed = |app: &mut HeadlessApp| {
            let report = report(app);
            report.meshes == 0 && report.scene_bytes == 0 && report.view_memory.is_empty()
        };
        assert_eq!(
            is_freed(app),
            retention.is_zero(),
            "{tracer:?}, {retention:?}: {}",
            report(app)
        );
        for _ in 0..6 {
            std::thread::sleep(retention / 4);
            frame(app);
        }
        assert!(is_freed(app), "{tracer:?}, {retention:?}: {}", report(app));
    }
}

fn a_reset_is_not_put_off_by_pipelines(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let camera = spawn_reflecting(app);
    warm_up(app);
    let mut settings = app.world().get_mut::<RayTracedReflections>(camera).unwrap();
    settings.technique = ReflectionTechnique::QuarterInline;
    settings.reset = true;
    app.step(1);
    assert!(!report(app).ready, "{tracer:?}: pipelines that nothing has used yet");
    let picture = app.capture().unwrap();
    let dark = picture
        .chunks_exact(4)
        .filter(|pixel| pixel[..3].iter().all(|channel| *channel < 90));
    assert_eq!(dark.count(), 0, "{tracer:?}: the environment map is back");
    let settings = app.world().get::<RayTracedReflections>(camera).unwrap();
    assert!(
        !settings.reset,
        "{tracer:?}: the view forgets its history in this frame"
    );
}

fn images_of_rates_can_take_turns(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let camera = spawn_reflecting(app);
    let images = [(); 2].map(|()| app.world().resource_mut::<Assets<Image>>().add(Image::default()));
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().technique = ReflectionTechnique::Variable;
    let turn = |app: &mut HeadlessApp, index: usize| {
        let image = ShadingRateHeuristic::Image(images[index % 2].clone());
        app.world().entity_mut(camera).insert(image);
        frame(app);
    };
    turn(app, 0);
    warm_up(app);
    (0..4).for_each(|index| turn(app, index));
    let ready = report(app).ready;
    assert!(
        ready && red(app) > 50,
        "{tracer:?}: ready {ready}, {} red pixels",
        red(app)
    );
    settings_of(app, camera).max_ray_length = 1.0;
    (4..8).for_each(|index| turn(app, index));
    assert_eq!(red(app), 0, "{tracer:?}: settings are followed");
}

fn cameras_that_reflect_later_have_the_hook_already(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    // Both images come from the same Bevy pipelines: no pipeline is recompiled when reflections come or go.
    spawn_scene(app);
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
    app.world()
        .entity_mut(camera)
        .insert(bevy_glint::ReflectionQuality::Off);
    app.step(3);
    let keys = readback::view_key(app.app(), camera);
    assert!(keys.is_some(), "{tracer:?}");
    for _ in 0..2 {
        app.world().entity_mut(camera).insert(plain());
        for _ in 0..4 {
            app.step(1);
            assert_eq!(readback::view_key(app.app(), camera), keys, "{tracer:?}: on");
        }
        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        for _ in 0..4 {
            app.step(1);
            assert_eq!(readback::view_key(app.app(), camera), keys, "{tracer:?}: off");
        }
    }
}

fn the_report_names_cameras_that_exist(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let first = spawn_reflecting(app);
    warm_up(app);
    let cameras = |app: &mut HeadlessApp| -> Vec<Entity> {
        let views = report(app).view_memory.into_iter();
        views.map(|view| view.camera).collect()
    };
    assert_eq!(cameras(app), [first], "{tracer:?}");
    // The other one takes as much memory.
    app.world().despawn(first);
    let second = spawn_reflecting(app);
    (0..2).for_each(|_| frame(app));
    assert_eq!(cameras(app), [second], "{tracer:?}");
}

fn a_front_layer_outlives_its_glass(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_scene(app);
    spawn_reflecting(app);
    let seen = Transform::from_xyz(0.0, 0.0, 1.0);
    let glass = spawn_mesh(app, Rectangle::new(1.0, 4.0), clear_glass(), seen);
    warm_up(app);
    (0..4).for_each(|_| frame(app));
    let bytes = layer_bytes(app);
    assert!(bytes > 0, "{tracer:?}");
    let is_seen = |app: &mut HeadlessApp, is_seen: bool| {
        let beside = Transform::from_xyz(2.0, 500.0, 1.0);
        app.world()
            .entity_mut(glass)
            .insert(if is_seen { seen } else { beside });
        (0..8).for_each(|_| frame(app));
        layer_bytes(app)
    };
    assert_eq!(
        [false, true, false].map(|seen| is_seen(app, seen)),
        [bytes; 3],
        "{tracer:?}"
    );
    retain(app, ReflectionRetention(Duration::ZERO));
    assert_eq!([false, true].map(|seen| is_seen(app, seen)), [0, bytes], "{tracer:?}");
}

/// Waits until a mirror shows everything. Returns the number of frames after the first one, and the milliseconds of the longest.
fn until_whole(app: &mut HeadlessApp, meshes: usize) -> (u32, f64) {
    let mut longest = 0.0_f64;
    for frames in 0..20_000 {
        let start = Instant::now();
        app.step(1);
        longest = longest.max(1e3 * start.elapsed().as_secs_f64());
        app.wait_until_idle().unwrap();
        let report = report(app);
        if report.meshes >= meshes && report.meshes_pending == 0 {
            return (frames, longest);
        }
    }
    panic!("the scene never comes back: {}", report(app));
}

/// The whole scene stays for the time of `ReflectionRetention`, and comes back afterwards.
#[test]
#[ignore = "long: two million triangles"]
fn a_pause_of_a_large_scene_costs_nothing() {
    const MESHES: usize = 40;
    let Some(mut app) = picture_app(SIZE) else { return };
    let app = &mut app;
    retain(app, FOREVER);
    spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
    for index in 0..MESHES {
        // 51,200 triangles each, and no two alike.
        let sphere = Sphere::new(0.4 + 0.001 * index as f32).mesh().uv(160, 161);
        let at = Transform::from_xyz((index % 8) as f32 - 3.5, (index / 8) as f32 - 2.0, 6.0);
        spawn_mesh(app, sphere, unlit(RED), at);
    }
    let camera = spawn_reflecting(app);
    let start = Instant::now();
    warm_up(app);
    until_at_rest(app);
    let (seconds, expected) = (start.elapsed().as_secs_f64(), red(app));
    println!(
        "{} triangles at rest after {seconds:.1} s",
        report(app).merged_triangles
    );
    for (name, pause, retention) in [
        ("a frame", Duration::ZERO, FOREVER),
        ("ten seconds", Duration::from_secs(10), FOREVER),
        (
            "ten seconds",
            Duration::from_secs(10),
            ReflectionRetention(Duration::from_secs(5)),
        ),
    ] {
        retain(app, retention);
        activate(app, camera, false);
        let paused = Instant::now();
        frame(app);
        while paused.elapsed() < pause {
            std::thread::sleep(Duration::from_millis(50));
            frame(app);
        }
        activate(app, camera, true);
        let (start, (frames, longest)) = (Instant::now(), until_whole(app, MESHES + 1));
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "a pause of {name}, retention {:?}: whole after {frames} more frames and {seconds:.2} s, longest frame \
             {longest:.1} ms",
            retention.0
        );
        app.step(1);
        assert_eq!(red(app), expected, "{name}");
        assert!(frames == 0 || retention != FOREVER, "{name}: {frames} frames");
    }
}
