//! The copy of the lit frame for rays that reuse its light.

use crate::{
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Options, Pass, Pipelines, Variant},
    scene::Features,
    targets::SCREEN_FORMAT,
};
use bevy::render::renderer::RenderContext;

/// The pass. Views without a screen have no target for it.
pub(crate) const SCREEN: &Pass = &Pass {
    label: "glint_keep_screen",
    shader: "composite/screen.wesl",
    entry_point: "keep",
    bindings: || {
        vec![
            Binding::floats(|context| Some(context.frame)),
            Binding::written(SCREEN_FORMAT, |context| context.screen),
        ]
    },
    ..Pass::new(Failure::COMPOSITE)
};

pub(super) fn variant() -> Variant {
    SCREEN.variant(Features::empty(), Options::empty())
}

/// Copies the current light of the camera.
pub(crate) fn keep_screen(ctx: &mut RenderContext, pipelines: &Pipelines, context: &PassContext) {
    if let Some(mut pass) = pipelines.begin(ctx, context, [variant()], &[]) {
        let size = context.textures.size();
        pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
    }
}
