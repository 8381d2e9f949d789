//! Pipelines of the passes that trace rays, and the tables that they read.

use super::{
    blocks,
    converged::converged_pass,
    directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo},
    inline::InlinePass,
    surface_shader::SurfaceShader,
    variant::{Asked, ShadingVariant, TracePass, Variant},
};
use crate::{
    diagnostics::CountInvocations,
    gbuffer::{GBufferPass, PassShader},
    scene::{Change, SceneBindings},
    settings::ClampedSettings,
    vrs::PipelineRequest,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    log::error_once,
    pbr::Bluenoise,
    platform::collections::HashSet,
    render::{
        render_asset::RenderAssets,
        render_resource::{
            Extent3d, PipelineCache, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat,
            TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};

/// Storage buffers of the pass that shades hits and traces mirror rays: those of the pass over the list of rays (`device/support.rs`), the
/// other list, and light probes.
const JOINED_STORAGE_BUFFERS: u32 = 11;

/// Pipelines of the tracing passes.
#[derive(Resource)]
pub struct TracePipelines {
    blocks_shader: Handle<Shader>,
    shading_shader: Handle<Shader>,
    converged_shader: Handle<Shader>,
    /// Makes shading-rate attachments.
    attachment_shader: Handle<Shader>,
    pub(super) rays: GBufferPass<Variant>,
    /// Shades what the rays hit.
    pub(super) shading: GBufferPass<ShadingVariant>,
    pub(super) mirror_rays: GBufferPass<Variant>,
    /// Both in one dispatch.
    pub(super) shading_and_mirrors: GBufferPass<Variant>,
    pub(super) converged: GBufferPass<Variant>,
    pub(super) inline: InlinePass,
    /// Table for `albedo.wesl`.
    pub(super) albedo_table: TextureView,
    /// Spatio-temporal blue noise, once its image is loaded.
    pub(super) noise: Option<TextureView>,
    /// Passes that views asked for, and with what.
    wanted: HashSet<(TracePass, Asked)>,
    /// Some view asked for rays of blocks or of mirrors, but not for both in one dispatch.
    wants_apart: bool,
    /// The device has as many storage buffers as both in one dispatch take.
    can_join_mirrors: bool,
    /// Definitions of all variants.
    common_defs: Vec<ShaderDefVal>,
    /// Definitions that are right for any scene.
    defs_for_any: Vec<ShaderDefVal>,
    /// The device has what light probes need.
    can_have_probes: bool,
    /// The variant that fits the scene, without what views ask for.
    pub(super) variant: Variant,
    /// Some object lets a part of the rays through.
    see_through: bool,
    /// Some object refracts them.
    refracts: bool,
    /// The scene has more lights than hits have bits for.
    pub(super) many_lights: bool,
    /// No pass leaves anything out that the scene has, since its shader is still being compiled.
    complete: bool,
}

impl TracePipelines {
    /// Asks for the passes of a view; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, settings: &ClampedSettings) {
        let asked = Asked::by(settings);
        self.wanted.extend(TracePass::of(settings).map(|pass| (pass, asked)));
        let mut passes = TracePass::of(settings);
        self.wants_apart |= passes.any(|pass| matches!(pass, TracePass::Blocks | TracePass::Mirrors))
            && !TracePass::may_join_mirrors(settings);
    }

    /// Returns whether mirror rays lose nothing in the pass that shades the hits of blocks: of a scene that it traces without bits for
    /// more lights, and where none of them is followed through layers.
    fn joins_mirrors(&self, variant: Variant) -> bool {
        self.can_join_mirrors && !self.many_lights && !variant.bounces && !self.mirror_variant(variant).layered
    }

    /// Returns whether some view takes the passes that trace rays of mirrors, or shade hits of blocks, alone.
    fn keeps_apart(&self, variant: Variant) -> bool {
        self.wants_apart || !self.joins_mirrors(variant)
    }

    /// The variant that traces the mirror rays of a view beside the shading of its blocks' hits, if that is as good as apart, or all that
    /// there is. `tinted`: the hits have tints.
    pub(super) fn joined_variant(
        &self,
        settings: &ClampedSettings,
        variant: Variant,
        tinted: bool,
        cache: &PipelineCache,
    ) -> Option<Variant> {
        if !TracePass::may_join_mirrors(settings) {
            return None;
        }
        let variant = Variant { tinted, ..variant };
        let has_apart = || {
            compiled(&self.mirror_rays, self.mirror_variant(variant), cache).is_some()
                && self.has_shading(variant, cache)
        };
        let joined = compiled(&self.shading_and_mirrors, variant, cache);
        joined.filter(|_| self.joins_mirrors(variant) || !has_apart())
    }

    /// Hits can be shaded by the pass that does nothing else.
    fn has_shading(&self, variant: Variant, cache: &PipelineCache) -> bool {
        let mut variants = variant.shading_substitutes(self.many_lights);
        variants.any(|key| self.shading.pipeline(&key, cache).is_some())
    }

    /// The variant of the rays of blocks that is compiled. Their hits are shaded with tints only if they have some.
    pub(super) fn ray_variant(&self, variant: Variant, cache: &PipelineCache) -> Option<Variant> {
        let mut variants = self.first_rays(variant.without_shading()).substitutes().into_iter();
        variants.find(|variant| self.rays.pipeline(variant, cache).is_some())
    }

    /// The variant of passes that trace first rays by chance: those of blocks, and those that are shaded at once.
    pub(super) fn first_rays(&self, variant: Variant) -> Variant {
        Variant {
            refracts: self.refracts && variant.masked,
            ..variant
        }
    }

    /// The variant that fits the scene and the settings of a view.
    pub(super) fn variant_for(&self, settings: &ClampedSettings) -> Variant {
        self.variant.with(Asked::by(settings))
    }

    /// The same for the rays of exact mirrors.
    pub(super) fn mirror_variant(&self, variant: Variant) -> Variant {
        Variant {
            layered: self.see_through && variant.masked,
            refracts: self.refracts && variant.masked,
            ..variant
        }
    }

    /// The same for the ground truth, which follows rays that are refracted without chance, and with less noise.
    pub(super) fn converged_variant(&self, variant: Variant) -> Variant {
        let layered = self.refracts && variant.masked;
        Variant {
            layered,
            refracts: layered,
            ..variant
        }
    }

    /// All that a view's settings need can be used.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &ClampedSettings) -> bool {
        let variant = self.variant_for(settings);
        let compiled = |pass: &GBufferPass<Variant>, variant: Variant| compiled(pass, variant, cache).is_some();
        let joined = TracePass::may_join_mirrors(settings) && compiled(&self.shading_and_mirrors, variant);
        self.noise.is_some()
            && TracePass::of(settings).all(|pass| match pass {
                TracePass::Blocks => {
                    compiled(&self.rays, self.first_rays(variant.without_shading()))
                        && (joined || self.has_shading(variant, cache))
                }
                TracePass::Mirrors => joined || compiled(&self.mirror_rays, self.mirror_variant(variant)),
                TracePass::Converged => compiled(&self.converged, self.converged_variant(variant)),
                TracePass::Inline => self.inline.pipeline(self.first_rays(variant), cache).is_some(),
            })
    }

    /// All passes that views asked for have shaders with all that the scene has.
    fn is_complete(&self, cache: &PipelineCache) -> bool {
        // The first substitutes leave out nothing.
        let whole = |variant: Variant| variant.substitutes().into_iter().take(2);
        let compiled = |pass: &GBufferPass<Variant>, variant: Variant| {
            whole(variant).any(|variant| pass.pipeline(&variant, cache).is_some())
        };
        self.wanted.iter().all(|&(pass, asked)| {
            let variant = self.variant.with(asked);
            match pass {
                TracePass::Blocks if self.many_lights || variant.bounces => {
                    compiled(&self.rays, self.first_rays(variant.without_shading()))
                        && whole(variant.without_screen()).any(|variant| {
                            self.shading
                                .pipeline(&ShadingVariant::Tracing(variant), cache)
                                .is_some()
                        })
                }
                TracePass::Blocks => {
                    compiled(&self.rays, self.first_rays(variant.without_shading()))
                        && (!self.keeps_apart(variant) || self.shading.pipeline(&variant.plain(), cache).is_some())
                }
                TracePass::Mirrors => {
                    (!self.joins_mirrors(variant) || compiled(&self.shading_and_mirrors, variant))
                        && (!self.keeps_apart(variant) || compiled(&self.mirror_rays, self.mirror_variant(variant)))
                }
                TracePass::Converged => compiled(&self.converged, self.converged_variant(variant)),
                TracePass::Inline => self.inline.has_any(whole(self.first_rays(variant)), cache),
            }
        })
    }

    /// Request for the pipeline of the raw Vulkan pass: the shader of [`TracePass::Inline`] with definitions that are right for
    /// any scene.
    pub(super) fn vrs_request(&self) -> PipelineRequest {
        let mut defs = self.defs_for_any.clone();
        defs.extend(
            [
                "LIGHTMAPS",
                "CLEARCOAT",
                "ATMOSPHERIC",
                "RECT_LIGHTS",
                "LIGHT_TEXTURES",
                "DIFFUSE_TRANSMISSION",
                // Its address takes the place of a binding.
                "ONE_TLAS",
            ]
            .map(Into::into),
        );
        defs.extend(self.can_have_probes.then(|| "LIGHT_PROBES".into()));
        defs.extend_from_slice(&self.common_defs);
        PipelineRequest {
            shader: self.inline.shader.clone(),
            defs,
            layouts: self.inline.layouts(),
            attachment_shader: self.attachment_shader.clone(),
        }
    }

    fn queue(&mut self, pass: TracePass, variant: Variant, scene: &SceneBindings, cache: &PipelineCache) {
        let common = &self.common_defs;
        let defs_of = |variant: Variant, own: &[&'static str]| {
            let mut defs = scene.shader_defs_for(variant.masked);
            defs.extend_from_slice(common);
            defs.extend(variant.defs().map(Into::into));
            defs.extend(own.iter().map(|&name| ShaderDefVal::from(name)));
            defs
        };
        let shading = variant.shading_defs();
        let shaded = variant.without_screen();
        let shader_of = |variant: Variant, shader: &Handle<Shader>, own: &[&'static str]| PassShader {
            shader: shader.clone(),
            defs: defs_of(variant, own),
            entry_point: Some("trace"),
        };
        match pass {
            TracePass::Blocks => {
                let first = self.first_rays(variant.without_shading());
                self.rays
                    .queue(first, cache, || shader_of(first, &self.blocks_shader, &[]));
                let own = [&shading[..], &["MANY_LIGHTS"]].concat();
                let tracing = || shader_of(shaded, &self.shading_shader, &own);
                if variant.bounces {
                    self.shading.queue(ShadingVariant::Tracing(shaded), cache, tracing);
                    return;
                }
                if !self.keeps_apart(variant) {
                    return;
                }
                // It traces no shadow rays, so that it can neither draw lights nor light fog.
                let plain = Variant {
                    draws_lights: false,
                    volumes: false,
                    fog_density: false,
                    ..shaded
                };
                self.shading.queue(variant.plain(), cache, || {
                    shader_of(plain, &self.shading_shader, &shading)
                });
                if self.many_lights {
                    self.shading.queue(ShadingVariant::Tracing(shaded), cache, tracing);
                }
            }
            TracePass::Mirrors => {
                let own = [&["MIRRORS"], &shading[..]].concat();
                if self.joins_mirrors(variant) {
                    self.shading_and_mirrors
                        .queue(variant, cache, || shader_of(variant, &self.shading_shader, &own));
                }
                if self.keeps_apart(variant) {
                    let variant = self.mirror_variant(variant);
                    self.mirror_rays
                        .queue(variant, cache, || shader_of(variant, &self.blocks_shader, &own));
                }
            }
            TracePass::Converged => {
                let variant = self.converged_variant(variant);
                self.converged
                    .queue(variant, cache, || shader_of(variant, &self.converged_shader, &shading));
            }
            TracePass::Inline => {
                let variant = self.first_rays(variant);
                self.inline.queue(variant, cache, || defs_of(variant, &shading));
            }
        }
    }

    /// The first error of a pipeline, of those with the app's shader or of those without.
    fn error<'a>(&'a self, cache: &'a PipelineCache, own_surfaces: bool) -> Option<&'a ShaderCacheError> {
        let compute = [
            &self.rays,
            &self.mirror_rays,
            &self.shading_and_mirrors,
            &self.converged,
        ]
        .into_iter();
        compute
            .flat_map(|pass| pass.errors(cache))
            .map(|(variant, error)| (variant.own_surfaces, error))
            .chain(
                self.shading
                    .errors(cache)
                    .map(|(variant, error)| (variant.has_own_surfaces(), error)),
            )
            .chain(
                self.inline
                    .errors(cache)
                    .map(|(variant, error)| (variant.own_surfaces, error)),
            )
            .find(|(own, _)| *own == own_surfaces)
            .map(|(_, error)| error)
    }
}

/// The first of a variant and its substitutes that is compiled.
fn compiled(pass: &GBufferPass<Variant>, variant: Variant, cache: &PipelineCache) -> Option<Variant> {
    let mut variants = variant.substitutes().into_iter();
    variants.find(|variant| pass.pipeline(variant, cache).is_some())
}

/// Makes layouts and the albedo table.
pub(super) fn init_trace_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    scene: Res<SceneBindings>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    count: Option<Res<CountInvocations>>,
) {
    let assets = asset_server.as_ref();
    commands.insert_resource(TracePipelines {
        blocks_shader: load_embedded_asset!(assets, "blocks.wesl"),
        shading_shader: load_embedded_asset!(assets, "shade.wesl"),
        converged_shader: load_embedded_asset!(assets, "converged.wesl"),
        attachment_shader: load_embedded_asset!(assets, "vrs.wesl"),
        rays: blocks::ray_pass(&scene.layout),
        shading: blocks::shading_pass(&scene.layout),
        mirror_rays: blocks::mirror_ray_pass(&scene.layout),
        shading_and_mirrors: blocks::shading_and_mirrors_pass(&scene.layout),
        converged: converged_pass(&scene.layout),
        inline: InlinePass::new(load_embedded_asset!(assets, "inline.wesl"), &scene.layout),
        albedo_table: create_albedo_table(&device, &queue),
        noise: None,
        wanted: HashSet::default(),
        wants_apart: false,
        can_join_mirrors: device.limits().max_storage_buffers_per_shader_stage >= JOINED_STORAGE_BUFFERS,
        common_defs: count.map(|_| "COUNT_INVOCATIONS".into()).into_iter().collect(),
        defs_for_any: scene.shader_defs_for_any(),
        can_have_probes: scene.can_have_light_probes(),
        variant: Variant {
            masked: true,
            ..default()
        },
        see_through: false,
        refracts: false,
        many_lights: false,
        complete: true,
    });
}

fn create_albedo_table(device: &RenderDevice, queue: &RenderQueue) -> TextureView {
    let size = ALBEDO_TABLE_SIZE as u32;
    let texture = device.create_texture_with_data(
        queue,
        &TextureDescriptor {
            label: Some("glint_albedo_table"),
            size: Extent3d {
                width: size,
                height: size,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            // The shader loads and blends texels itself: so this needs no filtering, and weights are not cut to the 8 bits of
            // texture units.
            format: TextureFormat::Rg32Float,
            usage: TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(DirectionalAlbedo::new().texels()),
    );
    texture.create_view(&TextureViewDescriptor::default())
}

/// Queues the passes that cameras asked for.
pub(super) fn queue_trace_pipelines(
    mut pipelines: ResMut<TracePipelines>,
    cache: Res<PipelineCache>,
    mut scene: ResMut<SceneBindings>,
    mut surface_shader: ResMut<SurfaceShader>,
    noise: Option<Res<Bluenoise>>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let pipelines = &mut *pipelines;
    let variant = Variant {
        own_surfaces: surface_shader.is_there(),
        ..Variant::of(&scene)
    };
    pipelines.variant = variant;
    if surface_shader.take_change() {
        scene.version.note(Change::Unmarked);
    }
    pipelines.see_through = scene.see_through.has_partial();
    pipelines.refracts = scene.see_through.has_refraction();
    pipelines.many_lights = scene.has_many_lights() || scene.has_fog_volumes();
    for (pass, asked) in pipelines.wanted.clone() {
        let variant = variant.with(asked);
        // The variant that is right for scenes with and without masks comes first.
        let tinted = variant.tinted.then_some((true, true));
        for (masked, tinted) in [(true, false), (false, false)].into_iter().chain(tinted) {
            let variant = Variant {
                masked,
                tinted,
                own_surfaces: false,
                ..variant
            };
            pipelines.queue(pass, variant, &scene, &cache);
        }
        if variant.own_surfaces {
            pipelines.queue(pass, variant, &scene, &cache);
        }
    }
    // Pictures at rest begin anew: the frames that they have gathered lack what was left out.
    let complete = pipelines.is_complete(&cache);
    if complete && !pipelines.complete {
        scene.version.note(Change::Unmarked);
    }
    pipelines.complete = complete;
    if pipelines.noise.is_none() {
        let image = noise.and_then(|noise| images.get(&noise.texture));
        pipelines.noise = image.map(array_view);
    }
    if let Some(error) = pipelines.error(&cache, false) {
        error_once!("ray-traced reflections stay off, since their shader failed: {error}");
    }
    if variant.own_surfaces
        && let Some(error) = pipelines.error(&cache, true)
    {
        error_once!(
            "the shader of `ReflectedSurfaceShader` failed, so that reflections show materials without it: {error}"
        );
    }
}

/// Without its feature `bluenoise_texture` Bevy keeps a single texel, which is no array.
fn array_view(image: &GpuImage) -> TextureView {
    image.texture.create_view(&TextureViewDescriptor {
        label: Some("glint_noise"),
        dimension: Some(TextureViewDimension::D2Array),
        ..default()
    })
}
