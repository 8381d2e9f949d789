//! Glossy wall tiles with joints, chrome and a mirror under a lamp.

use super::{ground, indoors, lamps, lathe, room};
use crate::prelude::*;

/// From the bath to the basin, which is in front of the back wall.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(1.3, 1.6, 1.4), vec3(-0.3, 1.1, -1.4)),
        (vec3(0.9, 1.5, 1.25), vec3(-0.2, 1.1, -1.4)),
        (vec3(0.2, 1.5, 1.0), vec3(-0.5, 0.9, -1.2)),
        (vec3(-0.2, 1.45, 0.9), vec3(1.2, 0.75, -0.7)),
        (vec3(-0.9, 1.5, 1.0), vec3(1.4, 0.8, -0.4)),
    ],
    12.0,
    62.0,
    40.0,
);

pub fn environment(world: &mut World) -> Environment {
    indoors(world, 5.3)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let tiles = scene.textures(size, tiles).material();
    let wall = scene.material(dyed(&tiles, Color::srgb(0.62, 0.80, 0.80)));
    let dark = scene.material(dyed(&tiles, Color::srgb(0.16, 0.18, 0.22)));
    let chrome = scene.material(metal(Color::srgb(0.93, 0.94, 0.95), 0.06));
    let mirror = scene.material(metal(Color::srgb(0.96, 0.97, 0.97), 0.0));
    let ceramic = scene.material(gloss(Color::srgb(0.88, 0.88, 0.86), 0.1));
    let wood = scene.material(gloss(Color::srgb(0.42, 0.26, 0.15), 0.45));
    let weave = scene.textures(size / 2, patterns::cloth).material();
    let towel = scene.material(both_sides(dielectric(dyed(&weave, Color::srgb(0.85, 0.35, 0.15)))));

    let walls = scene.shape(|g| room(g, vec3(3.6, 2.6, 3.6), 1.2));
    scene.place(&walls, &wall, Transform::IDENTITY);
    let floor = scene.shape(|g| ground(g, vec2(1.8, 1.8), 0.0, 0.6));
    scene.place(&floor, &dark, Transform::IDENTITY);

    let pane = scene.shape(|g| g.cuboid(vec3(0.0, 1.55, -1.775), vec3(1.1, 0.9, 0.03), 1.0));
    scene.place(&pane, &mirror, Transform::from_xyz(-0.4, 0.0, 0.0));
    let cabinet = scene.shape(|g| g.rounded_box(vec3(-0.4, 0.4, -1.5), vec3(1.2, 0.75, 0.5), 0.01, 2, 1.0));
    scene.place(&cabinet, &wood, Transform::IDENTITY);
    let basin = scene.shape(|g| {
        let profile = [
            0.0, 0.0, 0.16, 0.0, 0.24, 0.06, 0.27, 0.15, 0.26, 0.16, 0.24, 0.15, 0.2, 0.07, 0.0, 0.04,
        ];
        lathe(g, segments(48, fine), &profile);
    });
    scene.place(&basin, &ceramic, Transform::from_xyz(-0.4, 0.775, -1.45));
    let tap = scene.shape(|g| {
        let spout = [(0.0, 0.0), (0.28, 0.0), (0.36, 0.04), (0.37, 0.12), (0.33, 0.19)].map(|(y, z)| vec3(0.0, y, z));
        g.tube(&spout, 0.018, segments(20, fine));
        lathe(g, segments(32, fine), &[0.0, 0.0, 0.05, 0.0, 0.045, 0.02, 0.02, 0.03]);
        g.sphere(vec3(0.0, 0.3, -0.01), 0.032, segments(24, fine), Vec2::ONE);
    });
    scene.place(&tap, &chrome, Transform::from_xyz(-0.4, 0.775, -1.73));
    let bath = scene.shape(bath);
    scene.place(&bath, &ceramic, Transform::IDENTITY);
    let on_bath = Transform::from_xyz(1.72, 0.53, -0.6).with_rotation(turned(-90.0));
    scene.place(&tap, &chrome, on_bath);
    let rail = scene.shape(|g| {
        g.tube(&[vec3(-0.4, 0.0, 0.0), vec3(0.4, 0.0, 0.0)], 0.014, segments(16, fine));
        for x in [-0.4, 0.4] {
            g.tube(&[vec3(x, 0.0, 0.0), vec3(x, 0.0, -0.08)], 0.012, segments(16, fine));
        }
    });
    scene.place(&rail, &chrome, Transform::from_xyz(0.85, 1.6, -1.72));
    let cloth = scene.shape(|g| props::curtain(g, 0.5, 0.7, 4.0, segments(40, fine), segments(12, fine)));
    let on_rail = Transform::from_xyz(0.85, 0.9, -1.68);
    scene.place(&cloth, &towel, on_rail.with_scale(vec3(1.0, 1.0, 0.5)));
    let bottle = scene.shape(|g| {
        let profile = [0.0, 0.0, 0.035, 0.0, 0.035, 0.12, 0.012, 0.15, 0.012, 0.19, 0.0, 0.19];
        lathe(g, segments(24, fine), &profile);
    });
    for (x, color) in [
        (-0.9, Color::srgb(0.1, 0.3, 0.7)),
        (-0.8, Color::srgb(0.8, 0.6, 0.1)),
        (0.1, Color::srgb(0.6, 0.1, 0.2)),
    ] {
        let glossy = scene.material(gloss(color, 0.15));
        scene.place(&bottle, &glossy, Transform::from_xyz(x, 0.775, -1.6));
    }
    let color = LinearRgba::rgb(1.0, 0.9, 0.76);
    let places = [vec3(0.1, 2.35, 0.2), vec3(-0.4, 2.2, -1.66)];
    lamps(scene, fine, places, color, 3_200.0, 7.0, 0.09);
}

/// A bath along the wall at +x.
fn bath(g: &mut Geometry) {
    g.rounded_box(vec3(1.0, 0.27, -0.3), vec3(0.06, 0.54, 1.9), 0.025, 3, 1.0);
    g.rounded_box(vec3(1.72, 0.27, -0.3), vec3(0.14, 0.54, 1.9), 0.025, 3, 1.0);
    for z in [-1.22, 0.62] {
        g.rounded_box(vec3(1.36, 0.265, z), vec3(0.78, 0.53, 0.08), 0.025, 3, 1.0);
    }
    g.cuboid(vec3(1.36, 0.15, -0.3), vec3(0.68, 0.1, 1.8), 1.0);
}

/// Glazed tiles, six by six, between recessed joints. Their faces lean a little, each to its own side.
fn tiles(uv: Vec2) -> Texel {
    let grid = uv * 6.0;
    let (x, y) = (grid.x.floor() as i32, grid.y.floor() as i32);
    let tile = smooth(0.02, 0.06, edge(grid).min_element());
    let lean = vec2(hash(x, y, 1), hash(x, y, 2)) - 0.5;
    let plane = lean.dot(grid - grid.floor() - 0.5);
    let glaze = fractal(uv, 12, 3, 5);
    Texel {
        color: mix(Vec3::splat(0.75), Vec3::splat(0.86 + 0.14 * hash(x, y, 4)), tile),
        height: tile * (0.0025 + 0.002 * plane + 0.0006 * glaze),
        roughness: 0.85 + (0.03 + 0.09 * hash(x, y, 3) - 0.85) * tile,
        ..Default::default()
    }
}
