//! The order of a view's passes, over Bevy's G-buffer or its front layer's, and the results that are read back.

use crate::{
    common::{HIT_COUNT, MIRROR_RAY_COUNT, RAY_COUNT, TILE_COUNT, word_offset},
    composite::{CompositePipelines, Surfaces, composite_reflection},
    denoise::{DenoisePipelines, denoise},
    diagnostics::{TotalTimeOnly, WithoutReflections},
    gbuffer::PassContext,
    rate::{RatePipelines, determine_rates},
    settings::ReflectionTechnique,
    trace::{TracePipelines, VrsPass, trace_rays},
};
use bevy::{
    ecs::{prelude::*, system::SystemParam},
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        renderer::RenderContext,
        view::ViewTarget,
    },
};

/// Pipelines of all passes except tracing.
#[derive(SystemParam)]
pub(crate) struct PassPipelines<'w> {
    rate: Option<Res<'w, RatePipelines>>,
    denoise: Option<Res<'w, DenoisePipelines>>,
    composite: Option<Res<'w, CompositePipelines>>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
    without_reflections: Option<Res<'w, WithoutReflections>>,
}

impl PassPipelines<'_> {
    /// The passes; `None` until all pipelines are created.
    pub fn passes<'a>(
        &'a self,
        trace: Option<&'a TracePipelines>,
        diagnostics: Option<&'a DiagnosticsRecorder>,
    ) -> Option<ViewPasses<'a>> {
        Some(ViewPasses {
            rate: self.rate.as_deref()?,
            trace: trace?,
            denoise: self.denoise.as_deref()?,
            composite: Some(self.composite.as_deref()?).filter(|_| self.without_reflections.is_none()),
            stages: diagnostics.filter(|_| self.total_only.is_none()),
        })
    }
}

/// The passes of a view.
pub(crate) struct ViewPasses<'a> {
    rate: &'a RatePipelines,
    trace: &'a TracePipelines,
    denoise: &'a DenoisePipelines,
    /// `None` to trace reflections without showing them.
    composite: Option<&'a CompositePipelines>,
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
        determine_rates(ctx, self.rate, context);
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
        let watches = trace_rays(ctx, self.trace, context, vrs);
        span.end(ctx.command_encoder());
        denoise(ctx, self.denoise, context, self.stages);
        let span = self.stages.time_span(ctx.command_encoder(), "composite");
        if let Some(composite) = self.composite {
            composite_reflection(ctx, composite, context, target, surfaces);
        }
        span.end(ctx.command_encoder());
        watches
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
