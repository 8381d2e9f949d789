//! Many lights: more than a hit has bits for when it is handed from tracing to shading.

use crate::{
    pictures::{apps, assert_flip, picture_app, red_pixels, reflect},
    stage::{SIZE, behind, spawn_mesh, spawn_mirror, wall},
};
use bevy::prelude::*;
use bevy_glint::ReflectionTechnique;
use glint_scenes::{HeadlessApp, Output, SceneName};

/// In each direction of a grid: 100, of which 64 have bits.
const GRID: u8 = 10;

fn spawn_lights(app: &mut HeadlessApp) {
    for index in 0..GRID * GRID {
        let (column, row) = (f32::from(index % GRID), f32::from(index / GRID));
        // One light with shadows among those with bits, and one among the others.
        let shadow_maps_enabled = index == 22 || index == 77;
        app.world().spawn((
            PointLight {
                intensity: if shadow_maps_enabled { 60_000.0 } else { 3_000.0 },
                range: 4.0,
                shadow_maps_enabled,
                ..default()
            },
            Transform::from_xyz(column - 4.5, row - 4.5, 6.5),
        ));
    }
}

#[test]
fn lights_without_bits_shine_and_cast_shadows() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let camera = spawn_mirror(&mut app, 0.0, SceneName::MirrorRoom);
        spawn_mesh(&mut app, wall(), Color::WHITE.into(), behind(8.0));
        // Between each light with shadows and the wall.
        for (x, y) in [(-2.5, -2.5), (2.5, 2.5)] {
            let cube = Cuboid::from_length(0.3);
            let at = Transform::from_xyz(x, y, 7.3);
            spawn_mesh(&mut app, cube, StandardMaterial::from(Color::BLACK), at);
        }
        spawn_lights(&mut app);
        // Traces and shades in one pass, which doesn't need bits.
        reflect(&mut app, camera, ReflectionTechnique::Converged);
        app.step(8);
        let expected = app.capture().unwrap();
        reflect(&mut app, camera, ReflectionTechnique::Reference);
        app.step(8);
        let actual = app.capture().unwrap();
        assert_flip(&format!("many-lights-{tracer}"), SIZE, &expected, &actual, 0.005);
    }
}

/// More lights than reflections support: the strong ones are kept, whatever their kind.
#[test]
fn a_crowd_of_faint_lights_keeps_no_strong_one_out() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let camera = spawn_mirror(&mut app, 0.0, SceneName::MirrorRoom);
    spawn_mesh(&mut app, wall(), Color::WHITE.into(), behind(8.0));
    for index in 0..300u16 {
        let faint = PointLight {
            intensity: 0.001,
            range: 1.0,
            ..default()
        };
        app.world()
            .spawn((faint, Transform::from_xyz(f32::from(index), 200.0, 0.0)));
    }
    let strong = SpotLight {
        color: Color::srgb(1.0, 0.0, 0.0),
        intensity: 3_000_000.0,
        range: 20.0,
        outer_angle: 1.2,
        ..default()
    };
    app.world().spawn((strong, behind(4.0)));
    reflect(&mut app, camera, ReflectionTechnique::Reference);
    let red = red_pixels(&app.capture().unwrap());
    assert!(red > 1_000, "{red} pixels of the mirror show the spot light");
}
