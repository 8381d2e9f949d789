//! Draws the debug views over a frame.

use super::sides::Side;
use crate::{
    composite::{Surfaces, composited_radiance, history, or_gbuffer, resolution, shown_bindings},
    denoise,
    device::FRAME_FORMAT,
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Groups, Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::{ClampedSettings, RATE_LEGEND, ReflectionDebugView},
};
use bevy::render::{
    render_resource::{
        BufferInitDescriptor, BufferUsages, IntoBinding, StorageTextureAccess, TextureSampleType, TextureView,
        binding_types,
    },
    renderer::RenderContext,
    view::ViewTarget,
};
use bytemuck::{Pod, Zeroable};
use core::num::NonZeroU64;

/// Rates and rays are bound.
const HAS_PIPELINE: u32 = 1;
/// History is bound.
const HAS_HISTORY: u32 = 2;
/// The G-buffer of the front layer is bound.
const IS_FRONT_LAYER: u32 = 4;

/// Settings of a pass that shows one side of a view; `DebugSettings` in `show.wesl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct GpuDebugSettings {
    /// First column and the one after the last, for the view and for the dividing line.
    columns: [u32; 4],
    view: u32,
    flags: u32,
    padding: [u32; 2],
    legend: [[f32; 4]; RATE_LEGEND.len()],
}

/// Shows the light that the composite adds.
pub(crate) const SHOW_REFLECTION: &Pass = &Pass {
    label: "glint_debug_reflection",
    shader: "debug/show.wesl",
    entry_point: "show",
    bindings: || {
        let mut bindings = shown_bindings(|context| or_radiance(context, context.ssao));
        bindings.extend(frame_bindings());
        bindings
    },
    groups: Groups::Environment,
    options: Options::REFLECTION,
    ..Pass::new(Failure::SILENT)
};

/// Shows a texture before the composite.
pub(crate) const SHOW_INTERMEDIATE: &Pass = &Pass {
    label: "glint_debug_intermediate",
    bindings: intermediate_bindings,
    groups: Groups::None,
    options: Options::empty(),
    ..*SHOW_REFLECTION
};

/// Both frames, and the settings.
fn frame_bindings() -> [Binding; 3] {
    let size = NonZeroU64::new(size_of::<GpuDebugSettings>() as u64);
    [
        Binding::given(binding_types::texture_2d(TextureSampleType::Float {
            filterable: false,
        })),
        Binding::given(binding_types::texture_storage_2d(
            FRAME_FORMAT,
            StorageTextureAccess::WriteOnly,
        )),
        Binding::given(binding_types::uniform_buffer_sized(false, size)),
    ]
}

fn intermediate_bindings() -> Vec<Binding> {
    let mut bindings =
        shown_bindings(|context| or_radiance(context, context.images().map(|images| &images.ray_radiance)));
    bindings.extend(frame_bindings());
    bindings.extend([
        Binding::integers(|context| or_gbuffer(context, context.images().map(|images| &images.ray_sample))),
        Binding::floats(|context| {
            or_radiance(
                context,
                context.images().and_then(|images| images.reconstructed.as_ref()),
            )
        }),
        Binding::integers(|context| {
            or_gbuffer(
                context,
                context.images().and_then(|images| images.reconstructed_stats.as_ref()),
            )
        }),
        Binding::floats(|context| {
            or_radiance(
                context,
                history(context).map(|history| &history.radiance[context.now()]),
            )
        }),
        Binding::integers(|context| {
            or_gbuffer(context, history(context).map(|history| &history.surface[context.now()]))
        }),
    ]);
    bindings
}

/// The pass that draws a debug view. `blurs` is true if it blurs its input, as the composite does.
fn variant(view: ReflectionDebugView, settings: &ClampedSettings, blurs: bool) -> Variant {
    let mut options = Options::empty();
    if view == ReflectionDebugView::Reflection {
        options = resolution(settings);
        options.set(Options::BLUR, blurs);
    }
    let pass = match view {
        ReflectionDebugView::Reflection => SHOW_REFLECTION,
        _ => SHOW_INTERMEDIATE,
    };
    pass.variant(Features::empty(), options)
}

/// The variants for a debug view. Without history there is nothing to blur.
pub(super) fn variants(view: ReflectionDebugView, settings: &ClampedSettings) -> [Variant; 2] {
    [false, denoise::blurs(settings)].map(|blurs| variant(view, settings, blurs))
}

/// A texture to bind instead of a missing one; the shader doesn't read it.
fn or_radiance<'a>(context: &PassContext<'a>, texture: Option<&'a TextureView>) -> Option<&'a TextureView> {
    texture.or_else(|| composited_radiance(context))
}

/// Draws one side of a view, from one texture of the frame into the other. `context` belongs to `surfaces`.
pub(super) fn show_side(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
    surfaces: Surfaces,
    target: &ViewTarget,
    side: &Side,
) {
    let blurs = context.history().is_some() && denoise::blurs(&context.view.settings);
    let variant = variant(side.view, &context.view.settings, blurs);
    if !pipelines.is_compiled(context.cache, &variant) {
        return;
    }
    let bound = context.images().map_or(0, |_| HAS_PIPELINE) | history(context).map_or(0, |_| HAS_HISTORY);
    let settings = GpuDebugSettings {
        columns: [side.columns.start, side.columns.end, side.line.start, side.line.end],
        view: side.view as u32,
        flags: match surfaces {
            Surfaces::Opaque => bound,
            Surfaces::FrontLayer => bound | IS_FRONT_LAYER,
        },
        padding: [0; 2],
        legend: RATE_LEGEND.map(|(_, color)| [color.red, color.green, color.blue, color.alpha]),
    };
    let settings = ctx.render_device().create_buffer_with_data(&BufferInitDescriptor {
        label: Some("glint_debug_settings"),
        contents: bytemuck::bytes_of(&settings),
        usage: BufferUsages::UNIFORM,
    });
    let frame = target.post_process_write();
    let given = [
        frame.source.into_binding(),
        frame.destination.into_binding(),
        settings.as_entire_binding(),
    ];
    if let Some(mut compute) = pipelines.begin(ctx, context, [variant], &given) {
        let size = target.main_texture().size();
        compute.dispatch_workgroups(size.width.div_ceil(8), size.height.div_ceil(8), 1);
    }
}
