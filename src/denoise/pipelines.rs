//! The passes of the denoiser: which of them a view needs, and how they are compiled and run.

use super::{one_pass, reconstruct, temporal, tiles::PassVariant};
use crate::{
    common::{TILE_DISPATCH, WIDE_TILE_DISPATCH, word_offset},
    gbuffer::{GBufferPass, PassContext, PassShader},
    scene::SceneBindings,
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
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
    /// Combines rays of neighbours into an image at full resolution.
    Reconstruct,
    /// Averages images over frames.
    Temporal,
    /// Both at once.
    OnePass,
}

impl DenoisePass {
    /// The passes that a view's settings need, in order.
    fn of(settings: &ClampedSettings) -> &'static [Self] {
        if settings.technique == ReflectionTechnique::Converged {
            &[]
        } else if settings.denoises_in_one_pass() {
            &[Self::OnePass]
        } else if settings.denoiser.temporal {
            &[Self::Reconstruct, Self::Temporal]
        } else {
            &[Self::Reconstruct]
        }
    }

    /// The variant for static or moving views. Wide workgroups are for views with fewer rays than pixels.
    fn variant(self, settings: &ClampedSettings, rest: bool) -> PassVariant {
        PassVariant {
            wide: self != Self::Temporal && settings.technique.trace_scale() > 1,
            rest,
            hit_motion: false,
        }
    }

    /// The variant that follows images of moving objects. It is the same if the pass reads no history, or the view is static.
    fn following(self, variant: PassVariant) -> PassVariant {
        PassVariant {
            hit_motion: self != Self::Reconstruct && !variant.rest,
            ..variant
        }
    }

    /// Returns whether rays of a view record motions: only rays of lists do.
    fn has_motions(settings: &ClampedSettings) -> bool {
        settings.backend == ReflectionBackend::Compute && settings.technique != ReflectionTechnique::QuarterInline
    }

    /// Entry point, and name of the span of GPU time.
    const fn name(self) -> &'static str {
        match self {
            Self::Reconstruct => "reconstruct",
            Self::Temporal => "temporal",
            Self::OnePass => "denoise",
        }
    }
}

/// Pipelines of the denoiser.
#[derive(Resource)]
pub struct DenoisePipelines {
    passes: HashMap<DenoisePass, (GBufferPass<PassVariant>, Handle<Shader>)>,
    /// Passes requested since pipelines were last queued.
    wanted: HashSet<(DenoisePass, PassVariant)>,
    /// Objects with known motion move in this frame.
    knows_motions: bool,
}

impl DenoisePipelines {
    /// Requests the passes of a view. Call in each frame.
    pub(crate) fn request(&mut self, settings: &ClampedSettings) {
        for rest in [false, true] {
            let passes = DenoisePass::of(settings).iter();
            self.wanted
                .extend(passes.map(|&pass| (pass, pass.variant(settings, rest))));
        }
    }

    /// Returns whether everything that a view's settings need is ready.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &ClampedSettings) -> bool {
        // The variant that works for all views.
        DenoisePass::of(settings).iter().all(|pass| {
            let variant = pass.variant(settings, true);
            self.passes[pass].0.pipeline(&variant, cache).is_some()
        })
    }
}

/// Declares the bindings of the passes.
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
                DenoisePass::OnePass,
                (one_pass::pass(), load_embedded_asset!(assets, "one_pass.wesl")),
            ),
        ]),
        wanted: HashSet::default(),
        knows_motions: false,
    });
}

/// Queues the passes that cameras requested.
pub(super) fn queue_denoise_pipelines(
    mut pipelines: ResMut<DenoisePipelines>,
    cache: Res<PipelineCache>,
    scene: Res<SceneBindings>,
) {
    let pipelines = &mut *pipelines;
    pipelines.knows_motions = scene.knows_motions();
    for (name, variant) in core::mem::take(&mut pipelines.wanted) {
        let Some((pass, shader)) = pipelines.passes.get_mut(&name) else {
            continue;
        };
        let following = Some(name.following(variant)).filter(|_| pipelines.knows_motions);
        for variant in [Some(variant), following].into_iter().flatten() {
            pass.queue(variant, &cache, || PassShader {
                shader: shader.clone(),
                defs: variant.shader_defs(),
                entry_point: Some(name.name()),
            });
        }
    }
    let error = pipelines
        .passes
        .values()
        .find_map(|(pass, _)| pass.errors(&cache).next());
    if let Some((_, error)) = error {
        error_once!(
            "a denoiser of ray-traced reflections failed; cameras that need it get simpler reflections, or none: {error}"
        );
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
    for &name in DenoisePass::of(&context.view.settings) {
        // Only this pass has its inputs without history.
        if !temporal && name != DenoisePass::Reconstruct {
            continue;
        }
        let span = diagnostics.time_span(ctx.command_encoder(), name.name());
        let rests = [context.textures.is_at_rest, true];
        let [variant, stand_in] = rests.map(|rest| name.variant(&context.view.settings, rest));
        let following = if pipelines.knows_motions && DenoisePass::has_motions(&context.view.settings) {
            name.following(variant)
        } else {
            variant
        };
        let variants = [following, variant, stand_in];
        let dispatch = if variant.wide {
            WIDE_TILE_DISPATCH
        } else {
            TILE_DISPATCH
        };
        if let Some(mut pass) = pipelines.passes[&name].0.begin(ctx, context, variants, &[]) {
            pass.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(dispatch));
        }
        span.end(ctx.command_encoder());
    }
}

/// Returns whether the content of a history is blurred for display.
pub(crate) fn blurs(settings: &ClampedSettings) -> bool {
    let denoiser = &settings.denoiser;
    settings.technique != ReflectionTechnique::Converged && denoiser.temporal && denoiser.blur_radius > 0.0
}

/// Radiance that the composite displays, before the last blur; `None` for techniques without rays to denoise.
pub(crate) fn result<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    let images = context.images()?;
    match context.history() {
        Some((history, _)) => Some(&history.radiance[context.now()]),
        // After a camera lost its motion vectors, the last frame is displayed until its passes are compiled.
        None => images.reconstructed.as_ref().or_else(|| {
            let history = images.history.as_ref();
            history.map(|history| &history.radiance[context.before()])
        }),
    }
}
