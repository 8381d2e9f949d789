//! Shapes of the moving objects.

use crate::prelude::*;
use std::f32::consts::FRAC_PI_2;

/// Height of a person's hips and shoulders in metres. A person is 1.76 m tall, and looks along +x.
pub const HIP: f32 = 0.88;
pub const SHOULDER: f32 = 1.42;

/// A coat.
pub fn body(g: &mut Geometry, detail: f32) {
    let p = vec2;
    let profile = [
        p(0.0, 0.72),
        p(0.27, 0.72),
        p(0.27, 0.72),
        p(0.25, 0.9),
        p(0.20, 1.08),
        p(0.24, 1.32),
        p(0.21, 1.44),
        p(0.10, 1.50),
        p(0.07, 1.56),
        p(0.0, 1.56),
    ];
    // Flatter from front to back.
    let flat = Transform::from_scale(vec3(0.65, 1.0, 1.0));
    g.part(flat, |part| part.lathe(&profile, segments(24, detail), Vec2::ONE));
}

/// A head with a cap.
pub fn head(g: &mut Geometry, detail: f32) {
    g.sphere(vec3(0.02, 1.64, 0.0), 0.115, segments(24, detail), Vec2::ONE);
    g.rounded_box(vec3(0.12, 1.68, 0.0), vec3(0.14, 0.02, 0.16), 0.01, 1, 1.0);
}

/// A leg with a shoe, which hangs from the hip.
pub fn leg(g: &mut Geometry, detail: f32) {
    let line = [Vec3::ZERO, vec3(0.02, -0.42, 0.0), vec3(0.0, -0.84, 0.0)];
    g.tube(&line, 0.075, segments(12, detail));
    g.rounded_box(vec3(0.06, -0.84, 0.0), vec3(0.27, 0.08, 0.1), 0.03, 2, 1.0);
}

/// An arm with a hand, which hangs from the shoulder.
pub fn arm(g: &mut Geometry, detail: f32) {
    let line = [Vec3::ZERO, vec3(0.0, -0.3, 0.02), vec3(0.06, -0.56, 0.0)];
    g.tube(&line, 0.052, segments(10, detail));
    g.sphere(vec3(0.07, -0.6, 0.0), 0.05, segments(12, detail), Vec2::ONE);
}

/// The sheet metal of a van: 3.9 m long, 1.7 m wide; it drives along +x.
pub fn van(g: &mut Geometry) {
    g.rounded_box(vec3(-0.35, 1.12, 0.0), vec3(3.2, 1.6, 1.7), 0.14, 3, 0.5);
    g.rounded_box(vec3(1.2, 0.72, 0.0), vec3(1.5, 0.8, 1.66), 0.16, 3, 0.5);
}

/// Panes, which lie a little outside the sheet metal.
pub fn windows(g: &mut Geometry) {
    g.rounded_box(vec3(1.252, 1.5, 0.0), vec3(0.02, 0.56, 1.34), 0.008, 1, 0.5);
    for side in [-1.0, 1.0] {
        g.rounded_box(vec3(0.8, 1.48, side * 0.852), vec3(0.62, 0.54, 0.012), 0.005, 1, 0.5);
    }
    g.rounded_box(vec3(-1.952, 1.5, 0.0), vec3(0.012, 0.5, 1.2), 0.005, 1, 0.5);
}

/// Four wheels and the dark underside.
pub fn wheels(g: &mut Geometry, detail: f32) {
    let on_side = Quat::from_rotation_x(FRAC_PI_2);
    let p = vec2;
    let profile = [
        p(0.0, -0.1),
        p(0.3, -0.1),
        p(0.34, -0.07),
        p(0.34, 0.07),
        p(0.3, 0.1),
        p(0.0, 0.1),
    ];
    for (x, z) in [(1.3, -0.74), (1.3, 0.74), (-1.3, -0.74), (-1.3, 0.74)] {
        let place = Transform::from_xyz(x, 0.34, z).with_rotation(on_side);
        g.part(place, |part| part.lathe(&profile, segments(24, detail), Vec2::ONE));
    }
    g.cuboid(vec3(0.0, 0.36, 0.0), vec3(3.3, 0.12, 1.3), 0.5);
}

/// Bumpers and hub caps.
pub fn chrome(g: &mut Geometry) {
    for x in [-1.97, 1.97] {
        g.rounded_box(vec3(x, 0.42, 0.0), vec3(0.1, 0.14, 1.66), 0.04, 2, 0.5);
    }
    for (x, z) in [(1.3, -0.85), (1.3, 0.85), (-1.3, -0.85), (-1.3, 0.85)] {
        g.sphere(vec3(x, 0.34, z), 0.11, 16, Vec2::ONE);
    }
}

/// Headlights.
pub fn lights(g: &mut Geometry, detail: f32) {
    for side in [-1.0, 1.0] {
        g.sphere(vec3(1.93, 0.78, 0.58 * side), 0.1, segments(16, detail), Vec2::ONE);
    }
}

/// A ball around the origin.
pub fn ball(g: &mut Geometry, radius: f32, detail: f32) {
    g.sphere(Vec3::ZERO, radius, segments(48, detail), vec2(2.0, 1.0));
}

/// Two hoops of paint on a ball, which make its rolling visible.
pub fn bands(g: &mut Geometry, radius: f32, detail: f32) {
    let hoop = Geometry::of(|g| g.torus(radius, 0.02, segments(40, detail), 6));
    g.append(&hoop, Transform::IDENTITY);
    g.append(&hoop, Transform::from_rotation(Quat::from_rotation_y(FRAC_PI_2)));
}

/// A leaf with panels, from its hinge along +x.
pub fn leaf(g: &mut Geometry, size: Vec2) {
    let middle = (0.5 * size).extend(0.0);
    g.rounded_box(middle, size.extend(0.05), 0.012, 2, 0.5);
    for side in [-1.0, 1.0] {
        for y in [0.28, 0.72] {
            let at = vec3(0.5 * size.x, y * size.y, 0.028 * side);
            g.rounded_box(at, vec3(0.66 * size.x, 0.34 * size.y, 0.02), 0.008, 2, 0.5);
        }
    }
}

/// A handle on either side, and a plate at the foot.
pub fn fittings(g: &mut Geometry, size: Vec2) {
    let x = size.x - 0.09;
    g.sphere(vec3(x, 1.02, 0.07), 0.035, 16, Vec2::ONE);
    g.sphere(vec3(x, 1.02, -0.07), 0.035, 16, Vec2::ONE);
    g.tube(&[vec3(x, 1.02, -0.07), vec3(x, 1.02, 0.07)], 0.012, 8);
    let plate = vec3(0.94 * size.x, 0.16, 0.06);
    g.rounded_box(vec3(0.5 * size.x, 0.1, 0.0), plate, 0.006, 1, 0.5);
}

/// The cord of a lamp with a shade, from the origin down.
pub fn cord(g: &mut Geometry, length: f32, detail: f32) {
    g.tube(&[Vec3::ZERO, vec3(0.0, 0.16 - length, 0.0)], 0.01, 6);
    let p = |radius: f32, above: f32| vec2(radius, above - length);
    let shade = [
        p(0.0, 0.2),
        p(0.06, 0.2),
        p(0.06, 0.2),
        p(0.24, 0.02),
        p(0.26, 0.0),
        p(0.23, 0.01),
        p(0.05, 0.17),
        p(0.0, 0.17),
    ];
    // Lathes run from bottom to top. This one goes around its rim, so its points run from the inside out.
    let around: Vec<Vec2> = shade.into_iter().rev().collect();
    g.lathe(&around, segments(24, detail), Vec2::ONE);
}

/// A slender stand with a dish.
pub fn stand(g: &mut Geometry, height: f32, detail: f32) {
    let p = vec2;
    let profile = [
        p(0.0, 0.0),
        p(0.2, 0.0),
        p(0.2, 0.03),
        p(0.03, 0.08),
        p(0.025, height - 0.2),
        p(0.14, height - 0.12),
        p(0.0, height - 0.11),
    ];
    g.lathe(&profile, segments(16, detail), Vec2::ONE);
}
