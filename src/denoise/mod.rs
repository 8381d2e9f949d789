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
pub(crate) mod pass;
mod reconstruct;
mod temporal;

use crate::{
    settings::{SafeSettings, Technique},
    targets::{HistoryTargets, PipelineTargets, TILE_DISPATCH},
    trace::PassContext,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    platform::collections::{HashMap, HashSet},
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::{
            BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder, ComputePipelineDescriptor, DynamicBindGroupEntries,
            DynamicBindGroupLayoutEntries, PipelineCache, StorageTextureAccess, TextureFormat, TextureView,
            binding_types,
        },
        renderer::RenderContext,
    },
    shader::Shader,
    utils::default,
};
use core::num::NonZeroU64;
use pass::{GBufferPass, gbuffer_entries, gbuffer_layout};

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
}

/// Layouts and pipelines of the denoiser.
#[derive(Resource)]
pub struct DenoisePipelines {
    passes: HashMap<DenoisePass, GBufferPass>,
    wanted: HashSet<DenoisePass>,
}

impl DenoisePipelines {
    /// Asks for the passes of a view; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, settings: &SafeSettings) {
        self.wanted.extend(DenoisePass::of(settings));
    }

    /// What a view's settings need can be used.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &SafeSettings) -> bool {
        DenoisePass::of(settings).all(|pass| self.passes[&pass].pipeline(cache).is_some())
    }
}

/// Makes the layouts.
pub fn init_denoise_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    let assets = asset_server.as_ref();
    let describe = |pass: DenoisePass, shader: Handle<Shader>, layout: DynamicBindGroupLayoutEntries| {
        let name = pass.name();
        let layout = BindGroupLayoutDescriptor::new(format!("glint_{name}_layout"), &layout);
        let descriptor = ComputePipelineDescriptor {
            label: Some(format!("glint_{name}").into()),
            layout: vec![layout],
            shader,
            entry_point: Some(name.into()),
            ..default()
        };
        (pass, GBufferPass::new(descriptor))
    };
    commands.insert_resource(DenoisePipelines {
        passes: HashMap::from_iter([
            describe(
                DenoisePass::Reconstruct,
                load_embedded_asset!(assets, "reconstruct.wesl"),
                reconstruct::layout(),
            ),
            describe(
                DenoisePass::Temporal,
                load_embedded_asset!(assets, "temporal.wesl"),
                temporal::layout(),
            ),
            describe(
                DenoisePass::Blur,
                load_embedded_asset!(assets, "blur.wesl"),
                blur::layout(),
            ),
        ]),
        wanted: HashSet::default(),
    });
}

/// Queues what cameras asked for.
pub fn queue_denoise_pipelines(mut pipelines: ResMut<DenoisePipelines>, cache: Res<PipelineCache>) {
    let pipelines = &mut *pipelines;
    for pass in &pipelines.wanted {
        if let Some(pass) = pipelines.passes.get_mut(pass) {
            pass.queue(&cache);
        }
    }
    if let Some(error) = pipelines.passes.values().find_map(|pass| pass.error(&cache)) {
        bevy::log::error_once!("ray-traced reflections stay off, since their denoiser failed: {error}");
    }
}

/// Denoises the rays of one view.
pub(crate) fn denoise(
    ctx: &mut RenderContext,
    pipelines: &DenoisePipelines,
    context: &PassContext,
    diagnostics: Option<&DiagnosticsRecorder>,
) {
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
    let entries = match pass {
        DenoisePass::Reconstruct => reconstruct::entries(context),
        DenoisePass::Temporal => temporal::entries(context),
        DenoisePass::Blur => blur::entries(context),
    };
    let Some(entries) = entries else { return };
    if let Some(mut compute) = pipelines.passes[&pass].begin(ctx, context, &entries) {
        compute.dispatch_workgroups_indirect(&context.textures.targets.arguments, TILE_DISPATCH);
    }
}

/// What all passes bind first: the G-buffer, and the lists of `tiles.wesl`.
fn tile_layout() -> DynamicBindGroupLayoutEntries {
    let words = || binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4));
    gbuffer_layout().extend_sequential((words(), words()))
}

fn tile_entries<'a>(context: &PassContext<'a>, images: &'a PipelineTargets) -> DynamicBindGroupEntries<'a> {
    gbuffer_entries(context).extend_sequential((
        images.tiles.as_entire_binding(),
        context.textures.targets.arguments.as_entire_binding(),
    ))
}

fn written(format: TextureFormat) -> BindGroupLayoutEntryBuilder {
    binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly)
}
