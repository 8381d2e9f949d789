//! Traces the rays of one view, in the passes that its settings need.

use super::{
    blocks::{MIRRORS, RAYS, SHADING_AND_MIRRORS, run_list},
    converged::{CONVERGED, trace_converged},
    inline::{INLINE, trace_inline},
    kept_rays::trace_cells,
    state::TraceState,
    variant::{Demand, RayPass},
    vrs::VrsPass,
};
use crate::{
    common::{ALL_RAYS_DISPATCH, MIRROR_RAY_DISPATCH, RAY_DISPATCH},
    gbuffer::PassContext,
    pipelines::{Options, Pipelines},
    scene::Features,
    settings::ReflectionBackend,
};
use bevy::render::renderer::RenderContext;

/// Traces kept rays of a view again, while the scene changes. Returns false if there is nothing to trace, or no shader yet.
pub(crate) fn trace_kept_rays(
    ctx: &mut RenderContext,
    (pipelines, state): (&Pipelines, &TraceState),
    context: &PassContext,
) -> bool {
    let wanted = context.textures.follows_light();
    let variant = wanted.then(|| state.kept_rays(&context.view.settings, (pipelines, context.cache)));
    variant
        .flatten()
        .is_some_and(|variant| trace_cells(ctx, pipelines, variant, context))
}

/// Traces the rays of one view. Returns whether rays count recent changes that they hit. Passes for later bounces and for many lights
/// don't count changes, and lights on hits that aren't shaded aren't counted either.
pub(crate) fn trace_rays(
    ctx: &mut RenderContext,
    (pipelines, state): (&Pipelines, &TraceState),
    context: &PassContext,
    vrs: &mut VrsPass,
) -> bool {
    let demand = Demand::of(&context.view.settings);
    let Some(plan) = state.plan(demand, (pipelines, context.cache)) else {
        return false;
    };
    let wanted = state.features | demand.asked;
    // The single shader of the raw Vulkan pass can neither sample lights nor run the app's shader. If the pass fails, this frame's rays
    // come from the list.
    let by_hardware = demand.rays == RayPass::Blocks
        && context.view.settings.backend == ReflectionBackend::HardwareVrs
        && !wanted.intersects(Features::LIGHT_SAMPLING | Features::SURFACE_SHADER)
        && vrs.trace(ctx, pipelines, context);
    let mut watches = false;
    for (pass, features) in plan.steps() {
        let variant = pass.variant(features, Options::empty());
        if pass == INLINE {
            trace_inline(ctx, pipelines, &variant, context);
        } else if pass == CONVERGED {
            trace_converged(ctx, pipelines, variant, context);
        } else if pass == SHADING_AND_MIRRORS {
            run_list(ctx, pipelines, variant, context, ALL_RAYS_DISPATCH);
        } else if pass == MIRRORS {
            run_list(ctx, pipelines, variant, context, MIRROR_RAY_DISPATCH);
        } else if !by_hardware {
            run_list(ctx, pipelines, variant, context, RAY_DISPATCH);
        }
        let unwatched = Features::BOUNCES | Features::MANY_LIGHTS | Features::SCREEN_TRACES;
        watches |= pass == RAYS && !by_hardware && !wanted.intersects(unwatched);
    }
    watches
}
