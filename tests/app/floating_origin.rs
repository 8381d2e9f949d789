//! A floating origin: all transforms, the camera's included, are shifted by one vector.

use crate::{
    convergence::{capture, switch},
    pictures::{COARSE, assert_flip, linear_app, picture_app, red_pixels, reflect, spawn, warm_up},
    stage::{
        BEFORE_THE_MIRROR, BLUE, RED, SIZE, add, metal, report, settings_of, spawn_camera, spawn_mesh, spawn_mirror,
        unlit, until, until_at_rest, wall,
    },
};
use bevy::prelude::*;
use bevy_glint::{OriginShift, RayTracedReflections, ReflectionRetention, ReflectionTechnique};
use core::time::Duration;
use glint_scenes::{HeadlessApp, SceneName};

/// Sums and differences with the coordinates of the scene are nearly exact.
const SHIFT: Vec3 = Vec3::new(32.0, -16.0, 64.0);

fn shift(app: &mut HeadlessApp, by: Vec3) {
    let world = app.world();
    let mut placed = world.query_filtered::<&mut Transform, Without<ChildOf>>();
    for mut transform in placed.iter_mut(world) {
        transform.translation += by;
    }
}

#[test]
fn a_shift_of_the_origin_is_not_seen() {
    let Some(mut app) = picture_app(SIZE) else { return };
    spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    let merged = until_at_rest(&mut app);
    assert_eq!(merged.merged_instances, merged.instances);
    let before = app.capture().unwrap();
    shift(&mut app, SHIFT);
    app.step(2);
    assert_eq!(report(&mut app).merged_instances, merged.instances, "trees move along");
    assert_flip("shifted", SIZE, &before, &app.capture().unwrap(), 0.002);
    // Built again at their current places.
    let again = until_at_rest(&mut app);
    assert_eq!(again.merged_instances, merged.instances);
    assert_eq!(again.merge_builds, merged.merge_builds + 1);
    assert_flip("shifted-merged", SIZE, &before, &app.capture().unwrap(), 0.002);
}

/// Shifts in all frames until many objects are merged, which are looked up over several of them.
#[test]
fn shifts_until_objects_are_merged_are_not_seen() {
    const SIDE: i16 = 50;
    let Some(mut app) = picture_app(SIZE) else { return };
    let app = &mut app;
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let mesh = add(app, Mesh::from(Rectangle::new(0.1, 0.1)));
    let two_sided = StandardMaterial {
        cull_mode: None,
        ..unlit(RED)
    };
    let material = add(app, two_sided);
    for x in 0..SIDE {
        for y in 0..SIDE {
            let place = 0.2 * (Vec2::new(x.into(), y.into()) - f32::from(SIDE / 2));
            let at = Transform::from_translation(place.extend(8.0));
            app.world()
                .spawn((Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), at));
        }
    }
    reflect(app, camera, ReflectionTechnique::Reference);
    let picture_of = |app: &mut HeadlessApp| {
        warm_up(app);
        app.step(1);
        app.capture().unwrap()
    };
    let before = picture_of(app);
    assert_eq!(report(app).merged_instances, 0, "it is too late");
    assert!(red_pixels(&before) > 500);
    let mut back_and_forth = [SHIFT, -SHIFT].into_iter().cycle();
    let mut shift_and_step = |app: &mut HeadlessApp| {
        shift(app, back_and_forth.next().unwrap());
        app.step(1);
    };
    until(app, "they are never merged", |app| {
        (0..2).for_each(|_| shift_and_step(app));
        report(app).merged_instances == report(app).instances
    });
    assert_flip("shifted while merging", SIZE, &before, &picture_of(app), 0.002);
}

/// Four shifts, each while the last frames are still of use: a rough floor is denoised over frames.
#[test]
#[ignore = "long: 192 frames of truth"]
fn history_survives_shifts_of_the_origin() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let camera = app.spawn_scene(SceneName::AtriumSmall, &COARSE);
    switch(&mut app, camera, "converged");
    app.step(192);
    let truth = capture(&mut app, "truth");
    switch(&mut app, camera, "quarter");
    // The noise of motion.
    settings_of(&mut app, camera).denoiser.converge_static_views = false;
    app.step(48);
    let steady = error(&truth, &capture(&mut app, "steady"));
    let merged = until_at_rest(&mut app).merged_instances;
    assert!(merged > 0);
    for round in 0..4 {
        shift(&mut app, if round % 2 == 0 { SHIFT } else { -SHIFT });
        app.step(1);
        let after = error(&truth, &capture(&mut app, "shifted"));
        println!("shift {round}: error {after:.5}, {steady:.5} before");
        assert!(after < 1.2 * steady, "{round}: {after}, {steady} before");
        assert_eq!(report(&mut app).merged_instances, merged, "{round}");
        app.step(30);
    }
}

/// A rough mirror under a lamp. Some objects stay where they are when the world is shifted.
struct RoughMirror {
    app: HeadlessApp,
    camera: Entity,
    world: Vec<Entity>,
}

impl RoughMirror {
    /// `technique` is the name of settings, as in [`switch`]; `others` is the number of objects that stay.
    fn new(technique: &str, others: u8) -> Option<Self> {
        let mut app = linear_app(SIZE)?;
        let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        let mirror = spawn_mesh(&mut app, wall(), metal(0.35), Transform::IDENTITY);
        let mut world = vec![camera, mirror];
        for x in [-2.0, 0.0, 2.0] {
            let at = Transform::from_xyz(x, 0.3 * x, 5.0);
            world.push(spawn_mesh(&mut app, Cuboid::from_length(1.0), unlit(RED), at));
            let beside = Transform::from_xyz(x, -1.0, 5.5);
            world.push(spawn_mesh(&mut app, Sphere::new(0.6), Color::WHITE.into(), beside));
        }
        for x in 0..others {
            let afar = Transform::from_xyz(x.into(), 0.0, 4_000.0);
            spawn_mesh(&mut app, Cuboid::from_length(0.5), unlit(BLUE), afar);
        }
        let lamp = PointLight {
            intensity: 50.0,
            ..default()
        };
        world.push(app.world().spawn((lamp, Transform::from_xyz(0.0, 2.0, 3.5))).id());
        switch(&mut app, camera, technique);
        app.step(40);
        Some(Self { app, camera, world })
    }

    /// Moves the world back and forth.
    fn shift(&mut self, by: Vec3, is_announced: bool) {
        let world = self.app.world();
        for entity in &self.world {
            world.get_mut::<Transform>(*entity).unwrap().translation += by;
        }
        if is_announced {
            world.write_message(OriginShift(by));
        }
    }

    /// Loses the history.
    fn reset(&mut self) {
        let world = self.app.world();
        world.get_mut::<RayTracedReflections>(self.camera).unwrap().reset = true;
    }

    fn activate(&mut self, is_active: bool) {
        self.app.world().get_mut::<Camera>(self.camera).unwrap().is_active = is_active;
    }

    /// The error of the next frame against an earlier one.
    fn error(&mut self, truth: &[f32]) -> f32 {
        self.app.step(1);
        error(truth, &capture(&mut self.app, "the mirror"))
    }
}

/// The scene is too small to be recognised, and most objects stay.
#[test]
fn announced_shifts_are_believed() {
    let Some(mut mirror) = RoughMirror::new("quarter", 10) else {
        return;
    };
    mirror.app.world().insert_resource(ReflectionRetention(Duration::MAX));
    let before = capture(&mut mirror.app, "before");
    mirror.reset();
    let fresh = mirror.error(&before);
    mirror.app.step(40);
    mirror.shift(SHIFT, true);
    let announced = mirror.error(&before);
    mirror.app.step(40);
    // While no camera is active.
    mirror.activate(false);
    mirror.app.step(1);
    mirror.shift(-SHIFT, true);
    mirror.app.step(1);
    mirror.activate(true);
    let unseen = mirror.error(&before);
    mirror.app.step(40);
    mirror.shift(SHIFT, false);
    let unannounced = mirror.error(&before);
    println!("errors: {announced}, {unseen} while inactive, {unannounced} unannounced, {fresh} without history");
    assert!(announced < 0.5 * fresh && unseen < 0.5 * fresh);
    assert!(unannounced > 0.7 * fresh, "this test can't fail");
}

/// The ground truth begins anew after every change of the scene.
#[test]
fn lamps_move_with_the_world() {
    let Some(mut mirror) = RoughMirror::new("converged", 0) else {
        return;
    };
    let before = capture(&mut mirror.app, "before");
    mirror.shift(SHIFT, true);
    let shifted = mirror.error(&before);
    mirror.reset();
    let anew = mirror.error(&before);
    println!("errors: {shifted}, {anew} of a new estimate");
    assert!(shifted < 0.2 * anew);
}

/// Root mean square error as a display shows it.
fn error(truth: &[f32], picture: &[f32]) -> f32 {
    let shown = |light: f32| (light / (1.0 + light)).powf(1.0 / 2.2);
    let squares = picture.iter().zip(truth).map(|(a, b)| (shown(*a) - shown(*b)).powi(2));
    (squares.sum::<f32>() / truth.len() as f32).sqrt()
}
