//! Counts objects that rays can't see, by material type.

use super::reflected_material::SeenMaterials;
use crate::{
    settings::{NotReflected, RayTracedReflections, ReflectedMaterial3d},
    status::ReflectionStatus,
};
use bevy::{
    ecs::{
        archetype::{Archetype, ArchetypeGeneration, ArchetypeId, Archetypes},
        component::Components,
        entity_disabling::Disabled,
        prelude::*,
    },
    log::warn,
    mesh::Mesh3d,
    reflect::TypeRegistry,
};
use core::any::TypeId;

/// Name prefix of every component that draws a `Mesh3d` with a material.
const MATERIAL_COMPONENT: &str = "MeshMaterial3d<";
/// Number of frames with unseen objects before the log warns, since most scenes are spawned over several frames. A higher number warns
/// later, with a more accurate count.
const PATIENCE: u32 = 30;

/// A material type that rays don't support.
struct UnseenType {
    name: String,
    /// Archetypes of entities with this type.
    archetypes: Vec<ArchetypeId>,
    objects: usize,
    /// Number of frames in which there were any.
    frames: u32,
}

/// Unsupported material types of objects that should be in reflections.
#[derive(Default)]
pub(super) struct UnseenTypes {
    looked_at: Option<ArchetypeGeneration>,
    types: Vec<UnseenType>,
}

impl UnseenTypes {
    /// Checks archetypes that are new since the last call.
    fn look(&mut self, archetypes: &Archetypes, unseen: impl Fn(&Archetype) -> Option<String>) {
        let before = self.looked_at.replace(archetypes.generation());
        for archetype in &archetypes[before.unwrap_or_else(ArchetypeGeneration::initial)..] {
            let Some(name) = unseen(archetype) else { continue };
            match self.types.iter_mut().find(|known| known.name == name) {
                Some(known) => known.archetypes.push(archetype.id()),
                None => self.types.push(UnseenType {
                    name,
                    archetypes: vec![archetype.id()],
                    objects: 0,
                    frames: 0,
                }),
            }
        }
    }

    /// Counts objects. Warns of each type once, after its objects have existed for a while. Returns whether a number has changed.
    fn count(&mut self, archetypes: &Archetypes) -> bool {
        let mut changed = false;
        for unseen in &mut self.types {
            let sizes = unseen.archetypes.iter().filter_map(|id| archetypes.get(*id));
            let objects = sizes.map(|archetype| archetype.len() as usize).sum();
            changed |= core::mem::replace(&mut unseen.objects, objects) != objects;
            if objects > 0 && unseen.frames < PATIENCE {
                unseen.frames += 1;
                if unseen.frames == PATIENCE {
                    let name = &unseen.name;
                    warn!(
                        "objects of the material type `{name}` are missing from ray-traced reflections (so far {objects}): add \
                         `ReflectedMaterialPlugin::<{name}>`, give them a `ReflectedMaterial3d`, or keep them out with `NotReflected`"
                    );
                }
            }
        }
        changed
    }

    /// Types with objects, and the number of objects.
    fn report(&self) -> Vec<(String, usize)> {
        let there = self.types.iter().filter(|unseen| unseen.objects > 0);
        there.map(|unseen| (unseen.name.clone(), unseen.objects)).collect()
    }
}

/// Counts objects that rays can't see. Only visits archetypes, each once when it is new.
pub(super) fn count_unseen(
    archetypes: &Archetypes,
    components: &Components,
    registry: Res<AppTypeRegistry>,
    seen: Res<SeenMaterials>,
    status: Res<ReflectionStatus>,
    reflecting: Query<(), With<RayTracedReflections>>,
    mut unseen: Local<UnseenTypes>,
) {
    if reflecting.is_empty() {
        return;
    }
    if unseen.looked_at != Some(archetypes.generation()) {
        let registry = registry.read();
        unseen.look(archetypes, |archetype| {
            unseen_material(archetype, components, &registry, &seen)
        });
    }
    if unseen.count(archetypes) {
        status.update(|report| report.unseen = unseen.report());
    }
}

/// The name of the material type of an archetype's entities, if rays can't see them.
fn unseen_material(
    archetype: &Archetype,
    components: &Components,
    registry: &TypeRegistry,
    seen: &SeenMaterials,
) -> Option<String> {
    let has = |of: TypeId| components.get_id(of).is_some_and(|id| archetype.contains(id));
    let keeps_out = [
        TypeId::of::<ReflectedMaterial3d>(),
        TypeId::of::<NotReflected>(),
        TypeId::of::<Disabled>(),
    ];
    if !has(TypeId::of::<Mesh3d>()) || keeps_out.into_iter().any(has) {
        return None;
    }
    let types = archetype.components().iter();
    let types = types.filter_map(|id| components.get_info(*id)?.type_id());
    let mut name = None;
    for of in types {
        let path = registry
            .get(of)
            .map(|registration| registration.type_info().type_path_table().short_path());
        if let Some(material) = path.and_then(|path| path.strip_prefix(MATERIAL_COMPONENT)) {
            if seen.contains(of) {
                return None;
            }
            name = material.strip_suffix('>').map(str::to_owned);
        }
    }
    name
}
