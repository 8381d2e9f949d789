//! The top level of both tracers.

use crate::{
    scene::{
        acceleration::{BlasKey, RayQueryInstance, RayQueryObjects},
        bind_group::SceneBindings,
        instances::SceneInstances,
        meshes::SceneMeshes,
    },
    status::ReflectionStatus,
};
use bevy::{
    log::warn_once,
    platform::time::Instant,
    render::renderer::{RenderDevice, RenderQueue},
};
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
        let merge = &self.merge;
        self.top_level.truncate(instances.slots().len());
        self.top_level.advance(
            |slot| merge.is_merged(slot),
            |slot| instances.place_of(slot),
            meshes,
            queue,
        );
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
        let place_of = |slot| instances.place_of(slot);
        self.top_level.upload(self.merge.instances(), place_of, meshes, queue);
        if self.follow_lost_trees(instances, meshes) {
            self.top_level.upload(self.merge.instances(), place_of, meshes, queue);
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

    /// Removes objects from the other trees after they joined a merged tree, and vice versa.
    fn follow_merging(&mut self, instances: &SceneInstances, meshes: &SceneMeshes) {
        for slot in self.merge.take_crossed() {
            if self.merge.is_merged(slot) {
                self.top_level.merge(slot);
            } else if !self.top_level.holds(slot)
                && self.instances.can_be_hit(slot)
                && let Some(object) = instances
                    .get(slot)
                    .and_then(|source| self.object(source, slot, self.instances.flags(slot), meshes))
            {
                self.top_level.set(slot, object);
            }
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
