//! Worlds that change: what doesn't change costs nothing.

use bevy::{math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};

/// Milliseconds that the plugin takes of a frame in a world of so many objects of which one moves, where a quarter of all frames takes
/// less: what else runs on the machine counts little.
fn cost(instances: usize) -> Option<f64> {
    let clock = SystemClock::default();
    let settings = HeadlessSettings {
        size: UVec2::splat(16),
        ..default()
    };
    let tracer = ReflectionTracerChoice::Bvh;
    let mut app = match HeadlessApp::new(settings, |app| {
        clock.add_plugin(app, RayTracedReflectionsPlugin { tracer, ..default() });
    }) {
        Ok(app) => app,
        Err(error) => {
            assert!(std::env::var_os("GLINT_REQUIRE_GPU").is_none(), "{error}");
            println!("skipped: {error}");
            return None;
        }
    };
    app.spawn_camera((RayTracedReflections::default(), Transform::default()));
    let world = app.world();
    // Few triangles: all of them are merged before anything is measured.
    let mesh = world.resource_mut::<Assets<Mesh>>().add(Tetrahedron::default());
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(Color::WHITE);
    let entities: Vec<Entity> = (0..instances)
        .map(|index| {
            // Behind the camera.
            let place = Vec3::new((index % 256) as f32, (index / 256) as f32, 10.0);
            let object = (Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()));
            world.spawn((object, Transform::from_translation(place))).id()
        })
        .collect();
    let mover = entities[instances / 2];
    app.warm_up(20_000).expect("the world can be loaded");
    let mut quiet = 0;
    let mut frames = 0;
    let mut times = Vec::new();
    while times.len() < 60 {
        if let Some(mut transform) = app.world().get_mut::<Transform>(mover) {
            transform.translation.z += 0.01;
        }
        clock.take();
        app.step(1);
        let time: f64 = clock.take().iter().map(|(_, milliseconds)| milliseconds).sum();
        app.wait_until_idle().expect("the device is there");
        let report = app.world().resource::<ReflectionStatus>().report();
        let ready = report.ready && report.instances == instances && !report.merges_pending;
        quiet = if ready { quiet + 1 } else { 0 };
        if quiet > 40 {
            times.push(time);
        }
        frames += 1;
        assert!(frames < 20_000, "the world doesn't come to rest: {report:?}");
    }
    times.sort_by(f64::total_cmp);
    Some(times[times.len() / 4])
}

#[test]
fn one_mover_costs_as_much_in_a_large_world_as_in_a_small_one() {
    let (Some(small), Some(large)) = (cost(2_000), cost(40_000)) else {
        return;
    };
    println!("{small} ms among 2,000 objects, {large} ms among 40,000");
    assert!(
        large < 1.5 * small + 0.15,
        "{small} ms among 2,000 objects, {large} ms among 40,000"
    );
}
