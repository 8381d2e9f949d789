//! The objects that rays can hit, mirrored from the main world.

use super::{activity::SceneActivity, free_slots::FreeSlots};
use crate::settings::{NotReflected, ReflectedMaterial3d, ReflectedMesh3d};
use bevy::{
    asset::UntypedAssetId,
    camera::visibility::{RenderLayers, VisibilityRange},
    ecs::{
        change_detection::Tick,
        entity_disabling::Disabled,
        lifecycle::RemovedComponents,
        prelude::*,
        query::{ArchetypeFilter, QueryData},
        system::SystemParam,
    },
    light::{NotShadowCaster, NotShadowReceiver},
    math::Affine3A,
    mesh::{Mesh, Mesh3d, skinning::SkinnedMesh},
    pbr::{Material, MeshMaterial3d},
    platform::collections::{HashMap, HashSet},
    prelude::*,
    render::Extract,
};

/// One object as the main world describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct InstanceSource {
    /// The entity of the main world.
    pub entity: Entity,
    /// Its mesh.
    pub mesh: AssetId<Mesh>,
    /// Its material, of any type that rays see.
    pub material: UntypedAssetId,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// It blocks shadow rays.
    pub casts_shadow: bool,
    /// Shadows fall on it.
    pub receives_shadow: bool,
}

impl InstanceSource {
    fn is_same_apart_from_place(&self, other: &Self) -> bool {
        let Self {
            entity,
            mesh,
            material,
            world_from_object: _,
            casts_shadow,
            receives_shadow,
        } = self;
        (*entity, *mesh, *material) == (other.entity, other.mesh, other.material)
            && (*casts_shadow, *receives_shadow) == (other.casts_shadow, other.receives_shadow)
    }
}

/// In the place of a slot: the entity has none.
const NO_SLOT: u32 = u32::MAX;

/// All traced objects in stable slots: a slot is the object's index in the GPU's instance buffer.
#[derive(Resource, Default)]
pub struct SceneInstances {
    slots: Vec<Option<InstanceSource>>,
    free: FreeSlots,
    /// By index of the entity: the slot, or [`NO_SLOT`].
    by_entity: Vec<u32>,
    count: usize,
    /// How many objects show each mesh.
    mesh_users: HashMap<AssetId<Mesh>, u32>,
    dirty: Vec<u32>,
    moved: Vec<u32>,
}

impl SceneInstances {
    /// The slots, with holes, up to the last object.
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

    /// No object at all.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Slots whose objects have moved since the last call, and may have changed otherwise, too; each once.
    pub fn take_moved(&mut self) -> Vec<u32> {
        let mut moved = core::mem::take(&mut self.moved);
        moved.sort_unstable();
        moved.dedup();
        moved
    }

    /// Slots that changed otherwise than by moving since the last call, each once.
    pub fn take_dirty(&mut self) -> Vec<u32> {
        let mut dirty = core::mem::take(&mut self.dirty);
        dirty.sort_unstable();
        dirty.dedup();
        dirty
    }

    /// Adds or replaces an object; nothing happens where it equals what is there.
    pub fn set(&mut self, source: InstanceSource) {
        let index = source.entity.index_u32() as usize;
        if index >= self.by_entity.len() {
            self.by_entity.resize(index + 1, NO_SLOT);
        }
        let mut slot = self.by_entity[index];
        if slot == NO_SLOT {
            let slots = &self.slots;
            let free = self.free.take(slots.len(), |slot| slots[slot as usize].is_none());
            slot = free.unwrap_or_else(|| {
                self.slots.push(None);
                self.slots.len() as u32 - 1
            });
            self.by_entity[index] = slot;
            self.count += 1;
        }
        let place = &mut self.slots[slot as usize];
        if let Some(before) = place
            && before.world_from_object != source.world_from_object
            && before.is_same_apart_from_place(&source)
        {
            before.world_from_object = source.world_from_object;
            self.moved.push(slot);
        } else if place.as_ref() != Some(&source) {
            *self.mesh_users.entry(source.mesh).or_default() += 1;
            let replaced = place.replace(source);
            self.dirty.push(slot);
            self.release_mesh(replaced);
        }
    }

    /// The slot of an object and the object, if it is there.
    pub fn find(&self, entity: Entity) -> Option<(u32, &InstanceSource)> {
        let slot = *self.by_entity.get(entity.index_u32() as usize)?;
        // Another entity may have the same index by now.
        let source = self.get(slot).filter(|source| source.entity == entity)?;
        Some((slot, source))
    }

    /// Moves an object if it is there.
    pub fn set_place(&mut self, entity: Entity, world_from_object: Affine3A) {
        if let Some((slot, _)) = self.find(entity) {
            self.place(slot, world_from_object);
        }
    }

    /// Moves an object, and nothing happens where it is there already.
    pub fn place(&mut self, slot: u32, world_from_object: Affine3A) {
        if let Some(Some(source)) = self.slots.get_mut(slot as usize)
            && source.world_from_object != world_from_object
        {
            source.world_from_object = world_from_object;
            self.moved.push(slot);
        }
    }

    /// Removes an object if it is there.
    pub fn remove(&mut self, entity: Entity) {
        let Some(place) = self.by_entity.get_mut(entity.index_u32() as usize) else {
            return;
        };
        // Another entity may have the same index by now.
        let slot = *place;
        if self
            .slots
            .get(slot as usize)
            .and_then(Option::as_ref)
            .is_some_and(|source| source.entity == entity)
        {
            *place = NO_SLOT;
            self.count -= 1;
            let removed = self.slots[slot as usize].take();
            self.free.give(slot);
            while let Some(None) = self.slots.last() {
                self.slots.pop();
            }
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

/// A component that says which material rays see on an entity.
pub trait MaterialComponent: Component {
    /// Entities for which it does.
    type Filter: ArchetypeFilter + 'static;

    /// The material.
    fn material(&self) -> UntypedAssetId;
}

impl<M: Material> MaterialComponent for MeshMaterial3d<M> {
    type Filter = Without<ReflectedMaterial3d>;

    fn material(&self) -> UntypedAssetId {
        self.id().untyped()
    }
}

impl MaterialComponent for ReflectedMaterial3d {
    type Filter = ();

    fn material(&self) -> UntypedAssetId {
        self.id().untyped()
    }
}

/// Entities that have a mesh for rays, and take their material from `C`.
type IsObject<C> = (
    Or<(With<Mesh3d>, With<ReflectedMesh3d>)>,
    <C as MaterialComponent>::Filter,
);

/// Components of a traced entity that extraction reads.
type InstanceQuery<C> = (
    Entity,
    Option<Ref<'static, Mesh3d>>,
    Option<Ref<'static, ReflectedMesh3d>>,
    Ref<'static, C>,
    Ref<'static, GlobalTransform>,
    Ref<'static, InheritedVisibility>,
    Option<Ref<'static, RenderLayers>>,
    Option<Ref<'static, VisibilityRange>>,
    Option<Ref<'static, NotReflected>>,
    Option<Ref<'static, NotShadowCaster>>,
    Option<Ref<'static, NotShadowReceiver>>,
    Has<SkinnedMesh>,
);

/// Values of these components.
struct InstanceItem<'a> {
    entity: Entity,
    mesh: Option<&'a Mesh3d>,
    stand_in: Option<&'a ReflectedMesh3d>,
    material: UntypedAssetId,
    transform: &'a GlobalTransform,
    visibility: &'a InheritedVisibility,
    layers: Option<&'a RenderLayers>,
    range: Option<&'a VisibilityRange>,
    opted_out: bool,
    no_shadow: bool,
    no_shadow_on_it: bool,
    skinned: bool,
}

/// Components whose removal changes how an entity is traced, apart from those of materials.
#[derive(SystemParam)]
pub struct RemovedFromScene<'w, 's> {
    meshes: RemovedComponents<'w, 's, Mesh3d>,
    stand_ins: RemovedComponents<'w, 's, ReflectedMesh3d>,
    visibilities: RemovedComponents<'w, 's, InheritedVisibility>,
    layers: RemovedComponents<'w, 's, RenderLayers>,
    ranges: RemovedComponents<'w, 's, VisibilityRange>,
    opt_outs: RemovedComponents<'w, 's, NotReflected>,
    casters: RemovedComponents<'w, 's, NotShadowCaster>,
    receivers: RemovedComponents<'w, 's, NotShadowReceiver>,
    skins: RemovedComponents<'w, 's, SkinnedMesh>,
    disabled: RemovedComponents<'w, 's, Disabled>,
    /// Queries that don't name `Disabled` no longer find these.
    now_disabled: Query<'w, 's, Entity, Added<Disabled>>,
}

/// Entities that lost a component since the last frame. Those that no query finds any more are objects no longer.
#[derive(Resource, Default)]
pub struct LostComponents(HashSet<Entity>);

/// Notes who lost something, and forgets everything where reflections are off or begin.
pub fn begin_extraction(
    mut removed: Extract<RemovedFromScene>,
    activity: Res<SceneActivity>,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
) {
    let removed = &mut *removed;
    lost.0.clear();
    lost.0.extend(removed.meshes.read());
    lost.0.extend(removed.stand_ins.read());
    lost.0.extend(removed.visibilities.read());
    lost.0.extend(removed.layers.read());
    lost.0.extend(removed.ranges.read());
    lost.0.extend(removed.opt_outs.read());
    lost.0.extend(removed.casters.read());
    lost.0.extend(removed.receivers.read());
    lost.0.extend(removed.skins.read());
    lost.0.extend(removed.disabled.read());
    lost.0.extend(&removed.now_disabled);
    if (!activity.active || activity.started) && !instances.is_empty() {
        instances.clear();
    }
}

/// Notes who lost a material. Runs for all types of materials before any object is looked at, since another may have taken its place.
pub fn note_lost_materials<C: MaterialComponent>(
    mut removed: Extract<RemovedComponents<C>>,
    mut lost: ResMut<LostComponents>,
) {
    lost.0.extend(removed.read());
}

/// Mirrors objects whose material comes from `C`: what changed, or everything after reflections were off.
pub fn extract_instances<C: MaterialComponent>(
    all: Extract<Query<InstanceQuery<C>, IsObject<C>>>,
    activity: Res<SceneActivity>,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
) {
    if !activity.active {
        return;
    }
    if activity.started {
        for item in &all {
            update(&mut instances, item);
        }
        return;
    }
    lost.0.retain(|entity| match all.get(*entity) {
        Ok(item) => {
            update(&mut instances, item);
            false
        }
        Err(_) => true,
    });
    update_changed(&mut instances, &all);
}

/// Forgets the objects that no query has found.
pub fn drop_lost_objects(mut lost: ResMut<LostComponents>, mut instances: ResMut<SceneInstances>) {
    for entity in lost.0.drain() {
        instances.remove(entity);
    }
}

/// Entities whose ticks are looked at together. Most worlds are static for the most part, and blocks without a change cost little.
const BLOCK: usize = 128;

/// Tells which changes came after the last run.
#[derive(Clone, Copy)]
struct Clock {
    this_run: u32,
    /// Ticks since the last run.
    since: u32,
}

impl Clock {
    fn new(this_run: Tick, last_run: Tick) -> Self {
        Self {
            this_run: this_run.get(),
            since: this_run.get().wrapping_sub(last_run.get()),
        }
    }

    fn is_new(&self, tick: Tick) -> bool {
        self.this_run.wrapping_sub(tick.get()) < self.since
    }

    /// Without branches, so that many are compared at a time.
    fn any_is_new(&self, ticks: &[Tick]) -> bool {
        ticks.iter().fold(0, |any, tick| any | u32::from(self.is_new(*tick))) != 0
    }
}

/// Mirrors entities of which a component has changed. Queries with filters for changes take ten times as long in large worlds, since they
/// ask for each entity and component in turn.
fn update_changed<C: MaterialComponent>(instances: &mut SceneInstances, all: &Query<InstanceQuery<C>, IsObject<C>>) {
    let Ok(tables) = all.contiguous_iter() else {
        // All of these components are stored in tables, unless a future version of Bevy stores one elsewhere.
        for item in all {
            if is_changed(&item) {
                update(instances, item);
            }
        }
        return;
    };
    for table in tables {
        let (
            entities,
            meshes,
            stand_ins,
            materials,
            transforms,
            visibilities,
            layers,
            ranges,
            out,
            caster,
            receiver,
            skin,
        ) = table;
        let clock = Clock::new(transforms.this_run_tick(), transforms.last_run_tick());
        let places = transforms.changed_ticks_slice();
        let columns = [
            Some(visibilities.changed_ticks_slice()),
            Some(materials.changed_ticks_slice()),
            meshes.as_ref().map(|meshes| meshes.changed_ticks_slice()),
            stand_ins.as_ref().map(|stand_ins| stand_ins.changed_ticks_slice()),
            layers.as_ref().map(|layers| layers.changed_ticks_slice()),
            ranges.as_ref().map(|ranges| ranges.changed_ticks_slice()),
            out.as_ref().map(|out| out.changed_ticks_slice()),
            caster.as_ref().map(|caster| caster.changed_ticks_slice()),
            receiver.as_ref().map(|receiver| receiver.changed_ticks_slice()),
        ];
        for begin in (0..entities.len()).step_by(BLOCK) {
            let rows = begin..(begin + BLOCK).min(entities.len());
            let mut ticks = columns.iter().flatten().filter_map(|ticks| ticks.get(rows.clone()));
            let is_changed = ticks.any(|ticks| clock.any_is_new(ticks));
            if !is_changed && !clock.any_is_new(&places[rows.clone()]) {
                continue;
            }
            for row in rows {
                let is_changed = is_changed
                    && columns
                        .iter()
                        .flatten()
                        .any(|ticks| ticks.get(row).is_some_and(|tick| clock.is_new(*tick)));
                if !is_changed {
                    // Joints place a skinned mesh.
                    let is_placed = skin && stand_ins.is_none();
                    if !is_placed && clock.is_new(places[row]) {
                        instances.set_place(entities[row], transforms[row].affine());
                    }
                    continue;
                }
                update_item(
                    instances,
                    &InstanceItem {
                        entity: entities[row],
                        mesh: meshes.as_ref().map(|meshes| &meshes[row]),
                        stand_in: stand_ins.as_ref().map(|stand_ins| &stand_ins[row]),
                        material: materials[row].material(),
                        transform: &transforms[row],
                        visibility: &visibilities[row],
                        layers: layers.as_ref().map(|layers| &layers[row]),
                        range: ranges.as_ref().map(|ranges| &ranges[row]),
                        opted_out: out.is_some(),
                        no_shadow: caster.is_some(),
                        no_shadow_on_it: receiver.is_some(),
                        skinned: skin,
                    },
                );
            }
        }
    }
}

type Item<'w, 's, C> = <InstanceQuery<C> as QueryData>::Item<'w, 's>;

fn is_changed<C: MaterialComponent>(item: &Item<C>) -> bool {
    let (_, mesh, stand_in, material, transform, visibility, layers, range, out, caster, receiver, ..) = item;
    material.is_changed()
        || transform.is_changed()
        || visibility.is_changed()
        || mesh.as_ref().is_some_and(Ref::is_changed)
        || stand_in.as_ref().is_some_and(Ref::is_changed)
        || layers.as_ref().is_some_and(Ref::is_changed)
        || range.as_ref().is_some_and(Ref::is_changed)
        || out.as_ref().is_some_and(Ref::is_changed)
        || caster.as_ref().is_some_and(Ref::is_changed)
        || receiver.as_ref().is_some_and(Ref::is_changed)
}

fn update<C: MaterialComponent>(instances: &mut SceneInstances, item: Item<C>) {
    let (entity, mesh, stand_in, material, transform, visibility, layers, range, out, caster, receiver, skinned) = item;
    update_item(
        instances,
        &InstanceItem {
            entity,
            mesh: mesh.as_deref(),
            stand_in: stand_in.as_deref(),
            material: material.material(),
            transform: &transform,
            visibility: &visibility,
            layers: layers.as_deref(),
            range: range.as_deref(),
            opted_out: out.is_some(),
            no_shadow: caster.is_some(),
            no_shadow_on_it: receiver.is_some(),
            skinned,
        },
    );
}

fn update_item(instances: &mut SceneInstances, item: &InstanceItem) {
    // Reflections show what an ordinary camera shows: the default layer. Of levels of detail the nearest stands for all.
    let on_default_layer = item
        .layers
        .is_none_or(|layers| layers.intersects(&RenderLayers::default()));
    let nearest_detail = item.range.is_none_or(|range| range.start_margin.start <= 0.0);
    let mesh = item
        .stand_in
        .map(|stand_in| stand_in.id())
        .or_else(|| item.mesh.map(|mesh| mesh.id()));
    let shown = !item.opted_out && item.visibility.get() && on_default_layer && nearest_detail;
    let Some(mesh) = mesh.filter(|_| shown) else {
        instances.remove(item.entity);
        return;
    };
    let own = item.transform.affine();
    // Joints place a skinned mesh, which `pose/extract.rs` follows; a stand-in has none.
    let skinned = item.skinned && item.stand_in.is_none();
    let before = instances.find(item.entity).filter(|_| skinned);
    let world_from_object = before.map_or(own, |(_, source)| source.world_from_object);
    instances.set(InstanceSource {
        entity: item.entity,
        mesh,
        material: item.material,
        world_from_object,
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
            material: AssetId::<StandardMaterial>::default().untyped(),
            world_from_object: Affine3A::IDENTITY,
            casts_shadow: true,
            receives_shadow: true,
        }
    }

    #[test]
    fn places_of_objects_follow_and_of_others_are_ignored() {
        let mut world = World::new();
        let [a, b] = [(); 2].map(|()| world.spawn_empty().id());
        let mut instances = SceneInstances::default();
        instances.set(source(a));
        instances.take_dirty();
        let place = Affine3A::from_translation(Vec3::X);
        instances.set_place(b, place);
        instances.set_place(a, Affine3A::IDENTITY);
        assert!(instances.take_moved().is_empty(), "nothing has moved that is there");
        instances.set_place(a, place);
        assert_eq!((instances.take_moved(), instances.take_dirty()), (vec![0], vec![]));
        assert_eq!(instances.get(0).map(|source| source.world_from_object), Some(place));
        // An entity of the same index that is gone.
        let gone = Entity::from_bits(a.to_bits() ^ (1 << 32));
        assert_eq!(gone.index(), a.index());
        instances.set_place(gone, Affine3A::IDENTITY);
        assert_eq!(instances.get(0).map(|source| source.world_from_object), Some(place));
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
        instances.set(InstanceSource {
            world_from_object: Affine3A::from_scale(Vec3::splat(2.0)),
            ..source(b)
        });
        assert!(instances.take_dirty().is_empty());
        assert_eq!(instances.take_moved(), [1]);
        instances.remove(a);
        instances.set(source(c));
        assert_eq!(instances.take_dirty(), [0]);
        assert_eq!(instances.get(0).map(|s| s.entity), Some(c));
        assert_eq!(instances.count, 2);
        assert_eq!(instances.meshes().count(), 1);
        instances.remove(b);
        assert_eq!(instances.slots().len(), 1, "the end of the table is free");
        instances.remove(c);
        assert!(instances.slots().is_empty());
        assert_eq!(instances.meshes().count(), 0, "nobody shows the mesh any more");
    }
}
