//! Worlds that change: rays hit what is there, and what doesn't change costs nothing.

mod common;
#[path = "common/oracle_app.rs"]
mod oracle_app;
#[path = "common/oracle_scenes.rs"]
mod oracle_scenes;
#[path = "common/pictures.rs"]
mod pictures;

use bevy::{math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracerChoice};
use common::soup::Random;
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use oracle_app::OracleApp;
use oracle_scenes::{Scene, rays_into};

/// More than the trees of moving objects hold, and than a chunk that is cheap to build anew.
const CROWD: usize = 350;

/// Every ray hits what the entities of the app are at present.
fn judge(app: &mut OracleApp, scene: &Scene, random: &mut Random, step: u32) {
    let packed = app.packed_as(scene, false);
    let rays = rays_into(&packed, 400, scene.spread, random);
    let mut hits = 0;
    for (ray, answer) in rays.iter().zip(app.trace(&rays)) {
        let exact = packed.oracle(ray);
        let named = answer.hit.as_ref().map(|hit| (hit.t, hit.instance, hit.primitive));
        assert!(
            exact.accepts(named, 1e-3, 1e-5),
            "step {step}: {ray:?} {answer:?}, but exactly {}",
            exact.t
        );
        hits += usize::from(named.is_some());
    }
    assert!(hits > 100, "step {step}: {hits} hits");
}

fn change(app: &mut OracleApp, object: usize, respawn: bool, random: &mut Random) {
    let entity = app.entities()[object];
    let shift = 1.5 * random.vector();
    let turn = Quat::from_rotation_y(3.0 * random.signed());
    if respawn {
        let world = app.world();
        let (Some(mesh), Some(material), Some(transform)) = (
            world.get::<Mesh3d>(entity).cloned(),
            world.get::<MeshMaterial3d<StandardMaterial>>(entity).cloned(),
            world.get::<Transform>(entity).copied(),
        ) else {
            panic!("the object is complete")
        };
        world.despawn(entity);
        let transform = transform.with_rotation(turn);
        let entity = world.spawn((mesh, material, transform)).id();
        app.entities()[object] = entity;
    } else if let Some(mut transform) = app.world().get_mut::<Transform>(entity) {
        transform.translation += shift;
        transform.rotation = turn;
    }
}

/// Static and moving trees, merged trees and objects that are cut out of them: all of it changes, and is as if it was new.
#[test]
fn changes_in_any_order_are_hit_as_they_are() {
    for tracer in [ReflectionTracerChoice::Bvh, ReflectionTracerChoice::RayQuery] {
        let Some(mut app) = OracleApp::new(tracer) else {
            continue;
        };
        let random = &mut Random(17);
        let scene = Scene::crowd(CROWD, random);
        app.place(&scene);
        judge(&mut app, &scene, random, 0);
        let mut merged_seen = false;
        for step in 1..=40 {
            let count = [0, 1, 3, 30, 200][random.below(5)];
            for _ in 0..count {
                let object = random.below(CROWD);
                let respawn = random.below(4) == 0;
                change(&mut app, object, respawn, random);
            }
            app.step([1, 2, 7, 25][random.below(4)]);
            if step % 10 == 5 && tracer == ReflectionTracerChoice::Bvh {
                // Objects that were moved often rest late.
                app.rest();
                merged_seen |= app.report().merged_instances > 0;
            }
            judge(&mut app, &scene, random, step);
        }
        assert!(merged_seen || tracer == ReflectionTracerChoice::RayQuery);
    }
}

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
        clock.add_plugin(app, RayTracedReflectionsPlugin { tracer })
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
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Sphere::new(0.5).mesh().uv(12, 8));
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
    let (Some(small), Some(large)) = (cost(5_000), cost(50_000)) else {
        return;
    };
    println!("{small} ms among 5,000 objects, {large} ms among 50,000");
    assert!(
        large < 3.0 * small + 1.0,
        "{small} ms among 5,000 objects, {large} ms among 50,000"
    );
}
