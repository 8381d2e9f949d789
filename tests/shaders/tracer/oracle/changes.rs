//! Changing worlds: rays hit the current objects.

use super::{
    super::soup::Random,
    app::OracleApp,
    scenes::{Scene, rays_into},
};
use bevy::prelude::*;
use bevy_glint::ReflectionTracerChoice;

/// More than fit into the trees of moving objects and into a chunk that is cheap to rebuild.
const CROWD: usize = 350;

/// Every ray hits the current entities of the app.
fn judge(app: &mut OracleApp, scene: &Scene, random: &mut Random, step: u32) {
    let packed = app.packed_as(scene, false);
    let rays = rays_into(&packed, 400, scene.spread, random);
    let mut hits = 0;
    for (ray, answer) in rays.iter().zip(app.trace(&rays)) {
        let exact = packed.oracle(ray);
        let named = answer.named();
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

/// Static and moving trees, merged trees and objects that are cut out of them: all of them change, and equal newly built ones.
#[test]
fn changes_in_any_order_are_hit_as_they_are() {
    change_and_judge(17, 8);
}

#[test]
#[ignore = "long: many more changes"]
fn many_changes_in_any_order_are_hit_as_they_are() {
    change_and_judge(18, 40);
}

fn change_and_judge(seed: u64, steps: u32) {
    for tracer in [ReflectionTracerChoice::Bvh, ReflectionTracerChoice::RayQuery] {
        let Some(mut app) = OracleApp::new(tracer) else {
            continue;
        };
        let random = &mut Random(seed);
        let scene = Scene::crowd(CROWD, random);
        app.place(&scene);
        judge(&mut app, &scene, random, 0);
        let mut merged_seen = false;
        for step in 1..=steps {
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
