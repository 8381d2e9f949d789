//! Turns the lobe's radiance into light: directly in the frame if a compute shader can write it, else in a texture.

use crate::{
    common::{TILE_DISPATCH, word_offset},
    denoise,
    device::FRAME_FORMAT,
    gbuffer::{Binding, FindTexture, PassContext},
    pipelines::{Failure, Groups, Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::ClampedSettings,
    targets::{HistoryTargets, REFLECTION_FORMAT},
};
use bevy::render::{render_resource::TextureView, renderer::RenderContext};

/// Surfaces with a reflection to add to the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Surfaces {
    /// Surfaces in Bevy's G-buffer.
    Opaque,
    /// Surfaces in the front layer.
    FrontLayer,
}

/// Resolves every pixel of [`PassContext::area`] into a separate texture.
pub(crate) const RESOLVE_APART: &Pass = &Pass {
    label: "glint_resolve_apart",
    options: Options::empty(),
    bindings: || {
        let output = Binding::written(REFLECTION_FORMAT, |context| context.targets().reflection.as_ref());
        let frame = Binding::floats(|context| Some(context.frame));
        resolve_bindings([output, frame])
    },
    ..*RESOLVE
};

/// Reads and writes every pixel of the frame.
pub(crate) const RESOLVE: &Pass = &Pass {
    label: "glint_resolve",
    shader: "composite/resolve.wesl",
    entry_point: "resolve",
    bindings: || resolve_bindings([frame()]),
    groups: Groups::Environment,
    options: Options::IN_PLACE,
    ..Pass::new(Failure::COMPOSITE)
};

/// Reads and writes the active tiles of the frame.
pub(crate) const RESOLVE_TILES: &Pass = &Pass {
    label: "glint_resolve_tiles",
    options: Options::IN_PLACE.union(Options::TILES),
    bindings: || {
        resolve_bindings([
            frame(),
            Binding::words(|context| Some(&context.targets().indirect_args)),
            Binding::words(|context| Some(&context.images()?.tile_list)),
        ])
    },
    ..*RESOLVE
};

fn frame() -> Binding {
    Binding::read_written(FRAME_FORMAT, |context| Some(context.frame))
}

fn resolve_bindings(own: impl IntoIterator<Item = Binding>) -> Vec<Binding> {
    // Without SSAO something must be bound; the shader doesn't read it.
    let mut bindings = shown_bindings(|context| context.ssao.or_else(|| composited_radiance(context)));
    bindings.extend(own);
    bindings
}

/// The pass that resolves reflections. `in_place` is true if compute shaders can write the frame, and `has_tiles` if the view has a tile
/// list.
pub(super) fn pass(in_place: bool, has_tiles: bool) -> &'static Pass {
    match (in_place, has_tiles) {
        (false, _) => RESOLVE_APART,
        (true, true) => RESOLVE_TILES,
        (true, false) => RESOLVE,
    }
}

/// Properties of the scene that the front layer's light depends on: the layer can contain opaque surfaces, which are lit differently from
/// glass, and light probes affect transparent ones.
fn layer_features(settings: &ClampedSettings, scene: Features) -> Features {
    let mut features = scene & (Features::LIGHT_PROBES | Features::FORWARD_SURFACES);
    if !settings.forward {
        features -= Features::FORWARD_SURFACES;
    }
    features
}

/// The definitions of views with these settings. Without history, nothing is blurred.
fn blurs(settings: &ClampedSettings) -> impl Iterator<Item = Options> + Clone + use<> {
    let size = resolution(settings);
    [Some(size), denoise::blurs(settings).then_some(size | Options::BLUR)]
        .into_iter()
        .flatten()
}

/// The definition for the resolution of the denoiser.
pub(crate) fn resolution(settings: &ClampedSettings) -> Options {
    if settings.denoiser.half_resolution {
        Options::HALF_RESOLUTION
    } else {
        Options::empty()
    }
}

/// Variants for opaque surfaces.
pub(super) fn variants(pass: &'static Pass, settings: &ClampedSettings) -> impl Iterator<Item = Variant> + use<> {
    blurs(settings).map(|blurs| pass.variant(Features::empty(), blurs))
}

/// Variants for the front layer, in a scene with these features.
pub(super) fn layer_variants(
    pass: &'static Pass,
    settings: &ClampedSettings,
    scene: Features,
) -> impl Iterator<Item = Variant> + use<> {
    let features = layer_features(settings, scene);
    let (blurs, without_probes) = (blurs(settings), features - Features::LIGHT_PROBES);
    let all = [Some(without_probes), (features != without_probes).then_some(features)]
        .into_iter()
        .flatten();
    all.flat_map(move |features| {
        blurs
            .clone()
            .map(move |blurs| pass.variant(features, blurs | Options::FRONT_LAYER))
    })
}

/// Resolves the reflection of one view. Returns false if the pass isn't compiled.
pub(super) fn run(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    pass: &'static Pass,
    context: &PassContext,
    surfaces: Surfaces,
) -> bool {
    let settings = &context.view.settings;
    let size = resolution(settings);
    let mut blur = size;
    blur.set(Options::BLUR, context.history().is_some() && denoise::blurs(settings));
    let variants = [blur, size].map(|blur| match surfaces {
        Surfaces::Opaque => pass.variant(Features::empty(), blur),
        Surfaces::FrontLayer => pass.variant(layer_features(settings, context.features), blur | Options::FRONT_LAYER),
    });
    let Some(mut compute) = pipelines.begin(ctx, context, variants, &[]) else {
        return false;
    };
    if pass == RESOLVE_TILES {
        compute.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(TILE_DISPATCH));
    } else {
        // As in the shader.
        let groups = context
            .area()
            .size()
            .map(|pixels| pixels.div_ceil(8 * settings.texel()));
        compute.dispatch_workgroups(groups.x, groups.y, 1);
    }
    true
}

/// Bindings 5 to 9 of the passes that display reflections: the bindings of `denoise/blur.wesl` and `upsample.wesl`, with `second` as
/// binding 6.
pub(crate) fn shown_bindings(second: FindTexture) -> Vec<Binding> {
    vec![
        Binding::floats(composited_radiance),
        Binding::floats(second),
        Binding::integers(|context| or_gbuffer(context, context.images().map(|images| &images.rate[context.now()]))),
        Binding::integers(|context| or_gbuffer(context, history(context).map(|history| &history.stats[context.now()]))),
        Binding::floats(|context| {
            let mirrors = context.images().and_then(|images| images.mirrors.as_ref());
            mirrors
                .map(|(radiance, _)| radiance)
                .or_else(|| composited_radiance(context))
        }),
    ]
}

/// Textures of the history, if results are accumulated.
pub(crate) fn history<'a>(context: &PassContext<'a>) -> Option<&'a HistoryTargets> {
    context.images()?.history.as_ref()
}

/// A texture to bind instead of a missing texture of integers; the shader doesn't read it.
pub(crate) fn or_gbuffer<'a>(context: &PassContext<'a>, texture: Option<&'a TextureView>) -> Option<&'a TextureView> {
    Some(texture.unwrap_or(context.gbuffer.gbuffer))
}

/// Radiance of lobes divided by their albedo, which the composite reads.
pub(crate) fn composited_radiance<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    match &context.targets().accumulation {
        Some(pair) => Some(&pair[context.now()]),
        None => denoise::result(context),
    }
}
