//! The pass that traces rays of earlier frames again, to follow changes of the light, if the passes over the ray list can't.

use super::blocks::{RAYS, kept_ray_bindings};
use crate::{
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Options, Pass, Pipelines, Variant},
    scene::Passes,
};
use bevy::render::renderer::RenderContext;

/// The pass over all cells.
pub(crate) const KEPT_RAYS: &Pass = &Pass {
    label: "glint_trace_kept_rays",
    shader: "trace/kept_rays.wesl",
    sees: Passes::INLINE,
    options: Options::KEPT_RAYS,
    failure: Failure::KEPT_RAYS,
    bindings: || {
        let mut bindings = vec![Binding::floats(|context| Some(context.albedo_table))];
        bindings.extend(kept_ray_bindings());
        bindings
    },
    ..*RAYS
};

/// Traces a ray for each cell. Returns false if the shader isn't compiled yet.
pub(super) fn trace_cells(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    variant: Variant,
    context: &PassContext,
) -> bool {
    let cells = context.targets().sizes.cells();
    let Some(mut compute) = pipelines.begin(ctx, context, [variant], &[]) else {
        return false;
    };
    compute.dispatch_workgroups(cells.x.div_ceil(8), cells.y.div_ceil(8), 1);
    true
}
