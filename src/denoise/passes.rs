//! The passes of the denoiser: which of them a view needs, and how they run.

use super::{one_pass::ONE_PASS, reconstruct::RECONSTRUCT, temporal::TEMPORAL};
use crate::{
    common::{TILE_DISPATCH, WIDE_TILE_DISPATCH, word_offset},
    gbuffer::PassContext,
    pipelines::{Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
};
use bevy::render::{
    diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
    render_resource::TextureView,
    renderer::RenderContext,
};

/// The passes that a view's settings need, in order.
fn passes_of(settings: &ClampedSettings) -> &'static [&'static Pass] {
    if settings.technique == ReflectionTechnique::Converged {
        &[]
    } else if settings.denoises_in_one_pass() {
        &[ONE_PASS]
    } else if settings.denoiser.temporal {
        &[RECONSTRUCT, TEMPORAL]
    } else {
        &[RECONSTRUCT]
    }
}

/// The variant for static or moving views. Wide workgroups are for views with fewer rays than texels.
fn variant(pass: &'static Pass, settings: &ClampedSettings, rest: bool) -> Variant {
    let mut options = Options::empty();
    options.set(
        Options::WIDE,
        pass != TEMPORAL && settings.technique.trace_scale() > settings.texel(),
    );
    options.set(Options::REST, rest);
    pass.variant(Features::empty(), options)
}

/// The variant that follows images of moving objects. It is the same if the pass reads no history, or the view is static.
fn following(mut variant: Variant) -> Variant {
    let follows = variant.pass != RECONSTRUCT && !variant.options.contains(Options::REST);
    variant.options.set(Options::HIT_MOTION, follows);
    variant
}

/// The variant that shortens histories of light that changes. It is the same in the same cases.
fn following_light(mut variant: Variant) -> Variant {
    let follows = variant.pass != RECONSTRUCT && !variant.options.contains(Options::REST);
    variant.options.set(Options::LIGHT_CHANGES, follows);
    variant
}

/// Returns whether rays of a view record motions: only rays of lists do.
fn has_motions(settings: &ClampedSettings) -> bool {
    settings.backend == ReflectionBackend::Compute && settings.technique != ReflectionTechnique::QuarterInline
}

/// The variants for a view. `knows_motions` is true if objects with known motion move, and `changes` if the scene changes.
pub(crate) fn variants(
    settings: &ClampedSettings,
    knows_motions: bool,
    changes: bool,
) -> impl Iterator<Item = Variant> {
    let views = [false, true].into_iter();
    views.flat_map(move |rest| {
        let passes = passes_of(settings).iter();
        passes.flat_map(move |pass| {
            let variant = variant(pass, settings, rest);
            let following = knows_motions.then(|| following(variant.clone()));
            let all = [Some(variant), following].into_iter().flatten();
            all.flat_map(move |variant| {
                let follows = changes && settings.follows_light();
                let light = follows.then(|| following_light(variant.clone()));
                [Some(variant), light].into_iter().flatten()
            })
        })
    })
}

/// The variants without which a view can't start: they work for all views.
pub(crate) fn needed(settings: &ClampedSettings) -> impl Iterator<Item = Variant> {
    let passes = passes_of(settings).iter();
    passes.map(|pass| variant(pass, settings, true))
}

/// Denoises the rays of one view. `follows_light` is true if rays of earlier frames were traced again.
pub(crate) fn denoise(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
    follows_light: bool,
    diagnostics: Option<&DiagnosticsRecorder>,
) {
    let temporal = context.history().is_some();
    let settings = &context.view.settings;
    for pass in passes_of(settings) {
        // Only this pass has its inputs without history.
        if !temporal && *pass != RECONSTRUCT {
            continue;
        }
        let span = diagnostics.time_span(ctx.command_encoder(), pass.entry_point);
        let [variant, stand_in] = [context.textures.is_at_rest, true].map(|rest| variant(pass, settings, rest));
        let follows = context.knows_motions && has_motions(settings);
        let following = follows.then(|| following(variant.clone()));
        let dispatch = if variant.options.contains(Options::WIDE) {
            WIDE_TILE_DISPATCH
        } else {
            TILE_DISPATCH
        };
        let best = [following, Some(variant)].into_iter().flatten();
        let light = best.clone().filter(|_| follows_light).map(following_light);
        let variants = light.chain(best).chain([stand_in]);
        if let Some(mut pass) = pipelines.begin(ctx, context, variants, &[]) {
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
