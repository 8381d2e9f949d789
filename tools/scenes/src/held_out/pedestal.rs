//! A helmet of curved metal with two lenses on a matte pedestal before a matte wall. It alone reflects, about 13 % of the image. All
//! else is unlit: a lit surface traces rays up to the cut-off of the roughness, even if it hardly reflects.

use super::{ground, indoors, lamps, lathe, room};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Around the helmet, which looks along +z.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(1.6, 1.6, 1.3), vec3(0.0, 1.4, 0.0)),
        (vec3(1.1, 1.5, 1.7), vec3(0.0, 1.4, 0.0)),
        (vec3(0.2, 1.45, 1.95), vec3(0.0, 1.4, 0.0)),
        (vec3(-0.8, 1.65, 1.8), vec3(0.0, 1.4, 0.0)),
        (vec3(-1.4, 1.6, 1.4), vec3(0.0, 1.4, 0.0)),
    ],
    10.0,
    38.0,
    40.0,
);

pub fn environment(world: &mut World) -> Environment {
    indoors(world, 4.9)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let fine = options.detail.sqrt();
    let plaster = scene.textures(options.texture_size, patterns::plaster).base_color;
    let [wall, floor, stone] = [(0.56, 0.53, 0.52), (0.30, 0.25, 0.22), (0.74, 0.72, 0.68)].map(|(r, g, b)| {
        let base_color_texture = Some(plaster.clone());
        scene.material(StandardMaterial {
            base_color_texture,
            ..unlit(Color::srgb(r, g, b))
        })
    });

    let walls = scene.shape(|g| room(g, vec3(7.0, 3.4, 7.0), 0.5));
    scene.place(&walls, &wall, Transform::from_xyz(0.0, 0.0, 1.5));
    let level = scene.shape(|g| ground(g, vec2(3.5, 3.5), 0.0, 0.5));
    scene.place(&level, &floor, Transform::from_xyz(0.0, 0.0, 1.5));
    let foot = scene.shape(|g| g.rounded_box(vec3(0.0, 0.5, 0.0), vec3(0.55, 1.0, 0.55), 0.02, 3, 1.0));
    scene.place(&foot, &stone, Transform::IDENTITY);
    // Coloured boxes behind the camera, which the metal reflects.
    let block = scene.shape(|g| g.cuboid(vec3(0.0, 0.5, 0.0), Vec3::ONE, 1.0));
    for (index, color) in [
        (0.8, 0.2, 0.1),
        (0.1, 0.5, 0.7),
        (0.8, 0.7, 0.2),
        (0.2, 0.6, 0.2),
        (0.7, 0.7, 0.7),
    ]
    .into_iter()
    .enumerate()
    {
        let angle = 0.9 * (index as f32 - 2.0);
        let at = vec3(3.0 * ops::sin(angle), 0.0, 1.5 + 3.0 * ops::cos(angle));
        let material = scene.material(unlit(Color::linear_rgb(color.0, color.1, color.2)));
        let size = vec3(0.6, 0.8 + 0.5 * (index % 3) as f32, 0.6);
        scene.place(&block, &material, Transform::from_translation(at).with_scale(size));
    }
    let color = LinearRgba::rgb(1.0, 0.88, 0.72);
    let places = [vec3(-1.7, 2.8, 1.6), vec3(1.5, 3.0, 2.2), vec3(0.4, 2.6, 4.2)];
    lamps(scene, fine, places, color, 5_000.0, 10.0, 0.14);
    helmet(scene, options.texture_size, fine);
}

/// Shell, mask, crest, lenses with their rims, and two hoses.
fn helmet(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let worn = scene.textures(size, patterns::worn_metal).material();
    let steel = scene.material(dyed(&worn, Color::srgb(0.72, 0.73, 0.76)));
    let brass = scene.material(metal(Color::srgb(0.93, 0.74, 0.42), 0.2));
    let paint = scene.material(metal(Color::srgb(0.30, 0.33, 0.24), 0.45));
    let lens = scene.material(gloss(Color::srgb(0.02, 0.03, 0.05), 0.0));
    let hose = scene.material(metal(Color::srgb(0.45, 0.45, 0.47), 0.3));
    let middle = Vec3::Y * 1.42;
    let at = |x: f32, y: f32, z: f32| Transform::from_translation(middle + vec3(x, y, z));
    let ball = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, segments(72, fine), vec2(3.0, 2.0)));
    scene.place(&ball, &steel, at(0.0, 0.02, 0.0).with_scale(vec3(0.29, 0.33, 0.34)));
    scene.place(&ball, &paint, at(0.0, -0.19, 0.14).with_scale(vec3(0.19, 0.2, 0.23)));
    let ring = scene.shape(|g| g.torus(1.0, 0.06, segments(64, fine), segments(20, fine)));
    let level = Quat::from_rotation_x(0.25 * TAU);
    let neck = at(0.0, -0.24, -0.02).with_rotation(level);
    scene.place(&ring, &brass, neck.with_scale(vec3(0.25, 0.29, 0.6)));
    let crest = at(0.0, 0.04, 0.0).with_rotation(turned(90.0));
    scene.place(&ring, &brass, crest.with_scale(vec3(0.345, 0.335, 0.5)));
    let collar = scene.shape(|g| {
        let profile = [0.3, 0.0, 0.3, 0.02, 0.25, 0.06, 0.22, 0.16, 0.2, 0.2];
        lathe(g, segments(56, fine), &profile);
    });
    let below = Transform::from_xyz(0.0, 1.0, 0.0);
    scene.place(&collar, &steel, below.with_scale(vec3(0.9, 1.0, 0.9)));
    for side in [-1.0, 1.0] {
        let eye = at(0.125 * side, 0.02, 0.27).with_rotation(turned(20.0 * side));
        scene.place(&ball, &lens, eye.with_scale(vec3(0.1, 0.1, 0.07)));
        scene.place(&ring, &brass, eye.with_scale(vec3(0.105, 0.105, 0.3)));
        let line = scene.shape(|g| {
            let bend = |t: f32| {
                let x = side * (0.1 + 0.22 * ops::sin(3.0 * t));
                vec3(x, -0.22 - 0.16 * t, 0.3 - 0.42 * t)
            };
            let points: Vec<Vec3> = (0..=20).map(|i| bend(i as f32 / 20.0)).collect();
            g.tube(&points, 0.035, segments(20, fine));
            for point in points.iter().step_by(2) {
                g.sphere(*point, 0.041, segments(16, fine), Vec2::ONE);
            }
        });
        scene.place(&line, &hose, at(0.0, 0.0, 0.0));
    }
}
