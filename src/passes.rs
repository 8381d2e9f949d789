//! The order of a view's passes, over Bevy's G-buffer or that of its front layer.

use crate::{
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

/// Pipelines of the passes, besides those that trace.
#[derive(SystemParam)]
pub(crate) struct PassPipelines<'w> {
    rate: Option<Res<'w, RatePipelines>>,
    denoise: Option<Res<'w, DenoisePipelines>>,
    composite: Option<Res<'w, CompositePipelines>>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
    without_reflections: Option<Res<'w, WithoutReflections>>,
}

impl PassPipelines<'_> {
    /// The passes; `None` until all pipelines are made.
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
    /// `None` if reflections are to be traced and not shown.
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

    /// Traces, denoises, and adds reflections to the frame. Returns whether rays note changes that they meet.
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
