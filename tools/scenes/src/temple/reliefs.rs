//! Motifs carved and cast in relief, as heights over a plane.

use crate::prelude::*;
use std::f32::consts::PI;

/// The subject of a relief. Each fits into 2.3 by 3 metres around the origin.
#[derive(Clone, Copy)]
pub enum Picture {
    /// A sun with rays.
    Sun,
    /// A lotus in a bowl.
    Lotus,
    /// Robed figures that raise bowls.
    Procession,
    /// Running spirals.
    Waves,
}

impl Picture {
    /// Height in metres above the plane, 0 to about 0.1.
    fn height(self, p: Vec2) -> f32 {
        match self {
            Picture::Sun => sun(p),
            Picture::Lotus => lotus(p),
            Picture::Procession => [-0.74, 0.0, 0.74]
                .into_iter()
                .map(|x| figure(vec2(p.x - x, p.y)))
                .fold(0.0, f32::max),
            Picture::Waves => waves(p),
        }
    }

    /// Adds the relief in the xy plane, facing +z, from a plane at `base`. The motif is scaled to `size` from its 2.3 by 3 metres.
    pub fn carve(self, g: &mut Geometry, size: Vec2, base: f32, columns: u32, rows: u32) {
        let scale = size / vec2(2.3, 3.0);
        let depth = scale.min_element();
        let quads = vec2(columns as f32, rows as f32);
        let place = |share: Vec2| (share - 0.5) * size;
        let stride = columns as usize + 1;
        let heights: Vec<f32> = (0..stride * (rows as usize + 1))
            .map(|i| {
                let p = place(vec2((i % stride) as f32, (i / stride) as f32) / quads);
                // The rims stay flat, so that frames fit.
                let rim = (0.5 * size - p.abs()).min_element();
                base + depth * self.height(p / scale) * smooth(0.0, 0.04 * depth, rim)
            })
            .collect();
        // Normals follow from the flat quads between those heights, so details finer than the mesh don't disturb them.
        g.surface(columns, rows, size * 0.5, |u, v| {
            let at = (vec2(u, v) * quads).clamp(Vec2::ZERO, quads);
            let cell = at.floor().min(quads - 1.0);
            let corner = cell.y as usize * stride + cell.x as usize;
            let row = |first: usize| heights[first] + (heights[first + 1] - heights[first]) * (at.x - cell.x);
            let (low, high) = (row(corner), row(corner + stride));
            place(vec2(u, v)).extend(low + (high - low) * (at.y - cell.y))
        });
    }
}

/// A form of the given height in the area of negative `distance`, with slopes `edge` wide on both sides of its outline.
fn raised(distance: f32, height: f32, edge: f32) -> f32 {
    height * smooth(edge, -edge, distance)
}

/// A round form: `share` is 0 in its middle and 1 at its outline.
fn domed(share: f32, height: f32) -> f32 {
    height * smooth(0.0, 0.75, 1.0 - share)
}

/// Distance from `p` to the segment from `a` to `b`.
fn segment(p: Vec2, a: Vec2, b: Vec2) -> f32 {
    let (along, to) = (b - a, p - a);
    let t = (to.dot(along) / along.length_squared()).clamp(0.0, 1.0);
    to.distance(along * t)
}

fn sun(p: Vec2) -> f32 {
    let (radius, angle) = (p.length(), ops::atan2(p.y, p.x));
    let face = domed(radius / 0.38, 0.11);
    let hoop = raised((radius - 0.47).abs() - 0.035, 0.06, 0.025);
    // Rays that end in points, every second one shorter.
    let long = 0.5 + 0.5 * ops::cos(8.0 * angle);
    let reach = 0.84 + 0.22 * long;
    let taper = ((radius - 0.55) / (reach - 0.55)).clamp(0.0, 1.0);
    let ray = smooth(1.7 * taper - 0.8, 1.7 * taper - 0.2, ops::cos(16.0 * angle));
    let window = smooth(0.53, 0.58, radius) * smooth(reach, reach - 0.06, radius);
    // Rows of stars above and below.
    let star = vec2(p.x - (p.x / 0.46).round() * 0.46, p.y.abs() - 1.28);
    let stars = domed(star.length() / 0.13, 0.05);
    face.max(hoop).max(0.07 * ray * window).max(stars)
}

fn lotus(p: Vec2) -> f32 {
    let foot = vec2(0.0, -0.55);
    let mut height: f32 = 0.0;
    for i in -3..=3 {
        let angle = 0.42 * i as f32;
        let (sin, cos) = (ops::sin(angle), ops::cos(angle));
        let out = vec2(sin, cos);
        let length = 1.9 - 0.13 * (i * i) as f32;
        let q = p - foot - out * (0.5 * length);
        let (along, across) = (q.dot(out) / (0.5 * length), q.perp_dot(out) / 0.22);
        // Petals in front are higher than the ones behind them.
        let lift = 0.015 * (3 - i * i / 3) as f32;
        let rib = 0.02 * smooth(0.25, 0.0, across.abs());
        let inside = smooth(1.0, 0.8, along * along + across * across);
        height = height.max(inside * (domed(along * along + across * across, 0.045) + lift + rib));
    }
    let bowl = vec2(p.x / 0.62, (p.y + 0.60) / 0.36);
    let bowl = if p.y < -0.55 {
        domed(bowl.length_squared(), 0.10)
    } else {
        0.0
    };
    let stem = raised(segment(p, vec2(0.0, -0.9), vec2(0.0, -1.25)) - 0.10, 0.06, 0.03);
    let foot_plate = raised(segment(p, vec2(-0.4, -1.30), vec2(0.4, -1.30)) - 0.06, 0.07, 0.03);
    height.max(bowl).max(stem).max(foot_plate)
}

/// A figure in a robe around x = 0, looking towards +x.
fn figure(p: Vec2) -> f32 {
    let head = domed(p.distance(vec2(0.03, 0.98)) / 0.16, 0.10);
    let hair = domed(p.distance(vec2(-0.05, 1.02)) / 0.18, 0.08);
    let down = ((0.78 - p.y) / 2.1).clamp(0.0, 1.0);
    let half = 0.17 + 0.14 * down;
    let folds = 0.16 * ops::cos(26.0 * p.x / (1.0 + 0.8 * down)) * smooth(0.1, 0.4, down);
    let outline = (p.y - 0.78).max(-1.36 - p.y).max(p.x.abs() - half);
    let body = raised(outline, 0.075, 0.03) * (1.0 + folds);
    let belt = raised((p.y - 0.16).abs() - 0.035, 0.095, 0.03) * smooth(half, half - 0.03, p.x.abs());
    let arm = [
        segment(p, vec2(-0.02, 0.66), vec2(0.20, 0.38)),
        segment(p, vec2(0.20, 0.38), vec2(0.30, 0.70)),
    ];
    let arm = domed(arm[0].min(arm[1]) / 0.085, 0.105);
    let bowl = vec2((p.x - 0.30) / 0.14, (p.y - 0.80) / 0.10);
    let bowl = if p.y < 0.84 {
        domed(bowl.length_squared(), 0.09)
    } else {
        0.0
    };
    head.max(hair).max(body).max(belt).max(arm).max(bowl)
}

fn waves(p: Vec2) -> f32 {
    // Three rows of running spirals.
    let row = (p.y / 0.9).round().clamp(-1.0, 1.0);
    let q = vec2(p.x - (p.x / 0.75).round().clamp(-1.0, 1.0) * 0.75, p.y - 0.9 * row);
    let (radius, angle) = (q.length(), ops::atan2(q.y, q.x));
    let arm = ops::cos(angle + 2.0 * PI * radius / 0.24);
    let spiral = smooth(-0.7, 0.7, arm) * smooth(0.37, 0.31, radius) * 0.06;
    let eye = domed(radius / 0.10, 0.09);
    let band = raised((p.y.abs() - 0.45).abs() - 0.03, 0.05, 0.03);
    let outer = raised((p.y.abs() - 1.36).abs() - 0.03, 0.05, 0.03);
    spiral.max(eye).max(band).max(outer)
}
