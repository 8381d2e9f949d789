//! The top level of both tracers.

use super::SceneBindings;
use crate::{
    scene::{
        acceleration::{BlasKey, RayQueryInstance},
        gpu_types::INSTANCE_ALPHA_MASKED,
        instances::SceneInstances,
        meshes::SceneMeshes,
        top_level::Object,
    },
    status::ReflectionStatus,
};
use bevy::{
    log::warn_once,
    platform::time::Instant,
    render::renderer::{RenderDevice, RenderQueue},
};

impl SceneBindings {
    /// Builds the structure of the driver over all objects that can be hit.
    pub(super) fn build_ray_query_top_level(
        &mut self,
        instances: &SceneInstances,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) {
        let begin = Instant::now();
        let Some(acceleration) = &mut self.acceleration else {
            return;
        };
        let slots = instances.slots().iter().enumerate().take(self.instance_limit);
        let present = slots
            .filter(|(slot, _)| self.present.get(*slot) == Some(&true))
            .filter_map(|(slot, source)| {
                let source = source.as_ref()?;
                meshes.get(source.mesh).map(|_| (slot as u32, source))
            });
        let list: Vec<_> = present
            .map(|(slot, source)| {
                let flags = self.instance_data[slot as usize].flags;
                RayQueryInstance {
                    slot,
                    blas: BlasKey::new(source.mesh, flags),
                    world_from_object: source.world_from_object,
                    flags,
                }
            })
            .collect();
        let blas_builds = acceleration.build(&list, meshes, device, queue);
        self.uniform_data.tlas_node_count = list.len() as u32;
        self.report_top_level(begin, blas_builds, status);
    }

    /// Carries on with the BVH tracer's trees over instances, and brings them up to date. Notes what shaders must be compiled with for
    /// them.
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
        self.top_level.advance(|slot| merge.is_merged(slot), meshes, queue);
        self.follow_lost_trees(instances, meshes);
        if !self.top_level.is_changed() {
            return;
        }
        self.top_level.upload(self.merge.instances(), meshes, queue);
        if self.follow_lost_trees(instances, meshes) {
            self.top_level.upload(self.merge.instances(), meshes, queue);
        }
        self.set_masked(self.masked_instances > 0);
        let head = self.top_level.head();
        self.set_deep(head.is_deep);
        self.uniform_data.tlas_node_count = head.node_count;
        self.uniform_data.tlas_root = 0;
        if head.node_count == 0 && self.present_instances > 0 {
            warn_once!(
                "nothing is reflected, since meshes leave no room in the largest buffer of this device; use fewer or \
                 smaller meshes, or keep some out with `NotReflected`"
            );
        }
        self.report_top_level(begin, 0, status);
    }

    fn report_top_level(&mut self, begin: Instant, blas_builds: u64, status: &ReflectionStatus) {
        // Forces the uniform to be written.
        self.uniform_data.instance_count = u32::MAX;
        status.update(|report| {
            report.instances = self.present_instances;
            report.tlas_builds += 1;
            report.blas_builds += blas_builds;
            report.tlas_build_ms = begin.elapsed().as_secs_f32() * 1000.0;
        });
    }

    /// Objects that joined a merged tree leave the others, and the other way round.
    fn follow_merging(&mut self, instances: &SceneInstances, meshes: &SceneMeshes) {
        let limit = self.instance_limit;
        for slot in self.merge.take_crossed() {
            if self.merge.is_merged(slot) {
                self.top_level.merge(slot);
            } else if !self.top_level.holds(slot)
                && (slot as usize) < limit
                && self.present.get(slot as usize) == Some(&true)
                && let Some(object) = instances
                    .get(slot)
                    .and_then(|source| Object::new(source, slot, self.instance_data[slot as usize].flags, meshes))
            {
                self.top_level.set(slot, object);
            }
        }
    }

    /// Returns whether merged trees got lost since their room was needed.
    fn follow_lost_trees(&mut self, instances: &SceneInstances, meshes: &mut SceneMeshes) -> bool {
        let lost = self.merge.take_lost(meshes);
        if lost {
            self.top_level.touch();
            self.follow_merging(instances, meshes);
        }
        lost
    }

    /// Notes whether shaders need the alpha test.
    pub(super) fn set_masked(&mut self, masked: bool) {
        if self.masked != masked {
            self.masked = masked;
            self.defs_version = self.defs_version.wrapping_add(1);
        }
    }

    /// Notes whether shaders need a larger stack.
    pub(super) fn set_deep(&mut self, deep: bool) {
        if self.deep != deep {
            self.deep = deep;
            self.defs_version = self.defs_version.wrapping_add(1);
        }
    }

    /// Counts an object that comes (1) or goes (-1).
    pub(super) fn count(&mut self, flags: u32, step: isize) {
        let add = |count: usize| count.saturating_add_signed(step);
        self.present_instances = add(self.present_instances);
        if flags & INSTANCE_ALPHA_MASKED != 0 {
            self.masked_instances = add(self.masked_instances);
        }
    }
}
