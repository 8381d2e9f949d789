//! Things that move, as pure functions of [`Time`]: the same time always gives the same picture.

use bevy::{
    app::{App, Plugin, Update},
    ecs::{
        component::Component,
        system::{Query, Res},
    },
    math::{Quat, Vec3, ops, vec3},
    time::Time,
    transform::components::Transform,
};
use std::f32::consts::TAU;

/// Runs the animation of the scenes. Without it they stand still.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneAnimationPlugin;

impl Plugin for SceneAnimationPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(Update, animate);
    }
}

/// A motion around where the entity was spawned.
#[derive(Component, Clone, Copy, Debug)]
pub enum Motion {
    /// Turns about an axis through its own origin.
    Spin {
        /// Rotation at time zero.
        start: Quat,
        /// Unit axis in the entity's own space.
        axis: Vec3,
        /// Turns per second.
        rate: f32,
    },
    /// Runs along an ellipse in the horizontal plane while bobbing up and down.
    Orbit {
        /// Middle of the ellipse.
        center: Vec3,
        /// Half axes (x, z) and height of the bob (y), in metres.
        extent: Vec3,
        /// Turns per second.
        rate: f32,
        /// Its angle at the start, in turns.
        phase: f32,
    },
}

impl Motion {
    /// Writes the pose at a time in seconds.
    pub fn apply(&self, seconds: f32, transform: &mut Transform) {
        match *self {
            Motion::Spin { start, axis, rate } => {
                transform.rotation = start * Quat::from_axis_angle(axis, TAU * (seconds * rate).fract());
            }
            Motion::Orbit {
                center,
                extent,
                rate,
                phase,
            } => {
                let angle = TAU * (seconds * rate + phase).fract();
                let ring = vec3(ops::cos(angle), ops::sin(angle * 2.0), ops::sin(angle));
                transform.translation = center + extent * ring;
            }
        }
    }
}

fn animate(time: Res<Time>, mut moving: Query<(&Motion, &mut Transform)>) {
    for (motion, mut transform) in &mut moving {
        motion.apply(time.elapsed_secs(), &mut transform);
    }
}
