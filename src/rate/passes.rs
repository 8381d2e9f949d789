//! Layout, pipelines and the pass that gives each tile its rate.

use super::prepared::{RateSettings, RateVariant};
use crate::{
    targets::{ARGUMENT_WORDS, RATE_FORMAT, RAY_RECORD_FORMAT},
    trace::{GBufferBindings, PassContext, gbuffer_layout_entries},
};
use bevy::{
    asset::{AssetId, AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    image::Image,
    log::{error, warn},
    platform::collections::{HashMap, HashSet},
    render::{
        render_asset::RenderAssets,
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedComputePipelineId,
            CachedPipelineState, ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, PipelineCache,
            ShaderStages, StorageTextureAccess, TextureDimension, TextureFormat, TextureSampleType, TextureUsages,
            TextureView, binding_types,
        },
        renderer::RenderContext,
        texture::GpuImage,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};
use core::num::NonZeroU64;

/// A pipeline: what decides, and the size of tiles in trace pixels.
type RateKey = (RateVariant, u32);

/// Layout and pipelines of the pass that determines rates, and the rate images of users.
#[derive(Resource)]
pub struct RatePipelines {
    shader: Handle<Shader>,
    layout: BindGroupLayoutDescriptor,
    queued: HashMap<RateKey, CachedComputePipelineId>,
    /// Whose error has been logged.
    failed: HashSet<RateKey>,
    /// What was asked for since pipelines were queued last.
    wanted: HashSet<RateKey>,
    wanted_images: HashSet<AssetId<Image>>,
    images: HashMap<AssetId<Image>, TextureView>,
    /// Images that can't be used, of which the log knows.
    refused: HashSet<AssetId<Image>>,
}

impl RateVariant {
    fn shader_defs(&self) -> Vec<ShaderDefVal> {
        let names: &[&'static str] = match self {
            Self::Uniform => &[],
            Self::Roughness => &["ROUGHNESS"],
            Self::Grazing => &["GRAZING", "TILE_ANGLES"],
            Self::Combined => &["COMBINED", "TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
            Self::Image => &["IMAGE"],
            Self::Custom(_) => &["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"],
        };
        names.iter().map(|&name| name.into()).collect()
    }

    /// It needs something of the user's that may be missing or wrong; `Uniform` stands in for it.
    fn is_users_own(&self) -> bool {
        matches!(self, Self::Image | Self::Custom(_))
    }
}

impl RatePipelines {
    /// Asks for the pipelines of a view; they are compiled from the next frame on. To be called in each frame.
    pub(crate) fn request(&mut self, rate: &RateSettings) {
        self.wanted.insert((rate.variant.clone(), rate.tile_size));
        if rate.variant.is_users_own() {
            self.wanted.insert((RateVariant::Uniform, rate.tile_size));
        }
        self.wanted_images.extend(rate.image.as_ref().map(Handle::id));
    }

    /// Rates can be determined, if not yet by what a user brought along.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, rate: &RateSettings) -> bool {
        let stand_in = if rate.variant.is_users_own() {
            &RateVariant::Uniform
        } else {
            &rate.variant
        };
        self.pipeline(cache, stand_in, rate.tile_size).is_some()
    }

    fn pipeline<'a>(
        &self,
        cache: &'a PipelineCache,
        variant: &RateVariant,
        tile_size: u32,
    ) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(*self.queued.get(&(variant.clone(), tile_size))?)
    }

    fn queue(&mut self, key: RateKey, cache: &PipelineCache) {
        let (variant, tile_size) = &key;
        let mut shader_defs = variant.shader_defs();
        if *tile_size == 8 {
            shader_defs.push("TILES_8".into());
        }
        let shader = match variant {
            RateVariant::Custom(shader) => shader,
            _ => &self.shader,
        };
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some("glint_rate".into()),
            layout: vec![self.layout.clone()],
            shader: shader.clone(),
            shader_defs,
            ..default()
        });
        self.queued.insert(key, id);
    }
}

/// Makes the layout.
pub fn init_rate_pipelines(mut commands: Commands, asset_server: Res<AssetServer>) {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let list = || binding_types::storage_buffer_sized(false, NonZeroU64::new(4));
    let write = |format| binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly);
    let layout = BindGroupLayoutDescriptor::new(
        "glint_rate_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                view,
                settings,
                depth,
                gbuffer,
                normals,
                write(RATE_FORMAT),
                list(),
                list(),
                list(),
                binding_types::storage_buffer_sized(false, NonZeroU64::new(4 * ARGUMENT_WORDS)),
                write(RAY_RECORD_FORMAT),
                binding_types::texture_2d(TextureSampleType::Uint),
            ),
        ),
    );
    commands.insert_resource(RatePipelines {
        shader: load_embedded_asset!(asset_server.as_ref(), "classify.wesl"),
        layout,
        queued: HashMap::default(),
        failed: HashSet::default(),
        wanted: HashSet::default(),
        wanted_images: HashSet::default(),
        images: HashMap::default(),
        refused: HashSet::default(),
    });
}

/// Queues what cameras asked for, looks up their rate images, and logs what is wrong with either.
pub fn queue_rate_pipelines(
    mut pipelines: ResMut<RatePipelines>,
    cache: Res<PipelineCache>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let pipelines = &mut *pipelines;
    for key in core::mem::take(&mut pipelines.wanted) {
        if !pipelines.queued.contains_key(&key) {
            pipelines.queue(key, &cache);
        }
    }
    for (key, &id) in &pipelines.queued {
        if let CachedPipelineState::Err(error) = cache.get_compute_pipeline_state(id)
            // Modules that are still being loaded are errors, too, but not for long.
            && !matches!(
                error,
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable
            )
            && pipelines.failed.insert(key.clone())
        {
            match &key.0 {
                RateVariant::Custom(shader) => error!(
                    "the shading-rate heuristic {shader:?} failed, so that every trace pixel gets its ray: {error}"
                ),
                _ => error!("ray-traced reflections stay off, since their shading-rate shader failed: {error}"),
            }
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

/// What keeps an image from being used, and what to do about it.
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

/// Rates, lists of rays and their indirect arguments for one view; expects the arguments to be 0.
pub(crate) fn determine_rates(ctx: &mut RenderContext, pipelines: &RatePipelines, context: &PassContext) {
    let textures = context.textures;
    let targets = &textures.targets;
    let Some(own) = &targets.pipeline else { return };
    let rate = &context.view.rate;
    let image = rate.image.as_ref().and_then(|image| pipelines.images.get(&image.id()));
    let usable = rate.variant != RateVariant::Image || image.is_some();
    let pipeline = usable
        .then(|| pipelines.pipeline(context.cache, &rate.variant, rate.tile_size))
        .flatten()
        .or_else(|| pipelines.pipeline(context.cache, &RateVariant::Uniform, rate.tile_size));
    let Some(pipeline) = pipeline else { return };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let bind_group = ctx.render_device().create_bind_group(
        "glint_rate",
        &context.cache.get_bind_group_layout(&pipelines.layout),
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            &own.rate[textures.parity],
            own.blocks.as_entire_binding(),
            own.mirrors.as_entire_binding(),
            own.tiles.as_entire_binding(),
            targets.arguments.as_entire_binding(),
            &own.ray_record,
            // Without a rate image something must be bound; no shader reads it.
            image.unwrap_or(gbuffer),
        )),
    );
    let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some("glint_rate"),
        timestamp_writes: None,
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[context.view_offset]);
    let tiles = targets.sizes.tiles();
    pass.dispatch_workgroups(tiles.x, tiles.y, 1);
}
