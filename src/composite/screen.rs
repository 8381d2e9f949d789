//! The copy of the lit frame for rays that reuse its light.

use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext},
    targets::SCREEN_FORMAT,
};
use bevy::render::renderer::RenderContext;

/// The pass. Views without a screen have no target for it.
pub(super) fn screen_pass() -> GBufferPass {
    let bindings = vec![
        Binding::floats(|context| Some(context.frame)),
        Binding::written(SCREEN_FORMAT, |context| context.screen),
    ];
    GBufferPass::new("glint_keep_screen", bindings, OtherGroups::None)
}

/// Copies the current light of the camera.
pub(super) fn run(ctx: &mut RenderContext, pass: &GBufferPass, context: &PassContext) {
    if let Some(mut pass) = pass.begin(ctx, context, [()], &[]) {
        let size = context.textures.size();
        pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
    }
}
