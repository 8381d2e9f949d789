//! The hook in Bevy's deferred lighting, which leaves environment specular out where reflections replace it.
//!
//! Bevy leaves that term out for views that carry the uniform of its screen-space reflections, within its range of roughness. Every view
//! that could reflect carries one of ours from its first frame on, and [`drop_ssr_pass`] keeps the screen-space pass itself from running.
//! So reflections come and go by numbers alone. A uniform that came with them would be another key of all pipelines that draw into the
//! view, and Bevy draws nothing whose pipeline isn't compiled yet.

use crate::{
    front_layer::FrontLayer,
    ready::Readiness,
    settings::{ClampedSettings, LightingHook, ReflectionView},
    view::{MoreMemory, ReflectionTextures, ViewCulling},
};
use bevy::{
    ecs::prelude::*,
    pbr::{
        ScreenSpaceReflections, ScreenSpaceReflectionsBuffer, ScreenSpaceReflectionsPipelineId,
        ScreenSpaceReflectionsUniform, ViewScreenSpaceReflectionsUniformOffset,
    },
    render::{render_resource::encase::UniformBuffer, renderer::RenderQueue, view::ExtractedView},
};

/// Components of ours on a reflecting view.
pub(super) type OursOfAView = (ReflectionView, ReflectionTextures, ViewCulling, FrontLayer, MoreMemory);

/// The hook, and what is borrowed from Bevy's screen-space reflections for it.
pub(super) type HookOfAView = (
    LightingHook,
    ScreenSpaceReflectionsUniform,
    ViewScreenSpaceReflectionsUniformOffset,
    ScreenSpaceReflectionsPipelineId,
);

/// The range of roughness whose environment specular Bevy's lighting leaves out: none for a view that replaces nothing.
pub(super) fn left_out(settings: Option<&ClampedSettings>) -> ScreenSpaceReflectionsUniform {
    let greatest = settings.map_or(-1.0, |settings| settings.cutoff);
    ScreenSpaceReflectionsUniform::from(ScreenSpaceReflections {
        min_perceptual_roughness: 0.0..0.0,
        max_perceptual_roughness: greatest..greatest,
        ..Default::default()
    })
}

/// A view with the hook.
type Hooked = (
    &'static mut LightingHook,
    &'static ViewScreenSpaceReflectionsUniformOffset,
    Option<&'static ReflectionView>,
    Has<ReflectionTextures>,
);

/// Has the lighting of views leave nothing out whose passes can't run: the device had no memory for their textures, or the scene needs
/// other pipelines all of a sudden. Bevy has written the uniforms before either is known.
pub(super) fn settle_hooks(
    mut views: Query<Hooked, With<ExtractedView>>,
    readiness: Readiness,
    uniforms: Res<ScreenSpaceReflectionsBuffer>,
    queue: Res<RenderQueue>,
) {
    for (mut hook, offset, view, has_textures) in &mut views {
        hook.passes_run = has_textures && view.is_some_and(|view| readiness.is_ready(&view.settings, &view.rate));
        if hook.passes_run || view.is_none() {
            continue;
        }
        let mut bytes = UniformBuffer::new(Vec::new());
        if let (Ok(()), Some(buffer)) = (bytes.write(&left_out(None)), uniforms.buffer()) {
            queue.write_buffer(buffer, u64::from(**offset), bytes.as_ref());
        }
    }
}

/// Keeps Bevy's screen-space pass from running on views that only carry its uniform to suppress environment specular.
pub(super) fn drop_ssr_pass(
    views: Query<Entity, (With<LightingHook>, With<ScreenSpaceReflectionsPipelineId>)>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<ScreenSpaceReflectionsPipelineId>();
    }
}

/// After the device was lost, what views held on the old one is gone.
pub(super) fn forget_views(
    views: Query<Entity, Or<(With<ReflectionTextures>, With<LightingHook>)>>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<(OursOfAView, HookOfAView)>();
    }
}
