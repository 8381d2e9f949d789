//! How samples become an image: reconstruction, accumulation over frames, and a last blur.

use crate::{
    settings::SafeSettings,
    targets::{PAIR_FORMAT, RADIANCE_FORMAT, SURFACE_FORMAT, TILE_DISPATCH},
    trace::{GBufferBindings, PassContext, gbuffer_layout_entries},
};
use bevy::{
    asset::{AssetServer, Handle},
    ecs::prelude::*,
    platform::collections::{HashMap, HashSet},
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedComputePipelineId,
            ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, PipelineCache, ShaderStages,
            StorageTextureAccess, TextureSampleType, TextureView, binding_types,
        },
        renderer::RenderContext,
    },
    shader::Shader,
    utils::default,
};
use core::num::NonZeroU64;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum DenoisePass {
    Reconstruct,
    Temporal,
    Blur,
}

impl DenoisePass {
    const ALL: [Self; 3] = [Self::Reconstruct, Self::Temporal, Self::Blur];

    fn of(settings: &SafeSettings) -> impl Iterator<Item = Self> + use<> {
        let denoiser = settings.denoiser;
        let needed = settings.technique != crate::settings::Technique::Converged;
        [
            needed.then_some(Self::Reconstruct),
            (needed && denoiser.temporal).then_some(Self::Temporal),
            (needed && denoiser.temporal && denoiser.blur_radius > 0.0).then_some(Self::Blur),
        ]
        .into_iter()
        .flatten()
    }

    fn name(self) -> &'static str {
        match self {
            Self::Reconstruct => "reconstruct",
            Self::Temporal => "temporal",
            Self::Blur => "blur",
        }
    }
}

/// Layouts and pipelines of the denoiser.
#[derive(Resource)]
pub struct DenoisePipelines {
    shaders: HashMap<DenoisePass, Handle<Shader>>,
    layouts: HashMap<DenoisePass, BindGroupLayoutDescriptor>,
    queued: HashMap<DenoisePass, CachedComputePipelineId>,
    wanted: HashSet<DenoisePass>,
}

impl DenoisePipelines {
    pub(crate) fn request(&mut self, settings: &SafeSettings) {
        self.wanted.extend(DenoisePass::of(settings));
    }

    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &SafeSettings) -> bool {
        DenoisePass::of(settings).all(|pass| self.pipeline(cache, pass).is_some())
    }

    fn pipeline<'a>(&self, cache: &'a PipelineCache, pass: DenoisePass) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(*self.queued.get(&pass)?)
    }
}

fn layout(pass: DenoisePass) -> BindGroupLayoutDescriptor {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let float = || binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let uint = || binding_types::texture_2d(TextureSampleType::Uint);
    let words = || binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4));
    let write = |format| binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly);
    let label = format!("glint_{}_layout", pass.name());
    match pass {
        DenoisePass::Reconstruct => BindGroupLayoutDescriptor::new(
            label,
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    words(),
                    words(),
                    uint(),
                    float(),
                    uint(),
                    float(),
                    write(RADIANCE_FORMAT),
                    write(PAIR_FORMAT),
                ),
            ),
        ),
        DenoisePass::Temporal => BindGroupLayoutDescriptor::new(
            label,
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    words(),
                    words(),
                    uint(),
                    uint(),
                    float(),
                    float(),
                    uint(),
                    float(),
                    uint(),
                    uint(),
                    write(RADIANCE_FORMAT),
                    write(PAIR_FORMAT),
                    write(SURFACE_FORMAT),
                ),
            ),
        ),
        DenoisePass::Blur => BindGroupLayoutDescriptor::new(
            label,
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    words(),
                    words(),
                    uint(),
                    float(),
                    uint(),
                    uint(),
                    write(RADIANCE_FORMAT),
                ),
            ),
        ),
    }
}

/// Makes the layouts.
pub fn init_denoise_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    commands.insert_resource(DenoisePipelines {
        shaders: DenoisePass::ALL
            .into_iter()
            .map(|pass| {
                (
                    pass,
                    asset_server.load(format!("embedded://bevy_glint/denoise/{}.wesl", pass.name())),
                )
            })
            .collect(),
        layouts: DenoisePass::ALL.into_iter().map(|pass| (pass, layout(pass))).collect(),
        queued: HashMap::default(),
        wanted: HashSet::default(),
    });
}

/// Queues what cameras asked for.
pub fn queue_denoise_pipelines(mut pipelines: ResMut<DenoisePipelines>, cache: Res<PipelineCache>) {
    let pipelines = &mut *pipelines;
    for &pass in &pipelines.wanted {
        pipelines.queued.entry(pass).or_insert_with(|| {
            cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some(format!("glint_{}", pass.name()).into()),
                layout: vec![pipelines.layouts[&pass].clone()],
                shader: pipelines.shaders[&pass].clone(),
                entry_point: Some(pass.name().into()),
                ..default()
            })
        });
    }
}

/// The denoised radiance of a view, before the composite.
pub(crate) fn result<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    let images = context.textures.targets.pipeline.as_ref()?;
    Some(match &images.history {
        Some(history) if context.view.settings.denoiser.blur_radius <= 0.0 => {
            &history.radiance[context.textures.parity]
        }
        _ => &images.reconstructed,
    })
}

/// Reconstruction, accumulation and blur of one view.
pub(crate) fn denoise(ctx: &mut RenderContext, pipelines: &DenoisePipelines, context: &PassContext) {
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    for pass in DenoisePass::of(&context.view.settings) {
        let span = diagnostics.time_span(ctx.command_encoder(), pass.name());
        record(ctx, pipelines, context, pass);
        span.end(ctx.command_encoder());
    }
}

fn record(ctx: &mut RenderContext, pipelines: &DenoisePipelines, context: &PassContext, pass: DenoisePass) {
    let Some(pipeline) = pipelines.pipeline(context.cache, pass) else {
        return;
    };
    let Some(bind_group) = bind_group(ctx, pipelines, context, pass) else {
        return;
    };
    let mut compute = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some(pass.name()),
        timestamp_writes: None,
    });
    compute.set_pipeline(pipeline);
    compute.set_bind_group(0, &bind_group, &[context.view_offset]);
    compute.dispatch_workgroups_indirect(&context.textures.targets.arguments, TILE_DISPATCH);
}

fn bind_group(
    ctx: &mut RenderContext,
    pipelines: &DenoisePipelines,
    context: &PassContext,
    pass: DenoisePass,
) -> Option<BindGroup> {
    let textures = context.textures;
    let (now, before) = (textures.parity, 1 - textures.parity);
    let targets = &textures.targets;
    let images = targets.pipeline.as_ref()?;
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let layout = context.cache.get_bind_group_layout(&pipelines.layouts[&pass]);
    let device = ctx.render_device();
    let (tiles, arguments) = (images.tiles.as_entire_binding(), targets.arguments.as_entire_binding());
    Some(match pass {
        DenoisePass::Reconstruct => device.create_bind_group(
            pass.name(),
            &layout,
            &BindGroupEntries::sequential((
                view,
                settings,
                depth,
                gbuffer,
                normals,
                tiles,
                arguments,
                &images.rate[now],
                &images.ray_radiance,
                &images.ray_record,
                context.albedo_table,
                &images.reconstructed,
                &images.reconstructed_pair,
            )),
        ),
        DenoisePass::Temporal => {
            let history = images.history.as_ref()?;
            device.create_bind_group(
                pass.name(),
                &layout,
                &BindGroupEntries::sequential((
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    tiles,
                    arguments,
                    &images.rate[now],
                    &images.rate[before],
                    context.motion?,
                    &images.reconstructed,
                    &images.reconstructed_pair,
                    &history.radiance[before],
                    &history.pair[before],
                    &history.surface[before],
                    &history.radiance[now],
                    &history.pair[now],
                    &history.surface[now],
                )),
            )
        }
        DenoisePass::Blur => {
            let history = images.history.as_ref()?;
            device.create_bind_group(
                pass.name(),
                &layout,
                &BindGroupEntries::sequential((
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    tiles,
                    arguments,
                    &images.rate[now],
                    &history.radiance[now],
                    &history.pair[now],
                    &history.surface[now],
                    &images.reconstructed,
                )),
            )
        }
    })
}
