//! Extracts objects, for each component that determines the material for rays.

use super::{InstanceSource, LightmapSource, SceneInstances, details::LevelsOfDetail, lost::LostComponents};
use crate::{
    scene::{
        activity::SceneActivity,
        change_ticks::{Clock, blocks},
        render_layers::SceneLayers,
    },
    settings::{NotReflected, ReflectedMaterial3d, ReflectedMesh3d},
};
use bevy::{
    asset::UntypedAssetId,
    camera::visibility::{RenderLayers, VisibilityRange},
    ecs::{
        entity_disabling::Disabled,
        lifecycle::RemovedComponents,
        prelude::*,
        query::{ArchetypeFilter, QueryData},
        system::{ReadOnlySystemParam, StaticSystemParam, SystemParam, SystemParamItem},
    },
    light::{NotShadowCaster, NotShadowReceiver, TransmittedShadowReceiver},
    mesh::{Mesh3d, skinning::SkinnedMesh},
    pbr::{EntitiesNeedingSpecialization, Lightmap, Material, MeshMaterial3d},
    prelude::*,
    render::Extract,
};

/// A component that determines the material of an entity for rays.
pub trait MaterialComponent: Component {
    /// Entities for which this component determines the material.
    type Filter: ArchetypeFilter + 'static;

    /// Bevy's list of entities whose mesh or material changed.
    type Changes: ReadOnlySystemParam + 'static;

    /// Whether rays see another material than the one that the entity is drawn with.
    const IS_STAND_IN: bool;

    /// The material.
    fn material(&self) -> UntypedAssetId;

    /// Entities whose mesh or material changed, according to Bevy; `None` without such a list, so that all entities must be checked.
    fn changes<'a>(listed: &'a SystemParamItem<Self::Changes>) -> Option<&'a [Entity]>;
}

impl<M: Material> MaterialComponent for MeshMaterial3d<M> {
    type Filter = Without<ReflectedMaterial3d>;
    // Created by Bevy's `MaterialPlugin` in `PostUpdate`, for its own extraction.
    type Changes = Option<Res<'static, EntitiesNeedingSpecialization<M>>>;
    const IS_STAND_IN: bool = false;

    fn material(&self) -> UntypedAssetId {
        self.id().untyped()
    }

    fn changes<'a>(listed: &'a SystemParamItem<Self::Changes>) -> Option<&'a [Entity]> {
        listed.as_ref().map(|listed| listed.changed.as_slice())
    }
}

impl MaterialComponent for ReflectedMaterial3d {
    type Filter = ();
    type Changes = ();
    const IS_STAND_IN: bool = true;

    fn material(&self) -> UntypedAssetId {
        self.id().untyped()
    }

    fn changes<'a>((): &'a SystemParamItem<Self::Changes>) -> Option<&'a [Entity]> {
        None
    }
}

/// Maximum length of a list of changed entities. Instead of a longer list, the ticks of all objects are checked, which is cheaper.
const MOST_LISTED: usize = 256;

/// Entities with a mesh for rays and a material from `C`.
type IsObject<C> = (
    Or<(With<Mesh3d>, With<ReflectedMesh3d>)>,
    <C as MaterialComponent>::Filter,
);

/// Objects with their own render layers.
type IsLayered<C> = (IsObject<C>, With<RenderLayers>);

/// The parts of the main world that extraction reads.
type ObjectWorld<'w, 's, C> = (
    Query<'w, 's, InstanceQuery<C>, IsObject<C>>,
    Query<'w, 's, InstanceQuery<C>, IsLayered<C>>,
    StaticSystemParam<'w, 's, <C as MaterialComponent>::Changes>,
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
    Option<Ref<'static, TransmittedShadowReceiver>>,
    Option<Ref<'static, Lightmap>>,
    Has<SkinnedMesh>,
);

/// Values of these components.
struct InstanceItem<'a> {
    entity: Entity,
    mesh: Option<&'a Mesh3d>,
    stand_in: Option<&'a ReflectedMesh3d>,
    material: UntypedAssetId,
    is_stand_in: bool,
    transform: &'a GlobalTransform,
    visibility: &'a InheritedVisibility,
    layers: Option<&'a RenderLayers>,
    range: Option<&'a VisibilityRange>,
    opted_out: bool,
    no_shadow: bool,
    no_shadow_on_it: bool,
    shadow_through_it: bool,
    lightmap: Option<&'a Lightmap>,
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
    transmitted: RemovedComponents<'w, 's, TransmittedShadowReceiver>,
    lightmaps: RemovedComponents<'w, 's, Lightmap>,
    skins: RemovedComponents<'w, 's, SkinnedMesh>,
    disabled: RemovedComponents<'w, 's, Disabled>,
    /// Disabled entities: queries that don't mention `Disabled` no longer find them.
    now_disabled: Query<'w, 's, Entity, Added<Disabled>>,
}

/// Resources that decide which objects reflections show, besides their own components.
#[derive(SystemParam)]
pub struct Shown<'w> {
    layers: Res<'w, SceneLayers>,
    details: Res<'w, LevelsOfDetail>,
}

impl LostComponents {
    /// Records which entities lost a component in this frame.
    pub fn follow(&mut self, removed: &mut RemovedFromScene) {
        self.0.clear();
        self.0.extend(removed.meshes.read());
        self.0.extend(removed.stand_ins.read());
        self.0.extend(removed.visibilities.read());
        self.0.extend(removed.layers.read());
        self.0.extend(removed.ranges.read());
        self.0.extend(removed.opt_outs.read());
        self.0.extend(removed.casters.read());
        self.0.extend(removed.receivers.read());
        self.0.extend(removed.transmitted.read());
        self.0.extend(removed.lightmaps.read());
        self.0.extend(removed.skins.read());
        self.0.extend(removed.disabled.read());
        self.0.extend(&removed.now_disabled);
    }

    /// Drops the objects that no query has found.
    pub fn drop_objects(&mut self, instances: &mut SceneInstances) {
        for entity in self.0.drain() {
            instances.remove(entity);
        }
    }
}

/// Records which entities lost a material. Runs for all types of materials before any object is extracted, since a material of another
/// type might have replaced it.
pub fn note_lost_materials<C: MaterialComponent>(
    mut removed: Extract<RemovedComponents<C>>,
    mut lost: ResMut<LostComponents>,
) {
    lost.0.extend(removed.read());
}

/// Extracts objects with a material from `C`: the changed ones, or all after reflections were off or if cameras draw other layers.
pub fn extract_instances<C: MaterialComponent>(
    world: Extract<ObjectWorld<C>>,
    activity: Res<SceneActivity>,
    shown: Shown,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
) {
    if !activity.active {
        return;
    }
    let (all, layered, listed) = &*world;
    // Must run every frame: `drop_objects` removes the remaining entries of `lost`.
    lost.0.retain(|entity| match all.get(*entity) {
        Ok(item) => {
            update(&mut instances, &shown, item);
            false
        }
        Err(_) => true,
    });
    if activity.started || shown.layers.changed {
        for item in all {
            update(&mut instances, &shown, item);
        }
        return;
    }
    if shown.layers.lit_changed {
        for item in layered {
            update(&mut instances, &shown, item);
        }
    }
    // A changed material lists all objects that use it, although they are unchanged. For long lists, ticks are cheaper.
    let listed = C::changes(listed).filter(|listed| listed.len() <= MOST_LISTED);
    for item in listed.into_iter().flatten().filter_map(|entity| all.get(*entity).ok()) {
        update(&mut instances, &shown, item);
    }
    update_changed(&mut instances, &shown, all, listed.is_some());
}

/// Extracts entities with a changed component. Changes of mesh and material are skipped if Bevy has listed them already, which saves half
/// of all tick checks in a large world.
fn update_changed<C: MaterialComponent>(
    instances: &mut SceneInstances,
    shown: &Shown,
    all: &Query<InstanceQuery<C>, IsObject<C>>,
    without_listed: bool,
) {
    let Ok(tables) = all.contiguous_iter() else {
        // All of these components are stored in tables, unless a future version of Bevy stores one elsewhere.
        for item in all {
            if is_changed(&item) {
                update(instances, shown, item);
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
            through,
            lightmaps,
            skin,
        ) = table;
        let clock = Clock::new(transforms.this_run_tick(), transforms.last_run_tick());
        let places = transforms.changed_ticks_slice();
        let own_meshes = meshes.as_ref().filter(|_| !without_listed);
        let columns = [
            Some(visibilities.changed_ticks_slice()),
            (!without_listed).then(|| materials.changed_ticks_slice()),
            own_meshes.map(|meshes| meshes.changed_ticks_slice()),
            stand_ins.as_ref().map(|stand_ins| stand_ins.changed_ticks_slice()),
            layers.as_ref().map(|layers| layers.changed_ticks_slice()),
            ranges.as_ref().map(|ranges| ranges.changed_ticks_slice()),
            out.as_ref().map(|out| out.changed_ticks_slice()),
            caster.as_ref().map(|caster| caster.changed_ticks_slice()),
            receiver.as_ref().map(|receiver| receiver.changed_ticks_slice()),
            through.as_ref().map(|through| through.changed_ticks_slice()),
            lightmaps.as_ref().map(|lightmaps| lightmaps.changed_ticks_slice()),
        ];
        for rows in blocks(entities.len()) {
            let mut ticks = columns.iter().flatten().filter_map(|ticks| ticks.get(rows.clone()));
            let is_changed = ticks.any(|ticks| clock.any_is_new(ticks));
            if !is_changed && !clock.any_is_new(&places[rows.clone()]) {
                continue;
            }
            for row in rows {
                let mut row_ticks = columns.iter().flatten().filter_map(|ticks| ticks.get(row));
                let is_changed = is_changed && row_ticks.any(|tick| clock.is_new(*tick));
                if !is_changed {
                    // A skinned mesh is placed by its joints.
                    if !(skin && stand_ins.is_none()) && clock.is_new(places[row]) {
                        instances.set_place(entities[row], transforms[row].affine());
                    }
                    continue;
                }
                update_item(
                    instances,
                    shown,
                    &InstanceItem {
                        entity: entities[row],
                        mesh: meshes.as_ref().map(|meshes| &meshes[row]),
                        stand_in: stand_ins.as_ref().map(|stand_ins| &stand_ins[row]),
                        material: materials[row].material(),
                        is_stand_in: C::IS_STAND_IN,
                        transform: &transforms[row],
                        visibility: &visibilities[row],
                        layers: layers.as_ref().map(|layers| &layers[row]),
                        range: ranges.as_ref().map(|ranges| &ranges[row]),
                        opted_out: out.is_some(),
                        no_shadow: caster.is_some(),
                        no_shadow_on_it: receiver.is_some(),
                        shadow_through_it: through.is_some(),
                        lightmap: lightmaps.as_ref().map(|lightmaps| &lightmaps[row]),
                        skinned: skin,
                    },
                );
            }
        }
    }
}

type Item<'w, 's, C> = <InstanceQuery<C> as QueryData>::Item<'w, 's>;

fn is_changed<C: MaterialComponent>(item: &Item<C>) -> bool {
    let (
        _,
        mesh,
        stand_in,
        material,
        transform,
        visibility,
        layers,
        range,
        out,
        caster,
        receiver,
        transmitted,
        lightmap,
        _,
    ) = item;
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
        || transmitted.as_ref().is_some_and(Ref::is_changed)
        || lightmap.as_ref().is_some_and(Ref::is_changed)
}

fn update<C: MaterialComponent>(instances: &mut SceneInstances, shown: &Shown, item: Item<C>) {
    let (
        entity,
        mesh,
        stand_in,
        material,
        transform,
        visibility,
        layers,
        range,
        out,
        caster,
        receiver,
        transmitted,
        lightmap,
        skinned,
    ) = item;
    update_item(
        instances,
        shown,
        &InstanceItem {
            entity,
            mesh: mesh.as_deref(),
            stand_in: stand_in.as_deref(),
            material: material.material(),
            is_stand_in: C::IS_STAND_IN,
            transform: &transform,
            visibility: &visibility,
            layers: layers.as_deref(),
            range: range.as_deref(),
            opted_out: out.is_some(),
            no_shadow: caster.is_some(),
            no_shadow_on_it: receiver.is_some(),
            shadow_through_it: transmitted.is_some(),
            lightmap: lightmap.as_deref(),
            skinned,
        },
    );
}

fn update_item(instances: &mut SceneInstances, shown: &Shown, item: &InstanceItem) {
    let layers = &shown.layers;
    let groups = layers.groups_of(item.layers);
    let mesh = item
        .stand_in
        .map(|stand_in| stand_in.id())
        .or_else(|| item.mesh.map(|mesh| mesh.id()));
    let casts_shadow = !item.no_shadow && layers.casts_shadow(item.layers);
    let is_there = !item.opted_out && item.visibility.get() && (groups != 0 || casts_shadow);
    let Some(mesh) = mesh.filter(|_| is_there) else {
        instances.remove(item.entity);
        return;
    };
    if item.range.is_some() && !shown.details.shows(item.entity) {
        // Its mesh stays loaded, so that reflections show it as soon as it is within its range.
        instances.set_waiting(item.entity, mesh);
        return;
    }
    let own = item.transform.affine();
    // A skinned mesh is placed by its joints, in `pose/extract.rs`; a stand-in has none.
    let skinned = item.skinned && item.stand_in.is_none();
    let before = instances.find(item.entity).filter(|_| skinned);
    let world_from_object = before.map_or(own, |(_, source)| source.world_from_object);
    instances.set(InstanceSource {
        entity: item.entity,
        mesh,
        material: item.material,
        is_stand_in: item.is_stand_in,
        world_from_object,
        groups,
        casts_shadow,
        receives_shadow: !item.no_shadow_on_it,
        receives_transmitted_shadow: item.shadow_through_it,
        lightmap: item.lightmap.map(|lightmap| Box::new(LightmapSource::from(lightmap))),
    });
}

#[cfg(test)]
mod tests;
