//! Turns the lobe's radiance into light: directly in the frame if a compute shader can write it, else in a texture.

use crate::{
    common::{TILE_DISPATCH, word_offset},
    denoise,
    device::FRAME_FORMAT,
    gbuffer::{Binding, FindTexture, GBufferPass, OtherGroups, PassContext},
    settings::ClampedSettings,
    targets::{HistoryTargets, REFLECTION_FORMAT},
};
use bevy::{
    render::{render_resource::TextureView, renderer::RenderContext},
    shader::ShaderDefVal,
};

/// Surfaces with a reflection to add to the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Surfaces {
    /// Surfaces in Bevy's G-buffer.
    Opaque,
    /// Surfaces in the front layer.
    FrontLayer,
}

impl Surfaces {
    const ALL: [Self; 2] = [Self::Opaque, Self::FrontLayer];

    pub fn of(settings: &ClampedSettings) -> impl Iterator<Item = Self> + use<> {
        let has_layer = settings.has_front_layer();
        Self::ALL
            .into_iter()
            .filter(move |surfaces| has_layer || *surfaces == Self::Opaque)
    }

    fn shader_defs(self) -> Vec<ShaderDefVal> {
        match self {
            Self::Opaque => vec![],
            Self::FrontLayer => vec!["FRONT_LAYER".into()],
        }
    }
}

/// A variant of the pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct ResolveVariant {
    pub surfaces: Surfaces,
    /// Includes the last filter of the denoiser.
    pub blurs: bool,
    /// The front layer can contain opaque surfaces, which are lit differently from glass.
    pub forward: bool,
}

impl ResolveVariant {
    /// The variants that a view's settings need. Without history, nothing is blurred.
    pub fn of(settings: &ClampedSettings) -> impl Iterator<Item = Self> + use<> {
        let wants_forward = settings.forward;
        let blurs: &[bool] = if denoise::blurs(settings) {
            &[false, true]
        } else {
            &[false]
        };
        Surfaces::of(settings).flat_map(move |surfaces| {
            let forward = wants_forward && surfaces == Surfaces::FrontLayer;
            blurs.iter().map(move |&blurs| Self {
                surfaces,
                blurs,
                forward,
            })
        })
    }

    pub fn shader_defs(self) -> Vec<ShaderDefVal> {
        let mut defs = self.surfaces.shader_defs();
        if self.blurs {
            defs.push("BLUR".into());
        }
        if self.forward {
            defs.push("FORWARD_SURFACES".into());
        }
        defs
    }
}

/// Destination of the result, and the visited pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Resolve {
    /// Every pixel of [`PassContext::area`], into a separate texture.
    Apart,
    /// Reads and writes the same pixels of the frame.
    InPlace,
    /// The active tiles of the frame.
    InPlaceTiles,
}

impl Resolve {
    pub const ALL: [Self; 3] = [Self::Apart, Self::InPlace, Self::InPlaceTiles];

    /// `in_place` is true if compute shaders can write the frame, and `has_tiles` if the view has a tile list.
    pub fn new(in_place: bool, has_tiles: bool) -> Self {
        match (in_place, has_tiles) {
            (false, _) => Self::Apart,
            (true, true) => Self::InPlaceTiles,
            (true, false) => Self::InPlace,
        }
    }

    pub fn shader_defs(self) -> Vec<ShaderDefVal> {
        match self {
            Self::Apart => vec![],
            Self::InPlace => vec!["IN_PLACE".into()],
            Self::InPlaceTiles => vec!["IN_PLACE".into(), "TILES".into()],
        }
    }

    /// The pass. `others` are the environment, and the scene for passes that read light probes.
    pub fn pass(self, others: OtherGroups) -> GBufferPass<ResolveVariant> {
        let output = match self {
            Self::Apart => Binding::written(REFLECTION_FORMAT, |context| context.targets().reflection.as_ref()),
            Self::InPlace | Self::InPlaceTiles => Binding::read_written(FRAME_FORMAT, |context| Some(context.frame)),
        };
        // Without SSAO something must be bound; the shader doesn't read it.
        let mut bindings = shown_bindings(|context| context.ssao.or_else(|| composited_radiance(context)));
        bindings.push(output);
        if self == Self::Apart {
            bindings.push(Binding::floats(|context| Some(context.frame)));
        }
        if self == Self::InPlaceTiles {
            bindings.extend([
                Binding::words(|context| Some(&context.targets().indirect_args)),
                Binding::words(|context| Some(&context.images()?.tile_list)),
            ]);
        }
        GBufferPass::new("glint_resolve", bindings, others)
    }

    /// Resolves the reflection of one view. Returns false if the pass isn't compiled. `has_forward` is true if the scene has opaque
    /// surfaces drawn in the forward pass.
    pub fn run(
        self,
        ctx: &mut RenderContext,
        pass: &GBufferPass<ResolveVariant>,
        context: &PassContext,
        surfaces: Surfaces,
        has_forward: bool,
    ) -> bool {
        let settings = &context.view.settings;
        let blurs = context.history().is_some() && denoise::blurs(settings);
        let forward = has_forward && settings.forward && surfaces == Surfaces::FrontLayer;
        // Either of the layer's variants replaces the other until that is compiled: at most, some ambient occlusion is missing.
        let variants = [(blurs, forward), (false, forward), (blurs, !forward), (false, !forward)];
        let variants = variants.map(|(blurs, forward)| ResolveVariant {
            surfaces,
            blurs,
            forward,
        });
        let Some(mut pass) = pass.begin(ctx, context, variants, &[]) else {
            return false;
        };
        if self == Self::InPlaceTiles {
            pass.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(TILE_DISPATCH));
        } else {
            let size = context.area().size();
            pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
        }
        true
    }
}

/// Bindings 5 to 9 of the passes that display reflections: the bindings of `denoise/blur.wesl`, with `second` as binding 6.
pub(crate) fn shown_bindings(second: FindTexture) -> Vec<Binding> {
    vec![
        Binding::floats(composited_radiance),
        Binding::floats(second),
        Binding::integers(|context| or_gbuffer(context, context.images().map(|images| &images.rate[context.now()]))),
        Binding::integers(|context| or_gbuffer(context, history(context).map(|history| &history.stats[context.now()]))),
        Binding::integers(|context| {
            or_gbuffer(context, history(context).map(|history| &history.surface[context.now()]))
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
