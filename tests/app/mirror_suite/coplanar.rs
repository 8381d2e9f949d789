//! Rows of the mirror suite about surfaces in the same place: Bevy's depth test, depth biases and order of drawing decide between them.

use super::{Row, Stage, blue};
use crate::{
    pictures::{apps, dump},
    stage::SIZE,
};
use bevy::prelude::*;
use bevy_glint::ReflectionTechnique;
use core::f32::consts::PI;
use glint_scenes::Output;

pub(super) const ROWS: [Row; 8] = [
    ("blended sheets on the triangles of opaque ones", |stage| {
        stage.show_layers();
        stage.spawn_sheets([opaque(), blended()]);
    }),
    (
        "masked sheets on the triangles of opaque ones, beside a blended one",
        |stage| {
            let base_color_texture = Some(stage.checkers([60, 90, 255, 255], [0, 0, 0, 0], true));
            let masked = StandardMaterial {
                base_color_texture,
                alpha_mode: AlphaMode::Mask(0.5),
                ..unlit(1.0, 1.0, 1.0, 1.0)
            };
            stage.show_layers();
            stage.put(Rectangle::new(0.5, 0.5), blended(), facing(0.0, 1.6, 6.0));
            stage.spawn_sheets([opaque(), masked]);
        },
    ),
    (
        "two blended sheets of the same triangles, by their depth bias",
        |stage| {
            stage.show_layers();
            // Bevy draws those without a difference in an order that depends on the identifiers of their entities.
            let green = StandardMaterial {
                depth_bias: 1.0,
                ..unlit(0.1, 0.8, 0.1, 0.5)
            };
            stage.spawn_sheets([green, blended()]);
        },
    ),
    ("depth biases of sheets of the same triangles", |stage| {
        let biased = StandardMaterial {
            depth_bias: 1.0,
            ..unlit(0.1, 0.8, 0.1, 1.0)
        };
        stage.spawn_sheets([opaque(), biased]);
    }),
    ("decals in the plane of a wall, by their depth bias", |stage| {
        stage.spawn_decals([200.0, 1000.0, 100.0], 0.0, AlphaMode::Opaque);
    }),
    ("blended decals in the plane of a wall, by their depth bias", |stage| {
        stage.show_layers();
        stage.spawn_decals([200.0, 1000.0, 100.0], 0.0, AlphaMode::Blend);
    }),
    ("decals in the plane of a wall with a negative depth bias", |stage| {
        stage.spawn_decals([0.0, 20.0, -20.0], -200.0, AlphaMode::Opaque);
    }),
    ("decals that their depth bias hides", |stage| {
        stage.spawn_decals([-200.0, -30.0, 200.0], 0.0, AlphaMode::Opaque);
    }),
];

fn unlit(red: f32, green: f32, blue: f32, alpha: f32) -> StandardMaterial {
    StandardMaterial {
        base_color: Color::linear_rgba(red, green, blue, alpha),
        alpha_mode: if alpha < 1.0 {
            AlphaMode::Blend
        } else {
            AlphaMode::Opaque
        },
        unlit: true,
        ..default()
    }
}

fn opaque() -> StandardMaterial {
    unlit(0.9, 0.1, 0.1, 1.0)
}

fn blended() -> StandardMaterial {
    unlit(0.05, 0.1, 0.9, 0.3)
}

/// Faces the mirror.
fn facing(x: f32, y: f32, z: f32) -> Transform {
    Transform::from_xyz(x, y, z).with_rotation(Quat::from_rotation_y(PI))
}

impl Stage<'_> {
    /// Two sheets of the same triangles in both orders, before a wall.
    fn spawn_sheets(&mut self, materials: [StandardMaterial; 2]) {
        self.put(
            Rectangle::new(9.0, 6.0),
            unlit(0.05, 0.6, 0.1, 1.0),
            facing(0.0, 0.0, 9.0),
        );
        let [first, second] = materials;
        for (x, order) in [(-1.2, [first.clone(), second.clone()]), (1.2, [second, first])] {
            for material in order {
                self.put(Rectangle::new(2.0, 2.0), material, facing(x, 0.0, 6.0));
            }
        }
    }

    /// Sheets of other sizes and angles in the plane of a lit wall, which is turned away from the axes. The last two overlap.
    fn spawn_decals(&mut self, biases: [f32; 3], of_wall: f32, alpha_mode: AlphaMode) {
        let wall = StandardMaterial {
            depth_bias: of_wall,
            ..blue()
        };
        self.light_and_spawn(blue());
        let place = facing(0.3, 0.2, 6.0) * Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, 0.2, -0.4, 0.0));
        self.put(Rectangle::new(5.0, 3.5), wall, place);
        let colors = [(0.9, 0.2, 0.1), (0.1, 0.9, 0.1), (0.9, 0.8, 0.1)];
        let places = [(-1.2, 0.3), (0.9, 0.2), (1.4, -0.2)];
        for (i, (bias, ((red, green, blue), (x, y)))) in
            biases.into_iter().zip(colors.into_iter().zip(places)).enumerate()
        {
            let decal = StandardMaterial {
                base_color: Color::linear_rgba(red, green, blue, 0.7),
                depth_bias: bias,
                alpha_mode,
                ..super::blue()
            };
            let turn = Transform::from_xyz(x, y, 0.0).with_rotation(Quat::from_rotation_z(0.3 + i as f32));
            self.put(Rectangle::new(1.2, 1.4), decal, place * turn);
        }
    }
}

/// Mean colour of a rectangle of an image.
fn mean_color(image: &[u8], from: UVec2, to: UVec2) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for y in from.y..to.y {
        for x in from.x..to.x {
            let pixel = &image[4 * (y * SIZE.x + x) as usize..];
            for (sum, part) in sum.iter_mut().zip(pixel) {
                *sum += f32::from(*part);
            }
        }
    }
    let count = (to - from).element_product() as f32;
    sum.map(|sum| sum / count)
}

/// Rays that stop at see-through surfaces by chance see the same.
#[test]
fn sheets_in_one_place_blend_in_converged_mirrors() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let mut stage = Stage::new(&mut app);
        stage.technique = ReflectionTechnique::Converged;
        stage.frames = 64;
        stage.spawn_sheets([opaque(), blended()]);
        let actual = stage.in_the_mirror();
        stage.frames = 2;
        let expected = stage.by_the_mirrored_camera();
        for x in [30, 58] {
            let (from, to) = (UVec2::new(x, 26), UVec2::new(x + 8, 38));
            let [actual_mean, expected_mean] = [&actual, &expected].map(|image| mean_color(image, from, to));
            println!("{tracer}, columns from {x}: {actual_mean:?}, directly {expected_mean:?}");
            let apart = (0..3)
                .map(|i| (actual_mean[i] - expected_mean[i]).abs())
                .fold(0.0, f32::max);
            if apart > 3.0 {
                let folder = dump("sheets in a converged mirror", SIZE, &expected, &actual);
                panic!(
                    "{tracer}: {actual_mean:?}, directly {expected_mean:?}; see {}",
                    folder.display()
                );
            }
            // What Bevy shows, too.
            let right = [210.0, 89.0, 157.0];
            assert!(
                (0..3).all(|i| (expected_mean[i] - right[i]).abs() < 2.0),
                "{expected_mean:?}"
            );
        }
    }
}
