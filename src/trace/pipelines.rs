//! Layouts and pipelines of the passes that trace rays.

use super::directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo};
use crate::{
    inspect::CountInvocations,
    scene::{SceneBindings, environment::layout_descriptor},
    settings::{SafeSettings, Technique},
    targets::{ACCUMULATION_FORMAT, PAIR_FORMAT, RADIANCE_FORMAT, RAY_RADIANCE_FORMAT, RAY_RECORD_FORMAT},
    view::GpuReflectionView,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    pbr::Bluenoise,
    platform::collections::{HashMap, HashSet},
    render::{
        render_asset::RenderAssets,
        render_resource::{
            BindGroupLayoutDescriptor, BindGroupLayoutEntries, BindGroupLayoutEntryBuilder, CachedComputePipelineId,
            CachedPipelineState, CachedRenderPipelineId, ColorTargetState, ColorWrites, ComputePipeline,
            ComputePipelineDescriptor, Extent3d, FragmentState, PipelineCache, RenderPipeline,
            RenderPipelineDescriptor, ShaderStages, StorageTextureAccess, TextureDataOrder, TextureDescriptor,
            TextureDimension, TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor,
            TextureViewDimension, VertexState, binding_types,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
        view::ViewUniform,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};
use core::num::NonZeroU64;

/// A pass that traces rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum TracePass {
    /// One thread per block of the list.
    Blocks,
    /// One thread per mirror pixel of the list.
    Mirrors,
    /// One fragment per trace pixel.
    Inline,
    /// One thread per pixel, into the accumulation.
    Converged,
}

impl TracePass {
    /// The passes that a view's settings need.
    pub(crate) fn of(settings: &SafeSettings) -> impl Iterator<Item = Self> + use<> {
        let rays = match settings.technique {
            Technique::Converged => Self::Converged,
            Technique::QuarterInline => Self::Inline,
            Technique::Reference | Technique::Quarter | Technique::Variable => Self::Blocks,
        };
        let mirrors = settings.full_resolution_mirrors.then_some(Self::Mirrors);
        [Some(rays), mirrors].into_iter().flatten()
    }
}

/// Layouts and pipelines of the tracing passes.
#[derive(Resource)]
pub struct TracePipelines {
    blocks_shader: Handle<Shader>,
    inline_shader: Handle<Shader>,
    converged_shader: Handle<Shader>,
    layouts: HashMap<TracePass, BindGroupLayoutDescriptor>,
    scene_layout: BindGroupLayoutDescriptor,
    environment_layout: BindGroupLayoutDescriptor,
    /// Table for `albedo.wesl`.
    pub(crate) albedo_table: TextureView,
    /// Spatio-temporal blue noise, once its image is loaded.
    pub(crate) noise: Option<TextureView>,
    compute: HashMap<(TracePass, Variant), CachedComputePipelineId>,
    inline: HashMap<Variant, CachedRenderPipelineId>,
    wanted: HashSet<TracePass>,
    /// What is compiled into all of them.
    count_invocations: bool,
    /// For any scene.
    #[cfg(all(
        feature = "hardware-vrs",
        any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
    ))]
    defs_for_any: Vec<ShaderDefVal>,
    /// What fits the scene.
    variant: Variant,
}

/// What shaders are compiled for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Variant {
    /// Some object is alpha-masked.
    masked: bool,
    /// The scene's trees need a larger stack.
    deep: bool,
}

impl Variant {
    /// Itself, the one that is right for all scenes of such trees, and one that misses hits where the stack is full: better than
    /// nothing while the others are compiled.
    fn substitutes(self) -> [Self; 3] {
        let masked = Self { masked: true, ..self };
        [self, masked, Self { deep: false, ..masked }]
    }
}

/// Entries that every pass over the G-buffer starts with: `gbuffer.wesl`.
pub(crate) fn gbuffer_layout_entries() -> [BindGroupLayoutEntryBuilder; 5] {
    [
        binding_types::uniform_buffer::<ViewUniform>(true),
        binding_types::uniform_buffer::<GpuReflectionView>(false),
        binding_types::texture_depth_2d(),
        binding_types::texture_2d(TextureSampleType::Uint),
        binding_types::texture_2d(TextureSampleType::Float { filterable: false }),
    ]
}

fn trace_layout(pass: TracePass) -> BindGroupLayoutDescriptor {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let unfiltered = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let noise = binding_types::texture_2d_array(TextureSampleType::Float { filterable: false });
    let counters = || binding_types::storage_buffer_sized(false, NonZeroU64::new(4));
    let words = || binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4));
    let write = |format| binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly);
    match pass {
        TracePass::Blocks | TracePass::Mirrors => {
            let (first, second) = if pass == TracePass::Blocks {
                (RAY_RADIANCE_FORMAT, RAY_RECORD_FORMAT)
            } else {
                (RADIANCE_FORMAT, PAIR_FORMAT)
            };
            BindGroupLayoutDescriptor::new(
                format!("glint_trace_{pass:?}_layout"),
                &BindGroupLayoutEntries::sequential(
                    ShaderStages::COMPUTE,
                    (
                        view,
                        settings,
                        depth,
                        gbuffer,
                        normals,
                        unfiltered,
                        noise,
                        words(),
                        counters(),
                        words(),
                        write(first),
                        write(second),
                    ),
                ),
            )
        }
        TracePass::Inline => BindGroupLayoutDescriptor::new(
            "glint_trace_inline_layout",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    noise,
                    binding_types::texture_2d(TextureSampleType::Uint),
                    counters(),
                ),
            ),
        ),
        TracePass::Converged => BindGroupLayoutDescriptor::new(
            "glint_trace_converged_layout",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    view,
                    settings,
                    depth,
                    gbuffer,
                    normals,
                    unfiltered,
                    counters(),
                    counters(),
                    unfiltered,
                    write(ACCUMULATION_FORMAT),
                ),
            ),
        ),
    }
}

impl TracePipelines {
    /// Asks for the passes of a view; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, settings: &SafeSettings) {
        self.wanted.extend(TracePass::of(settings));
    }

    pub(crate) fn layout(&self, pass: TracePass) -> &BindGroupLayoutDescriptor {
        &self.layouts[&pass]
    }

    /// The shader of [`TracePass::Inline`] with definitions that are right for any scene, and the layouts of its bind groups.
    #[cfg(all(
        feature = "hardware-vrs",
        any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
    ))]
    pub(super) fn inline_parts(&self) -> (Handle<Shader>, Vec<ShaderDefVal>, [BindGroupLayoutDescriptor; 3]) {
        let layouts = [
            self.layout(TracePass::Inline).clone(),
            self.scene_layout.clone(),
            self.environment_layout.clone(),
        ];
        (
            self.inline_shader.clone(),
            self.defs(self.defs_for_any.clone()),
            layouts,
        )
    }

    fn defs(&self, mut defs: Vec<ShaderDefVal>) -> Vec<ShaderDefVal> {
        if self.count_invocations {
            defs.push("COUNT_INVOCATIONS".into());
        }
        defs
    }

    /// The variant that fits the scene, or a substitute.
    pub(crate) fn compute<'a>(&self, cache: &'a PipelineCache, pass: TracePass) -> Option<&'a ComputePipeline> {
        let get = |variant| cache.get_compute_pipeline(*self.compute.get(&(pass, variant))?);
        self.variant.substitutes().into_iter().find_map(get)
    }

    pub(crate) fn inline<'a>(&self, cache: &'a PipelineCache) -> Option<&'a RenderPipeline> {
        let get = |variant| cache.get_render_pipeline(*self.inline.get(&variant)?);
        self.variant.substitutes().into_iter().find_map(get)
    }

    /// What a view's settings need can be used.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &SafeSettings) -> bool {
        self.noise.is_some()
            && TracePass::of(settings).all(|pass| match pass {
                TracePass::Inline => self.inline(cache).is_some(),
                _ => self.compute(cache, pass).is_some(),
            })
    }

    fn queue(&mut self, pass: TracePass, variant: Variant, scene: &SceneBindings, cache: &PipelineCache) {
        let layout = vec![
            self.layouts[&pass].clone(),
            self.scene_layout.clone(),
            self.environment_layout.clone(),
        ];
        let mut shader_defs = self.defs(scene.shader_defs_for(variant.masked));
        if pass == TracePass::Inline {
            let target = |format| {
                Some(ColorTargetState {
                    format,
                    blend: None,
                    write_mask: ColorWrites::ALL,
                })
            };
            let id = cache.queue_render_pipeline(RenderPipelineDescriptor {
                label: Some("glint_trace_inline".into()),
                layout,
                vertex: VertexState {
                    shader: self.inline_shader.clone(),
                    shader_defs: shader_defs.clone(),
                    entry_point: Some("vertex".into()),
                    ..default()
                },
                fragment: Some(FragmentState {
                    shader: self.inline_shader.clone(),
                    shader_defs,
                    entry_point: Some("fragment".into()),
                    targets: vec![target(RAY_RADIANCE_FORMAT), target(RAY_RECORD_FORMAT)],
                    ..default()
                }),
                ..default()
            });
            self.inline.insert(variant, id);
            return;
        }
        if pass == TracePass::Mirrors {
            shader_defs.push("MIRRORS".into());
        }
        let shader = match pass {
            TracePass::Converged => &self.converged_shader,
            _ => &self.blocks_shader,
        };
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(format!("glint_trace_{pass:?}").into()),
            layout,
            shader: shader.clone(),
            shader_defs,
            entry_point: Some("trace".into()),
            ..default()
        });
        self.compute.insert((pass, variant), id);
    }

    /// The first error of a pipeline, other than that its modules are still being loaded.
    fn error<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ShaderCacheError> {
        let compute = self.compute.values().map(|&id| cache.get_compute_pipeline_state(id));
        let inline = self.inline.values().map(|&id| cache.get_render_pipeline_state(id));
        compute.chain(inline).find_map(|state| match state {
            CachedPipelineState::Err(
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
            ) => None,
            CachedPipelineState::Err(error) => Some(error),
            _ => None,
        })
    }
}

/// Makes layouts and the albedo table.
pub fn init_trace_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    scene: Res<SceneBindings>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    count: Option<Res<CountInvocations>>,
) {
    let table = DirectionalAlbedo::new();
    let size = ALBEDO_TABLE_SIZE as u32;
    let albedo_table = device
        .create_texture_with_data(
            &queue,
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
                format: TextureFormat::Rg32Float,
                usage: TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
            TextureDataOrder::LayerMajor,
            bytemuck::cast_slice(table.texels()),
        )
        .create_view(&TextureViewDescriptor::default());
    let passes = [
        TracePass::Blocks,
        TracePass::Mirrors,
        TracePass::Inline,
        TracePass::Converged,
    ];
    commands.insert_resource(TracePipelines {
        blocks_shader: load_embedded_asset!(asset_server.as_ref(), "blocks.wesl"),
        inline_shader: load_embedded_asset!(asset_server.as_ref(), "inline.wesl"),
        converged_shader: load_embedded_asset!(asset_server.as_ref(), "converged.wesl"),
        layouts: passes.into_iter().map(|pass| (pass, trace_layout(pass))).collect(),
        scene_layout: scene.layout.clone(),
        environment_layout: layout_descriptor(),
        albedo_table,
        noise: None,
        compute: HashMap::default(),
        inline: HashMap::default(),
        wanted: HashSet::default(),
        count_invocations: count.is_some(),
        #[cfg(all(
            feature = "hardware-vrs",
            any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
        ))]
        defs_for_any: scene.shader_defs_for_any(),
        variant: Variant {
            masked: true,
            deep: false,
        },
    });
}

/// Queues what cameras asked for.
pub fn queue_trace_pipelines(
    mut pipelines: ResMut<TracePipelines>,
    cache: Res<PipelineCache>,
    scene: Res<SceneBindings>,
    noise: Option<Res<Bluenoise>>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let pipelines = &mut *pipelines;
    let deep = scene.has_deep_trees();
    pipelines.variant = Variant {
        masked: scene.has_masked_geometry(),
        deep,
    };
    for pass in pipelines.wanted.clone() {
        // The variant that is right for scenes with and without masks comes first.
        for masked in [true, false] {
            let variant = Variant { masked, deep };
            let queued = match pass {
                TracePass::Inline => pipelines.inline.contains_key(&variant),
                _ => pipelines.compute.contains_key(&(pass, variant)),
            };
            if !queued {
                pipelines.queue(pass, variant, &scene, &cache);
            }
        }
    }
    if pipelines.noise.is_none() {
        let image = noise.and_then(|noise| images.get(&noise.texture));
        pipelines.noise = image.map(array_view);
    }
    if let Some(error) = pipelines.error(&cache) {
        bevy::log::error_once!("ray-traced reflections stay off, since their shader failed: {error}");
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
