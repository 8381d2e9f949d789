//! Objects that move through the places: people who walk, a van, doors, a lamp on a pendulum, a light that flickers, and balls that
//! roll. Their poses are pure functions of the time.

mod casts;
mod shapes;

pub use casts::{ATRIUM, STREET, TEMPLE};

use crate::{
    animation::{Flicker, Motion},
    prelude::*,
};
use bevy::light::NotShadowCaster;

/// A person who walks around an ellipse.
pub struct Walker {
    center: Vec3,
    /// Half axes along x and z.
    half_axes: Vec2,
    /// Turns per second; below 0 the other way around.
    rate: f32,
    phase: f32,
    coat: Color,
}

/// An object that goes to and fro.
pub struct Shuttle {
    from: Vec3,
    to: Vec3,
    rate: f32,
    phase: f32,
}

/// A leaf on a hinge.
pub struct Door {
    hinge: Vec3,
    /// Width and height in metres.
    size: Vec2,
    /// Direction of the leaf in the middle of its swing, in degrees.
    degrees: f32,
    rate: f32,
}

/// A lamp that hangs from a wire across.
pub struct Pendulum {
    pivot: Vec3,
    length: f32,
    /// Half of its wire; none if there is a ceiling.
    half_wire: Option<Vec3>,
    /// The axis of its swing.
    axis: Vec3,
    lumens: f32,
    rate: f32,
}

/// A light on a stand.
pub struct Flame {
    foot: Vec3,
    height: f32,
    lumens: f32,
}

/// All that moves in a place.
pub struct Cast {
    walkers: &'static [Walker],
    vans: &'static [Shuttle],
    /// Balls touch the ground below their ways.
    balls: &'static [Shuttle],
    doors: &'static [Door],
    pendulums: &'static [Pendulum],
    flames: &'static [Flame],
}

/// A mesh and its material.
type Part<'a> = (&'a SceneMesh, &'a Handle<StandardMaterial>);

/// Radius of balls in metres.
const BALL: f32 = 0.36;
/// Light of lamps and flames.
const WARM: Color = Color::srgb(1.0, 0.74, 0.46);
/// Emission of bulbs.
const BULB: LinearRgba = LinearRgba::rgb(9.0, 5.2, 2.2);

/// Adds a cast to a scene.
pub fn add(scene: &mut SceneBuilder, cast: &Cast, options: &SceneOptions) {
    let detail = options.detail;
    walkers(scene, cast.walkers, detail);
    vans(scene, cast.vans, detail);
    balls(scene, cast.balls, detail);
    doors(scene, cast.doors);
    pendulums(scene, cast.pendulums, detail);
    flames(scene, cast.flames, detail);
}

/// An entity that moves with all its parts.
fn mover(scene: &mut SceneBuilder, motion: Motion, start: Transform) -> Entity {
    scene.add((motion, start, Visibility::default()))
}

/// Makes a placed object a part of another one, in whose space it then lies.
fn attach(scene: &mut SceneBuilder, part: Entity, to: Entity) {
    scene.world.entity_mut(part).insert(ChildOf(to));
}

/// Places meshes as parts of another object, at its origin.
fn attach_all<'a>(scene: &mut SceneBuilder, parts: impl IntoIterator<Item = Part<'a>>, to: Entity) {
    for (mesh, material) in parts {
        let part = scene.place(mesh, material, Transform::IDENTITY);
        attach(scene, part, to);
    }
}

fn walkers(scene: &mut SceneBuilder, walkers: &[Walker], detail: f32) {
    let body = scene.shape(|g| shapes::body(g, detail));
    let head = scene.shape(|g| shapes::head(g, detail));
    let leg = scene.shape(|g| shapes::leg(g, detail));
    let arm = scene.shape(|g| shapes::arm(g, detail));
    let skin = scene.material(gloss(Color::srgb(0.62, 0.42, 0.31), 0.6));
    let cloth = scene.material(gloss(Color::srgb(0.06, 0.07, 0.10), 0.7));
    for walker in walkers {
        let coat = scene.material(gloss(walker.coat, 0.4));
        let motion = Motion::Lap {
            center: walker.center,
            half_axes: walker.half_axes,
            rate: walker.rate,
            phase: walker.phase,
        };
        let root = mover(scene, motion, Transform::IDENTITY);
        attach_all(scene, [(&body, &coat), (&head, &skin)], root);
        // Arms swing against the legs of their side.
        for (side, phase) in [(-1.0, 0.0), (1.0, 0.5)] {
            for (mesh, material, at, angle, phase) in [
                (&leg, &cloth, vec3(0.0, shapes::HIP, 0.1 * side), 0.5, phase),
                (&arm, &coat, vec3(0.0, shapes::SHOULDER, 0.25 * side), 0.4, phase + 0.5),
            ] {
                let limb = scene.place(mesh, material, Transform::from_translation(at));
                attach(scene, limb, root);
                scene.world.entity_mut(limb).insert(Motion::Swing {
                    middle: Quat::IDENTITY,
                    axis: Vec3::Z,
                    angle,
                    rate: 0.9,
                    phase: phase + walker.phase,
                });
            }
        }
    }
}

fn vans(scene: &mut SceneBuilder, vans: &[Shuttle], detail: f32) {
    if vans.is_empty() {
        return;
    }
    let parts = [
        (scene.shape(shapes::van), gloss(Color::srgb(0.45, 0.04, 0.03), 0.2)),
        (scene.shape(shapes::windows), gloss(Color::srgb(0.02, 0.03, 0.03), 0.05)),
        (
            scene.shape(|g| shapes::wheels(g, detail)),
            gloss(Color::srgb(0.03, 0.03, 0.03), 0.8),
        ),
        (scene.shape(shapes::chrome), metal(Color::srgb(0.92, 0.92, 0.93), 0.1)),
        (
            scene.shape(|g| shapes::lights(g, detail)),
            glow(LinearRgba::rgb(7.0, 6.4, 5.2)),
        ),
    ];
    let parts = parts.map(|(mesh, material)| (mesh, scene.material(material)));
    for van in vans {
        // It drives forward on its way to the second point, and backs up to the first one.
        let ahead = van.to - van.from;
        let motion = Motion::Shuttle {
            from: van.from,
            to: van.to,
            start: Quat::from_rotation_arc(Vec3::X, ahead.normalize_or(Vec3::X)),
            radius: f32::INFINITY,
            rate: van.rate,
            phase: van.phase,
        };
        let root = mover(scene, motion, Transform::IDENTITY);
        attach_all(scene, parts.iter().map(|(mesh, material)| (mesh, material)), root);
    }
}

fn balls(scene: &mut SceneBuilder, balls: &[Shuttle], detail: f32) {
    let ball = scene.shape(|g| shapes::ball(g, BALL, detail));
    let bands = scene.shape(|g| shapes::bands(g, BALL, detail));
    let chrome = scene.material(metal(Color::srgb(0.95, 0.95, 0.96), 0.03));
    let paint = scene.material(gloss(Color::srgb(0.02, 0.10, 0.38), 0.2));
    for shuttle in balls {
        let lifted = |at: Vec3| at + BALL * Vec3::Y;
        let motion = Motion::Shuttle {
            from: lifted(shuttle.from),
            to: lifted(shuttle.to),
            start: Quat::IDENTITY,
            radius: BALL,
            rate: shuttle.rate,
            phase: shuttle.phase,
        };
        let root = mover(scene, motion, Transform::IDENTITY);
        attach_all(scene, [(&ball, &chrome), (&bands, &paint)], root);
    }
}

fn doors(scene: &mut SceneBuilder, doors: &[Door]) {
    let lacquer = scene.material(gloss(Color::srgb(0.10, 0.035, 0.02), 0.12));
    let brass = scene.material(metal(Color::srgb(0.93, 0.76, 0.45), 0.2));
    for door in doors {
        let leaf = scene.shape(|g| shapes::leaf(g, door.size));
        let fittings = scene.shape(|g| shapes::fittings(g, door.size));
        let motion = Motion::Swing {
            middle: turned(door.degrees),
            axis: Vec3::Y,
            angle: 0.75,
            rate: door.rate,
            phase: 0.0,
        };
        let root = mover(scene, motion, Transform::from_translation(door.hinge));
        attach_all(scene, [(&leaf, &lacquer), (&fittings, &brass)], root);
    }
}

/// A point light with its bulb, as a part of something.
fn lamp(scene: &mut SceneBuilder, at: Vec3, lumens: f32, bulb: &Handle<StandardMaterial>, detail: f32) -> [Entity; 2] {
    let sphere = scene.shape(|g| shapes::ball(g, 0.09, 0.4 * detail));
    let sphere = scene.place(&sphere, bulb, Transform::from_translation(at));
    scene.world.entity_mut(sphere).insert(NotShadowCaster);
    let light = PointLight {
        color: WARM,
        intensity: lumens,
        range: 9.0,
        radius: 0.09,
        shadow_maps_enabled: true,
        ..Default::default()
    };
    [sphere, scene.add((light, Transform::from_translation(at)))]
}

fn pendulums(scene: &mut SceneBuilder, pendulums: &[Pendulum], detail: f32) {
    let iron = scene.material(metal(Color::srgb(0.20, 0.19, 0.18), 0.45));
    for pendulum in pendulums {
        if let Some(half) = pendulum.half_wire {
            let wire = scene.shape(|g| g.tube(&[-half, half], 0.012, 6));
            scene.place(&wire, &iron, Transform::from_translation(pendulum.pivot));
        }
        let motion = Motion::Swing {
            middle: Quat::IDENTITY,
            axis: pendulum.axis,
            angle: 0.3,
            rate: pendulum.rate,
            phase: 0.0,
        };
        let root = mover(scene, motion, Transform::from_translation(pendulum.pivot));
        let cord = scene.shape(|g| shapes::cord(g, pendulum.length, detail));
        attach_all(scene, [(&cord, &iron)], root);
        let bulb = scene.material(glow(BULB));
        for part in lamp(scene, Vec3::NEG_Y * pendulum.length, pendulum.lumens, &bulb, detail) {
            attach(scene, part, root);
        }
    }
}

fn flames(scene: &mut SceneBuilder, flames: &[Flame], detail: f32) {
    let iron = scene.material(metal(Color::srgb(0.20, 0.19, 0.18), 0.45));
    for flame in flames {
        let stand = scene.shape(|g| shapes::stand(g, flame.height, detail));
        scene.place(&stand, &iron, Transform::from_translation(flame.foot));
        let bulb = scene.material(glow(BULB));
        let at = flame.foot + flame.height * Vec3::Y;
        let [_, light] = lamp(scene, at, flame.lumens, &bulb, detail);
        scene.world.entity_mut(light).insert(Flicker {
            lumens: flame.lumens,
            emissive: BULB,
            bulb,
        });
    }
}
