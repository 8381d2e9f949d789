//! Carved and cast ornament: mouldings, leaves, rosettes, palmettes and scrolls.

use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Turns an object that faces +z upwards.
pub fn facing_up() -> Quat {
    Quat::from_rotation_x(-FRAC_PI_2)
}

/// Turns an object that faces +z downwards, and its up direction to +z.
pub fn facing_down() -> Quat {
    Quat::from_rotation_x(FRAC_PI_2)
}

/// An axis-aligned box between two corners.
pub fn block(g: &mut Geometry, low: Vec3, high: Vec3, uv_scale: f32) {
    g.cuboid((low + high) * 0.5, high - low, uv_scale);
}

/// A box with rounded edges between two corners.
pub fn soft_block(g: &mut Geometry, low: Vec3, high: Vec3, radius: f32, uv_scale: f32) {
    g.rounded_box((low + high) * 0.5, high - low, radius, 2, uv_scale);
}

/// A mitred moulding around a rectangle in the xy plane, facing +z. Points of the profile are (distance outwards from the rectangle, height
/// along z); the solid lies on the right of the profile.
pub fn frame(g: &mut Geometry, half: Vec2, profile: &[Vec2], uv_scale: f32) {
    for (out, reach, side) in [
        (Vec3::X, half.x, half.y),
        (Vec3::Y, half.y, half.x),
        (Vec3::NEG_X, half.x, half.y),
        (Vec3::NEG_Y, half.y, half.x),
    ] {
        let along = Vec3::Z.cross(out);
        let at = |p: Vec2, end: f32| out * (reach + p.x) + along * (end * (side + p.x)) + Vec3::Z * p.y;
        for pair in profile.windows(2) {
            let (p, q) = (pair[0], pair[1]);
            g.mapped_quad([at(p, -1.0), at(q, -1.0), at(q, 1.0), at(p, 1.0)], uv_scale);
        }
    }
}

/// A straight moulding along x. Points of the profile are (distance towards +z, height), from bottom to top.
pub fn moulding(g: &mut Geometry, length: f32, profile: &[Vec2], uv_scale: f32) {
    let at = |end: f32, p: Vec2| vec3(0.5 * end * length, p.y, p.x);
    for pair in profile.windows(2) {
        let (p, q) = (pair[0], pair[1]);
        g.mapped_quad([at(-1.0, p), at(1.0, p), at(1.0, q), at(-1.0, q)], uv_scale);
    }
}

/// A square pier of half widths `half` (x and z) with a moulded base and cap.
pub fn pier(g: &mut Geometry, half: Vec2, height: f32) {
    let low = vec3(-half.x, -0.05, -half.y);
    block(g, low, vec3(half.x, height - 0.02, half.y), 0.5);
    let p = Vec2::new;
    let mut rings = Geometry::default();
    let base = [
        p(0.0, 0.45),
        p(0.04, 0.42),
        p(0.06, 0.36),
        p(0.06, 0.28),
        p(0.10, 0.24),
        p(0.10, -0.05),
    ];
    frame(&mut rings, half, &base, 0.5);
    let cap = [
        p(0.0, height),
        p(0.14, height),
        p(0.14, height - 0.12),
        p(0.10, height - 0.16),
        p(0.08, height - 0.24),
        p(0.04, height - 0.30),
        p(0.0, height - 0.34),
    ];
    frame(&mut rings, half, &cap, 0.5);
    g.append(&rings, Transform::from_rotation(facing_up()));
}

/// A closed leaf: lens-shaped across, along a spine.
pub struct Blade {
    /// Quads around and along.
    pub quads: (u32, u32),
    /// Half the greatest width.
    pub width: f32,
    /// Half the greatest thickness.
    pub thickness: f32,
    /// How far the rims bend to the front, in widths.
    pub fold: f32,
}

impl Blade {
    /// Adds the leaf along `spine(0..=1)`. `side` is a unit vector across it, and its front faces `forward x side`. `outline` scales its
    /// width along the way.
    pub fn add(&self, g: &mut Geometry, side: Vec3, outline: impl Fn(f32) -> f32, spine: impl Fn(f32) -> Vec3) {
        let length = spine(0.0).distance(spine(1.0));
        let uv_scale = vec2(4.0 * self.width, length);
        g.surface(self.quads.0, self.quads.1, uv_scale, |u, v| {
            let forward = (spine(v + 1e-3) - spine(v - 1e-3)).normalize_or(Vec3::Y);
            let front = forward.cross(side);
            let (sin, cos) = (ops::sin(u * TAU), ops::cos(u * TAU));
            let share = outline(v.clamp(0.0, 1.0));
            let depth = share * (self.thickness * sin + self.fold * self.width * cos * cos);
            spine(v) + side * (self.width * share * cos) + front * depth
        });
    }
}

/// The outline of a petal: wide at its foot, round at its tip.
pub fn petal(v: f32) -> f32 {
    ops::sin(PI * (0.15 + 0.85 * v)).max(0.0).sqrt()
}

/// The outline of a leaf that is widest near its tip.
pub fn frond(v: f32) -> f32 {
    ops::sin(PI * v * v).max(0.0).sqrt()
}

/// Two rings of petals around a boss, facing +z.
pub fn rosette(g: &mut Geometry, radius: f32, petals: u32, fine: f32) {
    for (tier, (reach, lift)) in [(1.0, 0.07), (0.62, 0.15)].into_iter().enumerate() {
        let blade = Blade {
            quads: (segments(6, fine), segments(5, fine)),
            width: 0.5 * reach * radius * PI / petals as f32,
            thickness: 0.05 * radius,
            fold: 0.3,
        };
        for i in 0..petals {
            let angle = (i as f32 + 0.5 * tier as f32) / petals as f32 * TAU;
            let out = vec3(ops::cos(angle), ops::sin(angle), 0.0);
            blade.add(g, Vec3::Z.cross(out), petal, |v| {
                let rise = lift + 0.14 * ops::sin(2.6 * v);
                (out * (reach * (0.12 + 0.88 * v)) + Vec3::Z * rise) * radius
            });
        }
    }
    g.sphere(Vec3::Z * (0.18 * radius), 0.2 * radius, segments(12, fine), Vec2::ONE);
}

/// A fan of seven leaves between two scrolls, standing on the origin, facing +z.
pub fn palmette(g: &mut Geometry, height: f32, fine: f32) {
    for i in -3..=3 {
        let angle = 0.42 * i as f32;
        let length = height * (1.0 - 0.004 * (i * i * i * i) as f32 / 3.0 - 0.03 * (i * i) as f32);
        let out = vec3(ops::sin(angle), ops::cos(angle), 0.0);
        let blade = Blade {
            quads: (segments(6, fine), segments(5, fine)),
            width: 0.10 * height,
            thickness: 0.03 * height,
            fold: -0.2,
        };
        blade.add(g, Vec3::Z.cross(out), frond, |v| {
            let bend = Vec3::X * (0.05 * angle * height * v * v);
            out * (length * (0.06 + 0.94 * v)) + bend + Vec3::Z * (height * (0.035 + 0.09 * v * v))
        });
    }
    for (x, turns) in [(-1.0, 1.6), (1.0, -1.6)] {
        let center = vec3(0.34 * x * height, 0.14 * height, 0.04 * height);
        scroll(g, center, 0.13 * height, 0.5 * PI, turns, 0.025 * height, fine);
    }
    let heart = vec3(0.0, 0.05 * height, 0.04 * height);
    g.sphere(heart, 0.09 * height, segments(10, fine), Vec2::ONE);
}

/// A spiral in the xy plane that starts at an angle and winds inwards around a boss; positive turns go counter-clockwise.
pub fn scroll(g: &mut Geometry, center: Vec3, radius: f32, start: f32, turns: f32, thickness: f32, fine: f32) {
    g.curved_tube(segments(16, fine), thickness, segments(5, fine), |t| {
        let (angle, r) = (start + turns * TAU * t, radius * (1.0 - 0.75 * t));
        center + vec3(r * ops::cos(angle), r * ops::sin(angle), 0.0)
    });
    g.sphere(center, 0.3 * radius, segments(8, fine), Vec2::ONE);
}

/// A rod with round ends between two points, its radius going from the first value to the second.
pub fn limb(g: &mut Geometry, from: Vec3, to: Vec3, radii: (f32, f32), sides: u32) {
    let steps = (sides / 4).max(2);
    let mut profile = Vec::new();
    for (radius, height, start) in [(radii.0, 0.0, -1.0), (radii.1, from.distance(to), 0.0)] {
        for i in 0..=steps {
            let angle = FRAC_PI_2 * (start + i as f32 / steps as f32);
            let (out, up) = (ops::cos(angle).max(0.0), ops::sin(angle));
            profile.push(vec2(radius * out, height + radius * up));
        }
    }
    let turn = Quat::from_rotation_arc(Vec3::Y, (to - from).normalize_or(Vec3::Y));
    g.part(Transform::from_translation(from).with_rotation(turn), |part| {
        part.lathe(&profile, sides, vec2(TAU * radii.0, 1.0));
    });
}

/// A horizontal ring.
pub fn ring(g: &mut Geometry, height: f32, radius: f32, tube: f32, around: u32, sides: u32) {
    let level = Transform::from_xyz(0.0, height, 0.0).with_rotation(facing_up());
    g.part(level, |part| part.torus(radius, tube, around, sides));
}

/// A horizontal string of beads.
pub fn beads(g: &mut Geometry, height: f32, radius: f32, bead: f32, count: u32, fine: f32) {
    let one = Geometry::of(|g| g.sphere(Vec3::ZERO, bead, segments(8, fine), Vec2::ONE));
    for i in 0..count {
        let angle = i as f32 / count as f32 * TAU;
        let place = Transform::from_xyz(radius * ops::sin(angle), height, radius * ops::cos(angle));
        g.append(&one, place);
    }
}
