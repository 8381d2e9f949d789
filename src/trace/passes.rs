//! Traces the rays of one view, in the passes that its settings need.

use super::{
    blocks::{MIRRORS, RAYS, SHADING_AND_MIRRORS, run_list, with_kept_rays},
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

/// What the rays of a frame found, besides their light.
#[derive(Clone, Copy, Default)]
pub(crate) struct Traced {
    /// They count recent changes that they hit. Passes for later bounces and for many lights don't count changes, and lights on hits that
    /// aren't shaded aren't counted either.
    pub watches: bool,
    /// Kept rays were traced again.
    pub follows_light: bool,
}

/// Traces the rays of one view.
pub(crate) fn trace_rays(
    ctx: &mut RenderContext,
    (pipelines, state): (&Pipelines, &TraceState),
    context: &PassContext,
    vrs: &mut VrsPass,
) -> Traced {
    let settings = &context.view.settings;
    let demand = Demand::of(settings);
    let Some(plan) = state.plan(demand, (pipelines, context.cache)) else {
        return Traced::default();
    };
    let wanted = state.features | demand.asked;
    // The single shader of the raw Vulkan pass can neither sample lights nor run the app's shader. If the pass fails, this frame's rays
    // come from the list.
    let by_hardware = demand.rays == RayPass::Blocks
        && settings.backend == ReflectionBackend::HardwareVrs
        && !wanted.intersects(Features::LIGHT_SAMPLING | Features::SURFACE_SHADER)
        && vrs.trace(ctx, pipelines, context);
    let mut traced = Traced::default();
    let follows = context.textures.follows_light();
    let compiled = (pipelines, context.cache);
    let shared = follows
        .then(|| state.plan_with_kept_rays(demand, &plan, compiled))
        .flatten();
    traced.follows_light = if shared.is_some() {
        true
    } else {
        let alone = follows.then(|| state.kept_rays(demand, compiled)).flatten();
        alone.is_some_and(|variant| trace_cells(ctx, pipelines, variant, context))
    };
    let twin = if shared.is_some() { with_kept_rays } else { |pass| pass };
    for (pass, features) in shared.unwrap_or(plan).steps() {
        let variant = twin(pass).variant(features, Options::empty());
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
        traced.watches |= pass == RAYS && !by_hardware && !wanted.intersects(unwatched);
    }
    traced
}
