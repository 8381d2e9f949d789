//! The light of a small lamp, which few rays from a rough floor hit, is not lost while the camera moves.
//!
//! Most frames of a pixel don't see the lamp, and a history that is clipped to them grows dark.

use crate::{
    convergence::{capture, switch},
    pictures::linear_app,
    stage::{begin_history, spawn_mesh, unlit_color},
};
use bevy::{core_pipeline::tonemapping::Tonemapping, math::UVec2, prelude::*};

const SIZE: UVec2 = UVec2::new(160, 90);
const GROUND_TRUTH_FRAMES: u32 = 512;
const MOVING_FRAMES: u32 = 64;
/// Number of restarted histories for the mean.
const HISTORIES: u32 = 3;
/// Relative to the true light: it is 0.02. It was -0.60 when clipping underestimated the variance.
const MOST_BIAS: f32 = 0.1;

#[test]
#[ignore = "long: 512 frames of truth"]
fn rare_light_is_kept_in_motion() {
    let Some(mut app) = linear_app(SIZE) else { return };
    app.world()
        .insert_resource(ClearColor(Color::linear_rgb(0.02, 0.02, 0.02)));
    app.world().insert_resource(GlobalAmbientLight::NONE);
    let floor = StandardMaterial {
        base_color: Color::BLACK,
        perceptual_roughness: 0.5,
        ..default()
    };
    let lamp = unlit_color(Color::linear_rgb(60.0, 60.0, 60.0));
    let at = Transform::IDENTITY;
    spawn_mesh(&mut app, Plane3d::default().mesh().size(40.0, 40.0), floor, at);
    let above = Transform::from_xyz(0.0, 3.0, -2.0);
    spawn_mesh(&mut app, Cuboid::new(0.3, 0.3, 0.3).mesh(), lamp, above);
    let pose = |time: f32| {
        let eye = Vec3::new(1.5 * time, 3.0, 5.0);
        Transform::from_translation(eye).looking_to(Vec3::new(0.0, -0.8, -1.0), Vec3::Y)
    };
    let camera = app.spawn_camera((pose(0.0), Tonemapping::None));
    let mut light = |technique: &str, moving: bool, history: u32| {
        switch(&mut app, camera, technique);
        begin_history(&mut app, camera, history);
        let frames = if moving { MOVING_FRAMES } else { GROUND_TRUTH_FRAMES };
        for frame in 0..=frames {
            let time = if moving {
                frame as f32 / frames as f32 - 1.0
            } else {
                0.0
            };
            *app.world().get_mut::<Transform>(camera).unwrap() = pose(time);
            app.step(1);
        }
        capture(&mut app, technique).iter().sum::<f32>()
    };
    let truth = light("converged", false, 0);
    for technique in ["quarter", "vrs-combined", "vrs-adaptive"] {
        let found = (0..HISTORIES).map(|history| light(technique, true, history));
        let found = found.sum::<f32>() / (HISTORIES as f32 * truth);
        println!("{technique}: {found:.3} of the true light");
        assert!(
            (found - 1.0).abs() < MOST_BIAS,
            "{technique}: {found} of the true light"
        );
    }
}
