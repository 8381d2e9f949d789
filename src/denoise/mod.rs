//! From rays to a stable image: reconstruction, temporal accumulation, blur (section 4.1.2 of the paper).
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | `reconstruct` | rays of the neighbourhood | radiance at full resolution, its variance, hit distance, number of rays |
//! | `temporal` | that, and the history of the last frame | the history of this frame |
//! | `blur` | the history of this frame | what is shown |
//!
//! All visit the active tiles of the rate image alone. Shared by them: `tiles.wesl`, which thread works where; `neighbours.wesl`, whose
//! rays a pixel borrows; `lobes.wesl`, what they weigh; `filters.wesl`, which surfaces match and how far history is trusted.
//!
//! The blur can't write to what it reads. With temporal accumulation it reads the history, and there alone it runs.

mod blur;
mod reconstruct;
mod temporal;

use crate::{
    settings::{SafeSettings, Technique},
    targets::{HistoryTargets, TILE_DISPATCH},
    trace::PassContext,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    platform::collections::{HashMap, HashSet},
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder, CachedComputePipelineId, CachedPipelineState,
            ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, PipelineCache, StorageTextureAccess,
            TextureFormat, TextureSampleType, TextureView, binding_types,
        },
        renderer::RenderContext,
    },
    shader::{Shader, ShaderCacheError},
    utils::default,
};
use core::num::NonZeroU64;

/// A pass of the denoiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum DenoisePass {
    /// Rays of neighbours to an image at full resolution.
    Reconstruct,
    /// Images to their mean over frames.
    Temporal,
    /// What noise is left.
    Blur,
}

impl DenoisePass {
    /// The passes that a view's settings need, in order.
    fn of(settings: &SafeSettings) -> impl Iterator<Item = Self> + use<> {
        let rays = settings.technique != Technique::Converged;
        let temporal = rays && settings.denoiser.temporal;
        let blur = temporal && settings.denoiser.blur_radius > 0.0;
        [
            rays.then_some(Self::Reconstruct),
            temporal.then_some(Self::Temporal),
            blur.then_some(Self::Blur),
        ]
        .into_iter()
        .flatten()
    }

    /// Entry point, and name of the span of GPU time.
    const fn name(self) -> &'static str {
        match self {
            Self::Reconstruct => "reconstruct",
            Self::Temporal => "temporal",
            Self::Blur => "blur",
        }
    }

    const fn label(self) -> &'static str {
        match self {
            Self::Reconstruct => "glint_reconstruct",
            Self::Temporal => "glint_temporal",
            Self::Blur => "glint_blur",
        }
    }
}

/// Layouts and pipelines of the denoiser.
#[derive(Resource)]
pub struct DenoisePipelines {
    shaders: HashMap<DenoisePass, Handle<Shader>>,
    layouts: HashMap<DenoisePass, BindGroupLayoutDescriptor>,
    compute: HashMap<DenoisePass, CachedComputePipelineId>,
    wanted: HashSet<DenoisePass>,
}

impl DenoisePipelines {
    /// Asks for the passes of a view; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, settings: &SafeSettings) {
        self.wanted.extend(DenoisePass::of(settings));
    }

    /// What a view's settings need can be used.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &SafeSettings) -> bool {
        DenoisePass::of(settings).all(|pass| self.compute(cache, pass).is_some())
    }

    fn compute<'a>(&self, cache: &'a PipelineCache, pass: DenoisePass) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(*self.compute.get(&pass)?)
    }

    /// The first error of a pipeline, other than that its modules are still being loaded.
    fn error<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ShaderCacheError> {
        let mut states = self.compute.values().map(|&id| cache.get_compute_pipeline_state(id));
        states.find_map(|state| match state {
            CachedPipelineState::Err(
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
            ) => None,
            CachedPipelineState::Err(error) => Some(error),
            _ => None,
        })
    }
}

/// Makes the layouts.
pub fn init_denoise_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    let assets = asset_server.as_ref();
    commands.insert_resource(DenoisePipelines {
        shaders: HashMap::from_iter([
            (
                DenoisePass::Reconstruct,
                load_embedded_asset!(assets, "reconstruct.wesl"),
            ),
            (DenoisePass::Temporal, load_embedded_asset!(assets, "temporal.wesl")),
            (DenoisePass::Blur, load_embedded_asset!(assets, "blur.wesl")),
        ]),
        layouts: HashMap::from_iter([
            (DenoisePass::Reconstruct, reconstruct::layout()),
            (DenoisePass::Temporal, temporal::layout()),
            (DenoisePass::Blur, blur::layout()),
        ]),
        compute: HashMap::default(),
        wanted: HashSet::default(),
    });
}

/// Queues what cameras asked for.
pub fn queue_denoise_pipelines(mut pipelines: ResMut<DenoisePipelines>, cache: Res<PipelineCache>) {
    let pipelines = &mut *pipelines;
    for &pass in &pipelines.wanted {
        if pipelines.compute.contains_key(&pass) {
            continue;
        }
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(pass.label().into()),
            layout: vec![pipelines.layouts[&pass].clone()],
            shader: pipelines.shaders[&pass].clone(),
            entry_point: Some(pass.name().into()),
            ..default()
        });
        pipelines.compute.insert(pass, id);
    }
    if let Some(error) = pipelines.error(&cache) {
        bevy::log::error_once!("ray-traced reflections stay off, since their denoiser failed: {error}");
    }
}

/// Denoises the rays of one view.
pub(crate) fn denoise(ctx: &mut RenderContext, pipelines: &DenoisePipelines, context: &PassContext) {
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    for pass in passes(context) {
        let span = diagnostics.time_span(ctx.command_encoder(), pass.name());
        run(ctx, pipelines, context, pass);
        span.end(ctx.command_encoder());
    }
}

/// Radiance that the composite shows; `None` for techniques without rays to denoise.
pub(crate) fn result<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    match history(context) {
        Some((history, _)) if context.view.settings.denoiser.blur_radius <= 0.0 => {
            Some(&history.radiance[textures.parity])
        }
        _ => Some(&images.reconstructed),
    }
}

/// The passes of a view that can run.
fn passes(context: &PassContext) -> impl Iterator<Item = DenoisePass> + use<> {
    let temporal = history(context).is_some();
    DenoisePass::of(&context.view.settings).filter(move |&pass| temporal || pass == DenoisePass::Reconstruct)
}

/// History and motion vectors, if images are accumulated and both are there.
fn history<'a>(context: &PassContext<'a>) -> Option<(&'a HistoryTargets, &'a TextureView)> {
    let history = context.textures.targets.pipeline.as_ref()?.history.as_ref()?;
    context.motion.map(|motion| (history, motion))
}

fn run(ctx: &mut RenderContext, pipelines: &DenoisePipelines, context: &PassContext, pass: DenoisePass) {
    let cache = context.cache;
    let Some(pipeline) = pipelines.compute(cache, pass) else {
        return;
    };
    let layout = cache.get_bind_group_layout(&pipelines.layouts[&pass]);
    let device = ctx.render_device();
    let bind_group = match pass {
        DenoisePass::Reconstruct => reconstruct::bind_group(device, &layout, context),
        DenoisePass::Temporal => temporal::bind_group(device, &layout, context),
        DenoisePass::Blur => blur::bind_group(device, &layout, context),
    };
    let Some(bind_group) = bind_group else { return };
    let mut compute = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some(pass.label()),
        timestamp_writes: None,
    });
    compute.set_pipeline(pipeline);
    compute.set_bind_group(0, &bind_group, &[context.view_offset]);
    compute.dispatch_workgroups_indirect(&context.textures.targets.arguments, TILE_DISPATCH);
}

/// A list of `tiles.wesl`.
fn words() -> BindGroupLayoutEntryBuilder {
    binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4))
}

fn integers() -> BindGroupLayoutEntryBuilder {
    binding_types::texture_2d(TextureSampleType::Uint)
}

fn floats() -> BindGroupLayoutEntryBuilder {
    binding_types::texture_2d(TextureSampleType::Float { filterable: false })
}

fn written(format: TextureFormat) -> BindGroupLayoutEntryBuilder {
    binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly)
}
