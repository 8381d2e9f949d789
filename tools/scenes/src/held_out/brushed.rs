//! Machine parts of brushed and cast metal on the steel bench of a workshop with a few lamps.

use super::{ground, indoors, lamps, lathe, room};
use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, TAU};

/// Height of the bench.
const BENCH: f32 = 0.9;

/// Along the front of the bench.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(-1.9, 1.5, 1.9), vec3(-0.4, 1.0, 0.0)),
        (vec3(-1.2, 1.45, 1.5), vec3(-0.2, 0.98, 0.0)),
        (vec3(0.0, 1.55, 1.45), vec3(0.1, 0.95, -0.1)),
        (vec3(1.25, 1.75, 1.1), vec3(0.3, 0.9, -0.1)),
        (vec3(2.0, 1.6, 0.7), vec3(0.2, 1.0, -0.2)),
    ],
    14.0,
    50.0,
    60.0,
);

pub fn environment(world: &mut World) -> Environment {
    indoors(world, 5.2)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let brushed = scene.textures(size, brushed).material();
    let cast = scene.textures(size, cast).material();
    let steel = scene.material(dyed(&brushed, Color::srgb(0.78, 0.79, 0.80)));
    let brass = scene.material(dyed(&brushed, Color::srgb(0.90, 0.72, 0.40)));
    let copper = scene.material(dyed(&brushed, Color::srgb(0.93, 0.60, 0.46)));
    let iron = scene.material(dyed(&cast, Color::srgb(0.42, 0.43, 0.45)));
    let aluminium = scene.material(dyed(&cast, Color::srgb(0.86, 0.87, 0.88)));
    let wall = scene.material(gloss(Color::srgb(0.46, 0.50, 0.50), 0.7));
    let concrete = scene.material(gloss(Color::srgb(0.34, 0.33, 0.32), 0.6));
    let tool = scene.material(gloss(Color::srgb(0.70, 0.10, 0.05), 0.3));
    let shade = scene.material(metal(Color::srgb(0.2, 0.4, 0.3), 0.45));

    let walls = scene.shape(|g| room(g, vec3(7.0, 3.2, 6.0), 0.5));
    scene.place(&walls, &wall, Transform::IDENTITY);
    let floor = scene.shape(|g| ground(g, vec2(3.5, 3.0), 0.0, 0.5));
    scene.place(&floor, &concrete, Transform::IDENTITY);
    let bench = scene.shape(|g| {
        g.rounded_box(vec3(0.0, BENCH - 0.03, 0.0), vec3(3.0, 0.06, 1.5), 0.01, 2, 1.0);
        g.rounded_box(vec3(0.0, BENCH + 0.3, -0.78), vec3(3.0, 0.7, 0.02), 0.005, 1, 1.0);
        for (x, z) in [(-1.4, -0.6), (1.4, -0.6), (-1.4, 0.6), (1.4, 0.6)] {
            g.cuboid(vec3(x, 0.5 * BENCH - 0.03, z), vec3(0.08, BENCH - 0.06, 0.08), 1.0);
        }
    });
    scene.place(&bench, &steel, Transform::IDENTITY);

    let gear = scene.shape(|g| gear(g, segments(48, fine)));
    let shaft = scene.shape(|g| turned_part(g, segments(48, fine)));
    let flange = scene.shape(|g| flange(g, segments(64, fine)));
    let block = scene.shape(|g| g.rounded_box(vec3(0.0, 0.5, 0.0), Vec3::ONE, 0.06, 4, 2.0));
    let pipe = scene.shape(|g| {
        let bend = |t: f32| vec3(0.35 * ops::cos(t), 0.05, 0.35 * ops::sin(t));
        g.curved_tube(24, 0.05, segments(24, fine), |t| bend(t * FRAC_PI_2 * 2.0));
    });
    let on = |x: f32, z: f32, degrees: f32| Transform::from_xyz(x, BENCH, z).with_rotation(turned(degrees));
    let lying = Quat::from_rotation_z(FRAC_PI_2);
    scene.place(&gear, &iron, on(-0.55, 0.1, 10.0));
    scene.place(&gear, &brass, on(0.1, 0.42, 0.0).with_scale(vec3(0.55, 0.8, 0.55)));
    let leaning = Transform::from_xyz(0.55, BENCH + 0.385, -0.6).with_rotation(Quat::from_rotation_x(1.3));
    scene.place(&gear, &aluminium, leaning.with_scale(vec3(1.1, 1.0, 1.1)));
    let shaft_at = Transform::from_xyz(0.95, BENCH + 0.09, 0.1).with_rotation(turned(35.0) * lying);
    scene.place(&shaft, &steel, shaft_at);
    scene.place(&shaft, &copper, on(-1.05, -0.35, 0.0).with_scale(vec3(1.0, 0.8, 1.0)));
    scene.place(&flange, &aluminium, on(0.15, -0.4, 0.0).with_scale(Vec3::splat(0.8)));
    scene.place(&flange, &brass, on(-0.3, -0.45, 0.0).with_scale(Vec3::splat(0.7)));
    let ingot = on(0.75, -0.35, 25.0).with_scale(vec3(0.3, 0.16, 0.22));
    scene.place(&block, &aluminium, ingot);
    scene.place(&block, &tool, on(-1.15, 0.35, -20.0).with_scale(vec3(0.32, 0.14, 0.18)));
    scene.place(&pipe, &copper, on(0.4, 0.15, 160.0).with_scale(vec3(0.8, 1.0, 0.8)));
    let cone = scene.shape(|g| lathe(g, segments(32, fine), &[0.2, 0.0, 0.21, 0.0, 0.06, 0.16, 0.0, 0.2]));
    let places = [vec3(-1.1, 2.25, 0.3), vec3(0.4, 2.3, 0.0), vec3(1.4, 2.2, 0.5)];
    let color = LinearRgba::rgb(1.0, 0.82, 0.6);
    lamps(scene, fine, places, color, 2_600.0, 7.0, 0.06);
    for at in places {
        scene.place_unshadowed(&cone, &shade, Transform::from_translation(at + 0.03 * Vec3::Y));
    }
}

/// A wheel with teeth and a hub, on y = 0.
fn gear(g: &mut Geometry, sides: u32) {
    let profile = [
        0.05, 0.0, 0.3, 0.0, 0.3, 0.0, 0.3, 0.1, 0.3, 0.1, 0.24, 0.1, 0.22, 0.06, 0.12, 0.06, 0.1, 0.14, 0.1, 0.14,
        0.05, 0.14, 0.05, 0.14, 0.05, 0.0,
    ];
    lathe(g, sides, &profile);
    for tooth in 0..24 {
        let turn = Transform::from_rotation(Quat::from_rotation_y(tooth as f32 / 24.0 * TAU));
        g.part(turn, |part| {
            part.rounded_box(vec3(0.32, 0.05, 0.0), vec3(0.07, 0.098, 0.035), 0.006, 1, 2.0);
        });
    }
}

/// A stepped shaft along y.
fn turned_part(g: &mut Geometry, sides: u32) {
    let profile = [
        0.0, 0.0, 0.06, 0.0, 0.06, 0.0, 0.06, 0.12, 0.06, 0.12, 0.09, 0.12, 0.09, 0.12, 0.09, 0.3, 0.09, 0.3, 0.07,
        0.3, 0.07, 0.3, 0.07, 0.5, 0.07, 0.5, 0.045, 0.5, 0.045, 0.5, 0.045, 0.66, 0.045, 0.66, 0.0, 0.66,
    ];
    lathe(g, sides, &profile);
}

/// A bell on a disc with bolts.
fn flange(g: &mut Geometry, sides: u32) {
    let profile = [
        0.2, 0.0, 0.2, 0.0, 0.2, 0.035, 0.19, 0.04, 0.19, 0.04, 0.11, 0.045, 0.08, 0.07, 0.075, 0.18, 0.06, 0.2, 0.0,
        0.205,
    ];
    lathe(g, sides, &profile);
    for bolt in 0..8 {
        let angle = bolt as f32 / 8.0 * TAU;
        let at = vec3(0.155 * ops::cos(angle), 0.04, 0.155 * ops::sin(angle));
        g.sphere(at, 0.018, sides / 4, Vec2::ONE);
    }
}

/// Fine scratches along x.
fn brushed(uv: Vec2) -> Texel {
    // Mirrored, so that it tiles.
    let along = (2.0 * uv.x - 1.0).abs();
    let scratch =
        0.6 * noise(vec2(8.0 * along, 128.0 * uv.y), 128, 3) + 0.4 * noise(vec2(12.0 * along, 64.0 * uv.y), 64, 4);
    let smear = fractal(uv, 3, 4, 7);
    Texel {
        color: Vec3::splat(0.9 + 0.1 * scratch),
        height: 0.0008 * scratch,
        roughness: 0.2 + 0.12 * scratch + 0.14 * smooth(0.45, 0.7, smear),
        metallic: 1.0,
        ..Default::default()
    }
}

/// Grains and pits of a casting.
fn cast(uv: Vec2) -> Texel {
    let grain = fractal(uv, 32, 3, 11);
    Texel {
        color: Vec3::splat(0.85 + 0.15 * grain),
        height: 0.006 * grain,
        roughness: 0.34 + 0.16 * fractal(uv, 8, 3, 12),
        metallic: 1.0,
        ..Default::default()
    }
}
