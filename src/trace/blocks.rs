//! Rays of the lists: one for each block, traced in one pass and shaded in the next; and one for each pixel of an exact mirror, traced
//! in that shading pass or in a separate pass. Both passes over blocks have a twin that also processes kept rays.

use crate::{
    common::word_offset,
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Groups, Options, Pass, Pipelines, Variant},
    scene::Passes,
    targets::{HIT_FORMAT, RADIANCE_FORMAT, RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT, STATS_FORMAT},
};
use bevy::render::renderer::RenderContext;

/// The pass over the ray list.
pub(crate) const RAYS: &Pass = &Pass {
    label: "glint_trace_rays",
    shader: "trace/blocks.wesl",
    sees: Passes::RAYS,
    entry_point: "trace",
    bindings: || {
        let mut bindings = list_bindings();
        bindings.extend([
            Binding::words(|context| Some(&context.images()?.ray_list)),
            Binding::written(RAY_RADIANCE_FORMAT, |context| Some(&context.images()?.ray_radiance)),
            Binding::written(RAY_SAMPLE_FORMAT, |context| Some(&context.images()?.ray_sample)),
            Binding::written(HIT_FORMAT, |context| context.images()?.hits(context.now())),
        ]);
        bindings
    },
    groups: Groups::Scene,
    ..Pass::new(Failure::RAYS)
};

/// The pass that shades the hits of the ray list.
pub(crate) const SHADING: &Pass = &Pass {
    label: "glint_shade_hits",
    shader: "trace/shade.wesl",
    sees: Passes::SHADING,
    bindings: shading_bindings,
    ..*RAYS
};

/// The pass that shades the hits of the ray list and traces the mirror ray list.
pub(crate) const SHADING_AND_MIRRORS: &Pass = &Pass {
    label: "glint_shade_hits_and_mirrors",
    sees: Passes::SHADING_AND_MIRRORS,
    bindings: || {
        let [list, radiance, stats] = mirror_bindings();
        let counters = Binding::written_words(1, |context| Some(&context.targets().counters));
        let mut bindings = shading_bindings();
        bindings.extend([list, counters, radiance, stats]);
        bindings
    },
    options: Options::MIRRORS,
    ..*SHADING
};

/// [`RAYS`] that also traces kept rays again.
pub(crate) const RAYS_AND_KEPT_RAYS: &Pass = &Pass {
    label: "glint_trace_rays_and_kept_rays",
    bindings: || beside_kept_rays(RAYS),
    options: Options::KEPT_RAYS,
    failure: Failure::SILENT,
    ..*RAYS
};

/// [`SHADING`] for these rays.
pub(crate) const SHADING_AND_KEPT_RAYS: &Pass = &Pass {
    label: "glint_shade_hits_and_kept_rays",
    bindings: || beside_kept_rays(SHADING),
    options: Options::KEPT_RAYS,
    failure: Failure::SILENT,
    ..*SHADING
};

/// [`SHADING_AND_MIRRORS`] for these rays.
pub(crate) const SHADING_MIRRORS_AND_KEPT_RAYS: &Pass = &Pass {
    label: "glint_shade_hits_mirrors_and_kept_rays",
    bindings: || beside_kept_rays(SHADING_AND_MIRRORS),
    options: Options::MIRRORS.union(Options::KEPT_RAYS),
    failure: Failure::SILENT,
    ..*SHADING_AND_MIRRORS
};

/// The twin of a pass, or the pass itself if it has none.
pub(super) fn with_kept_rays(pass: &'static Pass) -> &'static Pass {
    let twins = [
        (RAYS, RAYS_AND_KEPT_RAYS),
        (SHADING, SHADING_AND_KEPT_RAYS),
        (SHADING_AND_MIRRORS, SHADING_MIRRORS_AND_KEPT_RAYS),
    ];
    let twin = twins.iter().find(|(alone, _)| *alone == pass);
    twin.map_or(pass, |(_, twin)| twin)
}

/// The pass over the mirror ray list.
pub(crate) const MIRRORS: &Pass = &Pass {
    label: "glint_trace_mirror_rays",
    sees: Passes::MIRRORS,
    bindings: || {
        let mut bindings = list_bindings();
        bindings.extend(mirror_bindings());
        bindings
    },
    options: Options::MIRRORS,
    ..*RAYS
};

fn list_bindings() -> Vec<Binding> {
    vec![
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::float_layers(|context| Some(context.noise)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
    ]
}

fn shading_bindings() -> Vec<Binding> {
    vec![
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::words(|context| Some(&context.images()?.ray_list)),
        Binding::integers(|context| Some(&context.images()?.ray_sample)),
        Binding::integers(|context| context.images()?.hits(context.now())),
        Binding::written(RAY_RADIANCE_FORMAT, |context| Some(&context.images()?.ray_radiance)),
        Binding::floats(|context| Some(context.albedo_table)),
    ]
}

/// The mirror ray list and its results.
fn mirror_bindings() -> [Binding; 3] {
    [
        Binding::words(|context| Some(&context.images()?.mirror_ray_list)),
        Binding::written(RADIANCE_FORMAT, |context| {
            context.images()?.mirror_radiance(context.now())
        }),
        Binding::written(STATS_FORMAT, |context| context.images()?.mirror_stats(context.now())),
    ]
}

/// Kept rays, and the changes that they find.
pub(super) fn kept_ray_bindings() -> [Binding; 2] {
    [
        Binding::written_words(20, |context| Some(&context.images()?.light_changes.as_ref()?.rays)),
        Binding::written(RADIANCE_FORMAT, |context| {
            Some(&context.images()?.light_changes.as_ref()?.changes)
        }),
    ]
}

/// The bindings of a pass, and those for kept rays.
fn beside_kept_rays(pass: &Pass) -> Vec<Binding> {
    let mut bindings = (pass.bindings)();
    bindings.extend(kept_ray_bindings());
    bindings
}

/// Traces or shades the rays of one list. `dispatch` is the first word of its indirect arguments.
pub(super) fn run_list(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    variant: Variant,
    context: &PassContext,
    dispatch: u64,
) {
    if let Some(mut compute) = pipelines.begin(ctx, context, [variant], &[]) {
        compute.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(dispatch));
    }
}
