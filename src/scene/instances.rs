//! The objects that rays can hit, mirrored from the main world.

use super::activity::SceneActivity;
use crate::settings::NotReflected;
use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    ecs::{
        entity::EntityHashMap, entity_disabling::Disabled, lifecycle::RemovedComponents, prelude::*, query::QueryData,
        system::SystemParam,
    },
    light::{NotShadowCaster, NotShadowReceiver},
    math::Affine3A,
    mesh::{Mesh, Mesh3d, morph::MeshMorphWeights, skinning::SkinnedMesh},
    pbr::{MeshMaterial3d, StandardMaterial},
    platform::collections::HashMap,
    prelude::*,
    render::Extract,
    utils::once,
};

/// One object as the main world describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct InstanceSource {
    /// The entity of the main world.
    pub entity: Entity,
    /// Its mesh.
    pub mesh: AssetId<Mesh>,
    /// Its material.
    pub material: AssetId<StandardMaterial>,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// It blocks shadow rays.
    pub casts_shadow: bool,
    /// Shadows fall on it.
    pub receives_shadow: bool,
}

/// All traced objects in stable slots: a slot is the object's index in the GPU's instance buffer.
#[derive(Resource, Default)]
pub struct SceneInstances {
    slots: Vec<Option<InstanceSource>>,
    free: Vec<u32>,
    by_entity: EntityHashMap<u32>,
    /// How many objects show each mesh.
    mesh_users: HashMap<AssetId<Mesh>, u32>,
    dirty: Vec<u32>,
}

impl SceneInstances {
    /// The slots, with holes.
    pub fn slots(&self) -> &[Option<InstanceSource>] {
        &self.slots
    }

    /// The object in a slot.
    pub fn get(&self, slot: u32) -> Option<&InstanceSource> {
        self.slots.get(slot as usize).and_then(Option::as_ref)
    }

    /// The meshes of all objects, each once.
    pub fn meshes(&self) -> impl Iterator<Item = AssetId<Mesh>> + '_ {
        self.mesh_users.keys().copied()
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.by_entity.len()
    }

    /// No object at all.
    pub fn is_empty(&self) -> bool {
        self.by_entity.is_empty()
    }

    /// Slots that changed since the last call, each once.
    pub fn take_dirty(&mut self) -> Vec<u32> {
        let mut dirty = core::mem::take(&mut self.dirty);
        dirty.sort_unstable();
        dirty.dedup();
        dirty
    }

    /// Adds or replaces an object; nothing happens where it equals what is there.
    pub fn set(&mut self, source: InstanceSource) {
        let slot = match self.by_entity.get(&source.entity) {
            Some(&slot) => slot,
            None => {
                let slot = self.free.pop().unwrap_or_else(|| {
                    self.slots.push(None);
                    self.slots.len() as u32 - 1
                });
                self.by_entity.insert(source.entity, slot);
                slot
            }
        };
        let place = &mut self.slots[slot as usize];
        if place.as_ref() != Some(&source) {
            *self.mesh_users.entry(source.mesh).or_default() += 1;
            let replaced = place.replace(source);
            self.dirty.push(slot);
            self.release_mesh(replaced);
        }
    }

    /// Removes an object if it is there.
    pub fn remove(&mut self, entity: Entity) {
        if let Some(slot) = self.by_entity.remove(&entity) {
            let removed = self.slots[slot as usize].take();
            self.free.push(slot);
            self.dirty.push(slot);
            self.release_mesh(removed);
        }
    }

    fn release_mesh(&mut self, gone: Option<InstanceSource>) {
        let Some(mesh) = gone.map(|source| source.mesh) else {
            return;
        };
        if let Some(users) = self.mesh_users.get_mut(&mesh) {
            *users -= 1;
            if *users == 0 {
                self.mesh_users.remove(&mesh);
            }
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

/// Data of a traced entity that extraction reads.
#[derive(QueryData)]
pub struct InstanceQuery {
    entity: Entity,
    mesh: &'static Mesh3d,
    material: &'static MeshMaterial3d<StandardMaterial>,
    transform: &'static GlobalTransform,
    visibility: &'static InheritedVisibility,
    layers: Option<&'static RenderLayers>,
    range: Option<&'static VisibilityRange>,
    opted_out: Has<NotReflected>,
    no_shadow: Has<NotShadowCaster>,
    no_shadow_on_it: Has<NotShadowReceiver>,
    skinned: Has<SkinnedMesh>,
    morphed: Has<MeshMorphWeights>,
}

type InstanceChanged = Or<(
    Changed<Mesh3d>,
    Changed<MeshMaterial3d<StandardMaterial>>,
    Changed<GlobalTransform>,
    Changed<InheritedVisibility>,
    Changed<RenderLayers>,
    Changed<VisibilityRange>,
    Added<NotReflected>,
    Added<NotShadowCaster>,
    Added<NotShadowReceiver>,
)>;

/// Components whose removal changes how an entity is traced.
#[derive(SystemParam)]
pub struct RemovedFromScene<'w, 's> {
    meshes: RemovedComponents<'w, 's, Mesh3d>,
    materials: RemovedComponents<'w, 's, MeshMaterial3d<StandardMaterial>>,
    visibilities: RemovedComponents<'w, 's, InheritedVisibility>,
    layers: RemovedComponents<'w, 's, RenderLayers>,
    ranges: RemovedComponents<'w, 's, VisibilityRange>,
    opt_outs: RemovedComponents<'w, 's, NotReflected>,
    casters: RemovedComponents<'w, 's, NotShadowCaster>,
    receivers: RemovedComponents<'w, 's, NotShadowReceiver>,
    disabled: RemovedComponents<'w, 's, Disabled>,
    /// Queries that don't name `Disabled` no longer find these.
    now_disabled: Query<'w, 's, Entity, Added<Disabled>>,
}

impl RemovedFromScene<'_, '_> {
    fn read(&mut self) -> Vec<Entity> {
        let mut entities: Vec<Entity> = self.meshes.read().collect();
        entities.extend(self.materials.read());
        entities.extend(self.visibilities.read());
        entities.extend(self.layers.read());
        entities.extend(self.ranges.read());
        entities.extend(self.opt_outs.read());
        entities.extend(self.casters.read());
        entities.extend(self.receivers.read());
        entities.extend(self.disabled.read());
        entities.extend(&self.now_disabled);
        entities
    }
}

/// Mirrors what changed, or everything after reflections were off.
pub fn extract_instances(
    changed: Extract<Query<InstanceQuery, InstanceChanged>>,
    all: Extract<Query<InstanceQuery>>,
    mut removed: Extract<RemovedFromScene>,
    activity: Res<SceneActivity>,
    mut instances: ResMut<SceneInstances>,
) {
    let removed = removed.read();
    if !activity.active {
        if !instances.is_empty() {
            instances.clear();
        }
        return;
    }
    if activity.started {
        instances.clear();
        for item in &all {
            update(&mut instances, &item);
        }
        return;
    }
    for entity in removed {
        match all.get(entity) {
            Ok(item) => update(&mut instances, &item),
            Err(_) => instances.remove(entity),
        }
    }
    for item in &changed {
        update(&mut instances, &item);
    }
}

fn update(instances: &mut SceneInstances, item: &InstanceQueryItem) {
    // Reflections show what an ordinary camera shows: the default layer. Of levels of detail the nearest stands for all.
    let on_default_layer = item
        .layers
        .is_none_or(|layers| layers.intersects(&RenderLayers::default()));
    let nearest_detail = item.range.is_none_or(|range| range.start_margin.start <= 0.0);
    if item.opted_out || !item.visibility.get() || !on_default_layer || !nearest_detail {
        instances.remove(item.entity);
        return;
    }
    if item.skinned || item.morphed {
        once!(bevy::log::warn!(
            "ray-traced reflections show skinned and morphed meshes in their bind pose (first seen on {}); \
             add `NotReflected` to leave them out",
            item.entity
        ));
    }
    instances.set(InstanceSource {
        entity: item.entity,
        mesh: item.mesh.id(),
        material: item.material.id(),
        world_from_object: item.transform.affine(),
        casts_shadow: !item.no_shadow,
        receives_shadow: !item.no_shadow_on_it,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(entity: Entity) -> InstanceSource {
        InstanceSource {
            entity,
            mesh: AssetId::default(),
            material: AssetId::default(),
            world_from_object: Affine3A::IDENTITY,
            casts_shadow: true,
            receives_shadow: true,
        }
    }

    #[test]
    fn slots_are_stable_and_reused() {
        let mut world = World::new();
        let [a, b, c] = [(); 3].map(|()| world.spawn_empty().id());
        let mut instances = SceneInstances::default();
        instances.set(source(a));
        instances.set(source(b));
        assert_eq!(instances.take_dirty(), [0, 1]);
        instances.set(source(a));
        assert!(instances.take_dirty().is_empty(), "nothing changed");
        instances.remove(a);
        instances.set(source(c));
        assert_eq!(instances.take_dirty(), [0]);
        assert_eq!(instances.get(0).map(|s| s.entity), Some(c));
        assert_eq!(instances.len(), 2);
        assert_eq!(instances.meshes().count(), 1);
        instances.remove(b);
        instances.remove(c);
        assert_eq!(instances.meshes().count(), 0, "nobody shows the mesh any more");
    }
}
