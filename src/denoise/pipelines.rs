//! The passes of the denoiser: which of them a view needs, and how they are compiled and run.

use super::{blur, reconstruct, temporal};
use crate::{
    common::{TILE_DISPATCH, WIDE_TILE_DISPATCH, word_offset},
    gbuffer::{GBufferPass, PassContext, PassShader},
    settings::{ClampedSettings, ReflectionTechnique},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    log::error_once,
    platform::collections::{HashMap, HashSet},
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::{PipelineCache, TextureView},
        renderer::RenderContext,
    },
    shader::Shader,
};

/// A pass of the denoiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum DenoisePass {
    /// Rays of neighbours to an image at full resolution.
    Reconstruct,
    /// Images to their mean over frames.
    Temporal,
    /// Smooths the noise that is left.
    Blur,
}

impl DenoisePass {
    /// The passes that a view's settings need, in order.
    fn of(settings: &ClampedSettings) -> impl Iterator<Item = Self> + use<> {
        let rays = settings.technique != ReflectionTechnique::Converged;
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

    /// Returns whether the pass works on 16x16 pixels at a time, which takes rays that are fewer than pixels.
    fn is_wide(self, settings: &ClampedSettings) -> bool {
        self == Self::Reconstruct && settings.technique.trace_scale() > 1
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

/// Pipelines of the denoiser.
#[derive(Resource)]
pub struct DenoisePipelines {
    passes: HashMap<DenoisePass, (GBufferPass<bool>, Handle<Shader>)>,
    /// Passes, and whether their workgroups are wide.
    wanted: HashSet<(DenoisePass, bool)>,
}

impl DenoisePipelines {
    /// Asks for the passes of a view; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, settings: &ClampedSettings) {
        let passes = DenoisePass::of(settings);
        self.wanted.extend(passes.map(|pass| (pass, pass.is_wide(settings))));
    }

    /// All that a view's settings need can be used.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &ClampedSettings) -> bool {
        DenoisePass::of(settings).all(|pass| self.passes[&pass].0.pipeline(&pass.is_wide(settings), cache).is_some())
    }
}

/// Declares what the passes bind.
pub(super) fn init_denoise_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    let assets = asset_server.as_ref();
    commands.insert_resource(DenoisePipelines {
        passes: HashMap::from_iter([
            (
                DenoisePass::Reconstruct,
                (reconstruct::pass(), load_embedded_asset!(assets, "reconstruct.wesl")),
            ),
            (
                DenoisePass::Temporal,
                (temporal::pass(), load_embedded_asset!(assets, "temporal.wesl")),
            ),
            (
                DenoisePass::Blur,
                (blur::pass(), load_embedded_asset!(assets, "blur.wesl")),
            ),
        ]),
        wanted: HashSet::default(),
    });
}

/// Queues what cameras asked for.
pub(super) fn queue_denoise_pipelines(mut pipelines: ResMut<DenoisePipelines>, cache: Res<PipelineCache>) {
    let pipelines = &mut *pipelines;
    for &(name, wide) in &pipelines.wanted {
        if let Some((pass, shader)) = pipelines.passes.get_mut(&name) {
            pass.queue(wide, &cache, || PassShader {
                shader: shader.clone(),
                defs: if wide { vec!["WIDE".into()] } else { vec![] },
                entry_point: Some(name.name()),
            });
        }
    }
    let error = pipelines
        .passes
        .values()
        .find_map(|(pass, _)| pass.errors(&cache).next());
    if let Some((_, error)) = error {
        error_once!("ray-traced reflections stay off, since their denoiser failed: {error}");
    }
}

/// Denoises the rays of one view.
pub(crate) fn denoise(
    ctx: &mut RenderContext,
    pipelines: &DenoisePipelines,
    context: &PassContext,
    diagnostics: Option<&DiagnosticsRecorder>,
) {
    let temporal = context.history().is_some();
    for name in DenoisePass::of(&context.view.settings) {
        // Without history, only this pass has what it needs.
        if !temporal && name != DenoisePass::Reconstruct {
            continue;
        }
        let span = diagnostics.time_span(ctx.command_encoder(), name.name());
        let wide = name.is_wide(&context.view.settings);
        let dispatch = if wide { WIDE_TILE_DISPATCH } else { TILE_DISPATCH };
        if let Some(mut pass) = pipelines.passes[&name].0.begin(ctx, context, [wide], &[]) {
            pass.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(dispatch));
        }
        span.end(ctx.command_encoder());
    }
}

/// Radiance that the composite shows; `None` for techniques without rays to denoise.
pub(crate) fn result<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    let images = context.images()?;
    match context.history() {
        Some((history, _)) if context.view.settings.denoiser.blur_radius <= 0.0 => {
            Some(&history.radiance[context.now()])
        }
        Some(_) => Some(images.blurred()),
        None => Some(&images.reconstructed),
    }
}
