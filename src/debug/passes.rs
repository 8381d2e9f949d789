//! Pipelines and passes of the debug views.

use super::{
    DebugView, RATE_LEGEND, Side,
    counters::{REPORT_WORDS, count_non_finite},
};
use crate::{
    composite::{CompositePipelines, composited_radiance},
    denoise::pass::{GBufferPass, floats, gbuffer_entries, gbuffer_layout, integers},
    extract::ReflectionView,
    scene::environment::layout_descriptor,
    trace::{PassContext, PassResources},
    view::ReflectionTextures,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::prelude::*,
    log::warn_once,
    pbr::{ScreenSpaceAmbientOcclusionResources, ViewScreenSpaceReflectionsUniformOffset},
    platform::collections::HashMap,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroupLayoutDescriptor, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages, ComputePipeline,
            ComputePipelineDescriptor, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries, PipelineCache,
            StorageTextureAccess, TextureFormat, TextureUsages, TextureView, binding_types,
        },
        renderer::{RenderContext, RenderDevice, ViewQuery},
        view::{ExtractedView, ViewTarget, ViewUniformOffset},
    },
    shader::Shader,
    utils::default,
};
use bytemuck::{Pod, Zeroable};
use core::num::NonZeroU64;

/// Frames that are written in place.
const FRAME_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// Rates, rays and reconstruction are bound.
const HAS_PIPELINE: u32 = 1;
/// History is bound.
const HAS_HISTORY: u32 = 2;

/// What a pass over one side of a view is to show; `DebugSettings` in `debug.wesl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct GpuDebugSettings {
    /// First column and the one after the last; the same of the dividing line.
    columns: [u32; 4],
    view: u32,
    flags: u32,
    padding: [u32; 2],
    legend: [[f32; 4]; RATE_LEGEND.len()],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum DebugPass {
    /// What the composite adds.
    Reflection,
    /// A texture before the composite.
    Intermediate,
    Count,
    Locate,
    Finish,
}

impl DebugPass {
    const ALL: [Self; 5] = [
        Self::Reflection,
        Self::Intermediate,
        Self::Count,
        Self::Locate,
        Self::Finish,
    ];

    fn of(view: DebugView) -> Self {
        if view == DebugView::Reflection {
            Self::Reflection
        } else {
            Self::Intermediate
        }
    }

    fn entry_point(self) -> &'static str {
        match self {
            Self::Reflection | Self::Intermediate => "show",
            Self::Count => "count",
            Self::Locate => "locate",
            Self::Finish => "finish",
        }
    }
}

/// Layouts and pipelines of debug views and counters. They are compiled when a camera first asks for them.
#[derive(Resource)]
pub struct DebugPipelines {
    passes: HashMap<DebugPass, GBufferPass>,
    empty_layout: BindGroupLayoutDescriptor,
    pub(super) count_layout: BindGroupLayoutDescriptor,
    /// What is counted; all views in turn.
    pub(super) report: Buffer,
}

impl DebugPipelines {
    pub(super) fn get<'a>(&self, cache: &'a PipelineCache, pass: DebugPass) -> Option<&'a ComputePipeline> {
        self.passes.get(&pass)?.pipeline(cache)
    }

    fn queue(&mut self, pass: DebugPass, cache: &PipelineCache) {
        if let Some(pass) = self.passes.get_mut(&pass) {
            pass.queue(cache);
        }
    }
}

/// What both variants of `debug.wesl` bind first.
fn show_layout() -> DynamicBindGroupLayoutEntries {
    gbuffer_layout().extend_sequential((
        floats(),
        floats(),
        binding_types::texture_storage_2d(FRAME_FORMAT, StorageTextureAccess::ReadWrite),
        binding_types::uniform_buffer_sized(false, NonZeroU64::new(size_of::<GpuDebugSettings>() as u64)),
        integers(),
    ))
}

/// And what follows where a texture before the composite is shown.
fn intermediate_layout() -> DynamicBindGroupLayoutEntries {
    show_layout().extend_sequential((integers(), floats(), integers(), floats(), integers(), integers()))
}

fn count_layout() -> DynamicBindGroupLayoutEntries {
    let report = binding_types::storage_buffer_sized(false, NonZeroU64::new(4 * REPORT_WORDS));
    gbuffer_layout().extend_sequential((floats(), report))
}

/// Makes the layouts.
pub fn init_debug_pipelines(mut commands: Commands, asset_server: Res<AssetServer>, device: Res<RenderDevice>) {
    let show_shader: Handle<Shader> = load_embedded_asset!(asset_server.as_ref(), "debug.wesl");
    let count_shader: Handle<Shader> = load_embedded_asset!(asset_server.as_ref(), "count.wesl");
    let reflection = BindGroupLayoutDescriptor::new("glint_debug_reflection_layout", &show_layout());
    let intermediate = BindGroupLayoutDescriptor::new("glint_debug_intermediate_layout", &intermediate_layout());
    let count = BindGroupLayoutDescriptor::new("glint_debug_count_layout", &count_layout());
    let empty = BindGroupLayoutDescriptor::new("glint_empty_layout", &[]);
    let passes = DebugPass::ALL.map(|pass| {
        let (shader, layout, shader_defs) = match pass {
            // Group 1 is the scene's in other passes, and empty here.
            DebugPass::Reflection => (
                &show_shader,
                vec![reflection.clone(), empty.clone(), layout_descriptor()],
                vec!["REFLECTION".into()],
            ),
            DebugPass::Intermediate => (&show_shader, vec![intermediate.clone()], vec![]),
            DebugPass::Count | DebugPass::Locate | DebugPass::Finish => (&count_shader, vec![count.clone()], vec![]),
        };
        let descriptor = ComputePipelineDescriptor {
            label: Some(format!("glint_debug_{pass:?}").into()),
            layout,
            shader: shader.clone(),
            shader_defs,
            entry_point: Some(pass.entry_point().into()),
            ..default()
        };
        (pass, GBufferPass::new(descriptor))
    });
    commands.insert_resource(DebugPipelines {
        passes: HashMap::from_iter(passes),
        empty_layout: empty,
        count_layout: count,
        report: device.create_buffer(&BufferDescriptor {
            label: Some("glint_debug_report"),
            size: 4 * REPORT_WORDS,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        }),
    });
}

/// Queues what cameras ask for.
pub fn queue_debug_pipelines(
    views: Query<(&ReflectionView, &ExtractedView)>,
    mut pipelines: ResMut<DebugPipelines>,
    composite: Res<CompositePipelines>,
    cache: Res<PipelineCache>,
) {
    for (view, extracted) in &views {
        if view.debug.counters {
            for pass in [DebugPass::Count, DebugPass::Locate, DebugPass::Finish] {
                pipelines.queue(pass, &cache);
            }
        }
        for shown in view.debug.views() {
            if composite.is_in_place(extracted.target_format) {
                pipelines.queue(DebugPass::of(shown), &cache);
            } else {
                warn_once!(
                    "cameras keep their picture instead of a `DebugView`, which is written into the frame: that takes an \
                     `Hdr` camera with frames of the format Rgba16Float, and a device with the feature \
                     `TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES` that can read and write such textures in compute shaders"
                );
            }
        }
    }
}

/// Draws the debug views of one camera over its picture, and counts.
pub fn show_debug_views(
    view: ViewQuery<(
        &ReflectionView,
        &ReflectionTextures,
        &ViewTarget,
        &ViewPrepassTextures,
        &ViewUniformOffset,
        &ViewScreenSpaceReflectionsUniformOffset,
        Option<&ScreenSpaceAmbientOcclusionResources>,
    )>,
    resources: PassResources,
    pipelines: Option<Res<DebugPipelines>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, textures, target, prepass, view_offset, _, ssao) = view.into_inner();
    let debug = view.debug;
    if !debug.counters && debug.views().next().is_none() {
        return;
    }
    let (Some(pipelines), Some(context)) = (
        pipelines,
        resources.context(entity, view, textures, prepass, view_offset, ssao),
    ) else {
        return;
    };
    let Some(radiance) = composited_radiance(&context) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_debug");
    if let (true, Some(diagnostics)) = (debug.counters, diagnostics) {
        count_non_finite(&mut ctx, &pipelines, &context, radiance, diagnostics);
    }
    if target.main_texture_format() == FRAME_FORMAT
        && target.main_texture().usage().contains(TextureUsages::STORAGE_BINDING)
    {
        for side in debug.sides(textures.size().x) {
            show_side(
                &mut ctx,
                &pipelines,
                &context,
                radiance,
                target.main_texture_view(),
                &side,
            );
        }
    }
    span.end(ctx.command_encoder());
}

fn show_side(
    ctx: &mut RenderContext,
    pipelines: &DebugPipelines,
    context: &PassContext,
    radiance: &TextureView,
    frame: &TextureView,
    side: &Side,
) {
    let pass = DebugPass::of(side.view);
    let Some(shown) = pipelines.passes.get(&pass) else {
        return;
    };
    let images = context.textures.targets.pipeline.as_ref();
    let history = images.and_then(|images| images.history.as_ref());
    let settings = GpuDebugSettings {
        columns: [side.columns.start, side.columns.end, side.line.start, side.line.end],
        view: side.view as u32,
        flags: images.map_or(0, |_| HAS_PIPELINE) | history.map_or(0, |_| HAS_HISTORY),
        padding: [0; 2],
        legend: RATE_LEGEND.map(|(_, color)| [color.red, color.green, color.blue, color.alpha]),
    };
    let device = ctx.render_device();
    let settings = device.create_buffer_with_data(&BufferInitDescriptor {
        label: Some("glint_debug_settings"),
        contents: bytemuck::bytes_of(&settings),
        usage: BufferUsages::UNIFORM,
    });
    let empty_layout = context.cache.get_bind_group_layout(&pipelines.empty_layout);
    let empty = device.create_bind_group("glint_empty", &empty_layout, &[]);
    let entries = show_entries(pass, context, radiance, frame, &settings);
    let Some(mut compute) = shown.begin(ctx, context, &entries) else {
        return;
    };
    if pass == DebugPass::Reflection {
        compute.set_bind_group(1, &empty, &[]);
        compute.set_bind_group(2, context.environment, &[]);
    }
    let (columns, rows) = (side.columns.len() as u32, context.textures.size().y);
    compute.dispatch_workgroups(columns.div_ceil(8), rows.div_ceil(8), 1);
}

/// Group 0 of `debug.wesl`. The shader doesn't read what is bound in the place of something missing.
fn show_entries<'a>(
    pass: DebugPass,
    context: &PassContext<'a>,
    radiance: &'a TextureView,
    frame: &'a TextureView,
    settings: &'a Buffer,
) -> DynamicBindGroupEntries<'a> {
    let (textures, gbuffer) = (context.textures, context.gbuffer.gbuffer);
    let now = textures.parity;
    let images = textures.targets.pipeline.as_ref();
    let second = match pass {
        DebugPass::Reflection => context.ssao,
        _ => images.map(|images| &images.ray_radiance),
    };
    let entries = gbuffer_entries(context).extend_sequential((
        radiance,
        second.unwrap_or(radiance),
        frame,
        settings.as_entire_binding(),
        images.map_or(gbuffer, |images| &images.rate[now]),
    ));
    if pass == DebugPass::Reflection {
        return entries;
    }
    let history = images.and_then(|images| images.history.as_ref());
    entries.extend_sequential((
        images.map_or(gbuffer, |images| &images.ray_record),
        images.map_or(radiance, |images| &images.reconstructed),
        images.map_or(gbuffer, |images| &images.reconstructed_pair),
        history.map_or(radiance, |history| &history.radiance[now]),
        history.map_or(gbuffer, |history| &history.pair[now]),
        history.map_or(gbuffer, |history| &history.surface[now]),
    ))
}
