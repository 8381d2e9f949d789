//! From the cameras of the main world to the views of the render world.

use crate::{
    composite::CompositePipelines,
    settings::{RayTracedReflections, SafeSettings, Technique},
    trace::ReflectionPipelines,
    view::ReflectionTextures,
};
use bevy::{
    camera::{Camera, Hdr},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass},
    ecs::{entity::EntityHashSet, prelude::*, query::QueryData},
    log::warn,
    math::Mat4,
    reflect::PartialReflect,
    pbr::{
        DefaultOpaqueRendererMethod, ScreenSpaceReflections, ScreenSpaceReflectionsPipelineId,
        ScreenSpaceReflectionsUniform, ViewScreenSpaceReflectionsUniformOffset,
    },
    render::{
        MainWorld,
        render_resource::PipelineCache,
        sync_world::RenderEntity,
        view::Msaa,
    },
    transform::components::GlobalTransform,
};

/// A view that traces reflections, in the render world.
#[derive(Component, Clone, Debug)]
pub struct ReflectionView {
    pub(crate) settings: SafeSettings,
    /// History must be forgotten.
    pub(crate) reset: bool,
}

/// What must go when a camera stops reflecting. Environment specular comes back with the removal of the uniform.
pub(crate) type AllOfAView = (
    ReflectionView,
    ReflectionTextures,
    ScreenSpaceReflectionsUniform,
    ViewScreenSpaceReflectionsUniformOffset,
    ScreenSpaceReflectionsPipelineId,
);

#[derive(QueryData)]
#[query_data(mutable)]
pub struct CameraQuery {
    entity: Entity,
    render_entity: RenderEntity,
    camera: &'static Camera,
    reflections: Option<&'static mut RayTracedReflections>,
    transform: &'static GlobalTransform,
    hdr: Has<Hdr>,
    depth: Has<DepthPrepass>,
    deferred: Has<DeferredPrepass>,
    screen_space: Has<ScreenSpaceReflections>,
    msaa: Option<&'static Msaa>,
}

/// What was true of a camera in the last frame.
#[derive(Clone, PartialEq)]
pub struct CameraState {
    world_from_view: Mat4,
    clip_from_view: Mat4,
    settings: SafeSettings,
}

/// Mirrors settings, decides whether a view may trace, and hands Bevy's deferred lighting the range of roughness whose
/// environment specular we replace.
///
/// Bevy leaves that term out for views that carry the uniform of its screen-space reflections; we give it ours, and
/// [`drop_ssr_pass`](crate::trace::drop_ssr_pass) keeps the screen-space pass itself from running.
pub fn extract_cameras(
    mut main_world: ResMut<MainWorld>,
    mut pipelines: Option<ResMut<ReflectionPipelines>>,
    composite: Option<Res<CompositePipelines>>,
    cache: Res<PipelineCache>,
    existing: Query<(), With<ReflectionView>>,
    mut states: Local<bevy::ecs::entity::EntityHashMap<CameraState>>,
    mut warned: Local<EntityHashSet>,
    mut commands: Commands,
) {
    let forward = main_world
        .get_resource::<DefaultOpaqueRendererMethod>()
        .is_none_or(|method| method.reflect_partial_eq(&DefaultOpaqueRendererMethod::deferred()) != Some(true));
    let mut cameras = main_world.query::<CameraQuery>();
    for mut camera in cameras.iter_mut(&mut main_world) {
        let Some(reflections) = camera.reflections.as_mut().filter(|_| camera.camera.is_active) else {
            states.remove(&camera.entity);
            warned.remove(&camera.entity);
            if existing.contains(camera.render_entity) {
                commands.entity(camera.render_entity).remove::<AllOfAView>();
            }
            continue;
        };
        let problem = if camera.screen_space {
            Some("it also has `ScreenSpaceReflections`, which use the same hook in Bevy's lighting: remove one of the two")
        } else if !camera.deferred || !camera.depth {
            Some("it lacks the `DeferredPrepass` or the `DepthPrepass`: insert them")
        } else if !camera.hdr {
            Some("it lacks `Hdr`, without which colours are tone-mapped before reflections can be added: insert `Hdr`")
        } else if camera.msaa.is_some_and(|msaa| *msaa != Msaa::Off) {
            Some("it has multisampling, which deferred rendering can't do: set `Msaa::Off`")
        } else {
            None
        };
        if let Some(problem) = problem {
            if warned.insert(camera.entity) {
                warn!("camera {} shows no ray-traced reflections: {problem}", camera.entity);
            }
            if existing.contains(camera.render_entity) {
                commands.entity(camera.render_entity).remove::<AllOfAView>();
            }
            continue;
        }
        if forward && warned.insert(camera.entity) {
            warn!(
                "camera {} shows reflections only on materials whose `opaque_render_method` is `Deferred`: for all opaque \
                 materials, insert the resource `DefaultOpaqueRendererMethod::deferred()`",
                camera.entity
            );
        }
        let settings = SafeSettings::from(&**reflections);
        let ready = pipelines.as_mut().is_some_and(|pipelines| {
            pipelines.request(settings.technique);
            pipelines.is_ready(&cache, settings.technique)
        }) && composite.as_ref().is_some_and(|composite| composite.are_ready(&cache));
        if !ready {
            // Until then the picture keeps Bevy's environment map.
            if existing.contains(camera.render_entity) {
                commands.entity(camera.render_entity).remove::<AllOfAView>();
            }
            continue;
        }
        let state = CameraState {
            world_from_view: camera.transform.to_matrix(),
            clip_from_view: camera.camera.clip_from_view(),
            settings,
        };
        let changed = states.insert(camera.entity, state.clone()).is_none_or(|last| last != state);
        let reset = reflections.reset || (changed && settings.technique == Technique::Converged);
        if reflections.reset {
            reflections.bypass_change_detection().reset = false;
        }
        commands.entity(camera.render_entity).insert((
            ReflectionView { settings, reset },
            ScreenSpaceReflectionsUniform::from(ScreenSpaceReflections {
                min_perceptual_roughness: 0.0..0.0,
                max_perceptual_roughness: settings.cutoff..settings.cutoff,
                ..Default::default()
            }),
        ));
    }
}
