//! Casts of the places, along the paths of their cameras: no walker passes through a camera, and each view has a moving object before it.

use super::{Cast, Door, Flame, Pendulum, Shuttle, Walker};
use crate::prelude::*;

const RED: Color = Color::srgb(0.62, 0.06, 0.05);
const BLUE: Color = Color::srgb(0.05, 0.16, 0.48);
const YELLOW: Color = Color::srgb(0.86, 0.62, 0.10);

/// A person in a coat. Turns per second are below 0 the other way around; the phase is the angle at the start, in turns.
const fn walker(center: Vec3, half_axes: Vec2, rate: f32, phase: f32, coat: Color) -> Walker {
    Walker {
        center,
        half_axes,
        rate,
        phase,
        coat,
    }
}

/// An object that goes from one point to another and back, `rate` times per second, and has gone the fraction `phase` at the start.
const fn shuttle(from: Vec3, to: Vec3, rate: f32, phase: f32) -> Shuttle {
    Shuttle { from, to, rate, phase }
}

/// The courtyard: on both sides of the fountain.
pub const ATRIUM: Cast = Cast {
    walkers: &[
        walker(vec3(4.7, 0.0, -1.0), vec2(2.6, 0.5), 0.08, 0.1, RED),
        walker(vec3(-4.9, 0.0, -1.1), vec2(2.6, 0.5), -0.08, 0.45, BLUE),
        // Behind the northern colonnade.
        walker(vec3(3.0, 0.0, -5.6), vec2(3.5, 0.5), 0.06, 0.7, YELLOW),
    ],
    vans: &[],
    balls: &[shuttle(vec3(2.4, 0.0, 0.7), vec3(7.4, 0.0, 0.5), 0.11, 0.2)],
    doors: &[Door {
        hinge: vec3(5.35, 0.0, -4.2),
        size: vec2(1.05, 2.3),
        degrees: -45.0,
        rate: 0.2,
    }],
    pendulums: &[Pendulum {
        pivot: vec3(-0.5, 6.2, -1.4),
        length: 2.7,
        half_wire: Some(vec3(0.0, 0.0, 2.8)),
        axis: Vec3::Z,
        lumens: 90_000.0,
        rate: 0.3,
    }],
    flames: &[Flame {
        foot: vec3(2.1, 0.0, -3.5),
        height: 1.9,
        lumens: 70_000.0,
    }],
};

/// The temple: along the basin and before the dais.
pub const TEMPLE: Cast = Cast {
    walkers: &[
        walker(vec3(-3.3, 0.0, 1.0), vec2(0.45, 6.0), 0.06, 0.2, RED),
        walker(vec3(-1.7, 0.0, -9.3), vec2(1.5, 1.0), -0.12, 0.0, YELLOW),
        // On the dais.
        walker(vec3(0.0, 0.51, -14.15), vec2(2.6, 0.2), 0.07, 0.0, BLUE),
    ],
    vans: &[],
    balls: &[
        shuttle(vec3(-2.5, 0.0, 8.0), vec3(0.2, 0.0, 6.9), 0.15, 0.0),
        shuttle(vec3(-2.2, 0.0, -7.4), vec3(0.6, 0.0, -7.0), 0.15, 0.3),
    ],
    doors: &[Door {
        hinge: vec3(-5.0, 0.0, -2.9),
        size: vec2(1.5, 2.8),
        degrees: 60.0,
        rate: 0.17,
    }],
    pendulums: &[Pendulum {
        pivot: vec3(0.0, 9.1, -3.2),
        length: 6.2,
        half_wire: None,
        axis: Vec3::Z,
        lumens: 90_000.0,
        rate: 0.2,
    }],
    flames: &[Flame {
        foot: vec3(-3.6, 0.0, -5.6),
        height: 1.9,
        lumens: 60_000.0,
    }],
};

/// The street: a van drives ahead of the camera and another one comes out of the side street.
pub const STREET: Cast = Cast {
    walkers: &[
        walker(vec3(-14.0, 0.0, -2.95), vec2(5.0, 0.35), 0.045, 0.55, YELLOW),
        walker(vec3(2.0, 0.0, -2.95), vec2(6.0, 0.35), -0.037, 0.3, BLUE),
        walker(vec3(8.5, 0.0, -6.0), vec2(2.2, 0.8), 0.09, 0.0, RED),
    ],
    vans: &[
        shuttle(vec3(-13.0, 0.0, 0.75), vec3(20.0, 0.0, 0.75), 1.0 / 48.0, 0.0),
        shuttle(vec3(8.5, 0.0, -30.0), vec3(8.5, 0.0, -12.0), 1.0 / 14.0, 0.0),
    ],
    balls: &[shuttle(vec3(4.5, 0.0, -4.3), vec3(9.5, 0.0, -3.7), 0.1, 0.1)],
    doors: &[Door {
        hinge: vec3(-3.0, 0.14, -7.9),
        size: vec2(0.95, 2.15),
        degrees: -50.0,
        rate: 0.2,
    }],
    pendulums: &[Pendulum {
        pivot: vec3(0.0, 6.4, -1.6),
        length: 2.2,
        half_wire: Some(vec3(0.0, 0.0, 6.4)),
        axis: Vec3::X,
        lumens: 150_000.0,
        rate: 0.33,
    }],
    flames: &[Flame {
        foot: vec3(-13.2, 0.14, -4.7),
        height: 2.4,
        lumens: 90_000.0,
    }],
};
