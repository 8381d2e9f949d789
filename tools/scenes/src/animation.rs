//! Moving or flickering objects, as pure functions of a time in seconds: the same time always gives the same image.

use bevy::prelude::*;
use std::f32::consts::TAU;

/// Runs the animation of the scenes by the app's clock. Without it they don't move, unless [`set_time`] moves them.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneAnimationPlugin;

impl Plugin for SceneAnimationPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(Update, animate);
    }
}

/// A motion in the space of the entity's parent.
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
    /// Swings about an axis through its own origin, as doors, pendulums and legs do.
    Swing {
        /// Rotation in the middle of the swing.
        middle: Quat,
        /// Unit axis in the entity's own space.
        axis: Vec3,
        /// Angle from the middle to either side, in radians.
        angle: f32,
        /// Swings to and fro per second.
        rate: f32,
        /// Finished fraction of a swing at the start.
        phase: f32,
    },
    /// Walks around an ellipse in the horizontal plane, with its own +x ahead.
    Lap {
        /// Middle of the ellipse.
        center: Vec3,
        /// Half axes along x and z, in metres.
        half_axes: Vec2,
        /// Turns per second.
        rate: f32,
        /// Its angle at the start, in turns.
        phase: f32,
    },
    /// Goes from one point to another and back, slowing down at both; rolls if it is round.
    Shuttle {
        /// The first point.
        from: Vec3,
        /// The other one.
        to: Vec3,
        /// Rotation at the first point.
        start: Quat,
        /// Radius of a rolling object, in metres; infinite for one that doesn't roll.
        radius: f32,
        /// Ways there and back per second.
        rate: f32,
        /// Finished fraction of the way there and back at the start.
        phase: f32,
    },
}

impl Motion {
    /// Writes the pose at a time in seconds.
    pub fn apply(&self, seconds: f32, transform: &mut Transform) {
        let turns = |rate: f32, phase: f32| TAU * (seconds * rate + phase).fract();
        match *self {
            Motion::Spin { start, axis, rate } => {
                transform.rotation = start * Quat::from_axis_angle(axis, turns(rate, 0.0));
            }
            Motion::Orbit {
                center,
                extent,
                rate,
                phase,
            } => {
                let angle = turns(rate, phase);
                let ring = vec3(ops::cos(angle), ops::sin(angle * 2.0), ops::sin(angle));
                transform.translation = center + extent * ring;
            }
            Motion::Swing {
                middle,
                axis,
                angle,
                rate,
                phase,
            } => {
                let angle = angle * ops::sin(turns(rate, phase));
                transform.rotation = middle * Quat::from_axis_angle(axis, angle);
            }
            Motion::Lap {
                center,
                half_axes,
                rate,
                phase,
            } => {
                let (sin, cos) = ops::sin_cos(turns(rate, phase));
                transform.translation = center + vec3(half_axes.x * cos, 0.0, half_axes.y * sin);
                let (ahead_x, ahead_z) = (-half_axes.x * sin, half_axes.y * cos);
                transform.rotation = Quat::from_rotation_y(ops::atan2(-ahead_z, ahead_x));
            }
            Motion::Shuttle {
                from,
                to,
                start,
                radius,
                rate,
                phase,
            } => {
                let share = 0.5 - 0.5 * ops::cos(turns(rate, phase));
                transform.translation = from.lerp(to, share);
                let axis = Vec3::Y.cross(to - from).try_normalize().unwrap_or(Vec3::X);
                let rolled = share * from.distance(to) / radius;
                transform.rotation = Quat::from_axis_angle(axis, rolled) * start;
            }
        }
    }
}

/// A light that flickers, with its bulb and its own material.
#[derive(Component, Clone, Debug)]
pub struct Flicker {
    /// Mean brightness of the light, in lumens.
    pub lumens: f32,
    /// Mean emission of the bulb.
    pub emissive: LinearRgba,
    /// The bulb's material.
    pub bulb: Handle<StandardMaterial>,
}

impl Flicker {
    /// Brightness at a time in seconds, relative to the mean: three waves with rates without a common period.
    pub fn brightness(seconds: f32) -> f32 {
        let wave = |rate: f32| ops::sin(TAU * (seconds * rate).fract());
        1.0 + 0.35 * wave(2.3) + 0.3 * wave(5.9) + 0.2 * wave(11.7)
    }
}

/// Moves all animated objects and lights to their state at a time in seconds.
pub fn set_time(world: &mut World, seconds: f32) {
    for (motion, mut transform) in world.query::<(&Motion, &mut Transform)>().iter_mut(world) {
        motion.apply(seconds, &mut transform);
    }
    let brightness = Flicker::brightness(seconds);
    let mut bulbs = Vec::new();
    for (flicker, mut light) in world.query::<(&Flicker, &mut PointLight)>().iter_mut(world) {
        light.intensity = brightness * flicker.lumens;
        bulbs.push((flicker.bulb.clone(), flicker.emissive * brightness));
    }
    let Some(mut materials) = world.get_resource_mut::<Assets<StandardMaterial>>() else {
        return;
    };
    for (bulb, emissive) in bulbs {
        if let Some(mut material) = materials.get_mut(&bulb) {
            material.emissive = emissive;
        }
    }
}

fn animate(world: &mut World) {
    if let Some(seconds) = world.get_resource::<Time>().map(Time::elapsed_secs) {
        set_time(world, seconds);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(motion: Motion, seconds: f32) -> Transform {
        let mut transform = Transform::IDENTITY;
        motion.apply(seconds, &mut transform);
        transform
    }

    #[test]
    fn a_walker_looks_ahead() {
        let motion = Motion::Lap {
            center: Vec3::Y,
            half_axes: Vec2::new(3.0, 1.0),
            rate: 0.05,
            phase: 0.1,
        };
        for step in 0..40 {
            let seconds = 0.5 * step as f32;
            let (here, next) = (pose(motion, seconds), pose(motion, seconds + 1e-2));
            let ahead = (next.translation - here.translation).normalize();
            assert!(ahead.dot(here.rotation * Vec3::X) > 0.999, "{seconds}: {ahead}");
        }
    }

    #[test]
    fn a_ball_rolls_without_slipping() {
        let motion = |radius| Motion::Shuttle {
            from: vec3(1.0, 0.5, 0.0),
            to: vec3(1.0, 0.5, 4.0),
            start: Quat::IDENTITY,
            radius,
            rate: 0.1,
            phase: 0.0,
        };
        let step = 1e-2;
        let (here, next) = (pose(motion(0.5), 2.0), pose(motion(0.5), 2.0 + step));
        // The point at the bottom of the ball stays where it touches the ground.
        let bottom = here.rotation.inverse() * vec3(0.0, -0.5, 0.0);
        let slipped = next.transform_point(bottom) - here.transform_point(bottom);
        let moved = here.translation.distance(next.translation);
        assert!(moved > 0.01 && slipped.length() < 0.05 * moved, "{slipped} of {moved}");
        assert_eq!(pose(motion(0.5), 5.0).translation.z, 4.0);
        assert_eq!(pose(motion(f32::INFINITY), 3.3).rotation, Quat::IDENTITY, "it slides");
    }

    #[test]
    fn a_door_swings_to_both_sides() {
        let motion = Motion::Swing {
            middle: Quat::from_rotation_y(1.0),
            axis: Vec3::Y,
            angle: 0.5,
            rate: 0.25,
            phase: 0.0,
        };
        let angle = |seconds| pose(motion, seconds).rotation.to_euler(EulerRot::YXZ).0;
        for (seconds, expected) in [(0.0, 1.0), (1.0, 1.5), (2.0, 1.0), (3.0, 0.5)] {
            assert!((angle(seconds) - expected).abs() < 1e-4, "{seconds}");
        }
    }

    #[test]
    fn a_light_flickers_with_its_bulb() {
        let mut world = World::new();
        world.init_resource::<Assets<StandardMaterial>>();
        let bulb = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::default());
        let flicker = Flicker {
            lumens: 1000.0,
            emissive: LinearRgba::rgb(8.0, 4.0, 2.0),
            bulb: bulb.clone(),
        };
        let lamp = world.spawn((PointLight::default(), flicker)).id();
        let mut seen = Vec::new();
        for frame in 0..60 {
            set_time(&mut world, frame as f32 / 60.0);
            let lumens = world.get::<PointLight>(lamp).unwrap().intensity;
            let emissive = world
                .resource::<Assets<StandardMaterial>>()
                .get(&bulb)
                .unwrap()
                .emissive;
            assert!((emissive.red / 8.0 - lumens / 1000.0).abs() < 1e-4);
            seen.push(lumens);
        }
        let (low, high) = (
            seen.iter().copied().fold(f32::MAX, f32::min),
            seen.iter().copied().fold(0.0, f32::max),
        );
        assert!(
            100.0 < low && low < 600.0 && 1400.0 < high && high < 2000.0,
            "{low} to {high}"
        );
        set_time(&mut world, 0.25);
        let first = world.get::<PointLight>(lamp).unwrap().intensity;
        set_time(&mut world, 7.0);
        set_time(&mut world, 0.25);
        assert_eq!(
            world.get::<PointLight>(lamp).unwrap().intensity,
            first,
            "a pure function of time"
        );
    }
}
