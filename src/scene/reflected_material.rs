//! Material types that rays support: `StandardMaterial`, and types that an app adds.

use super::{
    extract::{begin_extraction, extract_shapes},
    instances::{
        details::extract_details,
        extract::{MaterialComponent, extract_instances, note_lost_materials},
    },
    materials::{MaterialTypes, ReflectedMaterial, extract_materials},
    pose::extract_vertex_shader,
};
use crate::{
    device::tracing_app,
    schedule::ReflectionSystems,
    settings::{ReflectedMaterial3d, ReflectedVertices},
};
use bevy::{
    app::{App, Plugin, SubApp},
    ecs::{component::RequiredComponentsError, prelude::*},
    log::warn,
    pbr::{Material, MeshMaterial3d},
    platform::collections::HashSet,
    render::ExtractSchedule,
};
use core::{any::TypeId, marker::PhantomData};

/// Adds objects with a material of type `M` to reflections. `StandardMaterial` needs no plugin.
///
/// Add it before or after [`RayTracedReflectionsPlugin`](crate::RayTracedReflectionsPlugin), next to the `MaterialPlugin` of the same
/// type. Objects with materials of other types are missing from reflections; the log and
/// [`ReflectionStatusReport::unseen`](crate::ReflectionStatusReport::unseen) list their number by type.
///
/// # Examples
///
/// ```no_run
/// # use bevy::{pbr::{ExtendedMaterial, MaterialExtension}, prelude::*, render::render_resource::AsBindGroup};
/// # use bevy_glint::prelude::*;
/// # #[derive(Asset, AsBindGroup, Reflect, Clone)]
/// # struct Water {}
/// # impl MaterialExtension for Water {}
/// App::new().add_plugins((
///     DefaultPlugins,
///     MaterialPlugin::<ExtendedMaterial<StandardMaterial, Water>>::default(),
///     RayTracedReflectionsPlugin::default(),
///     ReflectedMaterialPlugin::<ExtendedMaterial<StandardMaterial, Water>>::default(),
/// ));
/// ```
pub struct ReflectedMaterialPlugin<M: ReflectedMaterial> {
    shows_environment: bool,
    vertices: Option<ReflectedVertices>,
    _material: PhantomData<fn() -> M>,
}

impl<M: ReflectedMaterial> Default for ReflectedMaterialPlugin<M> {
    fn default() -> Self {
        Self {
            shows_environment: M::shows_environment(),
            vertices: None,
            _material: PhantomData,
        }
    }
}

impl<M: ReflectedMaterial> ReflectedMaterialPlugin<M> {
    /// Use this for a type whose shader doesn't add the environment's specular light, such as a toon shader with flat colours.
    ///
    /// Traced reflections replace that light on materials drawn in the forward pass
    /// ([`forward`](crate::RayTracedReflections::forward)). If the shader doesn't add it, there is nothing to replace, and objects of
    /// this type keep the look of their shader. Their own appearance in reflections doesn't change.
    ///
    /// If the app implements [`ReflectedMaterial`] for the type, it can use [`ReflectedMaterial::shows_environment`] instead. Extended
    /// materials already have an implementation, which assumes that they are lit like their base. For them, use this function.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use bevy::{pbr::{ExtendedMaterial, MaterialExtension}, prelude::*, render::render_resource::AsBindGroup};
    /// # use bevy_glint::prelude::*;
    /// # #[derive(Asset, AsBindGroup, Reflect, Clone)]
    /// # struct Toon {}
    /// # impl MaterialExtension for Toon {}
    /// # let mut app = App::new();
    /// app.add_plugins(ReflectedMaterialPlugin::<ExtendedMaterial<StandardMaterial, Toon>>::without_environment());
    /// ```
    #[must_use]
    pub fn without_environment() -> Self {
        Self {
            shows_environment: false,
            ..Self::default()
        }
    }

    /// Use this for a type with a vertex shader that moves vertices: entities with such a material get this component, unless they have
    /// one, so that [`ReflectedVertexShader`](crate::ReflectedVertexShader) moves their vertices in reflections. They keep it if they get
    /// another material.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use bevy::{pbr::{ExtendedMaterial, MaterialExtension}, prelude::*, render::render_resource::AsBindGroup};
    /// # use bevy_glint::{ReflectedVertices, prelude::*};
    /// # #[derive(Asset, AsBindGroup, Reflect, Clone)]
    /// # struct Wind {}
    /// # impl MaterialExtension for Wind {}
    /// # let mut app = App::new();
    /// let swaying = ReflectedVertices { reach: 0.3, ..default() };
    /// app.add_plugins(
    ///     ReflectedMaterialPlugin::<ExtendedMaterial<StandardMaterial, Wind>>::default().with_vertices(swaying),
    /// );
    /// ```
    #[must_use]
    pub fn with_vertices(mut self, vertices: ReflectedVertices) -> Self {
        self.vertices = Some(vertices);
        self
    }
}

/// Components of the supported material types; there is one resource in either world.
#[derive(Resource, Default)]
pub(crate) struct SeenMaterials(HashSet<TypeId>);

impl SeenMaterials {
    /// Returns whether rays see objects with this component.
    pub fn contains(&self, component: TypeId) -> bool {
        self.0.contains(&component)
    }
}

impl<M: ReflectedMaterial> Plugin for ReflectedMaterialPlugin<M> {
    fn build(&self, app: &mut App) {
        see::<M>(app.world_mut());
        if let Some(vertices) = self.vertices {
            let component = move || vertices;
            let added = app.try_register_required_components_with::<MeshMaterial3d<M>, ReflectedVertices>(component);
            match added {
                // If the plugin was added twice, the first one counts.
                Ok(()) | Err(RequiredComponentsError::DuplicateRegistration(..)) => {}
                Err(error) => warn!(
                    "entities with {} get no `ReflectedVertices`; add the plugin before they are spawned: {error}",
                    M::short_type_path()
                ),
            }
        }
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        if !self.shows_environment {
            let mut types = render_app.world_mut().get_resource_or_init::<MaterialTypes>();
            types.deny_environment(TypeId::of::<M>());
        }
        if !see::<M>(render_app.world_mut()) {
            // The plugin was added twice.
            return;
        }
        let mut types = render_app.world_mut().get_resource_or_init::<MaterialTypes>();
        types.add(TypeId::of::<M>());
        let order = render_app.world().resource::<SeenMaterials>().0.len();
        render_app.add_systems(
            ExtractSchedule,
            extract_materials::<M>
                .after(begin_extraction)
                .in_set(ReflectionSystems::ExtractScene),
        );
        extract_objects::<MeshMaterial3d<M>>(render_app, order);
    }

    fn is_unique(&self) -> bool {
        false
    }
}

/// Returns false if the type was already registered in this world.
fn see<M: Material>(world: &mut World) -> bool {
    let mut seen = world.get_resource_or_init::<SeenMaterials>();
    seen.0.insert(TypeId::of::<MeshMaterial3d<M>>())
}

/// Steps of the extraction of objects, in this order. Material types are processed in the order of their plugins, so that objects get
/// the same slots in each run.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum ExtractObjects {
    Begin,
    NoteLostMaterials,
    NoteLostMaterialsOf(usize),
    Update,
    UpdateThoseOf(usize),
    Shapes,
}

fn extract_objects<C: MaterialComponent>(render_app: &mut SubApp, order: usize) {
    use ExtractObjects::{NoteLostMaterials, NoteLostMaterialsOf, Update, UpdateThoseOf};
    for before in 0..order {
        render_app.configure_sets(
            ExtractSchedule,
            (
                NoteLostMaterialsOf(order).after(NoteLostMaterialsOf(before)),
                UpdateThoseOf(order).after(UpdateThoseOf(before)),
            ),
        );
    }
    render_app
        .configure_sets(
            ExtractSchedule,
            (
                NoteLostMaterialsOf(order).in_set(NoteLostMaterials),
                UpdateThoseOf(order).in_set(Update),
            ),
        )
        .add_systems(
            ExtractSchedule,
            (
                note_lost_materials::<C>.in_set(NoteLostMaterialsOf(order)),
                extract_instances::<C>.in_set(UpdateThoseOf(order)),
            ),
        );
}

/// Adds the extraction of objects with this material, or with this material as a stand-in.
pub(super) fn add_extraction(render_app: &mut SubApp) {
    render_app.configure_sets(
        ExtractSchedule,
        (
            ExtractObjects::Begin,
            ExtractObjects::NoteLostMaterials,
            ExtractObjects::Update,
            ExtractObjects::Shapes,
        )
            .chain()
            .in_set(ReflectionSystems::ExtractScene),
    );
    render_app.add_systems(
        ExtractSchedule,
        (
            (begin_extraction, extract_details)
                .chain()
                .in_set(ExtractObjects::Begin),
            extract_shapes.in_set(ExtractObjects::Shapes),
            // Bevy sends its shaders to the pipeline cache, too. They are different ones, so the order doesn't matter.
            extract_vertex_shader
                .before(ExtractObjects::Shapes)
                .ambiguous_with_all(),
        ),
    );
    extract_objects::<ReflectedMaterial3d>(render_app, 0);
}
