//! Triangle soups, instances and rays from a seed, packed as the GPU sees them, with a slow and exact oracle.

use bevy::math::{Affine3A, DVec3, EulerRot, Quat, Vec3};
use bevy_glint::scene::bvh::{Blas, BvhQuality, Row, SceneView, Tlas, TlasInstance, TraceRay, build_blas, build_tlas};
use bevy_glint::scene::gpu_types::{INSTANCE_CASTS_SHADOW, INSTANCE_MIRRORED};

/// `SplitMix64`.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
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
    /// The same few triangles many times.
    Duplicates,
    /// All share a corner, each larger than the last.
    Nested,
}

pub const SOUPS: [Soup; 5] = [Soup::Random, Soup::Needles, Soup::Grid, Soup::Duplicates, Soup::Nested];

impl Soup {
    /// Relative error of t that single precision may cause: rounding tilts the plane of a needle by its ratio of length to
    /// width.
    pub fn tolerance(self) -> f64 {
        if self == Soup::Needles { 3e-3 } else { 1e-4 }
    }
}

/// Distances between a ray and an edge below this, relative to the coordinates, are within rounding.
const DOUBT: f64 = 5e-6;

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

/// Meshes and their instances, packed.
pub struct Packed {
    pub meshes: Vec<Mesh>,
    /// Mesh and object-to-world matrix.
    pub instances: Vec<(usize, Affine3A)>,
    pub flags: Vec<u32>,
    pub bvh: Vec<Row>,
    pub tlas: Tlas,
    pub stack_size: u32,
    /// Instance, primitive and corners in world space without rounding to `f32`: what the oracle searches.
    triangles: Vec<(u32, u32, [DVec3; 3])>,
}

impl Packed {
    pub fn new(meshes: Vec<Mesh>, instances: Vec<(usize, Affine3A)>, max_entries: usize) -> Self {
        let mut bvh = Vec::new();
        let mut trees: Vec<Option<(u32, Blas)>> = Vec::new();
        for mesh in &meshes {
            let base = bvh.len() as u32;
            let blas = build_blas(&mesh.positions, &mesh.indices, BvhQuality::Medium);
            bvh.extend_from_slice(blas.as_ref().map_or(&[], |b| b.rows.as_slice()));
            trees.push(blas.map(|b| (base, b)));
        }
        let records: Vec<TlasInstance> = instances
            .iter()
            .enumerate()
            .filter_map(|(i, (mesh, matrix))| {
                let (base, blas) = trees[*mesh].as_ref()?;
                Some(TlasInstance {
                    world_from_object: *matrix,
                    bounds: blas.bounds,
                    instance: i as u32,
                    node_row: *base,
                    triangle_row: base + blas.triangle_row(),
                    top: &blas.top,
                })
            })
            .collect();
        let tlas = build_tlas(&records, max_entries);
        let depth = trees.iter().flatten().map(|(_, b)| b.depth).max().unwrap_or(0);
        let stack_size = bevy_glint::scene::bvh::stack_size(tlas.depth, depth);
        let flags = instances
            .iter()
            .map(|(_, m)| {
                INSTANCE_CASTS_SHADOW
                    | if m.matrix3.determinant() < 0.0 {
                        INSTANCE_MIRRORED
                    } else {
                        0
                    }
            })
            .collect();
        let mut triangles = Vec::new();
        for (instance, (mesh, matrix)) in instances.iter().enumerate() {
            let (linear, translation) = (matrix.matrix3.as_dmat3(), matrix.translation.as_dvec3());
            for primitive in 0..meshes[*mesh].triangle_count() {
                let corners = meshes[*mesh]
                    .corners(primitive)
                    .map(|c| linear * Vec3::from(c).as_dvec3() + translation);
                triangles.push((instance as u32, primitive as u32, corners));
            }
        }
        Self {
            meshes,
            instances,
            flags,
            bvh,
            tlas,
            stack_size,
            triangles,
        }
    }

    pub fn view(&self) -> SceneView<'_> {
        SceneView {
            bvh: &self.bvh,
            tlas: &self.tlas.rows,
            tlas_node_count: self.tlas.node_count,
            tlas_entry_base: self.tlas.entry_base,
            flags: &self.flags,
        }
    }

    /// Rays from around the scene at points on triangles (half of them near edges) and in random directions.
    pub fn rays(&self, count: usize, spread: f32, centre: Vec3, random: &mut Random) -> Vec<TraceRay> {
        (0..count)
            .map(|i| {
                let origin = centre + random.vector() * spread;
                let direction = if i % 4 == 3 || self.triangles.is_empty() {
                    match i % 16 {
                        3 => Vec3::AXES[random.below(3)],
                        7 => -Vec3::AXES[random.below(3)],
                        _ => random.vector(),
                    }
                } else {
                    let (_, _, [a, b, c]) = self.triangles[random.below(self.triangles.len())];
                    let mut u = f64::from(random.signed() * 0.5 + 0.5);
                    let v = (1.0 - u) * f64::from(random.signed() * 0.5 + 0.5);
                    if i % 4 == 2 {
                        u = 0.0;
                    }
                    (a + (b - a) * u + (c - a) * v - origin.as_dvec3()).as_vec3()
                };
                let direction = direction.try_normalize().unwrap_or(Vec3::X);
                TraceRay {
                    origin,
                    direction,
                    t_min: 0.0,
                    t_max: f32::MAX,
                }
            })
            .collect()
    }

    /// The closest hit by brute force, and how sure it is.
    pub fn oracle(&self, ray: &TraceRay) -> Oracle {
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut result = Oracle {
            t: f64::INFINITY,
            candidates: Vec::new(),
        };
        for (instance, primitive, corners) in &self.triangles {
            if let Some((t, margin, error)) = intersect(corners, origin, direction)
                && t > -0.01
            {
                if margin >= 0.0 && t > f64::from(ray.t_min) {
                    result.t = result.t.min(t);
                }
                result.candidates.push(Candidate {
                    t,
                    margin,
                    error,
                    instance: *instance,
                    primitive: *primitive,
                });
            }
        }
        result
    }
}

/// A triangle that the ray hits, or misses by a little.
pub struct Candidate {
    pub t: f64,
    /// Distance between the ray and the nearest edge relative to the coordinates, negative outside: below [`DOUBT`],
    /// single precision may see the ray on either side.
    pub margin: f64,
    /// Bound of the error of `t` in single precision: rounding shifts and tilts the plane, which moves the point where a
    /// grazing ray meets it.
    pub error: f64,
    pub instance: u32,
    pub primitive: u32,
}

pub struct Oracle {
    /// Infinite for a miss.
    pub t: f64,
    pub candidates: Vec<Candidate>,
}

impl Oracle {
    /// Whether a tracer in single precision may answer `hit`: it must lie on a candidate, and no triangle that the ray
    /// surely hits may lie in front of it. `tolerance` is relative to t, `floor` absolute.
    pub fn accepts(&self, hit: Option<(f32, u32, u32)>, tolerance: f64, floor: f64) -> bool {
        let slack = |c: &Candidate| c.t.abs() * tolerance + floor + c.error;
        let sure = || self.candidates.iter().filter(|c| c.margin > DOUBT && c.t > slack(c));
        match hit {
            None => sure().next().is_none(),
            Some((t, instance, primitive)) => {
                let t = f64::from(t);
                self.candidates.iter().any(|c| {
                    (c.instance, c.primitive) == (instance, primitive)
                        && c.margin > -DOUBT
                        && (c.t - t).abs() <= slack(c)
                        && sure().all(|nearer| t <= nearer.t + slack(nearer) + c.error)
                })
            }
        }
    }
}

/// Distance, margin and error; `None` far outside or parallel.
fn intersect([a, b, c]: &[DVec3; 3], origin: DVec3, direction: DVec3) -> Option<(f64, f64, f64)> {
    let normal = (b - a).cross(c - a);
    let slope = normal.dot(direction);
    let cosine = slope.abs() / normal.length();
    if !(cosine > 0.0) {
        return None;
    }
    let t = normal.dot(a - origin) / slope;
    let at = origin + direction * t;
    let inside = |p: &DVec3, q: &DVec3| (p - at).cross(q - at).dot(normal) / (normal.length() * (q - p).length());
    let smallest = inside(b, c).min(inside(c, a)).min(inside(a, b));
    let size = t.abs() + origin.length() + a.length().max(b.length()).max(c.length());
    let margin = smallest * cosine / size;
    let longest = (b - a).length().max((c - a).length()).max((c - b).length());
    let aspect = longest * longest / normal.length();
    let error = 4.0 * f64::from(f32::EPSILON) * size * aspect / cosine;
    (margin > -DOUBT).then_some((t, margin, error))
}
