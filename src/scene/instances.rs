//! The objects that rays can hit, extracted from the main world; `instances/extract.rs` tracks their changes.

pub(in crate::scene) mod details;
pub(in crate::scene) mod extract;
mod lightmap;
pub(in crate::scene) mod lost;
mod movement;
mod users;

use super::free_slots::{FreeSlots, shrink};
use bevy::{
    asset::UntypedAssetId,
    ecs::entity::{EntityGeneration, EntityHashMap},
    math::Affine3A,
    mesh::Mesh,
    platform::collections::HashMap,
    prelude::*,
};

pub use lightmap::LightmapSource;
pub use movement::Movement;

use users::SlotUsers;

/// An object of the main world.
#[derive(Clone, Debug, PartialEq)]
pub struct InstanceSource {
    /// The entity of the main world.
    pub entity: Entity,
    /// Its mesh.
    pub mesh: AssetId<Mesh>,
    /// Its material, of any type that rays support.
    pub material: UntypedAssetId,
    /// The material stands in for another one.
    pub is_stand_in: bool,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Groups of its render layers, as bits of its flags: `render_layers.rs`. None if it only casts shadows.
    pub groups: u32,
    /// Whether it blocks shadow rays.
    pub casts_shadow: bool,
    /// Whether it receives shadows.
    pub receives_shadow: bool,
    /// Whether the light that passes through it receives shadows.
    pub receives_transmitted_shadow: bool,
    /// Its baked light. Boxed, since few objects have a lightmap.
    pub lightmap: Option<Box<LightmapSource>>,
}

impl InstanceSource {
    /// An object without its own properties.
    #[cfg(test)]
    pub(super) fn plain(entity: Entity) -> Self {
        Self {
            entity,
            mesh: AssetId::default(),
            material: AssetId::<StandardMaterial>::default().untyped(),
            is_stand_in: false,
            world_from_object: Affine3A::IDENTITY,
            groups: 0,
            casts_shadow: true,
            receives_shadow: true,
            receives_transmitted_shadow: false,
            lightmap: None,
        }
    }

    fn is_same_apart_from_place(&self, other: &Self) -> bool {
        let Self {
            entity,
            mesh,
            material,
            is_stand_in,
            world_from_object: _,
            groups,
            casts_shadow,
            receives_shadow,
            receives_transmitted_shadow,
            lightmap,
        } = self;
        (*entity, *mesh, *material) == (other.entity, other.mesh, other.material)
            && *is_stand_in == other.is_stand_in
            && (*groups, *casts_shadow, *receives_shadow) == (other.groups, other.casts_shadow, other.receives_shadow)
            && *receives_transmitted_shadow == other.receives_transmitted_shadow
            && *lightmap == other.lightmap
    }
}

/// Maximum number of objects that get another slot in one frame. Each counts as a removed and an added object, and with ray queries, this
/// many cause a build over all objects. A higher number makes such a frame longer; a lower one causes more such frames.
const MOVES_PER_FRAME: usize = 2048;
/// A table of this many slots isn't worth compacting.
const SHORT: usize = 64;

/// Placeholder for entities without a slot.
const NO_SLOT: u32 = u32::MAX;

/// The slot of an entity. Earlier and later entities with the same index have another generation.
#[derive(Clone, Copy)]
struct Seat {
    /// Or [`NO_SLOT`].
    slot: u32,
    generation: EntityGeneration,
}

impl Seat {
    const EMPTY: Self = Self {
        slot: NO_SLOT,
        generation: EntityGeneration::FIRST,
    };
}

/// An object that got another mesh.
struct Remeshed {
    entity: Entity,
    last: AssetId<Mesh>,
    now: AssetId<Mesh>,
}

/// All traced objects in stable slots: a slot is the object's index in the GPU's instance buffer.
#[derive(Resource, Default)]
pub struct SceneInstances {
    slots: Vec<Option<InstanceSource>>,
    free: FreeSlots,
    /// By entity index, so that finding an object's slot doesn't need to load the object.
    by_entity: Vec<Seat>,
    count: usize,
    by_mesh: SlotUsers<AssetId<Mesh>>,
    by_material: SlotUsers<UntypedAssetId>,
    /// Number of objects that use each mesh, including waiting ones.
    mesh_users: HashMap<AssetId<Mesh>, u32>,
    /// Objects that got another mesh in this frame.
    remeshed: Vec<Remeshed>,
    /// Next meshes of objects that keep their last mesh until the next one is ready.
    coming: EntityHashMap<AssetId<Mesh>>,
    /// Hidden objects that can appear at any time, with their meshes: levels of detail.
    waiting: EntityHashMap<AssetId<Mesh>>,
    /// Meshes that an object uses for the first time.
    new_meshes: Vec<AssetId<Mesh>>,
    dirty: Vec<u32>,
    moved: Vec<Movement>,
    /// Moves of objects to other slots: from and to.
    relocated: Vec<[u32; 2]>,
}

impl SceneInstances {
    /// The slots up to the last object; some are empty.
    pub fn slots(&self) -> &[Option<InstanceSource>] {
        &self.slots
    }

    /// The object in a slot.
    pub fn get(&self, slot: u32) -> Option<&InstanceSource> {
        self.slots.get(slot as usize).and_then(Option::as_ref)
    }

    /// Transform of the object in a slot.
    pub fn place_of(&self, slot: u32) -> Option<Affine3A> {
        self.get(slot).map(|source| source.world_from_object)
    }

    /// Meshes that objects began to use since the last call. Some might be unused by now.
    pub fn take_new_meshes(&mut self) -> Vec<AssetId<Mesh>> {
        core::mem::take(&mut self.new_meshes)
    }

    /// Slots of objects that use a mesh.
    pub fn slots_of_mesh(&self, mesh: AssetId<Mesh>) -> impl Iterator<Item = u32> + '_ {
        self.by_mesh.of(mesh)
    }

    /// Slots of objects that have a material.
    pub fn slots_of_material(&self, material: UntypedAssetId) -> impl Iterator<Item = u32> + '_ {
        self.by_material.of(material)
    }

    /// Returns whether an object uses a mesh, or waits with it.
    pub fn shows(&self, mesh: AssetId<Mesh>) -> bool {
        self.mesh_users.contains_key(&mesh)
    }

    /// Returns whether there are no objects, not even waiting ones.
    pub fn is_empty(&self) -> bool {
        self.count == 0 && self.waiting.is_empty()
    }

    /// Movements of objects since the last call, by slot. The objects might have changed otherwise, too.
    pub fn take_moved(&mut self) -> Vec<Movement> {
        let mut moved = core::mem::take(&mut self.moved);
        // Stable, so that movements of an object stay in order.
        moved.sort_by_key(|moved| moved.slot);
        moved.dedup_by(|later, first| {
            let is_same = later.slot == first.slot;
            if is_same {
                first.add(later);
            }
            is_same
        });
        moved
    }

    /// Slots that changed other than by moving since the last call, without duplicates.
    pub fn take_dirty(&mut self) -> Vec<u32> {
        let mut dirty = core::mem::take(&mut self.dirty);
        dirty.sort_unstable();
        dirty.dedup();
        dirty
    }

    /// Moves of objects between slots since the last call, in order, as from and to. Both slots count as changed.
    pub fn take_relocated(&mut self) -> Vec<[u32; 2]> {
        core::mem::take(&mut self.relocated)
    }

    /// Adds or replaces an object. Does nothing if it is unchanged.
    pub fn set(&mut self, source: InstanceSource) {
        let index = source.entity.index_u32() as usize;
        if index >= self.by_entity.len() {
            self.by_entity.resize(index + 1, Seat::EMPTY);
        }
        let mut slot = self.by_entity[index].slot;
        if slot == NO_SLOT {
            let slots = &self.slots;
            let free = self.free.take(slots.len(), |slot| slots[slot as usize].is_none());
            slot = free.unwrap_or_else(|| {
                self.slots.push(None);
                self.slots.len() as u32 - 1
            });
            self.count += 1;
        }
        self.by_entity[index] = Seat {
            slot,
            generation: source.entity.generation(),
        };
        let place = &mut self.slots[slot as usize];
        if let Some(before) = place
            && before.world_from_object != source.world_from_object
            && before.is_same_apart_from_place(&source)
        {
            let from = core::mem::replace(&mut before.world_from_object, source.world_from_object);
            self.moved.push(Movement::new(slot, &from, &source.world_from_object));
        } else if place.as_ref() != Some(&source) {
            let (entity, mesh, material) = (source.entity, source.mesh, source.material);
            let replaced = place.replace(source);
            self.dirty.push(slot);
            self.use_mesh(mesh);
            self.forget_coming(entity);
            let last = replaced.as_ref().map(|source| source.mesh);
            self.by_mesh.replace(slot, last, Some(mesh));
            let last_material = replaced.as_ref().map(|source| source.material);
            self.by_material.replace(slot, last_material, Some(material));
            if let Some(last) = last.filter(|last| *last != mesh) {
                let now = mesh;
                self.remeshed.push(Remeshed { entity, last, now });
            }
            self.release_mesh(last);
            self.release(entity);
        }
    }

    /// Removes an object if it exists, and keeps its mesh loaded.
    pub fn set_waiting(&mut self, entity: Entity, mesh: AssetId<Mesh>) {
        self.use_mesh(mesh);
        self.remove(entity);
        self.waiting.insert(entity, mesh);
    }

    /// Stops waiting for an object.
    pub fn release(&mut self, entity: Entity) {
        if !self.waiting.is_empty() {
            let mesh = self.waiting.remove(&entity);
            self.release_mesh(mesh);
        }
    }

    fn slot_of(&self, entity: Entity) -> Option<u32> {
        let seat = self.by_entity.get(entity.index_u32() as usize)?;
        (seat.generation == entity.generation() && seat.slot != NO_SLOT).then_some(seat.slot)
    }

    /// Returns an object and its slot, if it exists.
    pub fn find(&self, entity: Entity) -> Option<(u32, &InstanceSource)> {
        let slot = self.slot_of(entity)?;
        Some((slot, self.get(slot)?))
    }

    /// Moves an object if it exists.
    pub fn set_place(&mut self, entity: Entity, world_from_object: Affine3A) {
        if let Some(slot) = self.slot_of(entity) {
            self.place(slot, world_from_object);
        }
    }

    /// Moves an object. Does nothing if its transform is unchanged.
    pub fn place(&mut self, slot: u32, world_from_object: Affine3A) {
        if let Some(Some(source)) = self.slots.get_mut(slot as usize)
            && source.world_from_object != world_from_object
        {
            let from = core::mem::replace(&mut source.world_from_object, world_from_object);
            self.moved.push(Movement::new(slot, &from, &world_from_object));
        }
    }

    /// Removes an object if it exists.
    pub fn remove(&mut self, entity: Entity) {
        self.release(entity);
        let Some(slot) = self.slot_of(entity) else {
            return;
        };
        self.by_entity[entity.index_u32() as usize] = Seat::EMPTY;
        self.count -= 1;
        let removed = self.slots[slot as usize].take();
        self.forget_coming(entity);
        let mesh = removed.as_ref().map(|source| source.mesh);
        self.by_mesh.replace(slot, mesh, None);
        self.by_material
            .replace(slot, removed.map(|source| source.material), None);
        self.free.give(slot);
        self.cut();
        self.dirty.push(slot);
        self.release_mesh(mesh);
    }

    /// Objects that got another mesh in this frame keep their last one if `stays` returns true for the last and the new mesh.
    pub fn keep_last_meshes(&mut self, stays: impl Fn(AssetId<Mesh>, AssetId<Mesh>) -> bool) {
        for Remeshed { entity, last, now } in core::mem::take(&mut self.remeshed) {
            // It might be gone, or have got yet another mesh.
            let slot = self.find(entity).filter(|(_, source)| source.mesh == now);
            let Some(slot) = slot.map(|(slot, _)| slot).filter(|_| stays(last, now)) else {
                continue;
            };
            self.use_mesh(last);
            self.show_mesh(slot, last);
            self.coming.insert(entity, now);
        }
    }

    /// Switches objects to the mesh that they wait for, unless it is still expected.
    pub fn show_new_meshes(&mut self, is_expected: impl Fn(AssetId<Mesh>) -> bool) {
        if self.coming.is_empty() {
            return;
        }
        let mut coming = core::mem::take(&mut self.coming);
        for (entity, now) in coming.extract_if(|_, mesh| !is_expected(*mesh)) {
            let found = self.find(entity).map(|(slot, source)| (slot, source.mesh));
            if let Some((slot, last)) = found {
                self.show_mesh(slot, now);
                self.release_mesh(Some(last));
            }
        }
        self.coming = coming;
    }

    /// Returns whether an object keeps this mesh only until its next one is ready.
    pub fn keeps_for_now(&self, mesh: AssetId<Mesh>) -> bool {
        let mut objects = self.slots_of_mesh(mesh).filter_map(|slot| self.get(slot));
        !self.coming.is_empty() && objects.any(|source| self.coming.contains_key(&source.entity))
    }

    fn show_mesh(&mut self, slot: u32, mesh: AssetId<Mesh>) {
        if let Some(Some(source)) = self.slots.get_mut(slot as usize) {
            self.by_mesh.replace(slot, Some(source.mesh), Some(mesh));
            source.mesh = mesh;
            self.dirty.push(slot);
        }
    }

    fn forget_coming(&mut self, entity: Entity) {
        if !self.coming.is_empty() {
            let mesh = self.coming.remove(&entity);
            self.release_mesh(mesh);
        }
    }

    /// Moves some objects from the end of the table to free slots, if three quarters of it are free. Must run before extraction, which
    /// reads this frame's slots.
    pub(super) fn compact(&mut self) {
        for _ in 0..MOVES_PER_FRAME {
            let len = self.slots.len();
            if len <= SHORT || self.count > len / 4 {
                break;
            }
            let slots = &self.slots;
            let Some(slot) = self.free.take(len, |slot| slots[slot as usize].is_none()) else {
                break;
            };
            // The last slot is never free.
            let Some(source) = self.slots.pop().flatten() else {
                break;
            };
            self.by_entity[source.entity.index_u32() as usize].slot = slot;
            let last = len as u32 - 1;
            self.by_mesh.replace(last, Some(source.mesh), None);
            self.by_mesh.replace(slot, None, Some(source.mesh));
            self.by_material.replace(last, Some(source.material), None);
            self.by_material.replace(slot, None, Some(source.material));
            self.slots[slot as usize] = Some(source);
            self.dirty.extend([slot, last]);
            self.relocated.push([last, slot]);
            self.cut();
        }
        shrink(&mut self.slots);
        self.by_mesh.truncate(self.slots.len());
        self.by_material.truncate(self.slots.len());
    }

    /// Truncates the table after the last object.
    fn cut(&mut self) {
        while let Some(None) = self.slots.last() {
            self.slots.pop();
        }
    }

    fn use_mesh(&mut self, mesh: AssetId<Mesh>) {
        let users = self.mesh_users.entry(mesh).or_default();
        *users += 1;
        if *users == 1 {
            self.new_meshes.push(mesh);
        }
    }

    fn release_mesh(&mut self, gone: Option<AssetId<Mesh>>) {
        let Some(mesh) = gone else { return };
        if let Some(users) = self.mesh_users.get_mut(&mesh) {
            *users -= 1;
            if *users == 0 {
                self.mesh_users.remove(&mesh);
            }
        }
    }

    /// Removes everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_objects_follow_and_of_others_are_ignored() {
        let mut world = World::new();
        let [a, b] = [(); 2].map(|()| world.spawn_empty().id());
        let mut instances = SceneInstances::default();
        instances.set(InstanceSource::plain(a));
        instances.take_dirty();
        let place = Affine3A::from_translation(Vec3::X);
        instances.set_place(b, place);
        instances.set_place(a, Affine3A::IDENTITY);
        assert!(instances.take_moved().is_empty(), "nothing has moved that is there");
        instances.set_place(a, place);
        let moved = Movement::new(0, &Affine3A::IDENTITY, &place);
        assert_eq!((instances.take_moved(), instances.take_dirty()), (vec![moved], vec![]));
        assert_eq!(instances.get(0).map(|source| source.world_from_object), Some(place));
        // A removed entity with the same index.
        let gone = Entity::from_bits(a.to_bits() ^ (1 << 32));
        assert_eq!(gone.index(), a.index());
        instances.set_place(gone, Affine3A::IDENTITY);
        assert_eq!(instances.get(0).map(|source| source.world_from_object), Some(place));
    }

    #[test]
    fn objects_that_wait_keep_their_meshes() {
        let mut world = World::new();
        let [a, b] = [(); 2].map(|()| world.spawn_empty().id());
        let mesh = AssetId::default();
        let mut instances = SceneInstances::default();
        instances.set_waiting(a, mesh);
        assert!(instances.shows(mesh) && instances.count == 0);
        assert_eq!(instances.take_new_meshes(), [mesh]);
        instances.set(InstanceSource::plain(a));
        instances.set_waiting(a, mesh);
        instances.set_waiting(a, mesh);
        assert!(instances.count == 0 && instances.take_new_meshes().is_empty());
        instances.set(InstanceSource::plain(b));
        instances.release(a);
        assert!(instances.shows(mesh));
        instances.remove(b);
        assert!(!instances.shows(mesh) && instances.mesh_users.is_empty());
        instances.set_waiting(a, mesh);
        instances.remove(a);
        assert!(instances.is_empty() && !instances.shows(mesh));
    }

    fn mesh(number: u128) -> AssetId<Mesh> {
        AssetId::Uuid {
            uuid: bevy::asset::uuid::Uuid::from_u128(number),
        }
    }

    #[test]
    fn slots_are_found_by_their_mesh_and_material() {
        let mut world = World::new();
        let entities: Vec<_> = (0..100).map(|_| world.spawn_empty().id()).collect();
        let mut instances = SceneInstances::default();
        let source = |index: usize| InstanceSource {
            mesh: mesh(1 + index as u128 % 2),
            ..InstanceSource::plain(entities[index])
        };
        (0..100).for_each(|index| instances.set(source(index)));
        assert_eq!(instances.slots_of_mesh(mesh(1)).count(), 50);
        let material = AssetId::<StandardMaterial>::default().untyped();
        assert_eq!(instances.slots_of_material(material).count(), 100);
        // After these are removed, the rest moves to the beginning of the table.
        (0..90).for_each(|index| instances.remove(entities[index]));
        (0..3).for_each(|_| instances.compact());
        for number in [1, 2] {
            let slots: Vec<u32> = instances.slots_of_mesh(mesh(number)).collect();
            assert_eq!(slots.len(), 5);
            let shows = |slot: &u32| instances.get(*slot).is_some_and(|source| source.mesh == mesh(number));
            assert!(slots.iter().all(shows), "{slots:?}");
        }
        assert_eq!(instances.slots_of_material(material).count(), 10);
    }

    #[test]
    fn an_object_shows_its_last_mesh_until_the_new_one_is_there() {
        let mut world = World::new();
        let entity = world.spawn_empty().id();
        let mut instances = SceneInstances::default();
        let with = |number: u128| InstanceSource {
            mesh: mesh(number),
            ..InstanceSource::plain(entity)
        };
        let shown = |instances: &SceneInstances| instances.get(0).map(|source| source.mesh);
        instances.set(with(1));
        instances.keep_last_meshes(|_, _| true);
        instances.set(with(2));
        instances.keep_last_meshes(|last, now| (last, now) == (mesh(1), mesh(2)));
        assert_eq!(shown(&instances), Some(mesh(1)));
        assert!(instances.shows(mesh(1)) && instances.shows(mesh(2)), "both stay loaded");
        assert!(instances.keeps_for_now(mesh(1)) && !instances.keeps_for_now(mesh(2)));
        // It gets yet another mesh, and changes otherwise.
        instances.set(with(3));
        instances.keep_last_meshes(|last, _| last == mesh(1));
        assert!(!instances.shows(mesh(2)));
        instances.set(InstanceSource {
            casts_shadow: false,
            ..with(3)
        });
        instances.keep_last_meshes(|last, _| last == mesh(1));
        assert_eq!(shown(&instances), Some(mesh(1)));
        instances.show_new_meshes(|_| true);
        assert_eq!(shown(&instances), Some(mesh(1)), "it is still expected");
        instances.take_dirty();
        instances.show_new_meshes(|_| false);
        assert_eq!((shown(&instances), instances.take_dirty()), (Some(mesh(3)), vec![0]));
        assert!(instances.slots_of_mesh(mesh(3)).eq([0]) && !instances.shows(mesh(1)));
        // No mesh is used any more after the object is removed.
        instances.set(with(4));
        instances.keep_last_meshes(|_, _| true);
        instances.remove(entity);
        instances.show_new_meshes(|_| false);
        assert!(instances.mesh_users.is_empty() && instances.coming.is_empty());
    }

    #[test]
    fn a_table_that_is_nearly_empty_becomes_short() {
        const CROWD: usize = 20_000;
        let mut world = World::new();
        let entities: Vec<_> = (0..CROWD).map(|_| world.spawn_empty().id()).collect();
        let mut instances = SceneInstances::default();
        for entity in &entities {
            instances.set(InstanceSource::plain(*entity));
        }
        let (gone, rest) = entities.split_at(CROWD - 4_000);
        let (going, last) = rest.split_at(3_999);
        gone.iter().for_each(|entity| instances.remove(*entity));
        instances.take_dirty();
        instances.compact();
        let dirty = instances.take_dirty();
        assert_eq!(dirty.len(), 2 * MOVES_PER_FRAME, "only so many in one frame");
        let relocated = instances.take_relocated();
        assert!(relocated.iter().flatten().all(|slot| dirty.contains(slot)));
        assert_eq!(relocated.len(), MOVES_PER_FRAME);
        assert!(dirty.iter().all(|slot| {
            let object = instances.get(*slot);
            object.is_none_or(|object| instances.slot_of(object.entity) == Some(*slot))
        }));
        (0..100).for_each(|_| instances.compact());
        assert!(instances.slots().len() <= 16_000, "{} slots", instances.slots().len());
        going.iter().for_each(|entity| instances.remove(*entity));
        instances.compact();
        assert!(instances.slots().len() <= SHORT && instances.slots.capacity() <= 4 * SHORT);
        let slot = instances.slot_of(last[0]).unwrap();
        assert_eq!(instances.get(slot).map(|object| object.entity), Some(last[0]));
        assert_eq!((instances.count, instances.shows(AssetId::default())), (1, true));
        for entity in &entities[..100] {
            instances.set(InstanceSource::plain(*entity));
        }
        assert_eq!(instances.slots().len(), 101, "no slot is used twice");
    }

    #[test]
    fn slots_are_stable_and_reused() {
        let mut world = World::new();
        let [a, b, c] = [(); 3].map(|()| world.spawn_empty().id());
        let mut instances = SceneInstances::default();
        instances.set(InstanceSource::plain(a));
        instances.set(InstanceSource::plain(b));
        assert_eq!(instances.take_dirty(), [0, 1]);
        instances.set(InstanceSource::plain(a));
        assert!(instances.take_dirty().is_empty(), "nothing changed");
        instances.set(InstanceSource {
            world_from_object: Affine3A::from_scale(Vec3::splat(2.0)),
            ..InstanceSource::plain(b)
        });
        assert!(instances.take_dirty().is_empty());
        let moved = instances.take_moved();
        assert_eq!((moved.len(), moved[0].slot), (1, 1));
        instances.remove(a);
        instances.set(InstanceSource::plain(c));
        assert_eq!(instances.take_dirty(), [0]);
        assert_eq!(instances.get(0).map(|s| s.entity), Some(c));
        assert_eq!(instances.count, 2);
        let mesh = AssetId::default();
        assert!(instances.shows(mesh));
        assert_eq!(instances.take_new_meshes(), [mesh], "it is new once");
        instances.remove(b);
        assert_eq!(instances.slots().len(), 1, "the end of the table is free");
        instances.remove(c);
        assert!(instances.slots().is_empty());
        assert!(!instances.shows(mesh), "nobody shows the mesh any more");
        instances.set(InstanceSource::plain(a));
        assert_eq!(instances.take_new_meshes(), [mesh]);
    }
}
