//! Casts of the places, along the paths of their cameras: no walker passes through a camera, and each view has a moving object before it.

use super::{Cast, Door, Flame, Pendulum, Shuttle, Walker};
use bevy::{
    color::Color,
    math::{Vec3, vec2, vec3},
};

const RED: Color = Color::srgb(0.62, 0.06, 0.05);
const BLUE: Color = Color::srgb(0.05, 0.16, 0.48);
const YELLOW: Color = Color::srgb(0.86, 0.62, 0.10);

/// The courtyard: on both sides of the fountain.
pub const ATRIUM: Cast = Cast {
    walkers: &[
        Walker {
            center: vec3(4.7, 0.0, -1.0),
            half_axes: vec2(2.6, 0.5),
            rate: 0.08,
            phase: 0.1,
            coat: RED,
        },
        Walker {
            center: vec3(-4.9, 0.0, -1.1),
            half_axes: vec2(2.6, 0.5),
            rate: -0.08,
            phase: 0.45,
            coat: BLUE,
        },
        // Behind the northern colonnade.
        Walker {
            center: vec3(3.0, 0.0, -5.6),
            half_axes: vec2(3.5, 0.5),
            rate: 0.06,
            phase: 0.7,
            coat: YELLOW,
        },
    ],
    vans: &[],
    balls: &[Shuttle {
        from: vec3(2.4, 0.0, 0.7),
        to: vec3(7.4, 0.0, 0.5),
        rate: 0.11,
        phase: 0.2,
    }],
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
        Walker {
            center: vec3(-3.3, 0.0, 1.0),
            half_axes: vec2(0.45, 6.0),
            rate: 0.06,
            phase: 0.2,
            coat: RED,
        },
        Walker {
            center: vec3(-1.7, 0.0, -9.3),
            half_axes: vec2(1.5, 1.0),
            rate: -0.12,
            phase: 0.0,
            coat: YELLOW,
        },
        // On the dais.
        Walker {
            center: vec3(0.0, 0.51, -14.15),
            half_axes: vec2(2.6, 0.2),
            rate: 0.07,
            phase: 0.0,
            coat: BLUE,
        },
    ],
    vans: &[],
    balls: &[
        Shuttle {
            from: vec3(-2.5, 0.0, 8.0),
            to: vec3(0.2, 0.0, 6.9),
            rate: 0.15,
            phase: 0.0,
        },
        Shuttle {
            from: vec3(-2.2, 0.0, -7.4),
            to: vec3(0.6, 0.0, -7.0),
            rate: 0.15,
            phase: 0.3,
        },
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
        Walker {
            center: vec3(-14.0, 0.0, -2.95),
            half_axes: vec2(5.0, 0.35),
            rate: 0.045,
            phase: 0.55,
            coat: YELLOW,
        },
        Walker {
            center: vec3(2.0, 0.0, -2.95),
            half_axes: vec2(6.0, 0.35),
            rate: -0.037,
            phase: 0.3,
            coat: BLUE,
        },
        Walker {
            center: vec3(8.5, 0.0, -6.0),
            half_axes: vec2(2.2, 0.8),
            rate: 0.09,
            phase: 0.0,
            coat: RED,
        },
    ],
    vans: &[
        Shuttle {
            from: vec3(-13.0, 0.0, 0.75),
            to: vec3(20.0, 0.0, 0.75),
            rate: 1.0 / 48.0,
            phase: 0.0,
        },
        Shuttle {
            from: vec3(8.5, 0.0, -30.0),
            to: vec3(8.5, 0.0, -12.0),
            rate: 1.0 / 14.0,
            phase: 0.0,
        },
    ],
    balls: &[Shuttle {
        from: vec3(4.5, 0.0, -4.3),
        to: vec3(9.5, 0.0, -3.7),
        rate: 0.1,
        phase: 0.1,
    }],
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
