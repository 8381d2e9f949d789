//! Uploads built meshes.

use super::{BuiltMesh, MeshUpload, SceneBlas, SceneMesh, SceneMeshes};
use crate::{
    scene::{
        arena::{Arena, ArenaSlice},
        bvh::ITEM_WORDS,
        tree_builds,
    },
    status::ReflectionStatus,
};
use bevy::{asset::AssetId, log::warn, mesh::Mesh, render::renderer::RenderQueue};

impl SceneMeshes {
    /// Builds and uploads a mesh at once.
    #[cfg(test)]
    pub(in crate::scene) fn load(&mut self, id: AssetId<Mesh>, mesh: Mesh, queue: &RenderQueue) {
        self.start(id, super::MeshSource::Copy(Box::new(mesh)), 1);
        while self.get(id).is_none() {
            self.upload(u64::MAX, queue);
            std::thread::yield_now();
        }
    }

    /// Uploads up to this number of bytes of finished meshes. Returns the number of finished builds, and their total time.
    fn upload(&mut self, mut bytes: u64, queue: &RenderQueue) -> (u64, f32) {
        self.geometry.advance(queue);
        self.bvh.advance(queue);
        let (mut builds, mut milliseconds) = (0, 0.0);
        let mut finished = self.finished();
        loop {
            // A changed mesh is uploaded before new ones.
            let is_next = match self.uploading.last() {
                None => true,
                Some(upload) => !self.is_edited(upload.id) && finished.last().is_some_and(|next| self.is_edited(*next)),
            };
            if let Some(id) = finished.pop_if(|_| is_next) {
                if let Some(time) = self.take_finished(id) {
                    builds += 1;
                    milliseconds += time;
                }
                continue;
            }
            let uploads = self.uploading.len();
            bytes = self.carry_on(bytes, queue);
            if bytes == 0 || uploads == 0 || self.uploading.len() == uploads {
                break;
            }
        }
        (builds, milliseconds)
    }

    /// Takes over a finished build. Returns its duration if it succeeded.
    fn take_finished(&mut self, id: AssetId<Mesh>) -> Option<f32> {
        let mut build = self.pending.remove(&id)?;
        self.copied_bytes -= build.copied_bytes;
        match build.task.take() {
            Some(Ok(built)) => {
                let milliseconds = built.milliseconds;
                if built.packed.triangle_count == 0 {
                    self.remove_for_next(id);
                    self.failed.insert(id);
                } else if !self.begin_upload(id, built) {
                    let used = self.used_bytes();
                    self.without_room.wait(id, used);
                    if !core::mem::replace(&mut self.warned_full, true) {
                        warn!(
                            "a mesh doesn't fit into the memory that one buffer may take on this device, so it is missing \
                             from reflections; use fewer or smaller meshes, or keep some out with `NotReflected`"
                        );
                    }
                }
                Some(milliseconds)
            }
            Some(Err(error)) => {
                self.decline(id, &error);
                None
            }
            None => {
                self.remove_for_next(id);
                self.failed.insert(id);
                None
            }
        }
    }

    /// Allocates space for a built mesh, while keeping its last version if possible.
    fn begin_upload(&mut self, id: AssetId<Mesh>, built: BuiltMesh) -> bool {
        let words = built.packed.words.len() as u32;
        let items = built.blas.as_ref().map(|blas| blas.items.len());
        let room = self.allocate_mesh(words, items).or_else(|| {
            if !self.may_fit_in_place_of(id, words, items) {
                return None;
            }
            self.remove_for_next(id);
            self.allocate_mesh(words, items)
        });
        let Some((geometry, bvh)) = room else { return false };
        self.uploading.push(MeshUpload {
            id,
            built,
            geometry,
            bvh,
            done: 0,
        });
        true
    }

    /// Removes a mesh, but keeps the note if it changed since its build began, so that another build follows.
    pub(super) fn remove_for_next(&mut self, id: AssetId<Mesh>) {
        let is_stale = self.stale.contains(&id);
        self.remove(id);
        if is_stale {
            self.stale.insert(id);
        }
    }

    /// Returns whether a mesh could fit in terms of bytes once its last version is gone. If free space is fragmented, it might still not
    /// fit. The last version is better than none.
    fn may_fit_in_place_of(&self, id: AssetId<Mesh>, words: u32, items: Option<usize>) -> bool {
        let Some(last) = self.ready.get(&id) else {
            return false;
        };
        let fits = |arena: &Arena, last: Option<&ArenaSlice>, words: u64| {
            let freed = last.map_or(0, |slice| 4 * u64::from(slice.words()));
            !arena.lacks_memory() && 4 * words <= arena.max_bytes() - arena.used_bytes() + freed
        };
        let tree_words = items.map_or(0, |items| items as u64 * u64::from(ITEM_WORDS));
        fits(&self.geometry, Some(&last.geometry), words.into())
            && fits(&self.bvh, last.bvh.as_ref().map(|bvh| &bvh.slice), tree_words)
    }

    fn allocate_mesh(&mut self, words: u32, items: Option<usize>) -> Option<(ArenaSlice, Option<ArenaSlice>)> {
        let geometry = self.geometry.allocate(words)?;
        let Some(items) = items else {
            return Some((geometry, None));
        };
        match self.allocate_tree(items) {
            Some(slice) => Some((geometry, Some(slice))),
            None => {
                self.geometry.free(geometry);
                None
            }
        }
    }

    /// Uploads up to this number of bytes of the last mesh. When it is complete, rays can hit it. Returns the bytes that are left.
    fn carry_on(&mut self, bytes: u64, queue: &RenderQueue) -> u64 {
        let is_reached = |upload: &mut MeshUpload| {
            self.geometry.is_in_reach(&upload.geometry)
                && upload.bvh.as_ref().is_none_or(|slice| self.bvh.is_in_reach(slice))
        };
        let Some(mut upload) = self.uploading.pop_if(is_reached) else {
            return bytes;
        };
        let geometry = upload.built.packed.words.as_slice();
        let blas = upload.built.blas.as_ref();
        let tree = blas.map_or(&[][..], |blas| blas.items.as_flattened().as_flattened());
        let all = geometry.len() + tree.len();
        let end = all.min(upload.done + (bytes / 4) as usize);
        let of_geometry = upload.done.min(geometry.len())..end.min(geometry.len());
        let first = of_geometry.start;
        self.geometry
            .write_from(queue, &upload.geometry, first, &geometry[of_geometry]);
        if let Some(slice) = &upload.bvh {
            let of_tree = upload.done.saturating_sub(geometry.len())..end.saturating_sub(geometry.len());
            self.bvh.write_from(queue, slice, of_tree.start, &tree[of_tree]);
        }
        let left = bytes - 4 * (end - upload.done) as u64;
        upload.done = end;
        if end < all {
            self.uploading.push(upload);
        } else {
            self.insert(upload);
        }
        left
    }

    /// Makes a completely uploaded mesh available to rays.
    fn insert(&mut self, upload: MeshUpload) {
        let MeshUpload {
            id,
            built,
            geometry,
            bvh,
            ..
        } = upload;
        let packed = built.packed;
        self.remove_for_next(id);
        let bvh = bvh.zip(built.blas).map(|(slice, mut blas)| {
            let levels = built.deformation.as_ref().map(|_| blas.levels());
            tree_builds::discard(core::mem::take(&mut blas.items));
            let first_node = slice.base() / ITEM_WORDS;
            SceneBlas {
                slice,
                first_node,
                first_triangle: first_node + blas.node_count,
                bounds: blas.bounds,
                top: blas.top.into(),
                groups: blas.groups,
                levels: levels.unwrap_or_default().into(),
            }
        });
        let mesh = SceneMesh {
            geometry,
            bvh,
            vertex_count: packed.vertex_count,
            triangle_count: packed.triangle_count,
            offsets: packed.offsets,
            indices: built.indices,
            triangles: built.triangles,
            deformation: built.deformation,
            version: self.next_version,
        };
        tree_builds::discard(packed);
        self.next_version += 1;
        self.triangles += u64::from(mesh.triangle_count);
        self.ready.insert(id, mesh);
        self.changed.insert(id);
    }
}

/// Uploads finished meshes.
pub fn upload_meshes(meshes: &mut SceneMeshes, status: &ReflectionStatus, queue: &RenderQueue) {
    let (builds, milliseconds) = meshes.upload(meshes.upload_bytes, queue);
    status.update(|report| {
        report.meshes_pending = meshes.on_their_way();
        report.meshes_without_room = meshes.without_room.len();
        report.meshes = meshes.ready.len();
        report.triangles = meshes.triangles;
        report.blas_builds += builds;
        report.blas_build_ms += milliseconds;
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::ReflectionTracer,
        scene::{
            geometry::{BASE_ALIGNMENT, pack_mesh},
            meshes::{CopyBudget, MeshSource, Rank, Start, kept::RenderWorldMeshes},
            test_gpu,
        },
    };
    use bevy::{
        asset::{Assets, RenderAssetUsages, uuid::Uuid},
        mesh::PrimitiveTopology,
        platform::collections::HashSet,
        prelude::{Cuboid, Sphere},
        render::{render_resource::BufferUsages, renderer::RenderDevice},
    };
    use std::sync::Arc;

    const ID: AssetId<Mesh> = AssetId::Uuid {
        uuid: Uuid::from_u128(1),
    };

    const OTHER: AssetId<Mesh> = AssetId::Uuid {
        uuid: Uuid::from_u128(2),
    };

    fn start(meshes: &mut SceneMeshes, mesh: impl Into<Mesh>) {
        meshes.start(ID, MeshSource::Copy(Box::new(mesh.into())), 1);
    }

    /// Uploads this number of bytes after the build has finished.
    fn upload(meshes: &mut SceneMeshes, bytes: u64, queue: &RenderQueue) {
        while meshes.pending.values().any(|build| !build.task.is_finished()) {
            std::thread::yield_now();
        }
        meshes.upload(bytes, queue);
    }

    #[test]
    fn a_large_mesh_arrives_in_parts_and_shows_its_last_version_until_then() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        start(&mut meshes, Cuboid::default());
        upload(&mut meshes, u64::MAX, &queue);
        assert_eq!(meshes.get(ID).map(|mesh| mesh.triangle_count), Some(12));
        start(&mut meshes, Sphere::default());
        let mut frames = 0;
        while meshes.get(ID).is_some_and(|mesh| mesh.triangle_count == 12) {
            upload(&mut meshes, 4096, &queue);
            assert!(!meshes.uploading.is_empty() || meshes.pending.is_empty());
            frames += 1;
            assert!(frames < 1000, "it never arrives");
        }
        let mesh = meshes.get(ID).unwrap();
        let tree = mesh.bvh.as_ref().unwrap();
        let bytes = 4 * u64::from(mesh.geometry.words() + tree.slice.words());
        assert_eq!(frames, bytes.div_ceil(4096), "{bytes} bytes");
        let words = test_gpu::read(&device, &queue, meshes.bvh.buffer());
        let last = (tree.slice.base() + tree.slice.words()) as usize - ITEM_WORDS as usize;
        assert!(
            words[last..last + ITEM_WORDS as usize].iter().any(|word| *word != 0),
            "its last triangle is there"
        );
        meshes.remove(ID);
        assert_eq!(meshes.geometry.used_bytes(), 0);
    }

    #[test]
    fn what_changes_while_it_is_built_is_built_again() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        start(&mut meshes, Cuboid::default());
        meshes.stale.insert(ID);
        upload(&mut meshes, u64::MAX, &queue);
        assert!(meshes.get(ID).is_some() && meshes.stale.contains(&ID));
    }

    /// Data that stays in memory anyway isn't copied again.
    #[test]
    fn a_kept_mesh_stays_in_memory_once() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        let packed = Arc::new(pack_mesh(&Sphere::default().into()).unwrap());
        meshes.start(ID, MeshSource::Kept(packed.clone()), 0);
        upload(&mut meshes, u64::MAX, &queue);
        let triangles = meshes.get(ID).unwrap().triangles.as_ref().unwrap();
        assert!(std::ptr::eq(triangles.positions(), packed.positions()));
        // This one, and the triangles for merging. The build drops its own on another thread.
        for _ in 0..1_000 {
            if Arc::strong_count(&packed) == 2 {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert_eq!(Arc::strong_count(&packed), 2);
    }

    /// Leaves space for one and a half spheres.
    fn limit_geometry(meshes: &mut SceneMeshes, device: &RenderDevice, queue: &RenderQueue) {
        start(meshes, Sphere::default());
        upload(meshes, u64::MAX, queue);
        let size = 4 * u64::from(meshes.get(ID).unwrap().geometry.words());
        meshes.remove(ID);
        let usages = BufferUsages::STORAGE;
        meshes.geometry = Arena::new(device, "glint_geometry", usages, BASE_ALIGNMENT, size * 3 / 2);
    }

    #[test]
    fn a_mesh_that_outgrows_its_room_keeps_its_last_version() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        limit_geometry(&mut meshes, &device, &queue);
        meshes.start(OTHER, MeshSource::Copy(Box::new(Sphere::default().into())), 1);
        start(&mut meshes, Cuboid::default());
        for _ in 0..2 {
            upload(&mut meshes, u64::MAX, &queue);
        }
        start(&mut meshes, Sphere::default());
        upload(&mut meshes, u64::MAX, &queue);
        assert_eq!(meshes.get(ID).map(|mesh| mesh.triangle_count), Some(12));
        let used = meshes.used_bytes();
        assert!(meshes.take_ready_to_try(used).is_empty() && meshes.without_room.contains(&ID));
        meshes.remove(OTHER);
        let used = meshes.used_bytes();
        assert!(
            meshes.take_ready_to_try(used).is_empty() && meshes.stale.contains(&ID),
            "it is built again"
        );
        start(&mut meshes, Sphere::default());
        upload(&mut meshes, u64::MAX, &queue);
        assert!(meshes.get(ID).is_some_and(|mesh| mesh.triangle_count > 12));
    }

    #[test]
    fn a_mesh_without_room_is_built_once_there_is_some() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        limit_geometry(&mut meshes, &device, &queue);
        start(&mut meshes, Sphere::default());
        upload(&mut meshes, u64::MAX, &queue);
        meshes.start(OTHER, MeshSource::Copy(Box::new(Sphere::default().into())), 1);
        upload(&mut meshes, u64::MAX, &queue);
        assert!(meshes.get(ID).is_some() && meshes.get(OTHER).is_none());
        // It is remembered, so that it isn't built in each frame until something is freed.
        let used = meshes.used_bytes();
        assert!(meshes.take_ready_to_try(used).is_empty());
        assert!(meshes.is_known(OTHER));
        meshes.remove(ID);
        let used = meshes.used_bytes();
        assert_eq!(meshes.take_ready_to_try(used), [OTHER]);
        assert!(!meshes.is_known(OTHER), "it is built again");
    }

    /// A changed mesh interrupts the upload of a new one, and the nearest of the new ones is first.
    #[test]
    fn what_changed_comes_first() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let id = |number: u128| AssetId::Uuid {
            uuid: Uuid::from_u128(number),
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        start(&mut meshes, Cuboid::default());
        upload(&mut meshes, u64::MAX, &queue);
        for number in 10..30 {
            meshes.start(id(number), MeshSource::Copy(Box::new(Sphere::default().into())), 1);
            if let Some(build) = meshes.pending.get_mut(&id(number)) {
                build.rank = Rank::far(100 - number as u64);
            }
        }
        upload(&mut meshes, 4096, &queue);
        assert_eq!(meshes.uploading[0].id, id(29));
        start(&mut meshes, Cuboid::new(1.0, 2.0, 3.0));
        let version = meshes.get(ID).map(|mesh| mesh.version);
        upload(&mut meshes, 16 << 10, &queue);
        assert_ne!(
            meshes.get(ID).map(|mesh| mesh.version),
            version,
            "it waits for no other"
        );
        assert!(meshes.get(id(29)).is_none() && meshes.uploading.len() == 1);
        let mut arrived: Vec<AssetId<Mesh>> = Vec::new();
        while arrived.len() < 20 {
            upload(&mut meshes, 16 << 10, &queue);
            let new = (10..30).map(id).filter(|id| meshes.get(*id).is_some());
            let new: Vec<_> = new.filter(|id| !arrived.contains(id)).collect();
            assert!(new.len() < 2);
            arrived.extend(new);
        }
        assert!(arrived.into_iter().eq((10..30).rev().map(id)));
    }

    /// However often a mesh of lines changes, it isn't copied, and it is logged only once.
    #[test]
    fn lines_are_declined_at_once() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        let mut assets = Assets::<Mesh>::default();
        let lines = Mesh::new(PrimitiveTopology::LineList, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, vec![[0.0; 3]; 1_000]);
        let mesh = assets.add(lines);
        let (mut kept, changed) = (RenderWorldMeshes::default(), HashSet::default());
        let mut budget = CopyBudget::new(1 << 20, 0);
        for _ in 0..60 {
            let start = meshes.start_from(mesh.id(), &mut kept, &assets, &changed, &mut budget);
            assert!(start == Start::Done && meshes.pending.is_empty() && meshes.copied_bytes == 0);
            upload(&mut meshes, u64::MAX, &queue);
        }
        assert!(meshes.failed.contains(&mesh.id()) && meshes.told.len() == 1);
    }
}
