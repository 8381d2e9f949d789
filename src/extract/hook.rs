//! The hook in Bevy's deferred lighting, which leaves environment specular out where reflections replace it.
//!
//! Bevy leaves that term out for views that carry the uniform of its screen-space reflections, within its range of roughness. A
//! reflecting view gets a uniform of ours, and [`drop_ssr_pass`] keeps the screen-space pass itself from running.

use crate::{
    front_layer::FrontLayer,
    settings::{ClampedSettings, ReflectionView},
    view::{MoreMemory, ReflectionTextures, ViewCulling},
};
use bevy::{
    ecs::prelude::*,
    pbr::{
        ScreenSpaceReflections, ScreenSpaceReflectionsPipelineId, ScreenSpaceReflectionsUniform,
        ViewScreenSpaceReflectionsUniformOffset,
    },
};

/// Components of ours on a reflecting view.
pub(super) type OursOfAView = (ReflectionView, ReflectionTextures, ViewCulling, FrontLayer, MoreMemory);

/// The same, and what is borrowed from Bevy's screen-space reflections. The environment's specular term comes back with its
/// removal.
pub(super) type AllOfAView = (
    ReflectionView,
    ReflectionTextures,
    ViewCulling,
    FrontLayer,
    MoreMemory,
    ScreenSpaceReflectionsUniform,
    ViewScreenSpaceReflectionsUniformOffset,
    ScreenSpaceReflectionsPipelineId,
);

/// The range of roughness whose environment specular Bevy's lighting leaves out: none for a culled view, which replaces nothing.
/// Only numbers change: without the uniform Bevy would switch to other pipelines.
pub(super) fn left_out(settings: &ClampedSettings, culled: bool) -> ScreenSpaceReflectionsUniform {
    let greatest = if culled { -1.0 } else { settings.cutoff };
    ScreenSpaceReflectionsUniform::from(ScreenSpaceReflections {
        min_perceptual_roughness: 0.0..0.0,
        max_perceptual_roughness: greatest..greatest,
        ..Default::default()
    })
}

/// Keeps Bevy's screen-space pass from running on views that only carry its uniform to suppress environment specular.
pub(super) fn drop_ssr_pass(
    views: Query<Entity, (With<ReflectionView>, With<ScreenSpaceReflectionsPipelineId>)>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<ScreenSpaceReflectionsPipelineId>();
    }
}

/// After the device was lost, what views held on the old one is gone.
pub(super) fn forget_views(views: Query<Entity, With<ReflectionView>>, mut commands: Commands) {
    for view in &views {
        commands.entity(view).remove::<AllOfAView>();
    }
}
