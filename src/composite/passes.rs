//! The passes of the composite: which of them a view needs, and how they run.

use super::{
    add,
    resolve::{self, RESOLVE_APART, Surfaces},
    screen,
};
use crate::{
    device::{FRAME_FORMAT, WritesInPlace},
    gbuffer::PassContext,
    pipelines::{Pass, Pipelines, Variant},
    scene::{Features, SceneBindings},
    settings::{ClampedSettings, ReflectionTechnique, ReflectionView},
};
use bevy::{
    camera::CameraMainTextureUsages,
    ecs::prelude::*,
    platform::collections::HashSet,
    render::{
        camera::ExtractedCamera,
        render_resource::{TextureFormat, TextureUsages},
        renderer::RenderContext,
        view::{ExtractedView, ViewTarget},
    },
};

/// The pass that resolves the reflection of a view with frames of this format.
fn resolve_of(settings: &ClampedSettings, format: TextureFormat, in_place: WritesInPlace) -> &'static Pass {
    resolve::pass(
        in_place.allows(format),
        settings.technique != ReflectionTechnique::Converged,
    )
}

/// The variants for a view with frames of this format.
pub(crate) fn variants(
    settings: &ClampedSettings,
    format: TextureFormat,
    in_place: WritesInPlace,
    scene: &SceneBindings,
) -> impl Iterator<Item = Variant> + use<> {
    let mut features = scene.features();
    if !scene.has_layer_surfaces() {
        features -= Features::LIGHT_PROBES;
    }
    let pass = resolve_of(settings, format, in_place);
    let layer = settings
        .has_front_layer()
        .then(|| resolve::layer_variants(pass, settings, features));
    needed(settings, format, in_place)
        .chain(resolve::variants(pass, settings))
        .chain(layer.into_iter().flatten())
}

/// The variants without which a view can't start: all that its opaque surfaces need.
pub(crate) fn needed(
    settings: &ClampedSettings,
    format: TextureFormat,
    in_place: WritesInPlace,
) -> impl Iterator<Item = Variant> + use<> {
    let pass = resolve_of(settings, format, in_place);
    let all = [
        resolve::variants(pass, settings).last(),
        (pass == RESOLVE_APART).then(|| add::variant(format)),
        settings.reuses_screen().then(screen::variant),
    ];
    all.into_iter().flatten()
}

/// Allows compute shaders to write to the frames of reflecting cameras if the composite or a debug view does, and to the frames of all
/// cameras with the same target: cameras share a frame only if its usages are the same.
pub(super) fn allow_writes_in_place(
    reflecting: Query<(&ExtractedCamera, &ExtractedView, &ReflectionView)>,
    mut cameras: Query<(&ExtractedCamera, &ExtractedView, &mut CameraMainTextureUsages)>,
    in_place: Option<Res<WritesInPlace>>,
) {
    let Some(in_place) = in_place else { return };
    let targets: HashSet<_> = reflecting
        .iter()
        .filter(|(_, view, reflections)| {
            let has_debug_view = reflections.debug.views().next().is_some();
            in_place.allows(view.target_format) || has_debug_view && view.target_format == FRAME_FORMAT
        })
        .map(|(camera, ..)| camera.target.clone())
        .collect();
    for (camera, view, mut usages) in &mut cameras {
        if view.target_format == FRAME_FORMAT && targets.contains(&camera.target) {
            usages.0 |= TextureUsages::STORAGE_BINDING;
        }
    }
}

/// Adds the reflection of some surfaces to the lit frame.
pub(crate) fn composite_reflection(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
    target: &ViewTarget,
    surfaces: Surfaces,
) {
    let pass = resolve::pass(context.targets().reflection.is_none(), context.images().is_some());
    if pass != RESOLVE_APART && !target.main_texture().usage().contains(TextureUsages::STORAGE_BINDING) {
        return;
    }
    if resolve::run(ctx, pipelines, pass, context, surfaces) && pass == RESOLVE_APART {
        add::run(ctx, pipelines, context, target);
    }
}
