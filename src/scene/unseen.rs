//! Objects that rays can't see, counted by material type.

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
    platform::collections::{HashMap, HashSet},
    reflect::TypeRegistry,
};
use core::any::TypeId;

/// Every component that draws a `Mesh3d` with a material begins so.
const MATERIAL_COMPONENT: &str = "MeshMaterial3d<";
/// Frames in a row with unseen objects before the log tells: most scenes are spawned in several.
const PATIENCE: u32 = 30;

/// Archetypes whose entities are drawn with a material that rays don't know.
#[derive(Default)]
pub(super) struct UnseenArchetypes {
    looked_at: Option<ArchetypeGeneration>,
    /// With the name of the material type.
    archetypes: Vec<(ArchetypeId, String)>,
    /// What the status says.
    counts: Vec<(String, usize)>,
    frames: HashMap<String, u32>,
    told: HashSet<String>,
}

impl UnseenArchetypes {
    /// Looks at archetypes that are new since the last call.
    fn look(&mut self, archetypes: &Archetypes, unseen: impl Fn(&Archetype) -> Option<String>) {
        let before = self.looked_at.replace(archetypes.generation());
        let new = &archetypes[before.unwrap_or_else(ArchetypeGeneration::initial)..];
        let found = new
            .iter()
            .filter_map(|archetype| Some((archetype.id(), unseen(archetype)?)));
        self.archetypes.extend(found);
    }

    /// Objects by the name of their material type.
    fn count(&self, archetypes: &Archetypes) -> Vec<(String, usize)> {
        let mut counts: Vec<(String, usize)> = Vec::new();
        for (id, name) in &self.archetypes {
            let objects = archetypes.get(*id).map_or(0, |archetype| archetype.len() as usize);
            match counts.iter_mut().find(|(known, _)| known == name) {
                _ if objects == 0 => {}
                Some((_, count)) => *count += objects,
                None => counts.push((name.clone(), objects)),
            }
        }
        counts
    }

    /// Tells of each type once, when its objects have been there for a while.
    fn tell(&mut self) {
        for (name, count) in &self.counts {
            let frames = self.frames.entry(name.clone()).or_default();
            *frames += 1;
            if *frames >= PATIENCE && self.told.insert(name.clone()) {
                warn!(
                    "objects of the material type `{name}` are missing from ray-traced reflections (so far {count}): add \
                     `ReflectedMaterialPlugin::<{name}>`, give them a `ReflectedMaterial3d`, or keep them out with `NotReflected`"
                );
            }
        }
    }
}

/// Counts objects that rays can't see. Nothing is walked but archetypes, each once when it is new.
pub(super) fn count_unseen(
    archetypes: &Archetypes,
    components: &Components,
    registry: Res<AppTypeRegistry>,
    seen: Res<SeenMaterials>,
    status: Res<ReflectionStatus>,
    reflecting: Query<(), With<RayTracedReflections>>,
    mut unseen: Local<UnseenArchetypes>,
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
    if unseen.archetypes.is_empty() {
        return;
    }
    let counts = unseen.count(archetypes);
    if counts != unseen.counts {
        status.update(|report| report.unseen.clone_from(&counts));
        unseen.counts = counts;
    }
    unseen.tell();
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
