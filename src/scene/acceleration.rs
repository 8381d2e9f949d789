//! The driver's acceleration structures, for the ray-query tracer.

mod blas;

use super::{
    gpu_types::{INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW},
    meshes::SceneMeshes,
};
use crate::device::try_allocate;
use bevy::{
    log::warn_once,
    math::Affine3A,
    platform::collections::{HashMap, HashSet},
    render::{
        render_resource::{
            AccelerationStructureFlags, AccelerationStructureUpdateMode, Blas, BlasBuildEntry,
            CommandEncoderDescriptor, CreateTlasDescriptor, Tlas, TlasInstance,
        },
        renderer::{RenderDevice, RenderQueue},
    },
};
use blas::{PendingBlas, Refusal};

pub use blas::BlasKey;

/// Cull mask bit of everything that reflection rays see.
pub const MASK_REFLECTED: u8 = 1;
/// Cull mask bit of what blocks shadow rays.
pub const MASK_CASTS_SHADOW: u8 = 2;
/// Cull mask bit of what may let rays pass.
pub const MASK_HAS_HOLES: u8 = 4;

/// Cull mask bits of the groups of an object's render layers, as they stand in the highest byte of its flags.
pub const MASK_GROUPS: u8 = 0xf8;

/// Triangles that go into one build command, to bound the driver's scratch memory.
const TRIANGLES_PER_BUILD: u32 = 4_000_000;
/// Instances that a TLAS has room for at least, where the device allows as many.
const SMALLEST_TLAS: u32 = 64;
/// Rays tell instances apart by 24 bits.
const MOST_INSTANCES: u32 = 1 << 24;
/// Frames until the device is asked again for memory that it refused.
const REFUSED_FRAMES: u32 = 300;

/// Vertices of an object that has its own, in a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosedVertices {
    /// In the geometry buffer, counted in vertices.
    pub first_vertex: u32,
    /// Changes with each pose, and is unlike that of any other object.
    pub revision: u64,
}

/// One instance of the TLAS to build.
pub struct RayQueryInstance {
    /// Index in the instance buffer.
    pub slot: u32,
    /// Its BLAS, or the variant that is made of its own vertices.
    pub blas: BlasKey,
    /// Its own vertices, if it has any.
    pub posed: Option<PosedVertices>,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// `INSTANCE_` flags.
    pub flags: u32,
}

/// BLASes of all meshes in use and the TLAS over them.
pub struct AccelerationStructures {
    blas: HashMap<BlasKey, (u64, Blas)>,
    /// Structures of objects with a pose, by slot.
    posed: HashMap<u32, PosedBlas>,
    /// Variants that can't be built, with the mesh's version.
    refused: HashMap<BlasKey, u64>,
    /// Frames until what lacked memory is tried again; 0 where nothing did.
    retry_in: u32,
    tlas: Tlas,
    capacity: u32,
    /// Changes when [`Self::tlas`] becomes another object.
    pub generation: u64,
}

impl AccelerationStructures {
    /// An empty TLAS.
    pub fn new(device: &RenderDevice, queue: &RenderQueue) -> Self {
        let capacity = tlas_capacity(0, instance_limit(device));
        let tlas = create_tlas(device, capacity);
        // A structure that was never built may not be bound.
        submit_builds("glint_tlas_build", &[], Some(&tlas), device, queue);
        Self {
            blas: HashMap::default(),
            posed: HashMap::default(),
            refused: HashMap::default(),
            retry_in: 0,
            tlas,
            capacity,
            generation: 0,
        }
    }

    /// The TLAS for binding.
    pub fn tlas(&self) -> &Tlas {
        &self.tlas
    }

    /// Counts a frame. Returns true once what lacked memory should be tried again by another [`Self::build`].
    pub fn is_retry_due(&mut self) -> bool {
        let waited = self.retry_in > 0;
        self.retry_in = self.retry_in.saturating_sub(1);
        let is_due = waited && self.retry_in == 0;
        if is_due {
            self.refused.clear();
        }
        is_due
    }

    /// Something lacked memory. Later failures don't put off what waits already.
    fn try_again_later(&mut self) {
        if self.retry_in == 0 {
            self.retry_in = REFUSED_FRAMES;
        }
    }

    /// Builds missing BLASes and the TLAS. Returns how many BLASes were built. What the device has no memory for is left out for a while.
    pub fn build(
        &mut self,
        instances: &[RayQueryInstance],
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let built =
            self.build_missing(instances, meshes, device, queue) + self.build_posed(instances, meshes, device, queue);
        let limit = instance_limit(device);
        // Slots are given out from the lowest on, so that few are ever left out for their number.
        let tellable = instances.iter().filter(|instance| instance.slot < MOST_INSTANCES);
        let used: Vec<_> = tellable.take(limit as usize).collect();
        if used.len() < instances.len() {
            warn_once!(
                "{} objects can be reflected, but the device's limit is {limit}: the others are missing; use fewer \
                 objects, or keep some out with `NotReflected`",
                instances.len()
            );
        }
        let count = used.len() as u32;
        let mut next = None;
        if count > self.capacity || (count < self.capacity / 4 && self.capacity > SMALLEST_TLAS) {
            let capacity = tlas_capacity(count, limit);
            next = try_allocate(device, || create_tlas(device, capacity)).map(|tlas| (tlas, capacity));
            if next.is_none() {
                self.try_again_later();
                warn_once!(
                    "only {} of {count} objects can be reflected, since the device has no memory for more",
                    self.capacity
                );
            }
        }
        let entries = used.into_iter().filter_map(|instance| {
            let blas = match instance.posed {
                Some(_) => &self.posed.get(&instance.slot)?.blas.blas,
                None => &self.blas.get(&instance.blas)?.1,
            };
            let mut mask = MASK_REFLECTED | (instance.flags >> 24) as u8 & MASK_GROUPS;
            if instance.flags & INSTANCE_CASTS_SHADOW != 0 {
                mask |= MASK_CASTS_SHADOW;
            }
            if instance.flags & INSTANCE_ALPHA_MASKED != 0 {
                mask |= MASK_HAS_HOLES;
            }
            Some(TlasInstance::new(
                blas,
                rows(&instance.world_from_object),
                instance.slot,
                mask,
            ))
        });
        let entries: Vec<_> = entries.collect();
        let (tlas, capacity) = match &mut next {
            Some((tlas, capacity)) => (tlas, *capacity),
            None => (&mut self.tlas, self.capacity),
        };
        if let Some(places) = tlas.get_mut_slice(0..capacity as usize) {
            let mut entries = entries.into_iter();
            for place in places {
                *place = entries.next();
            }
        }
        // A structure that was never built may not be bound.
        if !submit_builds("glint_tlas_build", &[], Some(tlas), device, queue) {
            self.try_again_later();
        } else if let Some(next) = next {
            (self.tlas, self.capacity) = next;
            self.generation += 1;
        }
        built
    }

    fn build_missing(
        &mut self,
        instances: &[RayQueryInstance],
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let whole = instances.iter().filter(|instance| instance.posed.is_none());
        let used: HashSet<BlasKey> = whole.map(|instance| instance.blas).collect();
        self.blas.retain(|key, (version, _)| {
            meshes.get(key.mesh).is_some_and(|mesh| mesh.version == *version) && used.contains(key)
        });
        self.refused.retain(|key, version| {
            meshes.get(key.mesh).is_some_and(|mesh| mesh.version == *version) && used.contains(key)
        });
        let is_missing = |key: &BlasKey| !self.blas.contains_key(key) && !self.refused.contains_key(key);
        let mut missing: Vec<_> = used.into_iter().filter(is_missing).collect();
        let mut built = 0;
        while !missing.is_empty() {
            let mut triangles = 0;
            let mut batch = Vec::new();
            while triangles < TRIANGLES_PER_BUILD
                && let Some(key) = missing.pop()
            {
                let Some(mesh) = meshes.get(key.mesh) else {
                    continue;
                };
                triangles += mesh.triangle_count;
                let flags = AccelerationStructureFlags::PREFER_FAST_TRACE;
                match PendingBlas::new(key, mesh, flags, device, queue) {
                    Ok(pending) => batch.push(pending),
                    Err(refusal) => {
                        self.refused.insert(key, mesh.version);
                        if refusal == Refusal::NoMemory {
                            self.try_again_later();
                        }
                    }
                }
            }
            let entries: Vec<_> = batch.iter().map(|pending| pending.entry(meshes)).collect();
            if entries.is_empty() {
                continue;
            }
            let is_built = submit_builds("glint_blas_build", &entries, None, device, queue);
            drop(entries);
            if is_built {
                built += batch.len() as u64;
                let ready = batch.into_iter();
                self.blas
                    .extend(ready.map(|pending| (pending.key, (pending.version, pending.blas))));
            } else {
                self.refused
                    .extend(batch.iter().map(|pending| (pending.key, pending.version)));
                self.try_again_later();
            }
        }
        built
    }

    /// Builds the BLASes of objects whose pose has changed, and drops those of objects that are gone. wgpu has no updates, so they are
    /// built from the start, as fast as the driver can.
    fn build_posed(
        &mut self,
        instances: &[RayQueryInstance],
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let posed = || {
            instances
                .iter()
                .filter_map(|instance| Some((instance, instance.posed?)))
        };
        if self.posed.is_empty() && posed().next().is_none() {
            return 0;
        }
        let present: HashMap<u32, BlasKey> = posed().map(|(instance, _)| (instance.slot, instance.blas)).collect();
        self.posed.retain(|slot, posed| {
            present.get(slot) == Some(&posed.blas.key)
                && meshes
                    .get(posed.blas.key.mesh)
                    .is_some_and(|mesh| mesh.version == posed.blas.version)
        });
        let mut stale = Vec::new();
        let mut lacking = false;
        for (instance, vertices) in posed() {
            if !self.posed.contains_key(&instance.slot)
                && let Some(mesh) = meshes.get(instance.blas.mesh)
            {
                let flags = AccelerationStructureFlags::PREFER_FAST_BUILD;
                match PendingBlas::new(instance.blas, mesh, flags, device, queue) {
                    Ok(blas) => {
                        self.posed.insert(instance.slot, PosedBlas { blas, revision: 0 });
                    }
                    Err(refusal) => lacking |= refusal == Refusal::NoMemory,
                }
            }
            if let Some(posed) = self.posed.get_mut(&instance.slot)
                && posed.revision != vertices.revision
            {
                posed.revision = vertices.revision;
                posed.blas.first_vertex = vertices.first_vertex;
                stale.push(instance.slot);
            }
        }
        // In parts, since the driver's scratch memory grows with what is built at a time.
        let mut rest = stale.as_slice();
        while !rest.is_empty() {
            let mut triangles = 0;
            let fits = |slot: &&u32| {
                let fits = triangles < TRIANGLES_PER_BUILD;
                let size = self
                    .posed
                    .get(*slot)
                    .map_or(0, |posed| posed.blas.size.index_count.unwrap_or(0) / 3);
                triangles += size;
                fits
            };
            let (batch, others) = rest.split_at(rest.iter().take_while(fits).count().max(1));
            rest = others;
            let posed = batch.iter().filter_map(|slot| self.posed.get(slot));
            let entries: Vec<_> = posed.map(|posed| posed.blas.entry(meshes)).collect();
            let is_built = submit_builds("glint_posed_blas_build", &entries, None, device, queue);
            drop(entries);
            if !is_built {
                // Those that keep their pose from now on have no other build to wait for.
                lacking = true;
                self.posed.retain(|slot, _| !batch.contains(slot));
            }
        }
        if lacking {
            self.try_again_later();
        }
        stale.len() as u64
    }
}

/// Has the driver build these structures. Returns false, and leaves all as it was, where it has no memory to do that.
fn submit_builds<'a>(
    label: &'static str,
    blas: &'a [BlasBuildEntry<'a>],
    tlas: Option<&'a Tlas>,
    device: &RenderDevice,
    queue: &RenderQueue,
) -> bool {
    let commands = try_allocate(device, || {
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor { label: Some(label) });
        encoder.build_acceleration_structures(blas, tlas);
        encoder.finish()
    });
    if commands.is_none() {
        warn_once!(
            "objects are missing from reflections, since the device has no memory to build acceleration structures; use \
             fewer or smaller meshes, or keep some out with `NotReflected`"
        );
    }
    commands.map(|commands| queue.submit([commands])).is_some()
}

/// The BLAS of an object with a pose.
struct PosedBlas {
    blas: PendingBlas,
    /// As of the last build.
    revision: u64,
}

/// Instances that a TLAS of this device may hold.
fn instance_limit(device: &RenderDevice) -> u32 {
    device.limits().max_tlas_instance_count.min(MOST_INSTANCES)
}

/// Instances to make room for, where `count` are there.
fn tlas_capacity(count: u32, limit: u32) -> u32 {
    count.next_power_of_two().max(SMALLEST_TLAS).min(limit)
}

fn create_tlas(device: &RenderDevice, capacity: u32) -> Tlas {
    device.wgpu_device().create_tlas(&CreateTlasDescriptor {
        label: Some("glint_tlas"),
        max_instances: capacity,
        flags: AccelerationStructureFlags::PREFER_FAST_TRACE,
        update_mode: AccelerationStructureUpdateMode::Build,
    })
}

/// The row-major 3x4 matrix that wgpu and our shaders take.
pub fn rows(affine: &Affine3A) -> [f32; 12] {
    let m = affine.matrix3;
    let t = affine.translation;
    [
        m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x, //
        m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y, //
        m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::{REFUSES, ReflectionTracer},
        scene::test_gpu,
    };
    use bevy::{
        asset::{AssetId, uuid::Uuid},
        mesh::Mesh,
        prelude::Sphere,
    };

    const MESH: AssetId<Mesh> = AssetId::Uuid {
        uuid: Uuid::from_u128(1),
    };

    fn instances(count: u32) -> Vec<RayQueryInstance> {
        let instance = |slot| RayQueryInstance {
            slot,
            // Both faces, so that indices are written, too.
            blas: BlasKey::new(MESH, 0),
            posed: None,
            world_from_object: Affine3A::IDENTITY,
            flags: 0,
        };
        (0..count).map(instance).collect()
    }

    #[test]
    fn what_the_device_has_no_memory_for_is_built_later() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        if device.limits().max_blas_primitive_count == 0 {
            let is_required = std::env::var_os("GLINT_REQUIRE_RAY_QUERY").is_some();
            assert!(!is_required, "the device has no ray queries");
            return;
        }
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::RayQuery);
        meshes.load(MESH, Sphere::default().into(), &queue);
        let mut structures = AccelerationStructures::new(&device, &queue);
        // More than the first structure has room for.
        let instances = instances(4 * SMALLEST_TLAS);
        let build = |structures: &mut AccelerationStructures| structures.build(&instances, &meshes, &device, &queue);
        REFUSES.set(true);
        assert_eq!(build(&mut structures), 0);
        assert_eq!((structures.refused.len(), structures.capacity), (1, SMALLEST_TLAS));
        REFUSES.set(false);
        assert_eq!(build(&mut structures), 0, "it isn't asked for again at once");
        let due = (1..=REFUSED_FRAMES).find(|_| structures.is_retry_due());
        assert_eq!(due, Some(REFUSED_FRAMES));
        assert_eq!(build(&mut structures), 1);
        assert_eq!((structures.refused.len(), structures.capacity), (0, 4 * SMALLEST_TLAS));
        assert!(!structures.is_retry_due() && structures.retry_in == 0);
    }

    #[test]
    fn no_more_room_is_asked_for_than_the_device_has() {
        assert_eq!(tlas_capacity(0, MOST_INSTANCES), SMALLEST_TLAS);
        assert_eq!(tlas_capacity(65, MOST_INSTANCES), 128);
        assert_eq!(tlas_capacity(0, 10), 10);
        assert_eq!(tlas_capacity(10, 10), 10);
        assert_eq!(tlas_capacity(100, 100), 100);
        assert_eq!(tlas_capacity(MOST_INSTANCES, MOST_INSTANCES), MOST_INSTANCES);
    }
}
