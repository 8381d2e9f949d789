//! Traces the rays of one view, in the passes that its settings need.

use super::{
    blocks::{List, run_list},
    converged::trace_converged,
    pipelines::TracePipelines,
    variant::{Demand, Kernel, RayPass},
    vrs::VrsPass,
};
use crate::{gbuffer::PassContext, scene::Features, settings::ReflectionBackend};
use bevy::render::renderer::RenderContext;

/// Traces the rays of one view. Returns whether rays count recent changes that they hit. Passes for later bounces and for many lights
/// don't count changes, and lights on hits that aren't shaded aren't counted either.
pub(crate) fn trace_rays(
    ctx: &mut RenderContext,
    pipelines: &TracePipelines,
    context: &PassContext,
    vrs: &mut VrsPass,
) -> bool {
    let demand = Demand::of(&context.view.settings);
    let Some(plan) = pipelines.plan(demand, context.cache) else {
        return false;
    };
    let features = pipelines.features | demand.asked;
    // The single shader of the raw Vulkan pass can neither sample lights nor run the app's shader. If the pass fails, this frame's rays
    // come from the list.
    let by_hardware = demand.rays == RayPass::Blocks
        && context.view.settings.backend == ReflectionBackend::HardwareVrs
        && !features.intersects(Features::LIGHT_SAMPLING | Features::SURFACE_SHADER)
        && vrs.trace(ctx, pipelines, context);
    let mut watches = false;
    for (kernel, variant) in plan.steps() {
        let list = match kernel {
            Kernel::Rays | Kernel::Shading if by_hardware => continue,
            Kernel::Rays | Kernel::Shading => List::Rays,
            Kernel::ShadingAndMirrors => List::AllRays,
            Kernel::Mirrors => List::MirrorRays,
            Kernel::Inline => {
                pipelines.inline.trace(ctx, variant, context);
                continue;
            }
            Kernel::Converged => {
                if let Some(pass) = pipelines.compute(kernel) {
                    trace_converged(ctx, pass, variant, context);
                }
                continue;
            }
        };
        let unwatched = Features::BOUNCES | Features::MANY_LIGHTS | Features::SCREEN_TRACES;
        watches |= kernel == Kernel::Rays && !features.intersects(unwatched);
        if let Some(pass) = pipelines.compute(kernel) {
            run_list(ctx, pass, variant, context, list);
        }
    }
    watches
}
