//! The top level of both tracers.

use super::{SceneBindings, instance_limit};
use crate::{
    scene::{
        acceleration::{BlasKey, RayQueryInstance},
        arena::ArenaSlice,
        bvh::{ITEM_WORDS, Tlas, TlasInstance, USUAL_STACK, build_tlas, opening_budget, owner},
        gpu_types::INSTANCE_ALPHA_MASKED,
        instances::{InstanceSource, SceneInstances},
        meshes::SceneMeshes,
    },
    status::ReflectionStatus,
};
use bevy::{
    log::warn_once,
    platform::time::Instant,
    render::renderer::{RenderDevice, RenderQueue},
};

/// Nodes, entries and matrices that the TLAS has room for at least.
const SMALLEST_TLAS: usize = 1 << 9;

impl SceneBindings {
    /// Builds the top level over all objects that can be hit.
    pub(super) fn build_top_level(
        &mut self,
        instances: &SceneInstances,
        meshes: &mut SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) {
        let begin = Instant::now();
        let slots = instances.slots().iter().enumerate().take(instance_limit(device));
        let present: Vec<(u32, &InstanceSource)> = slots
            .filter(|(slot, _)| self.present.get(*slot) == Some(&true))
            .filter_map(|(slot, source)| {
                let source = source.as_ref()?;
                meshes.get(source.mesh).map(|_| (slot as u32, source))
            })
            .collect();
        let mut blas_builds = 0;
        if let Some(acceleration) = &mut self.acceleration {
            let list: Vec<_> = present
                .iter()
                .map(|(slot, source)| {
                    let flags = self.instance_data[*slot as usize].flags;
                    RayQueryInstance {
                        slot: *slot,
                        blas: BlasKey::new(source.mesh, flags),
                        world_from_object: source.world_from_object,
                        flags,
                    }
                })
                .collect();
            blas_builds = acceleration.build(&list, meshes, device, queue);
            self.uniform_data.tlas_node_count = present.len() as u32;
        } else {
            self.build_bvh_top_level(&present, meshes, queue);
        }
        // Forces the uniform to be written.
        self.uniform_data.instance_count = u32::MAX;
        status.update(|report| {
            report.instances = present.len();
            report.tlas_builds += 1;
            report.blas_builds += blas_builds;
            report.tlas_build_ms = begin.elapsed().as_secs_f32() * 1000.0;
        });
    }

    /// Builds and uploads the BVH tracer's TLAS: merged trees, and instances of those objects that are not merged. Notes
    /// what shaders must be compiled with for them.
    ///
    /// It stands among the BLASes, so that the shader loads the nodes of both levels with the same instructions.
    fn build_bvh_top_level(
        &mut self,
        present: &[(u32, &InstanceSource)],
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        let any_masked = present.iter().any(|(slot, _)| self.is_masked(*slot));
        self.set_masked(any_masked);

        let mut tlas = self.tlas_over(present, meshes);
        let mut fits = self.reserve_tlas(&tlas, meshes);
        if self.merge.take_lost(meshes) {
            tlas = self.tlas_over(present, meshes);
            fits = self.reserve_tlas(&tlas, meshes);
        }
        self.set_deep(tlas.stack > USUAL_STACK);
        self.uniform_data.tlas_node_count = 0;
        match &self.tlas {
            Some(slice) if fits => {
                self.uniform_data.tlas_node_count = tlas.traversal_node_count();
                self.uniform_data.tlas_root = slice.base() / ITEM_WORDS;
                meshes.bvh.write(queue, slice, tlas.items.as_flattened().as_flattened());
            }
            _ => {
                warn_once!(
                    "nothing is reflected, since meshes leave no room in the largest buffer of this device; use fewer or \
                     smaller meshes, or keep some out with `NotReflected`"
                );
            }
        }
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

    fn is_masked(&self, slot: u32) -> bool {
        self.instance_data[slot as usize].flags & INSTANCE_ALPHA_MASKED != 0
    }

    fn tlas_over(&self, present: &[(u32, &InstanceSource)], meshes: &SceneMeshes) -> Tlas {
        let mut list: Vec<TlasInstance> = present
            .iter()
            .filter(|(slot, _)| !self.merge.is_merged(*slot))
            .filter_map(|(slot, source)| {
                let blas = meshes.get(source.mesh)?.bvh.as_ref()?;
                Some(TlasInstance {
                    world_from_object: source.world_from_object,
                    bounds: blas.bounds,
                    instance: owner(*slot, self.instance_data[*slot as usize].flags),
                    first_node: blas.first_node,
                    first_triangle: blas.first_triangle,
                    top: &blas.top,
                    groups: blas.groups,
                })
            })
            .collect();
        let single = list.len();
        list.extend(self.merge.instances());
        // A lone tree overlaps with nothing, and rays start in it at once where it is not opened.
        let max_entries = if list.len() > 1 {
            opening_budget(single) + list.len() - single
        } else {
            0
        };
        build_tlas(&list, max_entries)
    }

    /// Makes room for the TLAS; false where there is none. Merged trees may get lost over it.
    fn reserve_tlas(&mut self, tlas: &Tlas, meshes: &mut SceneMeshes) -> bool {
        let items = tlas.items.len();
        let room = |slice: &ArenaSlice| (slice.words() / ITEM_WORDS) as usize;
        if self.tlas.as_ref().is_some_and(|slice| room(slice) >= items) {
            return true;
        }
        if let Some(slice) = self.tlas.take() {
            meshes.bvh.free(slice);
        }
        // Room to grow, so that a slowly growing scene doesn't ask for it in every frame.
        let roomy = items.next_power_of_two().max(SMALLEST_TLAS);
        self.tlas = meshes.allocate_tree(roomy).or_else(|| meshes.allocate_tree(items));
        self.tlas.is_some()
    }
}
