//! One ray for each pixel, averaged over frames.

use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext},
    scene::Features,
    targets::ACCUMULATION_FORMAT,
};
use bevy::render::{render_resource::BindGroupLayoutDescriptor, renderer::RenderContext};

/// The pass over all pixels.
pub(super) fn converged_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Features> {
    let bindings = vec![
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::written_words(1, |context| Some(&context.targets().indirect_args)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
        Binding::floats(|context| Some(&context.targets().accumulation.as_ref()?[context.before()])),
        Binding::written(ACCUMULATION_FORMAT, |context| {
            Some(&context.targets().accumulation.as_ref()?[context.now()])
        }),
    ];
    GBufferPass::new(
        "glint_trace_converged",
        bindings,
        OtherGroups::SceneAndEnvironment(scene_layout.clone()),
    )
}

/// Traces a ray for each pixel.
pub(super) fn trace_converged(
    ctx: &mut RenderContext,
    pass: &GBufferPass<Features>,
    features: Features,
    context: &PassContext,
) {
    let size = context.textures.size();
    if let Some(mut compute) = pass.begin(ctx, context, [features], &[]) {
        compute.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
    }
}
