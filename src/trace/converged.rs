//! One ray for each pixel, averaged over frames.

use super::blocks::RAYS;
use crate::{
    gbuffer::{Binding, PassContext},
    pipelines::{Pass, Pipelines, Variant},
    scene::Passes,
    targets::ACCUMULATION_FORMAT,
};
use bevy::render::renderer::RenderContext;

/// The pass over all pixels.
pub(crate) const CONVERGED: &Pass = &Pass {
    label: "glint_trace_converged",
    shader: "trace/converged.wesl",
    sees: Passes::CONVERGED,
    bindings,
    ..*RAYS
};

fn bindings() -> Vec<Binding> {
    vec![
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::written_words(1, |context| Some(&context.targets().indirect_args)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
        Binding::floats(|context| Some(&context.targets().accumulation.as_ref()?[context.before()])),
        Binding::written(ACCUMULATION_FORMAT, |context| {
            Some(&context.targets().accumulation.as_ref()?[context.now()])
        }),
    ]
}

/// Traces a ray for each pixel.
pub(super) fn trace_converged(ctx: &mut RenderContext, pipelines: &Pipelines, variant: Variant, context: &PassContext) {
    let size = context.textures.size();
    if let Some(mut compute) = pipelines.begin(ctx, context, [variant], &[]) {
        compute.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
    }
}
