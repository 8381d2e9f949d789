//! A polished stone floor under a row of arches. The sun shines in from one side.

use super::{ground, lathe};
use crate::prelude::*;
use std::f32::consts::PI;

/// Distance from arch to arch along x, half the width of an opening, the height at which the curve begins, and the height of the wall.
const BAY: f32 = 3.2;
const RADIUS: f32 = 1.15;
const SPRING: f32 = 2.3;
const TOP: f32 = 4.2;

/// Half the thickness of the arches, and the depth of the walk behind them.
const HALF_DEPTH: f32 = 0.3;
const DEPTH: f32 = 4.4;

/// Along the walk, and out through an arch.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(-11.4, 1.6, -2.0), vec3(0.0, 1.0, -2.0)),
        (vec3(-9.0, 1.3, -2.9), vec3(0.0, 0.8, -1.4)),
        (vec3(-5.0, 1.5, -3.4), vec3(2.0, 0.8, -0.8)),
        (vec3(-0.5, 1.7, -3.7), vec3(2.6, 0.3, 0.0)),
        (vec3(2.6, 1.6, -3.2), vec3(9.0, 0.7, -0.8)),
    ],
    16.0,
    58.0,
    200.0,
);

fn sun() -> Vec3 {
    sun_direction(158.0, 34.0)
}

pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Day { sun: sun() }, 750.0, 10.2)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let stone = scene.textured(size, patterns::limestone);
    let floor = scene.textured(size, slabs);
    let plaster = scene.textures(size, patterns::plaster).material();
    let plaster = scene.material(dyed(&plaster, Color::srgb(0.86, 0.66, 0.52)));
    let bronze = scene.textures(size / 2, patterns::worn_metal).material();
    let bronze = scene.material(dyed(&bronze, Color::srgb(0.78, 0.55, 0.32)));

    let paved = scene.shape(|g| ground(g, vec2(16.0, 0.5 * DEPTH + 1.0), 0.0, 0.4));
    scene.place(&paved, &floor, Transform::from_xyz(0.0, 0.0, -0.5 * DEPTH));
    let yard = scene.shape(|g| ground(g, vec2(60.0, 60.0), -0.06, 0.2));
    scene.place(&yard, &plaster, Transform::IDENTITY);
    let arch = scene.shape(|g| arch(g, segments(24, fine)));
    for bay in -4..=4 {
        scene.place(&arch, &stone, Transform::from_xyz(BAY * bay as f32, 0.0, 0.0));
    }
    let shell = scene.shape(|g| {
        g.cuboid(vec3(0.0, 2.1, -DEPTH - 0.2), vec3(30.0, 4.4, 0.4), 0.4);
        g.cuboid(vec3(0.0, TOP + 0.25, -0.5 * DEPTH), vec3(30.0, 0.5, DEPTH + 1.2), 0.4);
        for x in [-14.9, 14.9] {
            g.cuboid(vec3(x, 2.1, -0.5 * DEPTH - 0.2), vec3(0.4, 4.2, DEPTH - 0.2), 0.4);
        }
    });
    scene.place(&shell, &plaster, Transform::IDENTITY);
    // The garden: a wall, and hedges cut to cones.
    let wall = scene.shape(|g| g.cuboid(vec3(0.0, 0.9, 14.0), vec3(60.0, 1.9, 0.5), 0.4));
    scene.place(&wall, &stone, Transform::IDENTITY);
    let hedge = scene.material(gloss(Color::srgb(0.12, 0.25, 0.09), 0.9));
    let cone = scene.shape(|g| {
        let profile = [0.0, -0.1, 0.7, -0.1, 0.75, 0.3, 0.5, 1.4, 0.0, 3.2];
        lathe(g, segments(24, fine), &profile);
    });
    for index in -5i32..=5 {
        let at = Transform::from_xyz(2.6 * index as f32, 0.0, 5.0 + 2.5 * (index % 2).abs() as f32);
        scene.place(&cone, &hedge, at);
    }
    let foot = scene.shape(|g| props::pedestal(g, 0.7, 0.3, segments(32, fine)));
    let urn = scene.shape(|g| props::pot(g, 0.6, 0.32, segments(40, fine)));
    for bay in [-2, 0, 1, 3] {
        let at = vec3(BAY * bay as f32 + 0.5 * BAY, 0.0, -DEPTH + 0.6);
        scene.place(&foot, &stone, Transform::from_translation(at));
        scene.place(&urn, &bronze, Transform::from_translation(at + 0.7 * Vec3::Y));
    }
    scene.sun(sun(), Color::srgb(1.0, 0.92, 0.8), 20_000.0, (3, 8.0, 50.0));
}

/// One opening between two halves of piers: front, back, and the curve's underside.
fn arch(g: &mut Geometry, steps: u32) {
    let scale = Vec2::splat(0.8);
    for side in [-1.0, 1.0] {
        g.surface(steps, 1, vec2(2.0, 1.0), |u, v| {
            let angle = if side > 0.0 { PI * (1.0 - u) } else { PI * u };
            let x = RADIUS * ops::cos(angle);
            let low = SPRING + RADIUS * ops::sin(angle);
            vec3(x, low + (TOP - low) * v, side * HALF_DEPTH)
        });
        let width = 0.5 * BAY - RADIUS;
        let x = side * (RADIUS + 0.5 * width);
        g.cuboid(vec3(x, 0.5 * TOP, 0.0), vec3(width, TOP, 2.0 * HALF_DEPTH), 0.8);
        for (y, height) in [(0.12, 0.24), (SPRING, 0.12)] {
            let size = vec3(width + 0.08, height, 2.0 * HALF_DEPTH + 0.12);
            g.rounded_box(vec3(x - side * 0.04, y, 0.0), size, 0.02, 2, 0.8);
        }
    }
    g.surface(steps, 1, scale, |u, v| {
        let angle = PI * u;
        let z = HALF_DEPTH * (1.0 - 2.0 * v);
        vec3(RADIUS * ops::cos(angle), SPRING + RADIUS * ops::sin(angle), z)
    });
}

/// Polished slabs, four by four, of several tones and degrees of polish.
fn slabs(uv: Vec2) -> Texel {
    let grid = uv * 4.0;
    let (x, y) = (grid.x.floor() as i32, grid.y.floor() as i32);
    let slab = smooth(0.008, 0.016, edge(grid).min_element());
    let tone = mix(vec3(0.30, 0.27, 0.27), vec3(0.66, 0.52, 0.46), hash(x, y, 3));
    let worn = fractal(uv, 6, 4, 17);
    let polished = 0.03 + 0.2 * hash(x, y, 5) + 0.2 * worn * worn;
    Texel {
        color: mix(Vec3::splat(0.2), tone * (0.45 + 0.45 * veins(uv, 4, 31)), slab),
        height: 0.0012 * slab,
        roughness: mix(Vec3::splat(0.8), Vec3::splat(polished), slab).x,
        ..Default::default()
    }
}
