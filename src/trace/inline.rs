//! Traces rays in a full-screen fragment pass over the trace target.

use super::blocks::RAYS;
use crate::{
    gbuffer::{Binding, PassContext},
    pipelines::{Kind, Pass, Pipelines, Variant},
    scene::Passes,
    targets::{RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT, attachment},
};
use bevy::render::{render_resource::LoadOp, renderer::RenderContext};

/// The fragment pass. The raw Vulkan pass runs the same shader.
pub(crate) const INLINE: &Pass = &Pass {
    label: "glint_trace_inline",
    shader: "trace/inline.wesl",
    sees: Passes::INLINE,
    entry_point: "fragment",
    kind: Kind::Fragments(&[RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT]),
    bindings,
    ..*RAYS
};

fn bindings() -> Vec<Binding> {
    vec![
        Binding::float_layers(|context| Some(context.noise)),
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
        Binding::floats(|context| Some(context.albedo_table)),
    ]
}

/// Traces a ray for each fragment.
pub(super) fn trace_inline(ctx: &mut RenderContext, pipelines: &Pipelines, variant: &Variant, context: &PassContext) {
    let Some(images) = context.images() else { return };
    // Every texel is written, so nothing needs to be cleared.
    let targets = [&images.ray_radiance, &images.ray_sample].map(|view| attachment(view, LoadOp::Load));
    if let Some(mut pass) = pipelines.begin_fragments(ctx, context, variant, &targets) {
        pass.draw(0..3, 0..1);
    }
}
