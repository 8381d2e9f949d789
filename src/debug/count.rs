//! Counts non-finite pixels, and finds the worst one.

use crate::{
    composite::composited_radiance,
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Options, Pass, Pipelines, Variant},
    scene::Features,
};
use bevy::{
    ecs::prelude::*,
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::{Buffer, BufferDescriptor, BufferUsages, binding_types},
        renderer::{RenderContext, RenderDevice},
    },
};
use core::num::NonZeroU64;

/// Words of the buffer written by `count.wesl`.
const REPORT_WORDS: u64 = 8;

/// Counts.
pub(crate) const COUNT: &Pass = &Pass {
    label: "glint_debug_count",
    shader: "debug/count.wesl",
    entry_point: "count",
    bindings: || {
        let report = binding_types::storage_buffer_sized(false, NonZeroU64::new(4 * REPORT_WORDS));
        vec![Binding::floats(composited_radiance), Binding::given(report)]
    },
    ..Pass::new(Failure::SILENT)
};

/// Finds the worst pixel.
pub(crate) const LOCATE: &Pass = &Pass {
    label: "glint_debug_locate",
    entry_point: "locate",
    ..*COUNT
};

/// Writes the report.
pub(crate) const FINISH: &Pass = &Pass {
    label: "glint_debug_finish",
    entry_point: "finish",
    ..*COUNT
};

/// The passes in the order in which they run.
pub(super) fn variants() -> [Variant; 3] {
    [COUNT, LOCATE, FINISH].map(|pass| pass.variant(Features::empty(), Options::empty()))
}

/// The result buffer, which all views use in turn.
#[derive(Resource)]
pub(crate) struct Report(Buffer);

impl FromWorld for Report {
    fn from_world(world: &mut World) -> Self {
        Self(world.resource::<RenderDevice>().create_buffer(&BufferDescriptor {
            label: Some("glint_debug_report"),
            size: 4 * REPORT_WORDS,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        }))
    }
}

/// Counts, and requests a readback of the result.
pub(super) fn count_non_finite(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    Report(report): &Report,
    context: &PassContext,
    diagnostics: &DiagnosticsRecorder,
) {
    let [count, locate, finish] = variants();
    let others = [locate, finish].map(|variant| pipelines.compute(context.cache, &variant));
    let [Some(locate), Some(finish)] = others else {
        return;
    };
    if !pipelines.is_compiled(context.cache, &count) {
        return;
    }
    ctx.command_encoder().clear_buffer(report, 0, None);
    let size = context.textures.size();
    {
        let given = [report.as_entire_binding()];
        let Some(mut compute) = pipelines.begin(ctx, context, [count], &given) else {
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
