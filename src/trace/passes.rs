//! Traces the rays of one view, by the passes that its settings need.

use super::{
    blocks::{List, run_list},
    converged::trace_converged,
    pipelines::TracePipelines,
    variant::{TracePass, Variant},
    vrs::VrsPass,
};
use crate::{gbuffer::PassContext, settings::ReflectionBackend};
use bevy::render::renderer::RenderContext;

/// Traces the rays of one view. Returns whether they count what has changed lately where they meet it: what the passes of later bounces
/// and of many lights meet is not counted, and neither are lights on hits that are not shaded.
pub(crate) fn trace_rays(
    ctx: &mut RenderContext,
    pipelines: &TracePipelines,
    context: &PassContext,
    vrs: &mut VrsPass,
) -> bool {
    let settings = &context.view.settings;
    let variant = pipelines.variant_for(settings);
    let mut watches = false;
    let mut has_mirrors = false;
    for pass in TracePass::of(settings) {
        match pass {
            TracePass::Converged => {
                let variant = pipelines.converged_variant(variant);
                trace_converged(ctx, &pipelines.converged, variant, context);
            }
            TracePass::Inline => pipelines.inline.trace(ctx, pipelines.first_rays(variant), context),
            TracePass::Mirrors if has_mirrors => {}
            TracePass::Mirrors => {
                let variants = pipelines.mirror_variant(variant).substitutes();
                run_list(ctx, &pipelines.mirror_rays, variants, context, List::MirrorRays);
            }
            // If the raw Vulkan pass gives up, this frame's rays come from the list. Its one shader can't draw lights, nor
            // run the app's.
            TracePass::Blocks => {
                let by_hardware = settings.backend == ReflectionBackend::HardwareVrs
                    && !variant.draws_lights
                    && !variant.own_surfaces;
                if !by_hardware || !vrs.trace(ctx, pipelines, context) {
                    let rays = pipelines.ray_variant(variant, context.cache);
                    run_list(ctx, &pipelines.rays, rays, context, List::Rays);
                    let tinted = rays.is_some_and(|rays| rays.tinted);
                    if let Some(joined) = pipelines.joined_variant(settings, variant, tinted, context.cache) {
                        run_list(ctx, &pipelines.shading_and_mirrors, [joined], context, List::AllRays);
                        has_mirrors = true;
                    } else {
                        let variants = Variant { tinted, ..variant }.shading_substitutes(pipelines.many_lights);
                        run_list(ctx, &pipelines.shading, variants, context, List::Rays);
                    }
                    watches = settings.max_bounces <= 1 && !pipelines.many_lights && !variant.reuses_screen;
                }
            }
        }
    }
    watches
}
