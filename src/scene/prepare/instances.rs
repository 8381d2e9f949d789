//! Updates the table of instances from extracted objects, and everything that depends on an object: its alpha test, and its place in
//! a merged tree or in the top level.

use crate::{
    device::ReflectionTracer,
    scene::{
        bind_group::{SceneBindings, pack_instance},
        bvh::TRAVERSAL_FLAGS,
        change::Change,
        gpu_types::{GpuInstance, INSTANCE_ALPHA_MASKED, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT},
        instances::{InstanceSource, SceneInstances},
        masks::{MaskKey, Surroundings},
        materials::{MaterialAssets, MaterialTable, instance_flags, is_traced},
        merge::Placement,
        meshes::SceneMeshes,
    },
};
use bevy::{mesh::UvChannel, render::renderer::RenderQueue};

impl SceneBindings {
    /// Updates objects that have only moved; their slots are sorted. If a movement requires more than new matrices, its slot is added to
    /// `dirty`. Returns the change for rays.
    pub(super) fn move_instances(&mut self, moved: &[u32], instances: &SceneInstances, dirty: &mut Vec<u32>) -> Change {
        let is_bvh = self.tracer == ReflectionTracer::Bvh;
        let place_of = |slot| instances.place_of(slot);
        let merge = &mut self.merge;
        let observe = || {
            for slot in moved.iter().filter(|_| is_bvh) {
                merge.observe_move(*slot);
            }
        };
        let mut all = Change::Nothing;
        for (slot, change) in self.instances.move_objects(moved, place_of, observe) {
            let Some(change) = change else {
                dirty.push(slot);
                continue;
            };
            all = all.max(change);
            // Those that were merged until now enter it in `follow_merging`.
            if is_bvh
                && self.top_level.holds(slot)
                && let Some(source) = instances.get(slot)
            {
                let object_from_world = self.instances.object_from_world(slot);
                self.top_level
                    .set_transform(slot, &source.world_from_object, object_from_world);
            }
        }
        all
    }

    /// Updates objects that might have changed in any way. Returns the change for rays.
    pub(super) fn update_instances(
        &mut self,
        dirty: &[u32],
        instances: &SceneInstances,
        materials: &mut MaterialTable,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Change {
        let mut change = Change::Nothing;
        for &slot in dirty {
            let source = instances.get(slot);
            let mut packed = source.and_then(|source| {
                let mesh = meshes.get(source.mesh)?;
                let material = surroundings.materials.get(source.material)?;
                let mut flags = is_traced(material).then(|| instance_flags(material))?;
                if source.groups == 0 && self.tracer == ReflectionTracer::Bvh {
                    // Only shadow rays hit it. The other tracer's masks do the same.
                    flags |= INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT;
                }
                let packed = pack_instance(source, mesh, materials.index(source.material), flags)?;
                let geometry_base = self.poses.geometry_base(slot).unwrap_or(packed.geometry_base);
                Some(GpuInstance {
                    geometry_base,
                    lightmap: self.lightmaps.word(slot, surroundings.textures),
                    ..packed
                })
            });
            let seen = source.filter(|source| packed.is_some() && source.groups != 0);
            let material = seen.and_then(|source| surroundings.materials.get(source.material));
            self.see_through.note(slot, seen.map(|source| source.entity), material);
            let seen_flags = seen.and(packed.as_ref()).map(|packed| packed.flags);
            self.depth_biases.note(slot, seen_flags);
            let own = seen.filter(|source| !source.is_stand_in);
            let forward = own.filter(|source| surroundings.materials.reflects_forward(source.material));
            self.forward.note(slot, forward.map(|source| source.entity));
            if self.tracer == ReflectionTracer::Bvh {
                self.assign_masks(slot, packed.as_mut().zip(source), surroundings, meshes, queue);
                self.observe_placement(slot, packed.as_ref().zip(source), meshes);
            }
            let replaced = source.is_some_and(|source| meshes.changed.contains(&source.mesh));
            if self.instances.set(slot, packed) || (replaced && packed.is_some()) {
                change = Change::Unmarked;
                if self.tracer == ReflectionTracer::Bvh && !self.merge.is_merged(slot) {
                    self.update_object(slot, packed.as_ref().zip(source), meshes);
                }
            }
        }
        change
    }

    /// Assigns masks to an alpha-masked instance. If they don't fit, it becomes opaque.
    fn assign_masks(
        &mut self,
        slot: u32,
        instance: Option<(&mut GpuInstance, &InstanceSource)>,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        let wanted = instance
            .as_ref()
            .and_then(|(packed, source)| mask_key(packed, source, surroundings.materials, meshes));
        let masks = self.masks.assign(slot, wanted, surroundings, meshes, queue);
        if let (Some((packed, _)), Some(_)) = (instance, wanted) {
            match masks {
                Some(masks) => packed.masks = masks,
                None => packed.flags &= !INSTANCE_ALPHA_MASKED,
            }
        }
    }

    /// Reports the state of an object for merging.
    fn observe_placement(
        &mut self,
        slot: u32,
        instance: Option<(&GpuInstance, &InstanceSource)>,
        meshes: &SceneMeshes,
    ) {
        // A merged tree would be stale with the next pose.
        let is_posed = self.poses.geometry_base(slot).is_some();
        let mergeable = instance.filter(|_| self.instances.has_room(slot) && !is_posed);
        let placement = mergeable.and_then(|(packed, source)| {
            Some(Placement {
                entity: source.entity,
                mesh: source.mesh,
                version: meshes.get(source.mesh)?.version,
                flags: packed.flags & TRAVERSAL_FLAGS,
                masks: packed.masks,
                micromaps: self.masks.micromaps(slot).name,
            })
        });
        let last = self.instances.place(slot);
        let has_moved = instance.is_some_and(|(packed, _)| last != Some(&packed.world_from_object));
        self.merge.observe(slot, placement, has_moved);
    }

    /// Adds an object to the top level, or removes it.
    fn update_object(&mut self, slot: u32, instance: Option<(&GpuInstance, &InstanceSource)>, meshes: &SceneMeshes) {
        let source = instance.map(|(_, source)| source);
        let source = source.filter(|_| self.instances.has_room(slot));
        let entry = source.and_then(|source| self.tables().entry(source, slot, meshes));
        self.top_level.set(slot, entry);
    }

    /// Updates posed objects. Returns the change for rays.
    pub(super) fn update_posed(&mut self, posed: &[u32], instances: &SceneInstances, meshes: &SceneMeshes) -> Change {
        let mut change = Change::Nothing;
        for &slot in posed {
            let Some(source) = instances.get(slot).filter(|_| self.instances.can_be_hit(slot)) else {
                continue;
            };
            change = change.max(self.instances.mark_posed(slot, self.poses.knows_motions(slot)));
            if self.tracer == ReflectionTracer::Bvh {
                let entry = self.tables().entry(source, slot, meshes);
                self.top_level.set(slot, entry);
            }
        }
        change
    }
}

/// The key of an instance's masks; `None` if it isn't alpha-masked.
fn mask_key(
    packed: &GpuInstance,
    source: &InstanceSource,
    assets: &MaterialAssets,
    meshes: &SceneMeshes,
) -> Option<MaskKey> {
    if packed.flags & INSTANCE_ALPHA_MASKED == 0 {
        return None;
    }
    Some(MaskKey {
        mesh: source.mesh,
        version: meshes.get(source.mesh)?.version,
        material: source.material,
        second_uvs: assets.get(source.material)?.base_color_channel == UvChannel::Uv1,
    })
}
