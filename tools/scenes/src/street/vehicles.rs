//! Parked cars and scooters: small, rounded, with chrome.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{Body, bent, block, curve, rod, turned_shape},
};
use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// Parked cars: x, z, direction in degrees, and paint.
const CARS: [(f32, f32, f32, usize); 7] = [
    (-31.5, 2.55, 180.0, 3),
    (-20.3, 2.60, 180.0, 0),
    (-14.6, 2.55, 180.0, 2),
    (23.0, 2.60, 180.0, 1),
    (28.6, 2.55, 180.0, 3),
    (25.5, -2.55, 0.0, 0),
    (-35.5, -2.55, 0.0, 1),
];

/// Parks them.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    cars(scene, m, detail);
    scooters(scene, m, detail);
}

/// A wheel around the z axis: a tyre of this radius and width, and its rim with a hub cap.
fn wheel(tyre: &mut Geometry, rim: &mut Geometry, at: Vec3, radius: f32, width: f32, segments: u32) {
    let on_side = Quat::from_rotation_x(FRAC_PI_2);
    let place = Transform::from_translation(at).with_rotation(on_side);
    let (half, r) = (0.5 * width, radius);
    let mut part = Geometry::default();
    let profile = [
        (0.66, -0.7),
        (0.72, -0.95),
        (0.86, -1.0),
        (0.96, -0.85),
        (1.0, -0.5),
        (1.0, 0.5),
        (0.96, 0.85),
        (0.86, 1.0),
        (0.72, 0.95),
        (0.66, 0.7),
    ];
    turned_shape(&mut part, segments, &profile.map(|(x, y)| (x * r, y * half)));
    tyre.append(&part, place);
    let mut part = Geometry::default();
    let side = [
        (0.67, 0.7),
        (0.62, 0.76),
        (0.58, 0.5),
        (0.34, 0.42),
        (0.32, 0.62),
        (0.22, 0.8),
        (0.0, 0.86),
    ];
    turned_shape(&mut part, segments, &side.map(|(x, y)| (x * r, y * half)));
    rim.append(&part, place);
    rim.append(&part, place * Transform::from_rotation(Quat::from_rotation_x(PI)));
}

/// The cabin of a car.
fn cabin() -> Body {
    Body::new([-0.22, 0.88, 0.0], [0.98, 0.52, 0.62], 0.42)
}

/// The body of a car with its mudguards and mirrors.
fn body(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    Body::new([0.0, 0.54, 0.0], [1.70, 0.30, 0.72], 0.55).add(g, fine(44), fine(36));
    cabin().add(g, fine(40), fine(28));
    for side in [-1.0, 1.0] {
        for (x, length) in [(1.08, 0.52), (-1.10, 0.56)] {
            Body::new([x, 0.52, side * 0.60], [length, 0.30, 0.19], 0.35).add(g, fine(20), fine(16));
        }
        Body::new([0.72, 0.80, side * 0.46], [0.66, 0.10, 0.14], 0.2).add(g, fine(14), fine(14));
        Body::new([0.42, 1.02, side * 0.80], [0.05, 0.055, 0.09], 0.3).add(g, fine(12), fine(10));
    }
}

/// Panes, which lie a little outside the cabin.
fn windows(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    let pane = || Body {
        half: vec3(0.988, 0.528, 0.628),
        ..cabin()
    };
    for [first, last] in [[50.0, 87.0], [273.0, 310.0]] {
        pane().part([first, last], [-38.0, 1.5]).add(g, fine(10), fine(10));
        pane().part([first, last], [4.0, 38.0]).add(g, fine(10), fine(10));
    }
    pane().part([-72.0, 72.0], [49.0, 85.0]).add(g, fine(20), fine(10));
    pane().part([-64.0, 64.0], [-84.0, -50.0]).add(g, fine(20), fine(10));
}

/// Bumpers, rings of lamps, handles and the grille.
fn bumpers(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    let edges = bevel(detail) + 1;
    for end in [-1.0, 1.0] {
        let bow = [
            [end * 1.42, 0.40, -0.76],
            [end * 1.70, 0.40, -0.62],
            [end * 1.80, 0.40, 0.0],
            [end * 1.70, 0.40, 0.62],
            [end * 1.42, 0.40, 0.76],
        ];
        bent(g, fine(10), 0.035, 6, &bow);
        for z in [-0.3, 0.3] {
            block(g, edges, [end * 1.80, 0.42, z], [0.05, 0.2, 0.05]);
        }
    }
    for side in [-1.0, 1.0] {
        let forward = Quat::from_rotation_y(FRAC_PI_2);
        let ring = Transform::from_xyz(1.545, 0.66, side * 0.52).with_rotation(forward);
        g.part(ring, |part| part.torus(0.105, 0.014, fine(28), 8));
        block(g, edges, [-0.12, 0.70, side * 0.735], [0.16, 0.022, 0.03]);
        rod(g, 6, 0.010, [1.2, 0.60, side * 0.735], [-1.2, 0.60, side * 0.735]);
    }
    for i in 0..5 {
        let y = 0.46 + 0.035 * i as f32;
        rod(g, 6, 0.008, [1.70, y, -0.22], [1.70, y, 0.22]);
    }
}

/// The parts of a car, by material. It is 3.5 m long and drives along +x.
fn cars(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    let paint = scene.shape(|g| body(g, detail));
    let glass = scene.shape(|g| windows(g, detail));
    let chrome = scene.shape(|g| bumpers(g, detail));
    let lamps = scene.shape(|g| {
        for side in [-1.0, 1.0] {
            Body::new([1.51, 0.66, side * 0.52], [0.08, 0.10, 0.10], 0.0).add(g, fine(20), fine(12));
        }
    });
    let tail = scene.shape(|g| {
        for side in [-1.0, 1.0] {
            Body::new([-1.60, 0.62, side * 0.55], [0.06, 0.09, 0.06], 0.4).add(g, fine(14), fine(10));
        }
    });
    let (mut tyres, mut rims) = (Geometry::default(), Geometry::default());
    for (x, z) in [(1.08, -0.68), (1.08, 0.68), (-1.10, -0.68), (-1.10, 0.68)] {
        wheel(&mut tyres, &mut rims, vec3(x, 0.29, z), 0.29, 0.17, fine(32));
    }
    // The underside, dark as the tyres.
    tyres.rounded_box(vec3(0.0, 0.27, 0.0), vec3(2.9, 0.12, 1.1), 0.04, 1, 1.0);
    let (tyres, rims) = (scene.mesh(tyres), scene.mesh(rims));
    let plate = scene.shape(|g| {
        for end in [-1.0, 1.0] {
            block(g, 1, [end * 1.79, 0.50, 0.0], [0.012, 0.10, 0.46]);
        }
    });
    for (x, z, degrees, color) in CARS {
        let at = Transform::from_xyz(x, 0.0, z).with_rotation(turned(degrees + 1.3));
        scene.place(&paint, &m.cars[color], at);
        scene.place(&glass, &m.car_glass, at);
        scene.place(&chrome, &m.chrome, at);
        scene.place(&lamps, &m.clear_glass, at);
        scene.place(&tail, &m.red_glass, at);
        scene.place(&tyres, &m.rubber, at);
        scene.place(&rims, &m.chrome, at);
        scene.place(&plate, &m.signs[1], at);
    }
}

/// The painted sheet metal of a scooter.
fn scooter(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    // Leg shield and floor board as one bent sheet with two sides.
    let spine = [
        [0.60, 1.02],
        [0.50, 0.70],
        [0.42, 0.40],
        [0.30, 0.24],
        [0.05, 0.21],
        [-0.2, 0.24],
    ];
    let spine = curve(&spine.map(|[x, y]| vec3(x, y, 0.0)), 6);
    let last = (spine.len() - 1) as f32;
    let at = |v: f32| {
        let place = v.clamp(0.0, 1.0) * last;
        let index = (place as usize).min(spine.len() - 2);
        spine[index].lerp(spine[index + 1], place - index as f32)
    };
    for side in [1.0, -1.0] {
        g.surface(fine(14), fine(24), Vec2::ONE, |u, v| {
            let across = (2.0 * u - 1.0) * side;
            let half = 0.15 + 0.10 * ops::sin(PI * (0.15 + 0.75 * v.clamp(0.0, 1.0)));
            let curl = 0.07 * across * across * (1.0 - v);
            at(v) + vec3(0.004 * side - curl, -0.004 * side, half * across)
        });
    }
    Body::new([-0.46, 0.50, 0.0], [0.40, 0.24, 0.12], 0.3).add(g, fine(24), fine(18));
    for side in [-1.0, 1.0] {
        Body::new([-0.50, 0.43, side * 0.15], [0.31, 0.17, 0.11], 0.15).add(g, fine(22), fine(18));
    }
    Body::new([0.66, 0.30, 0.0], [0.26, 0.12, 0.075], 0.2).add(g, fine(18), fine(16));
    Body::new([0.57, 1.06, 0.0], [0.13, 0.08, 0.13], 0.2).add(g, fine(18), fine(14));
    rod(g, fine(12), 0.035, [0.56, 1.0, 0.0], [0.66, 0.30, 0.0]);
}

/// Handlebars, mirrors, the kickstand, and rails.
fn trim(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    let path = [
        [0.49, 1.09, -0.26],
        [0.56, 1.09, -0.10],
        [0.56, 1.09, 0.10],
        [0.49, 1.09, 0.26],
    ];
    bent(g, fine(10), 0.013, 5, &path);
    for side in [-1.0, 1.0] {
        let path = [
            [0.53, 1.10, side * 0.2],
            [0.54, 1.22, side * 0.25],
            [0.52, 1.30, side * 0.30],
        ];
        bent(g, 6, 0.006, 4, &path);
        Body::new([0.52, 1.33, side * 0.32], [0.015, 0.05, 0.05], 0.2).add(g, fine(12), fine(8));
        rod(g, 6, 0.012, [0.02, 0.2, side * 0.05], [-0.08, 0.01, side * 0.19]);
    }
    let ring = Transform::from_xyz(0.685, 1.06, 0.0).with_rotation(Quat::from_rotation_y(FRAC_PI_2));
    g.part(ring, |part| part.torus(0.07, 0.010, fine(24), 8));
    let path = [
        [-0.62, 0.70, -0.12],
        [-0.86, 0.72, -0.11],
        [-0.86, 0.72, 0.11],
        [-0.62, 0.70, 0.12],
    ];
    bent(g, 6, 0.009, 4, &path);
}

/// Scooters along the southern kerb. One is 1.7 m long and drives along +x; it leans on its kickstand.
fn scooters(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    let paint = scene.shape(|g| scooter(g, detail));
    let seat = scene.shape(|g| {
        Body::new([-0.38, 0.78, 0.0], [0.34, 0.065, 0.13], 0.45).add(g, fine(22), fine(18));
        for side in [-1.0, 1.0] {
            rod(g, fine(10), 0.018, [0.51, 1.09, side * 0.24], [0.49, 1.09, side * 0.36]);
        }
    });
    let chrome = scene.shape(|g| trim(g, detail));
    let lamp = scene.shape(|g| {
        Body::new([0.66, 1.06, 0.0], [0.05, 0.066, 0.066], 0.0).add(g, fine(16), fine(10));
    });
    let tail = scene.shape(|g| {
        Body::new([-0.85, 0.55, 0.0], [0.035, 0.05, 0.045], 0.4).add(g, fine(12), fine(8));
    });
    let (mut tyres, mut rims) = (Geometry::default(), Geometry::default());
    for x in [0.66, -0.56] {
        wheel(&mut tyres, &mut rims, vec3(x, 0.22, 0.0), 0.22, 0.09, fine(28));
    }
    let (tyres, rims) = (scene.mesh(tyres), scene.mesh(rims));
    for (x, degrees, color) in [
        (-8.4, 84.0, 0),
        (-7.4, 88.0, 2),
        (-6.3, 80.0, 1),
        (-5.3, 86.0, 3),
        (12.2, 95.0, 4),
        (13.3, 92.0, 0),
    ] {
        let at = Transform::from_xyz(x, 0.0, 2.65).with_rotation(turned(degrees) * Quat::from_rotation_x(0.10));
        scene.place(&paint, &m.enamels[color], at);
        scene.place(&seat, &m.leather, at);
        scene.place(&chrome, &m.chrome, at);
        scene.place(&lamp, &m.clear_glass, at);
        scene.place(&tail, &m.red_glass, at);
        scene.place(&tyres, &m.rubber, at);
        scene.place(&rims, &m.steel, at);
    }
    // One more on the pavement of the side street.
    let at = Transform::from_xyz(11.9, PAVEMENT, -15.2).with_rotation(turned(86.0) * Quat::from_rotation_x(0.10));
    for (mesh, material) in [
        (&paint, &m.enamels[1]),
        (&seat, &m.leather),
        (&chrome, &m.chrome),
        (&tyres, &m.rubber),
        (&rims, &m.steel),
    ] {
        scene.place(mesh, material, at);
    }
}
