//! Meshes from code: positions, normals, UVs, tangents and U32 indices, as glTF files have them.

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
};
use std::f32::consts::{PI, TAU};

/// To the right and up on each face of a box, as seen from outside.
const BOX_FACES: [(Vec3, Vec3); 6] = [
    (Vec3::X, Vec3::Y),
    (Vec3::NEG_X, Vec3::Y),
    (Vec3::NEG_Z, Vec3::Y),
    (Vec3::Z, Vec3::Y),
    (Vec3::X, Vec3::NEG_Z),
    (Vec3::X, Vec3::Z),
];

/// Triangles under construction. Front faces are counter-clockwise; UVs are in metres times a scale, `v` pointing down.
#[derive(Clone, Debug, Default)]
pub struct Geometry {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    indices: Vec<u32>,
}

impl Geometry {
    /// A shape made by a closure.
    pub fn of(make: impl FnOnce(&mut Geometry)) -> Self {
        let mut shape = Self::default();
        make(&mut shape);
        shape
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.indices.len() / 3
    }

    /// Adds a copy of `other`, moved by `transform`.
    pub fn append(&mut self, other: &Geometry, transform: Transform) {
        let base = self.positions.len() as u32;
        let inverse_scale = transform.scale.recip();
        self.positions
            .extend(other.positions.iter().map(|&p| transform.transform_point(p)));
        self.normals.extend(
            other
                .normals
                .iter()
                .map(|&n| (transform.rotation * (n * inverse_scale)).normalize_or(n)),
        );
        self.uvs.extend_from_slice(&other.uvs);
        let mirrored = transform.scale.x * transform.scale.y * transform.scale.z < 0.0;
        for triangle in other.indices.chunks_exact(3) {
            let [a, b, c] = [triangle[0], triangle[1], triangle[2]].map(|i| i + base);
            self.indices.extend(if mirrored { [a, c, b] } else { [a, b, c] });
        }
    }

    /// Adds a part, moved by `transform`.
    pub fn part(&mut self, transform: Transform, make: impl FnOnce(&mut Geometry)) {
        self.append(&Self::of(make), transform);
    }

    /// Adds the surface `point(u, v)` over the unit square, `columns` by `rows` quads. Its front faces `d/du x d/dv`. `uv_scale` maps the
    /// square to texture coordinates.
    pub fn surface(&mut self, columns: u32, rows: u32, uv_scale: Vec2, point: impl Fn(f32, f32) -> Vec3) {
        let delta = 1e-3;
        self.sheet(columns.max(1), rows.max(1), uv_scale, |u, v| {
            let normal_at = |u: f32, v: f32| {
                let du = point(u + delta, v) - point(u - delta, v);
                let dv = point(u, v + delta) - point(u, v - delta);
                du.cross(dv).try_normalize()
            };
            // At a pole one derivative vanishes, so take it slightly inside.
            let normal = normal_at(u, v).or_else(|| normal_at(u * 0.99 + 0.005, v * 0.99 + 0.005));
            (point(u, v), normal.unwrap_or(Vec3::Y))
        });
    }

    /// Adds the surface `point(u, v)` like [`surface`](Self::surface), with its own normals, which can differ from the normals of its
    /// triangles.
    pub fn shaded_surface(&mut self, columns: u32, rows: u32, point: impl Fn(f32, f32) -> (Vec3, Vec3)) {
        self.sheet(columns, rows, Vec2::ONE, |u, v| {
            let (position, normal) = point(u, v);
            (position, normal.normalize_or(Vec3::Y))
        });
    }

    /// Adds `columns` by `rows` quads over the unit square. `vertex` returns a position and a unit normal.
    fn sheet(&mut self, columns: u32, rows: u32, uv_scale: Vec2, vertex: impl Fn(f32, f32) -> (Vec3, Vec3)) {
        let base = self.positions.len() as u32;
        for row in 0..=rows {
            for column in 0..=columns {
                let (u, v) = (column as f32 / columns as f32, row as f32 / rows as f32);
                let (position, normal) = vertex(u, v);
                self.positions.push(position);
                self.normals.push(normal);
                self.uvs.push(vec2(u, 1.0 - v) * uv_scale);
            }
        }
        self.grid(base, columns, rows);
    }

    /// Adds the triangles of `columns` by `rows` quads between vertices that begin at `base`, row by row.
    fn grid(&mut self, base: u32, columns: u32, rows: u32) {
        let stride = columns + 1;
        for row in 0..rows {
            for column in 0..columns {
                let a = base + row * stride + column;
                let (b, c, d) = (a + 1, a + stride + 1, a + stride);
                self.triangle(a, b, c);
                self.triangle(a, c, d);
            }
        }
    }

    /// Adds a flat quad; corners counter-clockwise from the lower left of its texture.
    pub fn quad(&mut self, corners: [Vec3; 4], uv_size: Vec2) {
        let (w, h) = (uv_size.x, uv_size.y);
        self.flat(corners, |_| [vec2(0.0, h), vec2(w, h), vec2(w, 0.0), Vec2::ZERO]);
    }

    /// Adds a flat quad with UVs from its position, so that neighbours in one plane continue the texture.
    pub fn mapped_quad(&mut self, corners: [Vec3; 4], uv_scale: f32) {
        self.flat(corners, |normal| {
            let up = if normal.y.abs() > 0.7 { Vec3::NEG_Z } else { Vec3::Y };
            let right = up.cross(normal).normalize_or(Vec3::X);
            corners.map(|p| vec2(p.dot(right), -p.dot(up)) * uv_scale)
        });
    }

    /// Adds a flat quad. `uvs` takes its normal.
    fn flat(&mut self, corners: [Vec3; 4], uvs: impl FnOnce(Vec3) -> [Vec2; 4]) {
        let [a, b, _, d] = corners;
        let normal = (b - a).cross(d - a).normalize_or(Vec3::Y);
        let base = self.positions.len() as u32;
        self.positions.extend(corners);
        self.normals.extend([normal; 4]);
        self.uvs.extend(uvs(normal));
        self.triangle(base, base + 1, base + 2);
        self.triangle(base, base + 2, base + 3);
    }

    /// Adds the four sides of an opening in a wall that faces +z, from one depth to another.
    pub fn reveal(&mut self, opening: Rect, front: f32, back: f32, uv_scale: f32) {
        let (Vec2 { x: l, y: b }, Vec2 { x: r, y: t }) = (opening.min, opening.max);
        for corners in [
            [vec3(l, b, front), vec3(l, b, back), vec3(l, t, back), vec3(l, t, front)],
            [vec3(r, b, back), vec3(r, b, front), vec3(r, t, front), vec3(r, t, back)],
            [vec3(l, b, front), vec3(r, b, front), vec3(r, b, back), vec3(l, b, back)],
            [vec3(l, t, back), vec3(r, t, back), vec3(r, t, front), vec3(l, t, front)],
        ] {
            self.mapped_quad(corners, uv_scale);
        }
    }

    /// Adds an axis-aligned box around `center`; UVs run in metres times `uv_scale`.
    pub fn cuboid(&mut self, center: Vec3, size: Vec3, uv_scale: f32) {
        let half = size * 0.5;
        for (right, up) in BOX_FACES {
            let out = right.cross(up);
            let (r, u, o) = (
                right * half.dot(right.abs()),
                up * half.dot(up.abs()),
                out * half.dot(out.abs()),
            );
            let m = center + o;
            self.quad(
                [m - r - u, m + r - u, m + r + u, m - r + u],
                2.0 * uv_scale * vec2(r.length(), u.length()),
            );
        }
    }

    /// Adds a box with rounded edges of the given radius: `segments` quads across each rounding.
    pub fn rounded_box(&mut self, center: Vec3, size: Vec3, radius: f32, segments: u32, uv_scale: f32) {
        let half = size * 0.5;
        let radius = radius.min(half.min_element());
        let segments = segments.max(1);
        for (right, up) in BOX_FACES {
            let out = right.cross(up);
            let extent = |axis: Vec3| half.dot(axis.abs());
            let inner = half - Vec3::splat(radius);
            let base = self.positions.len() as u32;
            let steps = 2 * segments + 2;
            let axis_at = |i: u32, length: f32| {
                // First half of the steps covers the left rounding (angle -45..0 degrees), the rest the right one.
                let (side, k) = if i <= segments {
                    (-1.0, segments - i)
                } else {
                    (1.0, i - segments - 1)
                };
                let tangent = ops::tan(k as f32 / segments as f32 * PI * 0.25);
                (side * (length - radius), side * tangent)
            };
            for j in 0..steps {
                for i in 0..steps {
                    let (x, tx) = axis_at(i, extent(right));
                    let (y, ty) = axis_at(j, extent(up));
                    let normal = (out + right * tx + up * ty).normalize_or(out);
                    let core = right * x + up * y + out * inner.dot(out.abs());
                    let position = core + normal * radius;
                    self.positions.push(center + position);
                    self.normals.push(normal);
                    let (s, t) = (position.dot(right) + extent(right), extent(up) - position.dot(up));
                    self.uvs.push(vec2(s, t) * uv_scale);
                }
            }
            self.grid(base, steps - 1, steps - 1);
        }
    }

    /// Adds a sphere around `center`.
    pub fn sphere(&mut self, center: Vec3, radius: f32, segments: u32, uv_scale: Vec2) {
        self.surface(segments.max(3), segments.max(4) / 2, uv_scale, |u, v| {
            let (longitude, latitude) = (u * TAU, (v - 0.5) * PI);
            let ring = ops::cos(latitude);
            center
                + radius
                    * vec3(
                        ring * ops::sin(longitude),
                        ops::sin(latitude),
                        ring * ops::cos(longitude),
                    )
        });
    }

    /// Adds a torus in the xy plane.
    pub fn torus(&mut self, radius: f32, tube: f32, segments: u32, sides: u32) {
        self.surface(
            segments.max(3),
            sides.max(3),
            vec2(segments as f32 / 8.0, 1.0),
            |u, v| {
                let (a, b) = (u * TAU, v * TAU);
                let ring = radius + tube * ops::cos(b);
                vec3(ring * ops::cos(a), ring * ops::sin(a), tube * ops::sin(b))
            },
        );
    }

    /// Adds the revolution about the y axis of a profile of (radius, height) points from bottom to top. Between consecutive
    /// points the surface is straight; a repeated point makes a hard edge.
    pub fn lathe(&mut self, profile: &[Vec2], segments: u32, uv_scale: Vec2) {
        let segments = segments.max(3);
        let mut height = 0.0;
        let mut runs: Vec<Vec<Vec2>> = Vec::new();
        let mut run: Vec<Vec2> = Vec::new();
        for &point in profile {
            if run.last().is_some_and(|last| last.distance_squared(point) < 1e-12) {
                runs.push(std::mem::take(&mut run));
            }
            run.push(point);
        }
        runs.push(run);
        for run in &runs {
            let base = self.positions.len() as u32;
            let mut along = height;
            for (i, &p) in run.iter().enumerate() {
                let previous = run[i.saturating_sub(1)];
                let next = run[(i + 1).min(run.len() - 1)];
                along += previous.distance(p);
                let slope = (next - previous).normalize_or(Vec2::Y);
                for s in 0..=segments {
                    let angle = s as f32 / segments as f32 * TAU;
                    let (sin, cos) = (ops::sin(angle), ops::cos(angle));
                    self.positions.push(vec3(p.x * sin, p.y, p.x * cos));
                    self.normals
                        .push(vec3(slope.y * sin, -slope.x, slope.y * cos).normalize_or(Vec3::Y));
                    self.uvs.push(vec2(s as f32 / segments as f32, -along) * uv_scale);
                }
            }
            height = along;
            self.grid(base, segments, run.len().saturating_sub(1) as u32);
        }
    }

    /// Adds a tube of circular section along a line of points.
    pub fn tube(&mut self, path: &[Vec3], radius: f32, sides: u32) {
        if path.len() < 2 {
            return;
        }
        let base = self.positions.len() as u32;
        let sides = sides.max(3);
        let (mut side, mut length) = (Vec3::ZERO, 0.0);
        for (i, &p) in path.iter().enumerate() {
            let (previous, next) = (path[i.saturating_sub(1)], path[(i + 1).min(path.len() - 1)]);
            let forward = (next - previous).normalize_or(Vec3::Y);
            // Parallel transport keeps the section from twisting.
            side = (side - forward * side.dot(forward))
                .try_normalize()
                .unwrap_or_else(|| forward.any_orthonormal_vector());
            let other = forward.cross(side);
            length += previous.distance(p);
            for s in 0..=sides {
                let angle = s as f32 / sides as f32 * TAU;
                let normal = side * ops::cos(angle) + other * ops::sin(angle);
                self.positions.push(p + normal * radius);
                self.normals.push(normal);
                self.uvs.push(vec2(s as f32 / sides as f32, length));
            }
        }
        self.grid(base, sides, path.len() as u32 - 1);
    }

    /// Adds a tube of circular section along the curve `point(t)`, with t from 0 to 1, in `steps` straight pieces.
    pub fn curved_tube(&mut self, steps: u32, radius: f32, sides: u32, point: impl Fn(f32) -> Vec3) {
        let path: Vec<Vec3> = (0..=steps).map(|i| point(i as f32 / steps as f32)).collect();
        self.tube(&path, radius, sides);
    }

    fn triangle(&mut self, a: u32, b: u32, c: u32) {
        let [p, q, r] = [a, b, c].map(|i| self.positions[i as usize]);
        // Poles and pinched surfaces make empty triangles. Loaders rarely deliver any, so we skip them, too.
        if (q - p).cross(r - p).length_squared() > 1e-16 {
            self.indices.extend([a, b, c]);
        }
    }

    /// Tangents along increasing `u`, with the handedness that makes `+y` of a normal map point to the top of the texture.
    fn tangents(&self) -> Vec<Vec4> {
        let mut along_u = vec![Vec3::ZERO; self.positions.len()];
        let mut along_v = along_u.clone();
        for triangle in self.indices.chunks_exact(3) {
            let [a, b, c] = [triangle[0], triangle[1], triangle[2]].map(|i| i as usize);
            let (e1, e2) = (
                self.positions[b] - self.positions[a],
                self.positions[c] - self.positions[a],
            );
            let (d1, d2) = (self.uvs[b] - self.uvs[a], self.uvs[c] - self.uvs[a]);
            let area = d1.perp_dot(d2);
            if area.abs() < 1e-12 {
                continue;
            }
            for i in [a, b, c] {
                along_u[i] += (e1 * d2.y - e2 * d1.y) / area;
                along_v[i] += (e2 * d1.x - e1 * d2.x) / area;
            }
        }
        (0..self.positions.len())
            .map(|i| {
                let normal = self.normals[i];
                let flat = along_u[i] - normal * normal.dot(along_u[i]);
                let tangent = flat.try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
                let down = normal.cross(tangent).dot(along_v[i]) > 0.0;
                tangent.extend(if down { -1.0 } else { 1.0 })
            })
            .collect()
    }

    /// The finished mesh.
    pub fn into_mesh(self) -> Mesh {
        let tangents = self.tangents();
        Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, self.positions)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, self.normals)
            .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, self.uvs)
            .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents)
            .with_inserted_indices(Indices::U32(self.indices))
    }
}

/// Turns a count of segments at detail one into the count at `detail`.
pub fn segments(base: u32, detail: f32) -> u32 {
    ((base as f32 * detail).round() as u32).max(3)
}

/// A rotation about the y axis, in degrees.
pub fn turned(degrees: f32) -> Quat {
    Quat::from_rotation_y(degrees.to_radians())
}

/// Corners of a level rectangle between two corners (x and z), for a quad that faces up.
pub fn level_corners(low: Vec2, high: Vec2, y: f32) -> [Vec3; 4] {
    [(low.x, high.y), (high.x, high.y), (high.x, low.y), (low.x, low.y)].map(|(x, z)| vec3(x, y, z))
}

/// Corners of an upright rectangle between two corners (x and y), for a quad that faces +z.
pub fn upright_corners(low: Vec2, high: Vec2, z: f32) -> [Vec3; 4] {
    [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)].map(|(x, y)| vec3(x, y, z))
}

/// The corners of a quad, which face the other way if `front` is false.
pub fn facing(front: bool, [a, b, c, d]: [Vec3; 4]) -> [Vec3; 4] {
    if front { [a, b, c, d] } else { [b, a, d, c] }
}

/// A point of the smooth line (Catmull-Rom) through four points, from the second at 0 to the third at 1.
pub fn catmull_rom([a, b, c, d]: [Vec3; 4], s: f32) -> Vec3 {
    0.5 * (2.0 * b + (c - a) * s + (2.0 * a - 5.0 * b + 4.0 * c - d) * s * s + (3.0 * b - a - 3.0 * c + d) * s * s * s)
}
