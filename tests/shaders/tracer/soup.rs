//! Triangle soups, instances and rays from a seed, packed as the GPU sees them, with a slow and exact oracle.

mod oracle;
mod shapes;

use bevy::math::{Affine3A, DVec3, Vec3};
use bevy_glint::internals::bvh::{
    Blas, BvhQuality, Item, MaskSource, MergeSource, Micromap, OPAQUE, SceneView, TRANSPARENT, Tlas, TlasInstance,
    TraceRay, UNKNOWN, build_blas, build_merged, build_tlas, masks as masks_of, owner,
};
use bevy_glint::internals::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED,
};
pub use oracle::Oracle;
use oracle::{Candidate, LocalRay, intersect, local_ray};
pub use shapes::{Mesh, Random, SOUPS, Soup, closed_surface, mesh, placement, two_meshes};
use std::collections::BTreeMap;

/// Replaces the alpha test of materials: every other triangle is cut out.
pub fn alpha_test(_instance: u32, primitive: u32, _barycentrics: [f32; 2]) -> bool {
    primitive.is_multiple_of(2)
}

/// The micromap of a masked triangle: the alpha test's answer for some triangles, unknown for others.
fn micromap(primitive: u32) -> Micromap {
    const STATES: [u32; 6] = [UNKNOWN, UNKNOWN, OPAQUE, TRANSPARENT, UNKNOWN, TRANSPARENT];
    [STATES[primitive as usize % 6] * 0x5555_5555; 4]
}

/// A ray of any length; along the x axis if the direction has no length.
pub fn ray(origin: Vec3, direction: Vec3) -> TraceRay {
    TraceRay {
        origin,
        direction: direction.try_normalize().unwrap_or(Vec3::X),
        t_min: 0.0,
        t_max: f32::MAX,
    }
}

/// How an instance is packed.
#[derive(Clone, Copy, Debug)]
pub struct Packing {
    /// `INSTANCE_` flags, except for [`INSTANCE_MIRRORED`], which follows from the matrix.
    pub flags: u32,
    /// The merged tree that it is part of. Masked instances get one of their own, with the same number.
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
    pub bvh: Vec<Item>,
    pub tlas: Tlas,
    pub stack_size: u32,
    tlas_root: u32,
    /// Index of each instance's masks in [`Self::bvh`].
    pub masks: Vec<u32>,
    /// For instances that are part of a merged tree, the vector by which it was shifted since it was built.
    shifts: Vec<Option<Vec3>>,
    /// The triangles that the oracle searches.
    triangles: Vec<Target>,
}

/// A triangle without rounding to `f32`.
pub struct Target {
    pub instance: u32,
    primitive: u32,
    pub world: [DVec3; 3],
    /// In the tracer's space: the world as of the build for merged instances, otherwise the object.
    local: [DVec3; 3],
}

/// The buffer of trees and masks while it is put together.
#[derive(Default)]
struct Buffer(Vec<Item>);

impl Buffer {
    /// Adds items and returns the index of the first one.
    fn add(&mut self, items: &[Item]) -> u32 {
        let base = self.0.len() as u32;
        self.0.extend_from_slice(items);
        base
    }

    /// Adds the masks of a mesh and returns their index.
    fn add_masks(&mut self, mesh: &Mesh, micromaps: &[Micromap]) -> u32 {
        let source = MaskSource {
            indices: &mesh.indices,
            ..MaskSource::default()
        };
        let mut masks = masks_of(&source, None);
        for (mask, map) in masks.iter_mut().zip(micromaps) {
            mask[2] = *map;
        }
        self.add(&masks)
    }

    /// Adds a tree, if there is one, and returns it with its index.
    fn add_tree(&mut self, blas: Option<Blas>) -> Option<(u32, Blas)> {
        blas.map(|blas| (self.add(&blas.items), blas))
    }
}

/// The vector by which a merged tree was shifted since it was built: none for the first and every second one after it.
fn shift_of(tree: u32) -> Vec3 {
    if tree.is_multiple_of(2) {
        Vec3::ZERO
    } else {
        Vec3::new(2.0, -0.5, 1.0)
    }
}

/// A tree in the TLAS. `instance` is 0 for merged trees.
fn record(base: u32, blas: &Blas, world_from_object: Affine3A, instance: u32) -> TlasInstance<'_> {
    TlasInstance {
        world_from_object,
        bounds: blas.bounds,
        instance,
        first_node: base,
        first_triangle: base + blas.node_count,
        top: if instance == 0 { &[] } else { &blas.top },
        groups: blas.groups,
    }
}

/// All triangles, for the oracle.
fn targets(meshes: &[Mesh], instances: &[(usize, Affine3A)], shifts: &[Option<Vec3>]) -> Vec<Target> {
    let mut triangles = Vec::new();
    for (instance, (mesh, matrix)) in instances.iter().enumerate() {
        let (linear, translation) = (matrix.matrix3.as_dmat3(), matrix.translation.as_dvec3());
        for primitive in 0..meshes[*mesh].triangle_count() {
            let object = meshes[*mesh].corners(primitive).map(|c| Vec3::from(c).as_dvec3());
            let world = object.map(|c| linear * c + translation);
            triangles.push(Target {
                instance: instance as u32,
                primitive: primitive as u32,
                world,
                local: match shifts[instance] {
                    Some(by) => world.map(|corner| corner - by.as_dvec3()),
                    None => object,
                },
            });
        }
    }
    triangles
}

impl Packed {
    /// Packs meshes without merging.
    pub fn new(meshes: Vec<Mesh>, instances: Vec<(usize, Affine3A)>, max_entries: usize) -> Self {
        Self::with(meshes, instances, max_entries, |_| Packing::SINGLE)
    }

    /// Packs one mesh in one place.
    pub fn single(mesh: Mesh, place: Affine3A, packing: Packing) -> Self {
        Self::with(vec![mesh], vec![(0, place)], 0, |_| packing)
    }

    /// `packing` returns the packing of each instance.
    pub fn with(
        meshes: Vec<Mesh>,
        instances: Vec<(usize, Affine3A)>,
        max_entries: usize,
        packing: impl Fn(usize) -> Packing,
    ) -> Self {
        let largest = meshes.iter().map(|mesh| mesh.indices.len() / 3).max();
        let micromaps: Vec<Micromap> = (0..largest.unwrap_or(0) as u32).map(micromap).collect();
        let mut bvh = Buffer::default();
        let masks: Vec<u32> = meshes.iter().map(|mesh| bvh.add_masks(mesh, &micromaps)).collect();
        let build = |mesh: &Mesh| build_blas(&mesh.positions, &mesh.indices, BvhQuality::Medium);
        let trees: Vec<Option<(u32, Blas)>> = meshes.iter().map(|mesh| bvh.add_tree(build(mesh))).collect();
        let packings: Vec<Packing> = (0..instances.len()).map(packing).collect();
        let mut flags = Vec::new();
        let mut sources: BTreeMap<u32, Vec<MergeSource>> = BTreeMap::new();
        for (i, ((mesh, matrix), packing)) in instances.iter().zip(&packings).enumerate() {
            let mirrored = matrix.matrix3.determinant() < 0.0;
            flags.push(packing.flags | if mirrored { INSTANCE_MIRRORED } else { 0 });
            if let Some(tree) = packing.tree {
                sources.entry(tree).or_default().push(MergeSource {
                    positions: &meshes[*mesh].positions,
                    indices: &meshes[*mesh].indices,
                    world_from_object: Affine3A::from_translation(-shift_of(tree)) * *matrix,
                    instance: i as u32,
                    flags: flags[i],
                    masks: masks[*mesh],
                    // Trees are right without them, too.
                    micromaps: if i % 3 == 0 { &[] } else { &micromaps },
                });
            }
        }
        let merged_trees: Vec<(u32, (u32, Blas))> = sources
            .into_iter()
            .filter_map(|(tree, sources)| Some((tree, bvh.add_tree(build_merged(&sources, BvhQuality::High))?)))
            .collect();

        let singles = instances.iter().zip(&packings).enumerate();
        let singles =
            singles
                .filter(|(_, (_, packing))| packing.tree.is_none())
                .filter_map(|(i, ((mesh, matrix), _))| {
                    let (base, blas) = trees[*mesh].as_ref()?;
                    Some(record(*base, blas, *matrix, owner(i as u32, flags[i])))
                });
        let in_world = merged_trees
            .iter()
            .map(|(tree, (base, blas))| record(*base, blas, Affine3A::from_translation(shift_of(*tree)), 0));
        let records: Vec<TlasInstance> = singles.chain(in_world).collect();
        let tlas = build_tlas(&records, max_entries);
        let tlas_root = bvh.add(&tlas.items);
        let shifts: Vec<_> = packings.iter().map(|packing| packing.tree.map(shift_of)).collect();
        Self {
            triangles: targets(&meshes, &instances, &shifts),
            masks: instances.iter().map(|(mesh, _)| masks[*mesh]).collect(),
            stack_size: tlas.stack.max(1),
            bvh: bvh.0,
            meshes,
            instances,
            flags,
            tlas,
            tlas_root,
            shifts,
        }
    }

    pub fn view(&self) -> SceneView<'_> {
        SceneView {
            bvh: &self.bvh,
            tlas_node_count: self.tlas.traversal_node_count(),
            tlas_root: self.tlas_root,
            alpha_test: Some(alpha_test),
            order: None,
        }
    }

    pub fn any_triangle(&self, random: &mut Random) -> &Target {
        &self.triangles[random.below(self.triangles.len())]
    }

    /// The corners of a triangle in world space.
    pub fn corners(&self, instance: u32, primitive: u32) -> [DVec3; 3] {
        let mut triangles = self.triangles.iter();
        let found = triangles.find(|target| (target.instance, target.primitive) == (instance, primitive));
        found.expect("the triangle exists").world
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
                    let [a, b, c] = self.any_triangle(random).world;
                    let mut u = f64::from(random.signed() * 0.5 + 0.5);
                    let v = (1.0 - u) * f64::from(random.signed() * 0.5 + 0.5);
                    if i % 4 == 2 {
                        u = 0.0;
                    }
                    (a + (b - a) * u + (c - a) * v - origin.as_dvec3()).as_vec3()
                };
                ray(origin, direction)
            })
            .collect()
    }

    /// Rays from within a surface at its corners and edges, where they could slip out between two triangles.
    pub fn rays_from_within(&self, count: usize, random: &mut Random) -> Vec<TraceRay> {
        (0..count)
            .map(|i| {
                let (mesh, matrix) = &self.instances[i % self.instances.len()];
                let mesh = &self.meshes[*mesh];
                let origin = matrix.transform_point3(random.vector() * 0.3);
                let [a, b, _] = mesh.corners(random.below(mesh.triangle_count())).map(Vec3::from);
                let along = if i % 2 == 0 { 0.0 } else { random.signed() * 0.5 + 0.5 };
                ray(origin, matrix.transform_point3(a.lerp(b, along)) - origin)
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

    /// Searches the triangles that block light: a culled face towards the light doesn't. With both bits, both faces do.
    pub fn shadow_oracle(&self, ray: &TraceRay) -> Oracle {
        self.search(ray, |flags, front| {
            let culled = if front { INSTANCE_CULL_BACK } else { INSTANCE_CULL_FRONT };
            let both = INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT;
            flags & INSTANCE_CASTS_SHADOW != 0 && (flags & culled == 0 || flags & both == both)
        })
    }

    /// `counts` judges the flags of an instance and the face that the ray sees: true = the front in world space.
    fn search(&self, ray: &TraceRay, counts: impl Fn(u32, bool) -> bool) -> Oracle {
        let rays: Vec<Option<LocalRay>> = self
            .instances
            .iter()
            .zip(&self.shifts)
            .map(|((_, matrix), shift)| local_ray(ray, &shift.map_or(*matrix, Affine3A::from_translation)))
            .collect();
        let mut result = Oracle {
            t: f64::INFINITY,
            candidates: Vec::new(),
        };
        for target in &self.triangles {
            let Target {
                instance,
                primitive,
                local,
                ..
            } = target;
            let flags = self.flags[*instance as usize];
            if flags & INSTANCE_ALPHA_MASKED != 0 && !alpha_test(*instance, *primitive, [0.0; 2]) {
                continue;
            }
            if let Some(local_ray) = &rays[*instance as usize]
                && let Some(found) = intersect(local, local_ray)
                && found.t > -0.01
            {
                let (front, back) = (counts(flags, true), counts(flags, false));
                // In the space of a mirrored object the winding is turned.
                let turned = flags & INSTANCE_MIRRORED != 0 && self.shifts[*instance as usize].is_none();
                let seen = if (found.cosine < 0.0) != turned { front } else { back };
                // Single precision can return either face of a triangle seen on edge.
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
