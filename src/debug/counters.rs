//! Counters of values that must not be, for Bevy's `DiagnosticsStore`.

use super::passes::{DebugPass, DebugPipelines};
use crate::trace::{GBufferBindings, PassContext};
use bevy::{
    diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore},
    ecs::prelude::*,
    math::UVec2,
    reflect::{Reflect, std_traits::ReflectDefault},
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::{BindGroupEntries, ComputePassDescriptor, TextureView},
        renderer::RenderContext,
    },
};

/// Pixels of the last reflection that are not finite.
pub const NON_FINITE_PIXELS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_non_finite");
/// Column of the worst pixel.
pub const WORST_X: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_x");
/// Row of the worst pixel.
pub const WORST_Y: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_y");
/// Exposed radiance of the worst pixel's brightest channel; -1 where it is not finite.
pub const WORST_RADIANCE: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_radiance");

/// On a reflecting camera: has the pixels counted that are not finite, and the worst one found, for [`NonFiniteReport`]. It costs
/// three passes over the picture. Without Bevy's `RenderDiagnosticsPlugin` nothing is counted; of several cameras each adds its
/// own measurements to the same diagnostics.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct DebugCounters;

/// What [`DebugCounters`] found in one of the last frames, in the radiance that
/// [`DebugView::Reconstructed`](super::DebugView::Reconstructed) shows: before the composite, which stops such values.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Debug, Clone, PartialEq)]
pub struct NonFiniteReport {
    /// Reflecting pixels that are not finite.
    pub pixels: u32,
    /// The first pixel that is not finite, else the brightest; counted from the first pixel of the view. (0, 0) where nothing
    /// reflects.
    pub worst: UVec2,
    /// Exposed radiance of the brightest channel of that pixel; `None` if it is not finite.
    pub radiance: Option<f32>,
}

impl NonFiniteReport {
    /// The last measurement; `None` before the first one.
    #[must_use]
    pub fn read(diagnostics: &DiagnosticsStore) -> Option<Self> {
        let value = |path: &DiagnosticPath| diagnostics.get(path).and_then(Diagnostic::value);
        let radiance = value(&WORST_RADIANCE)? as f32;
        Some(Self {
            pixels: value(&NON_FINITE_PIXELS)? as u32,
            worst: UVec2::new(value(&WORST_X)? as u32, value(&WORST_Y)? as u32),
            radiance: (radiance >= 0.0).then_some(radiance),
        })
    }
}

/// Words of the buffer that `count.wesl` writes.
pub(super) const REPORT_WORDS: u64 = 8;

/// Counts, and has the result read back.
pub(super) fn count_non_finite(
    ctx: &mut RenderContext,
    pipelines: &DebugPipelines,
    context: &PassContext,
    radiance: &TextureView,
    diagnostics: &DiagnosticsRecorder,
) {
    let (Some(count), Some(locate), Some(finish)) = (
        pipelines.get(context.cache, DebugPass::Count),
        pipelines.get(context.cache, DebugPass::Locate),
        pipelines.get(context.cache, DebugPass::Finish),
    ) else {
        return;
    };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let report = &pipelines.report;
    let bind_group = ctx.render_device().create_bind_group(
        "glint_debug_count",
        &context.cache.get_bind_group_layout(&pipelines.count_layout),
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            radiance,
            report.as_entire_binding(),
        )),
    );
    let size = context.textures.size();
    let encoder = ctx.command_encoder();
    encoder.clear_buffer(report, 0, None);
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("glint_debug_count"),
            timestamp_writes: None,
        });
        pass.set_bind_group(0, &bind_group, &[context.view_offset]);
        for pipeline in [count, locate] {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
        }
        pass.set_pipeline(finish);
        pass.dispatch_workgroups(1, 1, 1);
    }
    diagnostics.record_u32(encoder, &report.slice(0..4), "reflection_non_finite");
    diagnostics.record_u32(encoder, &report.slice(4..8), "reflection_worst_x");
    diagnostics.record_u32(encoder, &report.slice(8..12), "reflection_worst_y");
    diagnostics.record_f32(encoder, &report.slice(12..16), "reflection_worst_radiance");
}
