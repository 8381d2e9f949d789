//! The pass that assigns a rate to each tile and lists the rays.

use super::images::RateImages;
use crate::{
    common::INDIRECT_ARG_WORDS,
    gbuffer::{Binding, PassContext, integers},
    pipelines::{Failure, Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::{RateSettings, RateVariant},
    targets::{RATE_FORMAT, RAY_SAMPLE_FORMAT},
};
use bevy::render::{render_resource::IntoBinding, renderer::RenderContext};

/// The pass, with a variant for each heuristic and each of users' shaders.
pub(crate) const RATES: &Pass = &Pass {
    label: "glint_rate",
    shader: "rate/classify.wesl",
    entry_point: "classify",
    bindings,
    ..Pass::new(Failure::RATES)
};

/// The pass that reads the history, for [`RateVariant::Adaptive`].
pub(crate) const ADAPTIVE_RATES: &Pass = &Pass {
    label: "glint_adaptive_rate",
    shader: "rate/adaptive.wesl",
    bindings: || bindings().into_iter().chain(history_bindings()).collect(),
    ..*RATES
};

/// Bindings of the pass.
fn bindings() -> Vec<Binding> {
    vec![
        Binding::written(RATE_FORMAT, |context| Some(&context.images()?.rate[context.now()])),
        Binding::written_words(1, |context| Some(&context.images()?.ray_list)),
        Binding::written_words(1, |context| Some(&context.images()?.mirror_ray_list)),
        Binding::written_words(1, |context| Some(&context.images()?.tile_list)),
        Binding::written_words(INDIRECT_ARG_WORDS, |context| Some(&context.targets().indirect_args)),
        Binding::written(RAY_SAMPLE_FORMAT, |context| Some(&context.images()?.ray_sample)),
        // The user's rate image.
        Binding::given(integers()),
    ]
}

/// The last frame, for [`RateVariant::Adaptive`].
fn history_bindings() -> [Binding; 5] {
    [
        Binding::integers(|context| Some(&context.images()?.rate[context.before()])),
        Binding::floats(|context| context.motion),
        Binding::floats(|context| Some(&context.history()?.0.radiance[context.before()])),
        Binding::integers(|context| Some(&context.history()?.0.stats[context.before()])),
        Binding::integers(|context| Some(&context.history()?.0.surface[context.before()])),
    ]
}

/// The pass with a heuristic.
fn variant(heuristic: &RateVariant, rate: &RateSettings) -> Variant {
    let shape = Options::TILE_ANGLES | Options::TILE_SHAPE | Options::TILE_REFLECTANCE;
    let (pass, mut options) = match heuristic {
        RateVariant::Uniform => (RATES, Options::empty()),
        RateVariant::Roughness => (RATES, Options::ROUGHNESS),
        RateVariant::Grazing => (RATES, Options::GRAZING | Options::TILE_ANGLES),
        RateVariant::Combined => (RATES, Options::COMBINED | shape),
        RateVariant::Adaptive => (ADAPTIVE_RATES, shape),
        RateVariant::Image => (RATES, Options::IMAGE),
        RateVariant::Custom(_) => (RATES, shape | Options::TILE_DEPTH),
    };
    options.set(Options::TILES_8, rate.tile_size == 8);
    let own = match heuristic {
        RateVariant::Custom(shader) => Some(shader.clone()),
        _ => None,
    };
    Variant {
        own,
        ..pass.variant(Features::empty(), options)
    }
}

/// The variant for a part of the tiles. It doesn't exist for users' shaders.
fn of_part(mut variant: Variant) -> Option<Variant> {
    variant.options |= Options::PART;
    variant.own.is_none().then_some(variant)
}

/// The heuristic that replaces a user's asset until it is loaded, or if it is unusable, and one that reads the history while there is none.
fn stand_in(heuristic: &RateVariant) -> Option<RateVariant> {
    match heuristic {
        RateVariant::Image | RateVariant::Custom(_) => Some(RateVariant::Uniform),
        RateVariant::Adaptive => Some(RateVariant::Combined),
        _ => None,
    }
}

/// The variants for a view.
pub(crate) fn variants(rate: &RateSettings) -> impl Iterator<Item = Variant> {
    let heuristics = [Some(rate.variant.clone()), stand_in(&rate.variant)];
    heuristics
        .into_iter()
        .flatten()
        .map(|heuristic| variant(&heuristic, rate))
}

/// The variants that visit a part of a view's tiles.
pub(crate) fn variants_of_parts(rate: &RateSettings) -> impl Iterator<Item = Variant> {
    variants(rate).filter_map(of_part)
}

/// The variants without which a view can't start, even if a user's shader or image isn't ready.
pub(crate) fn needed(rate: &RateSettings) -> impl Iterator<Item = Variant> {
    let is_own = matches!(rate.variant, RateVariant::Image | RateVariant::Custom(_));
    variants(rate).skip(usize::from(is_own))
}

/// Computes rates, lists of rays and their indirect arguments for one view; expects the indirect arguments to be 0.
pub(crate) fn determine_rates(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    images: &RateImages,
    context: &PassContext,
) {
    let rate = &context.view.rate;
    let image = rate.image.as_ref().and_then(|image| images.get(image.id()));
    let is_usable = match rate.variant {
        RateVariant::Image => image.is_some(),
        RateVariant::Adaptive => context.history().is_some(),
        _ => true,
    };
    let heuristics = [is_usable.then(|| rate.variant.clone()), stand_in(&rate.variant)];
    let mut variants = heuristics
        .into_iter()
        .flatten()
        .map(|heuristic| variant(&heuristic, rate));
    let is_compiled = |variant: &Variant| pipelines.is_compiled(context.cache, variant);
    let Some(variant) = variants.find(is_compiled) else {
        return;
    };
    let part = of_part(variant.clone()).filter(is_compiled);
    let (variant, size) = match part.zip(context.tiles) {
        Some((part, tiles)) => (part, tiles.size()),
        None => (variant, context.targets().sizes.tiles()),
    };
    // Without a rate image something must be bound; no shader reads it.
    let image = image.unwrap_or(context.gbuffer.gbuffer);
    if let Some(mut pass) = pipelines.begin(ctx, context, [variant], &[image.into_binding()]) {
        pass.dispatch_workgroups(size.x, size.y, 1);
    }
}
