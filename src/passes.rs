//! The order of a view's passes, over Bevy's G-buffer or its front layer's, and the results that are read back.

use crate::{
    common::{HIT_COUNT, MIRROR_RAY_COUNT, RAY_COUNT, TILE_COUNT, word_offset},
    composite::{Surfaces, composite_reflection},
    denoise::denoise,
    diagnostics::{TotalTimeOnly, WithoutReflections},
    gbuffer::PassContext,
    pipelines::Pipelines,
    rate::{RateImages, determine_rates},
    settings::ReflectionTechnique,
    trace::{TraceState, VrsPass, trace_rays},
};
use bevy::{
    ecs::{prelude::*, system::SystemParam},
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        renderer::RenderContext,
        view::ViewTarget,
    },
};

/// Pipelines and images of all passes.
#[derive(SystemParam)]
pub(crate) struct PassPipelines<'w> {
    pipelines: Option<Res<'w, Pipelines>>,
    rate_images: Option<Res<'w, RateImages>>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
    without_reflections: Option<Res<'w, WithoutReflections>>,
}

impl PassPipelines<'_> {
    /// The passes; `None` until they are loaded.
    pub fn passes<'a>(
        &'a self,
        trace: Option<&'a TraceState>,
        diagnostics: Option<&'a DiagnosticsRecorder>,
    ) -> Option<ViewPasses<'a>> {
        Some(ViewPasses {
            pipelines: self.pipelines.as_deref()?,
            rate_images: self.rate_images.as_deref()?,
            trace: trace?,
            shows: self.without_reflections.is_none(),
            stages: diagnostics.filter(|_| self.total_only.is_none()),
        })
    }
}

/// The passes of a view.
pub(crate) struct ViewPasses<'a> {
    pipelines: &'a Pipelines,
    rate_images: &'a RateImages,
    trace: &'a TraceState,
    /// False to trace reflections without showing them.
    shows: bool,
    /// Measures each of them, unless only the total counts.
    stages: Option<&'a DiagnosticsRecorder>,
}

impl ViewPasses<'_> {
    /// Determines rates. The ground truth has none.
    pub fn rate(&self, ctx: &mut RenderContext, context: &PassContext) {
        if context.view.settings.technique == ReflectionTechnique::Converged {
            return;
        }
        let span = self.stages.time_span(ctx.command_encoder(), "rate");
        determine_rates(ctx, self.pipelines, self.rate_images, context);
        span.end(ctx.command_encoder());
    }

    /// Traces, denoises, and adds reflections to the frame. Returns whether rays count the changes that they hit.
    pub fn reflect(
        &self,
        ctx: &mut RenderContext,
        context: &PassContext,
        vrs: &mut VrsPass,
        target: &ViewTarget,
        surfaces: Surfaces,
    ) -> bool {
        let span = self.stages.time_span(ctx.command_encoder(), "trace");
        let traced = trace_rays(ctx, (self.pipelines, self.trace), context, vrs);
        span.end(ctx.command_encoder());
        denoise(ctx, self.pipelines, context, traced.follows_light, self.stages);
        let span = self.stages.time_span(ctx.command_encoder(), "composite");
        if self.shows {
            composite_reflection(ctx, self.pipelines, context, target, surfaces);
        }
        span.end(ctx.command_encoder());
        traced.watches
    }
}

/// Requests a readback of the lengths of lists and the number of hits.
pub(crate) fn record_counters(
    diagnostics: Option<&DiagnosticsRecorder>,
    ctx: &mut RenderContext,
    context: &PassContext,
    surfaces: Surfaces,
) {
    let targets = context.targets();
    let [rays, mirror_rays, tiles, hits] = match surfaces {
        Surfaces::Opaque => [
            "reflection_rays",
            "reflection_mirror_rays",
            "reflection_tiles",
            "reflection_hits",
        ],
        Surfaces::FrontLayer => [
            "reflection_front_layer_rays",
            "reflection_front_layer_mirror_rays",
            "reflection_front_layer_tiles",
            "reflection_front_layer_hits",
        ],
    };
    for (buffer, word, name) in [
        (&targets.indirect_args, RAY_COUNT, rays),
        (&targets.indirect_args, MIRROR_RAY_COUNT, mirror_rays),
        (&targets.indirect_args, TILE_COUNT, tiles),
        (&targets.counters, HIT_COUNT, hits),
    ] {
        let bytes = word_offset(word)..word_offset(word + 1);
        diagnostics.record_u32(ctx.command_encoder(), &buffer.slice(bytes), name);
    }
}
