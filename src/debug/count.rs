//! Counts non-finite pixels, and finds the worst one.

use crate::{
    composite::composited_radiance,
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext},
};
use bevy::render::{
    diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
    render_resource::{Buffer, BufferDescriptor, BufferUsages, binding_types},
    renderer::{RenderContext, RenderDevice},
};
use core::num::NonZeroU64;

/// Words of the buffer written by `count.wesl`.
const REPORT_WORDS: u64 = 8;

/// Entry points of `count.wesl`, in the order in which they run.
pub(super) const ENTRY_POINTS: [&str; 3] = ["count", "locate", "finish"];

/// The pass, with a variant for each of [`ENTRY_POINTS`].
pub(super) fn pass() -> GBufferPass<&'static str> {
    let report = binding_types::storage_buffer_sized(false, NonZeroU64::new(4 * REPORT_WORDS));
    let bindings = vec![Binding::floats(composited_radiance), Binding::given(report)];
    GBufferPass::new("glint_debug_count", bindings, OtherGroups::None)
}

/// The result buffer, which all views use in turn.
pub(super) fn create_report(device: &RenderDevice) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some("glint_debug_report"),
        size: 4 * REPORT_WORDS,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Counts, and requests a readback of the result.
pub(super) fn count_non_finite(
    ctx: &mut RenderContext,
    pass: &GBufferPass<&'static str>,
    report: &Buffer,
    context: &PassContext,
    diagnostics: &DiagnosticsRecorder,
) {
    let compiled = ENTRY_POINTS.map(|entry_point| pass.pipeline(&entry_point, context.cache));
    let [Some(_), Some(locate), Some(finish)] = compiled else {
        return;
    };
    ctx.command_encoder().clear_buffer(report, 0, None);
    let size = context.textures.size();
    {
        let given = [report.as_entire_binding()];
        let Some(mut compute) = pass.begin(ctx, context, [ENTRY_POINTS[0]], &given) else {
            return;
        };
        compute.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
        compute.set_pipeline(locate);
        compute.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
        compute.set_pipeline(finish);
        compute.dispatch_workgroups(1, 1, 1);
    }
    let encoder = ctx.command_encoder();
    diagnostics.record_u32(encoder, &report.slice(0..4), "reflection_non_finite");
    diagnostics.record_u32(encoder, &report.slice(4..8), "reflection_worst_x");
    diagnostics.record_u32(encoder, &report.slice(8..12), "reflection_worst_y");
    diagnostics.record_f32(encoder, &report.slice(12..16), "reflection_worst_radiance");
}
