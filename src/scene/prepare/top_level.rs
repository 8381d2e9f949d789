//! The top level of both tracers.

use crate::{
    scene::{
        acceleration::{BlasKey, RayQueryInstance, RayQueryObjects},
        bind_group::{InstanceTable, SceneBindings},
        bvh::{LinearEntry, TlasInstance, owner},
        in_parallel::{OBJECTS_OF_A_TASK, in_parallel},
        instances::{InstanceSource, SceneInstances},
        meshes::SceneMeshes,
        pose::{PosedTree, Poses},
        top_level::Object,
    },
    status::ReflectionStatus,
};
use bevy::{
    log::warn_once,
    platform::time::Instant,
    render::renderer::{RenderDevice, RenderQueue},
};
use std::sync::Arc;
use wgpu::CommandBuffer;

impl SceneBindings {
    /// Counts a frame for the driver's structures. Returns true if they must be built although no object has changed, in order to retry
    /// failed allocations or because a view begins to use a back end that supports only one structure.
    pub(super) fn must_build_again(&mut self, may_split: bool) -> bool {
        let joins = self.may_split && !may_split;
        self.may_split = may_split;
        self.acceleration
            .as_mut()
            .is_some_and(|acceleration| acceleration.is_retry_due() || (joins && acceleration.is_split()))
    }

    /// Builds the driver's structures over the objects that can be hit. Only objects in `changed` might have changed. Returns commands that
    /// remain to be submitted.
    pub(super) fn build_ray_query_top_level(
        &mut self,
        changed: &[u32],
        instances: &SceneInstances,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) -> Vec<CommandBuffer> {
        let begin = Instant::now();
        let Some(acceleration) = &mut self.acceleration else {
            return Vec::new();
        };
        let (table, poses) = (&self.instances, &self.poses);
        let get = |slot: u32| {
            let source = instances.get(slot).filter(|_| table.can_be_hit(slot))?;
            let flags = table.flags(slot);
            Some(RayQueryInstance {
                slot,
                blas: BlasKey::new(source.mesh, flags),
                posed: poses.vertices(slot),
                world_from_object: source.world_from_object,
                flags,
            })
        };
        let objects = RayQueryObjects {
            count: table.present_count(),
            slots: instances.slots().len() as u32,
            changed,
            get: &get,
            may_split: self.may_split,
        };
        let blas_builds = acceleration.build(&objects, meshes, device, queue);
        let commands = acceleration.take_commands();
        self.uniform_data.tlas_node_count = table.present_count() as u32;
        self.uniform_data.moving_count = acceleration.moving_count() as u32;
        self.uniform_data.left_count = acceleration.left_count() as u32;
        if let Some(left) = acceleration.take_left() {
            self.instances.mark_left(left);
            self.instances.upload(device, queue);
        }
        self.report_top_level(begin, blas_builds, status);
        commands
    }

    /// Advances and updates the BVH tracer's trees over instances, and records pending work.
    pub(super) fn update_bvh_top_level(
        &mut self,
        instances: &SceneInstances,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) {
        let begin = Instant::now();
        self.follow_merging(instances, meshes);
        self.top_level.truncate(instances.slots().len());
        let (merge, tables) = (&self.merge, ObjectTables::of(&self.instances, &self.poses));
        let object_of = |slot: u32, meshes: &SceneMeshes| tables.object(instances.get(slot)?, slot, meshes);
        self.top_level
            .advance(|slot| merge.is_merged(slot), object_of, meshes, queue);
        self.follow_lost_trees(instances, meshes);
        if self.top_level.is_changed() {
            self.upload_bvh_top_level(instances, meshes, queue);
            self.report_top_level(begin, 0, status);
        }
        status.update(|report| {
            report.merges_pending |= self.top_level.is_building();
            report.micromaps_pending = self.masks.is_pending();
            report.micromap_builds = self.masks.builds();
        });
    }

    /// Uploads the trees over instances, and records the features that shaders need for them.
    fn upload_bvh_top_level(&mut self, instances: &SceneInstances, meshes: &mut SceneMeshes, queue: &RenderQueue) {
        let upload = |this: &mut Self, meshes: &mut SceneMeshes| {
            let tables = ObjectTables::of(&this.instances, &this.poses);
            let object_of = |slot: u32, meshes: &SceneMeshes| tables.object(instances.get(slot)?, slot, meshes);
            this.top_level.upload(this.merge.instances(), object_of, meshes, queue);
        };
        upload(self, meshes);
        if self.follow_lost_trees(instances, meshes) {
            upload(self, meshes);
        }
        let head = self.top_level.head();
        self.set_tree_features(self.instances.masked_count() > 0, head.is_deep);
        self.uniform_data.tlas_node_count = head.node_count;
        self.uniform_data.tlas_root = 0;
        if head.node_count == 0 && self.instances.present_count() > 0 {
            warn_once!(
                "nothing is reflected, since meshes leave no room in the largest buffer of this device; use fewer or \
                 smaller meshes, or keep some out with `NotReflected`"
            );
        }
    }

    fn report_top_level(&mut self, begin: Instant, blas_builds: u64, status: &ReflectionStatus) {
        // Forces an update of the uniform.
        self.uniform_data.instance_count = u32::MAX;
        status.update(|report| {
            report.instances = self.instances.present_count();
            report.tlas_builds += 1;
            report.blas_builds += blas_builds;
            report.tlas_build_ms = begin.elapsed().as_secs_f32() * 1000.0;
        });
    }

    /// The tables of objects.
    pub(super) fn tables(&self) -> ObjectTables<'_> {
        ObjectTables::of(&self.instances, &self.poses)
    }

    /// Removes objects from the other trees after they joined a merged tree, and vice versa.
    fn follow_merging(&mut self, instances: &SceneInstances, meshes: &SceneMeshes) {
        let mut left = self.merge.take_crossed();
        left.retain(|slot| {
            let is_merged = self.merge.is_merged(*slot);
            if is_merged {
                self.top_level.merge(*slot);
            }
            !is_merged && !self.top_level.holds(*slot) && self.instances.can_be_hit(*slot)
        });
        let tables = self.tables();
        let enter = |slots: &[u32]| {
            let mut entries = Vec::with_capacity(slots.len());
            let entry = |slot: u32| Some((slot, tables.entry(instances.get(slot)?, slot, meshes)?));
            entries.extend(slots.iter().filter_map(|slot| entry(*slot)));
            entries
        };
        let entries = in_parallel(left.chunks(OBJECTS_OF_A_TASK).collect(), enter);
        self.top_level.reserve(left.len());
        for (slot, entry) in entries.into_iter().flatten() {
            self.top_level.set(slot, Some(entry));
        }
    }

    /// Returns whether merged trees were lost because their space was needed.
    fn follow_lost_trees(&mut self, instances: &SceneInstances, meshes: &mut SceneMeshes) -> bool {
        let lost = self.merge.take_lost(meshes);
        if lost {
            self.top_level.touch();
            self.follow_merging(instances, meshes);
        }
        lost
    }
}

/// What the top level needs of objects, in their poses.
#[derive(Clone, Copy)]
pub(super) struct ObjectTables<'a> {
    table: &'a InstanceTable,
    poses: &'a Poses,
}

impl<'a> ObjectTables<'a> {
    fn of(table: &'a InstanceTable, poses: &'a Poses) -> Self {
        Self { table, poses }
    }

    /// The object of a slot. Returns `None` if its mesh has no tree.
    fn object(&self, source: &InstanceSource, slot: u32, meshes: &SceneMeshes) -> Option<Object> {
        let instance = self.instance(source, slot, meshes)?;
        let is_posed = self.poses.tree(slot).is_some();
        // The mesh's top nodes have the bounds of the bind pose.
        let top = meshes.get(source.mesh)?.bvh.as_ref().filter(|_| !is_posed);
        let top = top.map_or_else(Arc::default, |blas| blas.top.clone());
        Some(Object::new(&instance, top))
    }

    /// The same for the tree of moving objects. Returns `None` if rays can't hit it.
    pub fn entry(&self, source: &InstanceSource, slot: u32, meshes: &SceneMeshes) -> Option<LinearEntry> {
        let instance = self.instance(source, slot, meshes)?;
        LinearEntry::with_inverse(&instance, self.table.object_from_world(slot))
    }

    fn instance(&self, source: &InstanceSource, slot: u32, meshes: &SceneMeshes) -> Option<TlasInstance<'static>> {
        let blas = meshes.get(source.mesh)?.bvh.as_ref()?;
        let tree = self.poses.tree(slot).unwrap_or(PosedTree {
            first_node: blas.first_node,
            first_triangle: blas.first_triangle,
            bounds: blas.bounds,
        });
        Some(TlasInstance {
            world_from_object: source.world_from_object,
            bounds: tree.bounds,
            instance: owner(slot, self.table.flags(slot)),
            first_node: tree.first_node,
            first_triangle: tree.first_triangle,
            top: &[],
            groups: blas.groups,
        })
    }
}
