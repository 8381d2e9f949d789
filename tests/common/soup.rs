//! Triangle soups, instances and rays from a seed, packed as the GPU sees them, with a slow and exact oracle.

use bevy::math::{Affine3A, DVec3, EulerRot, Quat, Vec3};
use bevy_glint::scene::bvh::{
    Blas, BvhQuality, MergeSource, Row, SceneView, Tlas, TlasInstance, TraceRay, build_blas, build_merged, build_tlas,
    owner, stack_size,
};
use bevy_glint::scene::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED,
};
use std::collections::BTreeMap;

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

/// Stands in for the alpha test of materials: every other triangle is cut out.
pub fn alpha_test(_instance: u32, primitive: u32, _barycentrics: [f32; 2]) -> bool {
    primitive.is_multiple_of(2)
}

/// How an instance is packed.
#[derive(Clone, Copy, Debug)]
pub struct Packing {
    /// `INSTANCE_` flags, but for [`INSTANCE_MIRRORED`], which follows from the matrix.
    pub flags: u32,
    /// The merged tree that it is part of.
    pub tree: Option<u32>,
}

impl Packing {
    /// An ordinary instance.
    pub const SINGLE: Self = Self {
        flags: INSTANCE_CASTS_SHADOW,
        tree: None,
    };
    /// Part of a merged tree.
    pub const MERGED: Self = Self {
        flags: INSTANCE_CASTS_SHADOW,
        tree: Some(0),
    };
}

/// Meshes and their instances, packed.
pub struct Packed {
    pub meshes: Vec<Mesh>,
    /// Mesh and object-to-world matrix.
    pub instances: Vec<(usize, Affine3A)>,
    /// `INSTANCE_` flags by instance.
    pub flags: Vec<u32>,
    /// All trees, the TLAS behind the others.
    pub bvh: Vec<Row>,
    pub tlas: Tlas,
    pub stack_size: u32,
    tlas_row: u32,
    /// Instance, primitive and corners in world space without rounding to `f32`: what the oracle searches.
    triangles: Vec<(u32, u32, [DVec3; 3])>,
}

impl Packed {
    /// Nothing is merged.
    pub fn new(meshes: Vec<Mesh>, instances: Vec<(usize, Affine3A)>, max_entries: usize) -> Self {
        Self::with(meshes, instances, max_entries, |_| Packing::SINGLE)
    }

    /// `packing` says for each instance how it is packed.
    pub fn with(
        meshes: Vec<Mesh>,
        instances: Vec<(usize, Affine3A)>,
        max_entries: usize,
        packing: impl Fn(usize) -> Packing,
    ) -> Self {
        let mut bvh: Vec<Row> = Vec::new();
        let mut add = |blas: Option<Blas>| {
            let base = bvh.len() as u32;
            bvh.extend_from_slice(blas.as_ref().map_or(&[], |b| b.rows.as_slice()));
            blas.map(|b| (base, b))
        };
        let build = |mesh: &Mesh| build_blas(&mesh.positions, &mesh.indices, BvhQuality::Medium);
        let trees: Vec<Option<(u32, Blas)>> = meshes.iter().map(|mesh| add(build(mesh))).collect();
        let mut merged: BTreeMap<u32, Vec<MergeSource>> = BTreeMap::new();
        let mut flags = Vec::new();
        for (i, (mesh, matrix)) in instances.iter().enumerate() {
            let Packing { flags: own, tree } = packing(i);
            let mirrored = matrix.matrix3.determinant() < 0.0;
            flags.push(own | if mirrored { INSTANCE_MIRRORED } else { 0 });
            if let Some(tree) = tree {
                merged.entry(tree).or_default().push(MergeSource {
                    positions: &meshes[*mesh].positions,
                    indices: &meshes[*mesh].indices,
                    world_from_object: *matrix,
                    instance: i as u32,
                    flags: flags[i],
                });
            }
        }
        let merged: Vec<(u32, Blas)> = merged
            .into_values()
            .filter_map(|sources| add(build_merged(&sources, BvhQuality::Medium)))
            .collect();

        let singles = instances
            .iter()
            .enumerate()
            .filter(|(i, _)| packing(*i).tree.is_none())
            .filter_map(|(i, (mesh, matrix))| {
                let (base, blas) = trees[*mesh].as_ref()?;
                Some((*base, blas, *matrix, owner(i as u32, flags[i])))
            });
        let in_world = merged.iter().map(|(base, blas)| (*base, blas, Affine3A::IDENTITY, 0));
        let records: Vec<TlasInstance> = singles
            .chain(in_world)
            .map(|(base, blas, world_from_object, instance)| TlasInstance {
                world_from_object,
                bounds: blas.bounds,
                instance,
                node_row: base,
                triangle_row: base + blas.triangle_row(),
                top: if instance == 0 { &[] } else { &blas.top },
            })
            .collect();
        let tlas = build_tlas(&records, max_entries);
        let depth = trees.iter().flatten().chain(&merged).map(|(_, b)| b.depth).max();
        let stack_size = stack_size(tlas.depth, depth.unwrap_or(0));
        let tlas_row = bvh.len() as u32;
        bvh.extend_from_slice(&tlas.rows);

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
            tlas_row,
            triangles,
        }
    }

    /// Row of the TLAS's first entry in the buffer.
    pub fn entry_base(&self) -> u32 {
        self.tlas_row + self.tlas.entry_base
    }

    pub fn view(&self) -> SceneView<'_> {
        SceneView {
            bvh: &self.bvh,
            tlas_node_count: self.tlas.traversal_node_count(),
            tlas_entry_base: self.entry_base(),
            alpha_test: Some(alpha_test),
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
        self.search(ray, |flags, front| {
            let culled = if front { INSTANCE_CULL_FRONT } else { INSTANCE_CULL_BACK };
            flags & culled == 0
        })
    }

    /// What may stand in the way of a shadow ray.
    pub fn shadow_oracle(&self, ray: &TraceRay) -> Oracle {
        self.search(ray, |flags, _| flags & INSTANCE_CASTS_SHADOW != 0)
    }

    /// `counts` judges the flags of an instance and the face that the ray sees: true = the front in world space.
    fn search(&self, ray: &TraceRay, counts: impl Fn(u32, bool) -> bool) -> Oracle {
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut result = Oracle {
            t: f64::INFINITY,
            candidates: Vec::new(),
        };
        for (instance, primitive, corners) in &self.triangles {
            let flags = self.flags[*instance as usize];
            if flags & INSTANCE_ALPHA_MASKED != 0 && !alpha_test(*instance, *primitive, [0.0; 2]) {
                continue;
            }
            if let Some(found) = intersect(corners, origin, direction)
                && found.t > -0.01
            {
                let (front, back) = (counts(flags, true), counts(flags, false));
                let seen = if found.cosine < 0.0 { front } else { back };
                // Of a triangle seen on edge, single precision may take either face.
                let doubtful = found.cosine.abs() < found.tilt && front != back;
                if !seen && !doubtful {
                    continue;
                }
                let margin = if doubtful { found.margin.min(0.0) } else { found.margin };
                if margin >= 0.0 && found.t > f64::from(ray.t_min) {
                    result.t = result.t.min(found.t);
                }
                result.candidates.push(Candidate {
                    t: found.t,
                    margin,
                    error: found.error,
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
    /// Whether a tracer in single precision may find that something, or nothing, is in the way.
    pub fn accepts_any(&self, blocked: bool, tolerance: f64, floor: f64) -> bool {
        if blocked {
            self.candidates
                .iter()
                .any(|c| c.margin > -DOUBT && c.t > -self.slack(c, tolerance, floor))
        } else {
            self.accepts(None, tolerance, floor)
        }
    }

    fn slack(&self, candidate: &Candidate, tolerance: f64, floor: f64) -> f64 {
        candidate.t.abs() * tolerance + floor + candidate.error
    }

    /// Whether a tracer in single precision may answer `hit`: it must lie on a candidate, and no triangle that the ray
    /// surely hits may lie in front of it. `tolerance` is relative to t, `floor` absolute.
    pub fn accepts(&self, hit: Option<(f32, u32, u32)>, tolerance: f64, floor: f64) -> bool {
        let slack = |c: &Candidate| self.slack(c, tolerance, floor);
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

/// Where a ray meets the plane of a triangle.
struct Met {
    t: f64,
    margin: f64,
    error: f64,
    /// Between the ray and the normal; negative where the front is seen.
    cosine: f64,
    /// Bound of the error of `cosine` in single precision.
    tilt: f64,
}

/// `None` far outside or parallel.
fn intersect([a, b, c]: &[DVec3; 3], origin: DVec3, direction: DVec3) -> Option<Met> {
    let normal = (b - a).cross(c - a);
    let slope = normal.dot(direction);
    let cosine = slope / normal.length();
    if !(cosine.abs() > 0.0) {
        return None;
    }
    let t = normal.dot(a - origin) / slope;
    let at = origin + direction * t;
    let inside = |p: &DVec3, q: &DVec3| (p - at).cross(q - at).dot(normal) / (normal.length() * (q - p).length());
    let smallest = inside(b, c).min(inside(c, a)).min(inside(a, b));
    let size = t.abs() + origin.length() + a.length().max(b.length()).max(c.length());
    let margin = smallest * cosine.abs() / size;
    let longest = (b - a).length().max((c - a).length()).max((c - b).length());
    let tilt = 4.0 * f64::from(f32::EPSILON) * size * longest / normal.length();
    let error = tilt * longest / cosine.abs();
    (margin > -DOUBT).then_some(Met {
        t,
        margin,
        error,
        cosine,
        tilt,
    })
}
