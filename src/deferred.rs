//! Makes opaque materials deferred, and every 3D camera able to draw them.
//!
//! Rays start from Bevy's G-buffer, which only deferred materials write. For others, rays fill a second one (`front_layer/`), which costs
//! more and is opt-in. Bevy doesn't draw deferred materials on cameras without a `DeferredPrepass`, and panics if such a camera has other
//! prepasses. Therefore, all 3D cameras get it, whether they reflect or not: otherwise, the objects of a mini map would vanish when the
//! main camera begins to reflect. A camera without reflections pays for the G-buffer. The alternative is to make materials deferred only
//! while a camera reflects. It would prepare all materials again at each switch, and other cameras would lose their objects meanwhile.
//!
//! An extended material with a custom shader can lack one for the G-buffer: Bevy would draw only its base there. A material without a
//! prepass wouldn't be drawn at all. Such materials stay forward.

use crate::{device::tracing_app, settings::ReflectionFallback};
use bevy::{
    app::{App, Plugin, PostUpdate},
    asset::{AssetId, AssetServer, Handle, UntypedAssetId},
    camera::Camera3d,
    core_pipeline::{
        core_3d::check_msaa,
        prepass::{DeferredPrepass, DepthPrepass},
    },
    ecs::{
        archetype::{ArchetypeGeneration, Archetypes},
        change_detection::Tick,
        component::Components,
        prelude::*,
    },
    log::{debug, info},
    material::{AlphaMode, MaterialProperties, OpaqueRendererMethod},
    pbr::{
        DefaultOpaqueRendererMethod, DeferredFragmentShader, DeferredVertexShader, Material, MaterialFragmentShader,
        MaterialVertexShader, PreparedMaterial, StandardMaterial, deferred::insert_deferred_lighting_pass_id_component,
    },
    platform::collections::{HashMap, HashSet},
    reflect::{GenericInfo, PartialReflect, TypeRegistry},
    render::{
        Extract, ExtractSchedule, Render, RenderApp, RenderSystems, erased_render_asset::ErasedRenderAssets,
        sync_world::SyncToRenderWorld, view::Msaa,
    },
    shader::{Shader, ShaderRef},
};
use core::any::TypeId;
use std::sync::{Arc, Weak};

/// Makes opaque materials deferred, unless the app later chooses another method, or nothing reflects because the device can't trace.
///
/// Must be added after `ProbePlugin`, which detects the latter.
pub(crate) struct DeferredPlugin {
    /// Screen-space reflections need deferred materials, too.
    pub fallback: ReflectionFallback,
}

/// The method that ours replaced, while plugins are being added.
#[derive(Resource)]
struct Replaced {
    method: DefaultOpaqueRendererMethod,
    at: Tick,
}

impl Plugin for DeferredPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        let world = app.world_mut();
        let method = world.get_resource::<DefaultOpaqueRendererMethod>().cloned();
        // The tick distinguishes this change from the app's changes.
        world.increment_change_tick();
        world.insert_resource(DefaultOpaqueRendererMethod::deferred());
        let at = world.increment_change_tick();
        world.insert_resource(Replaced {
            method: method.unwrap_or_default(),
            at,
        });
    }

    fn finish(&self, app: &mut App) {
        let needed = tracing_app(app).is_some() || self.fallback == ReflectionFallback::ScreenSpace;
        let world = app.world_mut();
        let Some(replaced) = world.remove_resource::<Replaced>() else {
            return;
        };
        if !needed {
            let method = world.get_resource_ref::<DefaultOpaqueRendererMethod>();
            if method.is_some_and(|method| method.last_changed() == replaced.at) {
                world.insert_resource(replaced.method);
            }
            return;
        }
        if world.get_resource().is_some_and(is_deferred) {
            require_prepass(world);
        }
        app.add_systems(
            PostUpdate,
            add_prepass
                .run_if(|method: Option<Res<DefaultOpaqueRendererMethod>>| method.is_some_and(|m| is_deferred(&m)))
                .before(check_msaa)
                .before(insert_deferred_lighting_pass_id_component),
        );
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            render_app
                .init_resource::<UsedMaterials>()
                .add_systems(ExtractSchedule, find_used_materials);
            render_app.add_systems(
                Render,
                // Runs before the prepass is specialized.
                keep_own_shaders
                    .after(RenderSystems::PrepareAssets)
                    .before(RenderSystems::PrepareMeshes),
            );
        }
    }
}

/// Returns whether opaque materials are deferred by default.
pub(crate) fn is_deferred(method: &DefaultOpaqueRendererMethod) -> bool {
    method.reflect_partial_eq(&DefaultOpaqueRendererMethod::deferred()) == Some(true)
}

/// Makes deferred rendering a requirement of 3D cameras, so that they support it from their first frame on. A camera's own `Msaa` stays;
/// Bevy switches it off with a warning.
fn require_prepass(world: &mut World) {
    let result = world
        .try_register_required_components::<Camera3d, DepthPrepass>()
        .and_then(|()| world.try_register_required_components::<Camera3d, DeferredPrepass>())
        .and_then(|()| world.try_register_required_components_with::<Camera3d, Msaa>(|| Msaa::Off));
    if let Err(error) = result {
        // Cameras exist already. The system below does the same, a little later.
        debug!("{error}");
    }
}

/// Cameras that Bevy draws without the prepasses of deferred materials. `remove_with_requires` also removes `SyncToRenderWorld`: Bevy then
/// no longer draws the camera, and panics if the component is added again.
type Lacking = (With<Camera3d>, With<SyncToRenderWorld>, Without<DeferredPrepass>);

/// Cameras that existed before, and cameras that lost the component.
fn add_prepass(cameras: Query<Entity, Lacking>, mut commands: Commands) {
    for camera in &cameras {
        commands
            .entity(camera)
            .insert((DepthPrepass, DeferredPrepass))
            .insert_if_new(Msaa::Off);
    }
}

/// Name of every component that draws a `Mesh3d` with a material.
const MATERIAL_COMPONENT: &str = "MeshMaterial3d";

/// Types of materials that entities of the main world have or had, with their names.
#[derive(Resource, Default)]
struct UsedMaterials {
    looked_at: Option<ArchetypeGeneration>,
    names: HashMap<TypeId, &'static str>,
}

/// Finds types of materials. Only visits archetypes, each once when it is new.
fn find_used_materials(
    archetypes: Extract<&Archetypes>,
    components: Extract<&Components>,
    registry: Extract<Res<AppTypeRegistry>>,
    mut used: ResMut<UsedMaterials>,
) {
    let generation = archetypes.generation();
    if used.looked_at == Some(generation) {
        return;
    }
    let before = used.bypass_change_detection().looked_at.replace(generation);
    let registry = registry.read();
    for archetype in &archetypes[before.unwrap_or_else(ArchetypeGeneration::initial)..] {
        let types = archetype.components().iter();
        let types = types.filter_map(|id| components.get_info(*id)?.type_id());
        for (material, name) in types.filter_map(|of| material_of(of, &registry)) {
            if !used.names.contains_key(&material) {
                used.names.insert(material, name);
            }
        }
    }
}

/// The type and name of the material of entities with such a component.
fn material_of(component: TypeId, registry: &TypeRegistry) -> Option<(TypeId, &'static str)> {
    let info = registry.get(component)?.type_info();
    if info.type_path_table().ident() != Some(MATERIAL_COMPONENT) {
        return None;
    }
    match info.generics().first()? {
        GenericInfo::Type(material) => Some((material.ty().id(), material.ty().short_path())),
        GenericInfo::Const(_) => None,
    }
}

/// Materials with shaders that the G-buffer would lose.
#[derive(Default)]
struct Lossy {
    /// By type of material. All materials of a type have the same shaders, so each type is checked once.
    types: HashMap<TypeId, bool>,
    /// Properties of the materials, which change if a material is prepared again. The references are weak; a plain address could be reused
    /// by later properties.
    known: HashMap<UntypedAssetId, Weak<MaterialProperties>>,
    /// Types that were logged.
    told: HashSet<TypeId>,
}

/// Draws materials in the forward pass if the G-buffer would not show them correctly. Materials that were prepared before the app chose
/// deferred rendering don't change, like all others in Bevy.
fn keep_own_shaders(
    mut materials: ResMut<ErasedRenderAssets<PreparedMaterial>>,
    used: Res<UsedMaterials>,
    method: Option<Res<DefaultOpaqueRendererMethod>>,
    server: Res<AssetServer>,
    mut lossy: Local<Lossy>,
) {
    if !materials.is_changed() && !used.is_changed() {
        return;
    }
    let Lossy { types, known, told } = &mut *lossy;
    // Bevy doesn't report the materials that it has prepared, and worlds have thousands: they are only visited if one could lose its
    // shader.
    if used.names.keys().all(|kind| types.get(kind) == Some(&false)) {
        return;
    }
    let is_deferred = method.is_some_and(|method| is_deferred(&method));
    // Most materials are of one type.
    let mut last = None;
    let mut has_changed = false;
    for (id, material) in materials.bypass_change_detection().iter_mut() {
        let kind = id.type_id();
        let loses = match last {
            Some((last, loses)) if last == kind => loses,
            _ => *types
                .entry(kind)
                .or_insert_with(|| is_lost(&material.properties, &server)),
        };
        last = Some((kind, loses));
        if !loses {
            continue;
        }
        let properties = &mut material.properties;
        if known
            .get(&id)
            .is_some_and(|known| known.as_ptr() == Arc::as_ptr(properties))
        {
            continue;
        }
        let is_drawn_deferred = properties.render_method == OpaqueRendererMethod::Deferred
            && matches!(properties.alpha_mode, AlphaMode::Opaque | AlphaMode::Mask(_));
        // No other code has a reference to a material that was just prepared.
        if is_deferred
            && is_drawn_deferred
            && let Some(properties) = Arc::get_mut(properties)
        {
            properties.render_method = OpaqueRendererMethod::Forward;
            has_changed = true;
            if told.insert(kind) {
                tell_of(used.names.get(&kind).copied().unwrap_or("unknown"));
            }
        }
        known.insert(id, Arc::downgrade(properties));
    }
    known.retain(|id, _| materials.get(*id).is_some());
    if has_changed {
        materials.set_changed();
    }
}

fn tell_of(name: &str) {
    info!(
        "materials of the type `{name}` are drawn forward, since they have shaders of their own and no `deferred_fragment_shader`, or no \
         prepass: with a prepass, a `ReflectedMaterialPlugin` for their type and `RayTracedReflections::forward` they reflect as rays know \
         them; write such a shader to have them reflect as they are drawn"
    );
}

/// Returns whether the G-buffer lacks effects of a material's own shaders, or the whole material.
fn is_lost(properties: &MaterialProperties, server: &AssetServer) -> bool {
    let base = base_shader(server);
    let own = properties.get_shader(MaterialFragmentShader);
    let deferred = properties.get_shader(DeferredFragmentShader);
    // Bevy's own vertex shader isn't set on materials.
    let moves_vertices = properties.get_shader(MaterialVertexShader).is_some();
    !properties.prepass_enabled
        || loses_its_shader(
            own.as_ref().map(Handle::id),
            deferred.as_ref().map(Handle::id),
            base.id(),
        )
        || (moves_vertices && properties.get_shader(DeferredVertexShader).is_none())
}

/// The shader for drawing `StandardMaterial`s, and extensions without their own one, into the G-buffer.
fn base_shader(server: &AssetServer) -> Handle<Shader> {
    match StandardMaterial::deferred_fragment_shader() {
        ShaderRef::Default => Handle::default(),
        ShaderRef::Handle(handle) => handle,
        ShaderRef::Path(path) => server.load(path),
    }
}

/// `base` also draws `StandardMaterial`s in the forward pass.
fn loses_its_shader(own: Option<AssetId<Shader>>, deferred: Option<AssetId<Shader>>, base: AssetId<Shader>) -> bool {
    own.is_some_and(|own| own != base) && deferred.is_none_or(|deferred| deferred == base)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{asset::uuid::Uuid, camera::visibility::Visibility, pbr::MeshMaterial3d};

    #[test]
    fn components_tell_their_material() {
        let mut registry = TypeRegistry::new();
        registry.register::<MeshMaterial3d<StandardMaterial>>();
        registry.register::<Visibility>();
        registry.register::<Option<Visibility>>();
        let of = material_of(TypeId::of::<MeshMaterial3d<StandardMaterial>>(), &registry);
        assert_eq!(of, Some((TypeId::of::<StandardMaterial>(), "StandardMaterial")));
        assert_eq!(material_of(TypeId::of::<Visibility>(), &registry), None);
        assert_eq!(
            material_of(TypeId::of::<Option<Visibility>>(), &registry),
            None,
            "it is of no material, although generic"
        );
        assert_eq!(material_of(TypeId::of::<StandardMaterial>(), &registry), None);
    }

    #[test]
    fn own_shaders_are_lost_where_the_g_buffer_has_none_of_them() {
        let [base, own, other] = [1, 2, 3].map(|number| AssetId::from(Uuid::from_u128(number)));
        assert!(loses_its_shader(Some(own), Some(base), base));
        assert!(loses_its_shader(Some(own), None, base));
        for (forward, deferred) in [
            (Some(base), Some(base)),
            (Some(own), Some(own)),
            (Some(own), Some(other)),
            (Some(base), Some(other)),
            (None, None),
        ] {
            assert!(!loses_its_shader(forward, deferred, base), "{forward:?}, {deferred:?}");
        }
    }
}
