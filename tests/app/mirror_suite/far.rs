//! Mirrors far from the world's origin, and in worlds with other units.

use crate::{
    pictures::{PATIENCE, apps, differing_pixels, dump, reflect},
    stage::{SIZE, clear, metal, settings_of, spawn_mesh, unlit},
};
use bevy::{core_pipeline::tonemapping::Tonemapping, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionTechnique};
use core::f32::consts::FRAC_PI_2;
use glint_scenes::{HeadlessApp, Output};

/// Images of a mirror that faces x, with a ball of 4 cm hanging 3 cm before it: with reflections, and without. A metre has `scale` units.
fn images(app: &mut HeadlessApp, origin: Vec3, scale: f32) -> [Vec<u8>; 2] {
    let at = |x: f32, y: f32, z: f32| {
        Transform::from_translation(origin + scale * Vec3::new(x, y, z)).with_scale(Vec3::splat(scale))
    };
    let facing = Quat::from_rotation_y(FRAC_PI_2);
    let mirror = at(0.0, 0.0, 0.0).with_rotation(facing);
    spawn_mesh(app, Rectangle::new(8.0, 8.0), metal(0.0), mirror);
    let back = at(6.0, 0.0, 0.0).with_rotation(facing.inverse());
    spawn_mesh(app, Rectangle::new(16.0, 16.0), unlit([90, 90, 90]), back);
    let [green, orange] = [[40, 240, 40], [240, 60, 40]].map(unlit);
    let ball = Sphere::new(0.04).mesh().uv(32, 16);
    spawn_mesh(app, ball, green, at(0.07, 0.0, 0.0));
    spawn_mesh(app, Cuboid::new(0.02, 0.2, 0.1), orange, at(0.04, 0.0, -0.2));
    let target = origin + scale * Vec3::new(0.02, 0.0, -0.05);
    let place = at(0.35, 0.12, 0.35).looking_at(target, Vec3::Y);
    let camera = app.spawn_camera(place.with_scale(Vec3::ONE));
    let projection = PerspectiveProjection {
        near: 0.1 * scale,
        near_clip_plane: Vec4::new(0.0, 0.0, -1.0, -0.1 * scale),
        far: 100.0 * scale,
        ..default()
    };
    let mut camera_entity = app.world().entity_mut(camera);
    camera_entity.insert((Tonemapping::None, Projection::Perspective(projection)));
    reflect(app, camera, ReflectionTechnique::Reference);
    settings_of(app, camera).max_ray_length = 100.0 * scale;
    app.step(2);
    let reflected = app.capture().unwrap();
    app.world().entity_mut(camera).remove::<RayTracedReflections>();
    // Nothing reflects, so only Bevy's own pipelines are awaited.
    app.warm_up(PATIENCE).unwrap();
    app.step(2);
    let plain = app.capture().unwrap();
    clear(app);
    [reflected, plain]
}

#[test]
fn what_nearly_touches_a_mirror_is_reflected_far_from_the_origin() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let [near, plain_near] = images(&mut app, Vec3::ZERO, 1.0);
        let shown = differing_pixels(&near, &plain_near, 16);
        assert!(shown > 200, "{tracer}: only {shown} pixels are reflections");
        for distance in [-1024.0, 4096.0] {
            let [far, plain] = images(&mut app, Vec3::new(distance, 3.0, 0.25 * distance), 1.0);
            let (apart, edges) = (
                differing_pixels(&far, &near, 16),
                differing_pixels(&plain, &plain_near, 16),
            );
            println!(
                "{tracer}, at {distance}: {apart} pixels apart, {edges} of them without reflections, {shown} are reflections"
            );
            // The gap of 16 mm moves edges; without the reflection of the ball and the box, hundreds differ.
            if apart > 2 * edges + 80 {
                let folder = dump(&format!("mirror at {distance}"), SIZE, &near, &far);
                panic!(
                    "{tracer}, at {distance}: {apart} pixels apart, {edges} without reflections; see {}",
                    folder.display()
                );
            }
        }
    }
}

#[test]
fn what_nearly_touches_a_mirror_is_reflected_in_any_unit() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let [metres, plain] = images(&mut app, Vec3::ZERO, 1.0);
        let shown = differing_pixels(&metres, &plain, 16);
        assert!(shown > 200, "{tracer}: only {shown} pixels are reflections");
        for scale in [0.01, 100.0, 1000.0] {
            let [scaled, _] = images(&mut app, Vec3::ZERO, scale);
            let apart = differing_pixels(&scaled, &metres, 16);
            println!("{tracer}, {scale} units for a metre: {apart} of {shown} pixels apart");
            if apart > 8 {
                let folder = dump(&format!("mirror scaled by {scale}"), SIZE, &metres, &scaled);
                panic!(
                    "{tracer}, {scale} units for a metre: {apart} pixels apart; see {}",
                    folder.display()
                );
            }
        }
    }
}
