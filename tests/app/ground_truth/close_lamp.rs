//! A lamp close to a floor lights no more of it than in the ground truth.
//!
//! Rays from beside the lamp hit its underside at a short distance. Some pixels farther away see the lamp on edge, and hardly at all:
//! rays borrowed from there must not count.

use crate::{
    convergence::{capture, switch},
    pictures::linear_app,
    stage::spawn_mesh,
};
use bevy::{core_pipeline::tonemapping::Tonemapping, math::UVec2, prelude::*};

const SIZE: UVec2 = UVec2::new(128, 72);
const GROUND_TRUTH_FRAMES: u32 = 512;
const FRAMES: u32 = 48;
/// Light of the floor in front of the lamp, as a multiple of the ground truth. It is 3, since records have no normal of the hit, and was
/// 6.5 with a lower limit on the weight of a neighbour's ray.
const MOST_LIGHT: f32 = 4.5;

#[test]
#[ignore = "long: 512 frames of truth"]
fn a_lamp_close_to_a_floor_shines_no_farther_than_in_truth() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let gray = Color::linear_rgb(0.05, 0.05, 0.05);
    app.world().insert_resource(ClearColor(gray));
    app.world().insert_resource(GlobalAmbientLight::NONE);
    let floor = StandardMaterial {
        base_color: Color::BLACK,
        ..default()
    };
    let lamp = StandardMaterial {
        base_color: Color::linear_rgb(100.0, 100.0, 100.0),
        unlit: true,
        double_sided: true,
        cull_mode: None,
        ..default()
    };
    let at = Transform::IDENTITY;
    spawn_mesh(&mut app, Plane3d::default().mesh().size(20.0, 20.0), floor, at);
    let above = Transform::from_xyz(0.0, 0.009, 0.0);
    spawn_mesh(&mut app, Plane3d::default().mesh().size(1.3, 1.05), lamp, above);
    let projection = Projection::from(PerspectiveProjection { fov: 0.2, ..default() });
    let eye = Transform::from_xyz(0.0, 2.75, 10.8).looking_at(Vec3::new(0.0, 0.0, 0.6), Vec3::Y);
    let camera = app.spawn_camera((eye, projection, Tonemapping::None));
    let mut light = |technique, frames| {
        switch(&mut app, camera, technique);
        app.step(frames);
        let picture = capture(&mut app, technique);
        let row = |y: u32| &picture[(y * SIZE.x) as usize..((y + 1) * SIZE.x) as usize];
        let is_lamp = |y: &u32| row(*y).contains(&4.0);
        let edge = (0..SIZE.y).rfind(is_lamp).expect("the lamp is in the picture");
        (edge + 2..edge + 12).map(|y| row(y).iter().sum::<f32>()).sum::<f32>()
    };
    let truth = light("converged", GROUND_TRUTH_FRAMES);
    let found = light("medium", FRAMES) / truth;
    println!("{found:.2} of the true light");
    assert!(found < MOST_LIGHT, "{found} of the true light");
}
