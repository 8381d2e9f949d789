//! Meshes that break trees or triangle tests, and their transforms, from a seed.

use crate::sampling::reference::split_mix;
use bevy::math::{Affine3A, EulerRot, Quat, Vec3};

/// `SplitMix64`.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        split_mix(&mut self.0)
    }

    /// In [-1, 1).
    pub fn signed(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 8_388_608.0 - 1.0
    }

    pub fn vector(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }
}

/// A triangle list.
#[derive(Clone, Default)]
pub struct Mesh {
    pub positions: Vec<[f32; 3]>,
    pub indices: Vec<u32>,
}

impl Mesh {
    pub fn push(&mut self, corners: [Vec3; 3]) {
        for corner in corners {
            self.indices.push(self.positions.len() as u32);
            self.positions.push(corner.to_array());
        }
    }

    pub fn triangle_count(&self) -> usize {
        self.indices.len() / 3
    }

    pub fn corners(&self, primitive: usize) -> [[f32; 3]; 3] {
        [0, 1, 2].map(|i| self.positions[self.indices[primitive * 3 + i] as usize])
    }
}

/// Shapes of triangles that break trees or triangle tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Soup {
    /// Triangles of all sizes anywhere.
    Random,
    /// Long and thin.
    Needles,
    /// An axis-aligned grid in one plane, with shared edges.
    Grid,
    /// A few triangles, each many times.
    Duplicates,
    /// All share a corner, each larger than the last.
    Nested,
}

pub const SOUPS: [Soup; 5] = [Soup::Random, Soup::Needles, Soup::Grid, Soup::Duplicates, Soup::Nested];

impl Soup {
    /// Relative error of t that single precision can cause: rounding tilts the plane of a needle by its ratio of length to width.
    pub fn tolerance(self) -> f64 {
        if self == Soup::Needles { 3e-3 } else { 1e-4 }
    }
}

/// A soup within about `scale` of `centre`.
pub fn mesh(kind: Soup, triangles: usize, scale: f32, centre: Vec3, random: &mut Random) -> Mesh {
    let mut mesh = Mesh::default();
    let side = (triangles as f32 / 2.0).sqrt().ceil().max(1.0);
    let originals: Vec<[Vec3; 3]> = (0..8).map(|_| [(); 3].map(|()| random.vector())).collect();
    while mesh.triangle_count() < triangles {
        let i = mesh.triangle_count();
        let corners = match kind {
            Soup::Random => {
                let (at, size) = (random.vector(), 10f32.powf(random.signed() * 1.5 - 1.5));
                [(); 3].map(|()| at + random.vector() * size)
            }
            Soup::Needles => {
                let (at, along) = (random.vector(), random.vector());
                [at, at + along, at + along * 0.5 + random.vector() * 1e-3]
            }
            Soup::Grid => {
                let cell = Vec3::new((i / 2) as f32 % side, 0.0, ((i / 2) as f32 / side).floor());
                let corner = |x: f32, z: f32| (cell + Vec3::new(x, 0.0, z)) * (2.0 / side) - Vec3::new(1.0, 0.0, 1.0);
                if i % 2 == 0 {
                    [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 0.0)]
                } else {
                    [corner(1.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0)]
                }
            }
            Soup::Duplicates => originals[i % originals.len()],
            Soup::Nested => {
                let size = (i + 1) as f32 / triangles as f32;
                [
                    Vec3::ZERO,
                    Vec3::new(size, 0.1 * size, 0.0),
                    Vec3::new(0.0, 0.1 * size, size),
                ]
            }
        };
        mesh.push(corners.map(|c| centre + c * scale));
    }
    mesh
}

/// Triangles of all sizes beside a grid, this many of each.
pub fn two_meshes(triangles: [usize; 2], random: &mut Random) -> Vec<Mesh> {
    vec![
        mesh(Soup::Random, triangles[0], 1.0, Vec3::ZERO, random),
        mesh(Soup::Grid, triangles[1], 2.0, Vec3::Y, random),
    ]
}

/// A lumpy sphere of radius 0.7 to 1.3 without a hole.
pub fn closed_surface(rings: usize, segments: usize, random: &mut Random) -> Mesh {
    use core::f32::consts::PI;
    let mut mesh = Mesh::default();
    let mut vertex = |latitude: f32, longitude: f32| {
        let (y, ring) = latitude.sin_cos();
        let (z, x) = longitude.sin_cos();
        let radius = 1.0 + 0.3 * random.signed();
        mesh.positions
            .push((Vec3::new(x * ring, y, z * ring) * radius).to_array());
    };
    vertex(-0.5 * PI, 0.0);
    for ring in 1..rings {
        for segment in 0..segments {
            vertex(
                PI * (ring as f32 / rings as f32 - 0.5),
                2.0 * PI * segment as f32 / segments as f32,
            );
        }
    }
    vertex(0.5 * PI, 0.0);
    let last = mesh.positions.len() as u32 - 1;
    let index = |ring: usize, segment: usize| match ring {
        0 => 0,
        ring if ring == rings => last,
        ring => (1 + (ring - 1) * segments + segment % segments) as u32,
    };
    for ring in 0..rings {
        for segment in 0..segments {
            let (a, b) = (index(ring, segment), index(ring, segment + 1));
            let (c, d) = (index(ring + 1, segment), index(ring + 1, segment + 1));
            if ring > 0 {
                mesh.indices.extend([a, c, b]);
            }
            if ring + 1 < rings {
                mesh.indices.extend([b, c, d]);
            }
        }
    }
    mesh
}

/// Turns, sizes and mirrors at random.
pub fn placement(random: &mut Random, spread: f32) -> Affine3A {
    let turn = random.vector() * 3.0;
    let mut scale = Vec3::from_array([(); 3].map(|()| 3f32.powf(random.signed())));
    if random.below(3) == 0 {
        scale.x = -scale.x;
    }
    Affine3A::from_scale_rotation_translation(
        scale,
        Quat::from_euler(EulerRot::XYZ, turn.x, turn.y, turn.z),
        random.vector() * spread,
    )
}
