//! Finds opaque materials that Bevy draws in its forward pass.

use crate::{scene::materials::MaterialAssets, settings::ReflectionView};
use bevy::{
    asset::UntypedAssetId,
    ecs::prelude::*,
    material::{MaterialProperties, OpaqueRendererMethod, RenderPhaseType},
    pbr::PreparedMaterial,
    platform::collections::HashSet,
    render::erased_render_asset::ErasedRenderAssets,
};

/// Reports the materials drawn in the forward pass to the scene, as soon as a view needs them.
pub(super) fn note_forward_materials(
    views: Query<&ReflectionView>,
    prepared: Res<ErasedRenderAssets<PreparedMaterial>>,
    mut materials: ResMut<MaterialAssets>,
    mut missed: Local<bool>,
) {
    // Changes aren't tracked while no view needs them.
    *missed |= prepared.is_changed();
    if !views.iter().any(|view| view.settings.forward) || (materials.forward().is_some() && !*missed) {
        return;
    }
    *missed = false;
    let forward: HashSet<UntypedAssetId> = prepared
        .iter()
        .filter(|(id, material)| materials.may_mirror(id.type_id()) && is_drawn_forward(&material.properties))
        .map(|(id, _)| id)
        .collect();
    if materials.forward() != Some(&forward) {
        materials.set_forward(forward);
    }
}

/// The depth of a surface isn't known when its reflection is traced, unless there is a prepass.
fn is_drawn_forward(properties: &MaterialProperties) -> bool {
    properties.render_method == OpaqueRendererMethod::Forward
        && properties.prepass_enabled
        && matches!(
            properties.render_phase_type,
            RenderPhaseType::Opaque | RenderPhaseType::AlphaMask
        )
}
