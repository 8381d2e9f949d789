//! Acceleration structures over several frames, and without memory.

use super::*;
use crate::{
    device::{REFUSED_FRAMES, REFUSES, ReflectionTracer},
    scene::{gpu_types::INSTANCE_RESTLESS, test_gpu},
};
use bevy::{
    asset::{AssetId, uuid::Uuid},
    math::Affine3A,
    mesh::Mesh,
    prelude::Sphere,
};
use tlas::SMALLEST_TLAS;

const MESH: AssetId<Mesh> = AssetId::Uuid {
    uuid: Uuid::from_u128(1),
};

/// A device with ray queries, and a mesh on it.
fn with_mesh() -> Option<(RenderDevice, RenderQueue, SceneMeshes)> {
    let (device, queue) = test_gpu::device()?;
    if device.limits().max_blas_primitive_count == 0 {
        let is_required = std::env::var_os("GLINT_REQUIRE_RAY_QUERY").is_some();
        assert!(!is_required, "the device has no ray queries");
        return None;
    }
    let mut meshes = SceneMeshes::new(&device, ReflectionTracer::RayQuery);
    meshes.load(MESH, Sphere::default().into(), &queue);
    Some((device, queue, meshes))
}

fn instance(slot: u32, flags: u32) -> RayQueryInstance {
    RayQueryInstance {
        slot,
        // Both faces, so that indices are written, too.
        blas: BlasKey::new(MESH, 0),
        posed: None,
        world_from_object: Affine3A::IDENTITY,
        flags,
    }
}

#[test]
fn what_the_device_has_no_memory_for_is_built_later() {
    let Some((device, queue, meshes)) = with_mesh() else {
        return;
    };
    let mut structures = AccelerationStructures::new(&device, &queue);
    // More than fit into the initial TLAS.
    let count = 4 * SMALLEST_TLAS;
    let objects = RayQueryObjects {
        count: count as usize,
        slots: count,
        changed: &[],
        get: &|slot| Some(instance(slot, 0)),
        may_split: true,
    };
    let build = |structures: &mut AccelerationStructures| structures.build(&objects, &meshes, &device, &queue);
    REFUSES.set(true);
    assert_eq!(build(&mut structures), 0);
    assert_eq!(
        (structures.refused.len(), structures.still.capacity),
        (1, SMALLEST_TLAS)
    );
    REFUSES.set(false);
    assert_eq!(build(&mut structures), 0, "it isn't asked for again at once");
    let due = (1..=REFUSED_FRAMES).find(|_| structures.is_retry_due());
    assert_eq!(due, Some(REFUSED_FRAMES));
    assert_eq!(build(&mut structures), 1);
    assert_eq!((structures.refused.len(), structures.still.capacity), (0, count));
    assert!((0..=REFUSED_FRAMES).all(|_| !structures.is_retry_due()));
}

/// Result of a frame.
#[derive(Debug, PartialEq)]
struct Frame {
    /// Everything was rebuilt.
    all: bool,
    split: bool,
    /// Objects in the moving TLAS.
    movers: Vec<u32>,
    /// Objects that rays must ignore in the static TLAS.
    left: Vec<u32>,
}

fn expect(all: bool, split: bool, movers: &[u32], left: &[u32]) -> Frame {
    Frame {
        all,
        split,
        movers: movers.to_vec(),
        left: left.to_vec(),
    }
}

/// Acceleration structures over several frames.
struct Frames {
    structures: AccelerationStructures,
    left: Vec<u32>,
    meshes: SceneMeshes,
    device: RenderDevice,
    queue: RenderQueue,
}

impl Frames {
    fn new() -> Option<Self> {
        let (device, queue, meshes) = with_mesh()?;
        Some(Self {
            structures: AccelerationStructures::new(&device, &queue),
            left: Vec::new(),
            meshes,
            device,
            queue,
        })
    }

    /// Renders a frame with this number of slots. Slots in `gone` are empty; objects in `restless` move, and those in
    /// `changed` have changed.
    fn next(&mut self, slots: u32, gone: &[u32], restless: &[u32], changed: &[u32], may_split: bool) -> Frame {
        let get = |slot| {
            let flags = if restless.contains(&slot) { INSTANCE_RESTLESS } else { 0 };
            (!gone.contains(&slot)).then(|| instance(slot, flags))
        };
        let objects = RayQueryObjects {
            count: slots as usize - gone.len(),
            slots,
            changed,
            get: &get,
            may_split,
        };
        let structures = &mut self.structures;
        structures.is_retry_due();
        structures.build(&objects, &self.meshes, &self.device, &self.queue);
        self.queue.submit(structures.take_commands());
        if let Some(left) = structures.take_left() {
            self.left = left.to_vec();
        }
        assert_eq!(structures.left_count(), self.left.len());
        Frame {
            all: structures.age == 0,
            split: structures.is_split(),
            movers: structures.movers.clone(),
            left: self.left.clone(),
        }
    }
}

const MANY: u32 = MANY_OBJECTS as u32;

#[test]
fn movements_build_what_moves_alone() {
    let Some(mut frames) = Frames::new() else { return };
    let few = frames.next(MANY, &[], &[3], &[3], true);
    assert_eq!(few, expect(true, false, &[], &[]), "few objects share one");
    let all = MANY + 10;
    let mut frame = |gone: &[u32], restless: &[u32], changed: &[u32]| frames.next(all, gone, restless, changed, true);
    assert_eq!(frame(&[], &[3], &[3]), expect(true, true, &[3], &[]));
    assert_eq!(frame(&[], &[3], &[3]), expect(false, true, &[3], &[]));
    let began = frame(&[], &[3, 7], &[3, 7]);
    assert_eq!(began, expect(false, true, &[3, 7], &[7]), "7 stood still");
    let went = frame(&[3], &[3, 7], &[3]);
    assert_eq!(went, expect(false, true, &[7], &[7]), "3 is gone");
    let came = frames.next(all + 1, &[3], &[7], &[all], true);
    assert_eq!(came, expect(false, true, &[7, all], &[7]), "one came");
    let mut frame = |gone: &[u32], changed: &[u32]| frames.next(all + 1, gone, &[7], changed, true);
    let went = frame(&[3, 9], &[9]);
    assert_eq!(
        went,
        expect(false, true, &[7, all], &[7, 9]),
        "9 stood still and is gone"
    );
    let reused = frame(&[3], &[9]);
    assert_eq!(
        reused,
        expect(false, true, &[7, 9, all], &[7, 9]),
        "another one took its slot"
    );
    let joined = frames.next(all + 1, &[], &[7], &[3, 9], false);
    assert_eq!(joined, expect(true, false, &[], &[]), "no second one is allowed");
    assert_eq!(frames.next(all, &[], &[], &[], true), expect(true, true, &[], &[]));
}

#[test]
fn all_is_built_once_many_left_or_stay() {
    let Some(mut frames) = Frames::new() else { return };
    let all = MANY + MOST_LEFT as u32 + 10;
    assert_eq!(frames.next(all, &[], &[], &[0], true), expect(true, true, &[], &[]));
    // Enough for rays to hit them too often.
    let most: Vec<_> = (0..MOST_LEFT as u32).collect();
    assert_eq!(
        frames.next(all, &most, &[], &most, true),
        expect(false, true, &[], &most)
    );
    assert_eq!(frames.next(all, &most, &[], &[700], true), expect(true, true, &[], &[]));
    // New objects that stop moving.
    let idle = MOST_IDLE as u32 + 1;
    let new: Vec<_> = (all..all + idle).collect();
    let mut frame = |restless: &[u32], changed: &[u32]| frames.next(all + idle, &most, restless, changed, true);
    assert_eq!(frame(&[], &new), expect(false, true, &new, &[]));
    let due = (2..).find(|_| frame(&[5], &[all]).all);
    assert_eq!(due, Some(IDLE_FRAMES));
    assert_eq!(frame(&[700], &[700]), expect(false, true, &[700], &[700]));
}
