//! Gathers the render-world data for the passes of a view.

use super::state::TraceState;
use crate::{
    gbuffer::{GBufferBindings, PassContext},
    scene::{SceneBindings, environment::EnvironmentBindings},
    settings::{LightingHook, ReflectionView},
    view::ReflectionTextures,
};
use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::{prelude::*, query::QueryData, system::SystemParam},
    pbr::ScreenSpaceAmbientOcclusionResources,
    render::{
        render_resource::PipelineCache,
        view::{ViewTarget, ViewUniformOffset, ViewUniforms},
    },
};

/// Components of a view that passes run for.
#[derive(QueryData)]
pub struct PassView {
    pub(crate) view: &'static ReflectionView,
    pub(crate) textures: &'static ReflectionTextures,
    pub(crate) target: &'static ViewTarget,
    prepass: &'static ViewPrepassTextures,
    offset: &'static ViewUniformOffset,
    ssao: Option<&'static ScreenSpaceAmbientOcclusionResources>,
    hook: &'static LightingHook,
}

/// Resources that the passes of all views share.
#[derive(SystemParam)]
pub struct PassResources<'w> {
    pub(crate) trace: Option<Res<'w, TraceState>>,
    scene: Option<Res<'w, SceneBindings>>,
    environments: Res<'w, EnvironmentBindings>,
    view_uniforms: Res<'w, ViewUniforms>,
    cache: Res<'w, PipelineCache>,
}

impl PassResources<'_> {
    /// The context of a view's passes; `None` as long as something is missing and the view shows no reflections.
    pub(crate) fn context<'a, 'v: 'a>(
        &'a self,
        entity: Entity,
        view: &PassViewItem<'v, '_>,
    ) -> Option<PassContext<'a>> {
        if !view.hook.passes_run {
            return None;
        }
        let state = self.trace.as_deref()?;
        let scene = self.scene.as_deref()?;
        let ssao = view.ssao;
        Some(PassContext {
            entity,
            gbuffer: GBufferBindings {
                view: self.view_uniforms.uniforms.binding()?,
                settings: view.textures.uniform.binding()?,
                depth: view.prepass.depth_only_view()?,
                gbuffer: view.prepass.deferred_view()?,
                normals: view.prepass.normal_view()?,
            },
            view_offset: view.offset.offset,
            motion: view.prepass.motion_vectors_view(),
            view: view.view,
            textures: view.textures,
            cache: &self.cache,
            features: scene.features(),
            knows_motions: scene.knows_motions(),
            scene: scene.bind_group.as_ref()?,
            environment: self.environments.bind_group(entity)?,
            contents: [&scene.contents, self.environments.contents(entity)?],
            ssao: ssao.map(|ssao| &ssao.screen_space_ambient_occlusion_texture.default_view),
            albedo_table: &state.albedo_table,
            noise: state.noise.as_ref()?,
            frame: view.target.main_texture_view(),
            screen: view.textures.targets.screen.as_ref(),
            tiles: None,
        })
    }
}
