//! The pass that assigns a rate to each tile and lists the rays.

use crate::{
    common::INDIRECT_ARG_WORDS,
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext, PassShader, integers},
    settings::{RateSettings, RateVariant},
    targets::{RATE_FORMAT, RAY_SAMPLE_FORMAT},
};
use bevy::{
    asset::{AssetId, AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    image::Image,
    log::{error, warn},
    platform::collections::{HashMap, HashSet},
    render::{
        render_asset::RenderAssets,
        render_resource::{IntoBinding, PipelineCache, TextureDimension, TextureFormat, TextureUsages, TextureView},
        renderer::RenderContext,
        texture::GpuImage,
    },
    shader::{Shader, ShaderDefVal},
};

/// A pipeline.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct RateKey {
    /// The heuristic.
    variant: RateVariant,
    /// Trace pixels of a tile in each direction.
    tile_size: u32,
    /// Starts at a tile given by the view, so that a part of the tiles can be visited.
    part: bool,
}

impl RateKey {
    fn new(variant: RateVariant, rate: &RateSettings) -> Self {
        Self {
            variant,
            tile_size: rate.tile_size,
            part: false,
        }
    }

    /// Variant for a part of the tiles. It doesn't exist for users' shaders.
    fn of_part(self) -> Option<Self> {
        let is_own = !matches!(self.variant, RateVariant::Custom(_));
        is_own.then_some(Self { part: true, ..self })
    }

    fn shader_defs(&self) -> Vec<ShaderDefVal> {
        let names: &[&'static str] = match self.variant {
            RateVariant::Uniform => &[],
            RateVariant::Roughness => &["ROUGHNESS"],
            RateVariant::Grazing => &["GRAZING", "TILE_ANGLES"],
            RateVariant::Combined => &["COMBINED", "TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
            RateVariant::Adaptive => &["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
            RateVariant::Image => &["IMAGE"],
            RateVariant::Custom(_) => &["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"],
        };
        let size = (self.tile_size == 8).then_some("TILES_8");
        let part = self.part.then_some("PART");
        names.iter().copied().chain(size).chain(part).map(Into::into).collect()
    }
}

/// Pipelines of the pass that determines rates, and users' rate images.
#[derive(Resource)]
pub struct RatePipelines {
    shader: Handle<Shader>,
    adaptive_shader: Handle<Shader>,
    pass: GBufferPass<RateKey>,
    /// Variant that reads the history, for [`RateVariant::Adaptive`].
    adaptive: GBufferPass<RateKey>,
    /// Shaders with an error that was logged.
    failed: HashSet<RateKey>,
    /// Pipelines requested since pipelines were last queued.
    wanted: HashSet<RateKey>,
    wanted_images: HashSet<AssetId<Image>>,
    images: HashMap<AssetId<Image>, TextureView>,
    /// Unusable images that were logged.
    refused: HashSet<AssetId<Image>>,
}

/// The variant that replaces a user's asset until it is loaded, or if it is unusable.
fn stand_in(variant: &RateVariant) -> Option<RateVariant> {
    match variant {
        RateVariant::Image | RateVariant::Custom(_) => Some(RateVariant::Uniform),
        RateVariant::Adaptive => Some(RateVariant::Combined),
        _ => None,
    }
}

fn keys_of(rate: &RateSettings) -> impl Iterator<Item = RateKey> {
    let variants = [Some(rate.variant.clone()), stand_in(&rate.variant)];
    variants
        .into_iter()
        .flatten()
        .map(|variant| RateKey::new(variant, rate))
}

impl RatePipelines {
    /// Requests the pipelines of a view; they are compiled from the next frame on. Call in each frame.
    pub(crate) fn request(&mut self, rate: &RateSettings) {
        self.wanted.extend(keys_of(rate));
        self.wanted_images.extend(rate.image.as_ref().map(Handle::id));
    }

    /// Also requests pipelines that visit a part of the tiles.
    pub(crate) fn request_parts(&mut self, rate: &RateSettings) {
        self.wanted.extend(keys_of(rate).filter_map(RateKey::of_part));
    }

    /// Returns whether rates can be determined, even if a user's own shader or image isn't ready.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, rate: &RateSettings) -> bool {
        let key = |variant| RateKey::new(variant, rate);
        let variant = stand_in(&rate.variant).unwrap_or_else(|| rate.variant.clone());
        let adaptive = rate.variant == RateVariant::Adaptive;
        self.pass.pipeline(&key(variant), cache).is_some()
            && (!adaptive || self.adaptive.pipeline(&key(RateVariant::Adaptive), cache).is_some())
    }

    fn queue(&mut self, key: RateKey, cache: &PipelineCache) {
        let shader = match &key.variant {
            RateVariant::Custom(shader) => shader.clone(),
            RateVariant::Adaptive => self.adaptive_shader.clone(),
            _ => self.shader.clone(),
        };
        let defs = key.shader_defs();
        let pass = match key.variant {
            RateVariant::Adaptive => &mut self.adaptive,
            _ => &mut self.pass,
        };
        pass.queue(key, cache, || PassShader {
            shader,
            defs,
            entry_point: None,
        });
    }
}

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

/// Declares the bindings of the passes.
pub(super) fn init_rate_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    let adaptive = bindings().into_iter().chain(history_bindings()).collect();
    commands.insert_resource(RatePipelines {
        shader: load_embedded_asset!(asset_server.as_ref(), "classify.wesl"),
        adaptive_shader: load_embedded_asset!(asset_server.as_ref(), "adaptive.wesl"),
        pass: GBufferPass::new("glint_rate", bindings(), OtherGroups::None),
        adaptive: GBufferPass::new("glint_adaptive_rate", adaptive, OtherGroups::None),
        failed: HashSet::default(),
        wanted: HashSet::default(),
        wanted_images: HashSet::default(),
        images: HashMap::default(),
        refused: HashSet::default(),
    });
}

/// Queues the pipelines that cameras requested, looks up their rate images, and logs problems of either.
pub(super) fn queue_rate_pipelines(
    mut pipelines: ResMut<RatePipelines>,
    cache: Res<PipelineCache>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let pipelines = &mut *pipelines;
    for key in core::mem::take(&mut pipelines.wanted) {
        pipelines.queue(key, &cache);
    }
    let errors = pipelines.pass.errors(&cache).chain(pipelines.adaptive.errors(&cache));
    for (key, error) in errors {
        if !pipelines.failed.insert(key.clone()) {
            continue;
        }
        match &key.variant {
            RateVariant::Custom(shader) => {
                error!("the shading-rate heuristic {shader:?} failed, so that every trace pixel gets its ray: {error}");
            }
            _ => error!(
                "a shading-rate shader of ray-traced reflections failed; cameras that need it get simpler rates, or no reflections: {error}"
            ),
        }
    }
    pipelines.images.clear();
    for id in core::mem::take(&mut pipelines.wanted_images) {
        let Some(image) = images.get(id) else { continue };
        match problem(image) {
            None => {
                pipelines.images.insert(id, image.texture_view.clone());
            }
            Some(problem) => {
                if pipelines.refused.insert(id) {
                    warn!(
                        "the shading-rate image {id} can't be used, so that every trace pixel gets its ray: {problem}"
                    );
                }
            }
        }
    }
}

/// Reason why an image can't be used, and how to fix it.
fn problem(image: &GpuImage) -> Option<&'static str> {
    let descriptor = &image.texture_descriptor;
    if !matches!(descriptor.format, TextureFormat::R8Uint | TextureFormat::R32Uint) {
        return Some(
            "give it the format `R8Uint` or `R32Uint`, with one texel per tile that holds `ShadingRate::code`",
        );
    }
    if descriptor.dimension != TextureDimension::D2 || descriptor.size.depth_or_array_layers != 1 {
        return Some("make it two-dimensional with one layer");
    }
    if descriptor.sample_count != 1 || !descriptor.usage.contains(TextureUsages::TEXTURE_BINDING) {
        return Some("create it with one sample and with the usage `TEXTURE_BINDING`");
    }
    None
}

/// Computes rates, lists of rays and their indirect arguments for one view; expects the indirect arguments to be 0.
pub(crate) fn determine_rates(ctx: &mut RenderContext, pipelines: &RatePipelines, context: &PassContext) {
    let rate = &context.view.rate;
    let image = rate.image.as_ref().and_then(|image| pipelines.images.get(&image.id()));
    let usable = rate.variant != RateVariant::Image || image.is_some();
    let adaptive = rate.variant == RateVariant::Adaptive && context.history().is_some();
    let variants = if adaptive {
        [Some(RateVariant::Adaptive), None]
    } else {
        let stand_in = stand_in(&rate.variant).unwrap_or(RateVariant::Uniform);
        [usable.then(|| rate.variant.clone()), Some(stand_in)]
    };
    let keys = variants
        .into_iter()
        .flatten()
        .map(|variant| RateKey::new(variant, rate));
    // Without a rate image something must be bound; no shader reads it.
    let image = image.unwrap_or(context.gbuffer.gbuffer);
    let pass = if adaptive { &pipelines.adaptive } else { &pipelines.pass };
    let key = keys.into_iter().find(|key| pass.pipeline(key, context.cache).is_some());
    let Some(key) = key else { return };
    let part = key
        .clone()
        .of_part()
        .filter(|part| pass.pipeline(part, context.cache).is_some());
    let (key, size) = match (part, context.tiles) {
        (Some(part), Some(tiles)) => (part, tiles.size()),
        _ => (key, context.targets().sizes.tiles()),
    };
    if let Some(mut pass) = pass.begin(ctx, context, [key], &[image.into_binding()]) {
        pass.dispatch_workgroups(size.x, size.y, 1);
    }
}
