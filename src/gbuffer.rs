//! Passes over the G-buffer: group 0, which starts with the bindings of `gbuffer.wesl`, and how they are compiled and started.
//!
//! Each pass declares a list of [`Binding`]s: the layout of a resource in its shader, together with the resource itself.

use crate::{
    scene::environment,
    settings::ReflectionView,
    targets::{HistoryTargets, PipelineTargets, Targets},
    view::{GpuReflectionView, ReflectionTextures},
    vrs::BindGroupContents,
};
use bevy::{
    app::{App, Plugin},
    asset::Handle,
    ecs::entity::Entity,
    math::{URect, UVec2},
    platform::collections::HashMap,
    render::{
        RenderApp,
        render_resource::{
            BindGroup, BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder, BindingResource, Buffer,
            CachedComputePipelineId, CachedPipelineState, ComputePass, ComputePassDescriptor, ComputePipeline,
            ComputePipelineDescriptor, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries, IntoBinding,
            PipelineCache, ShaderStages, StorageTextureAccess, TextureFormat, TextureSampleType, TextureView,
            binding_types,
        },
        renderer::{RenderContext, RenderDevice},
        view::ViewUniform,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal, load_shader_library},
    utils::default,
};
use core::{hash::Hash, num::NonZeroU64};

/// Registers `gbuffer.wesl`.
pub(crate) struct GBufferPlugin;

impl Plugin for GBufferPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_some() {
            load_shader_library!(app, "gbuffer.wesl");
        }
    }
}

/// The resources of `gbuffer.wesl`.
pub(crate) struct GBufferBindings<'a> {
    pub view: BindingResource<'a>,
    pub settings: BindingResource<'a>,
    pub depth: &'a TextureView,
    pub gbuffer: &'a TextureView,
    pub normals: &'a TextureView,
}

/// All inputs and outputs of a view's passes.
pub(crate) struct PassContext<'a> {
    /// The view in the render world.
    pub entity: Entity,
    pub gbuffer: GBufferBindings<'a>,
    /// Dynamic offset of the view's uniform.
    pub view_offset: u32,
    pub motion: Option<&'a TextureView>,
    pub view: &'a ReflectionView,
    pub textures: &'a ReflectionTextures,
    pub cache: &'a PipelineCache,
    /// Group 1.
    pub scene: &'a BindGroup,
    /// Group 2.
    pub environment: &'a BindGroup,
    /// Contents of groups 1 and 2, while the view uses variable rate shading of the rasterizer.
    pub contents: [&'a BindGroupContents; 2],
    pub ssao: Option<&'a TextureView>,
    /// Table for `albedo.wesl`.
    pub albedo_table: &'a TextureView,
    pub noise: &'a TextureView,
    /// The lit frame.
    pub frame: &'a TextureView,
    /// The frame that rays reuse: [`Targets::screen`] of the opaque surfaces' textures.
    pub screen: Option<&'a TextureView>,
    /// Tiles that contain all surfaces of these passes in the view; `None` if they can be anywhere.
    pub tiles: Option<URect>,
}

impl<'a> PassContext<'a> {
    pub fn targets(&self) -> &'a Targets {
        &self.textures.targets
    }

    /// Targets between the rate image and the composite; `None` for techniques without them.
    pub fn images(&self) -> Option<&'a PipelineTargets> {
        self.targets().pipeline.as_ref()
    }

    /// History and motion vectors, if results are accumulated and both exist.
    pub fn history(&self) -> Option<(&'a HistoryTargets, &'a TextureView)> {
        let history = self.images()?.history.as_ref()?;
        self.motion.map(|motion| (history, motion))
    }

    /// Pixels of the view that contain all surfaces of these passes.
    pub fn area(&self) -> URect {
        let size = self.textures.size();
        let Some(tiles) = self.tiles else {
            return URect::from_corners(UVec2::ZERO, size);
        };
        let pixels = self.targets().sizes.tile_pixels();
        URect::from_corners((tiles.min * pixels).min(size), (tiles.max * pixels).min(size))
    }

    /// Index in ping-pong pairs that this frame writes.
    pub fn now(&self) -> usize {
        self.textures.write_index
    }

    /// Index in ping-pong pairs that the last frame wrote.
    pub fn before(&self) -> usize {
        1 - self.textures.write_index
    }
}

/// Finds a texture of a view; `None` if the view has none.
pub(crate) type FindTexture = for<'a> fn(&PassContext<'a>) -> Option<&'a TextureView>;
/// Finds a buffer of a view; `None` if the view has none.
type FindBuffer = for<'a> fn(&PassContext<'a>) -> Option<&'a Buffer>;

#[derive(Clone, Copy)]
enum Resource {
    Texture(FindTexture),
    Buffer(FindBuffer),
    /// The pass provides it for each view.
    Given,
}

/// A binding of group 0, after the ones of `gbuffer.wesl`.
#[derive(Clone)]
pub(crate) struct Binding {
    layout: BindGroupLayoutEntryBuilder,
    resource: Resource,
}

impl Binding {
    /// A texture of floats.
    pub fn floats(find: FindTexture) -> Self {
        Self {
            layout: binding_types::texture_2d(TextureSampleType::Float { filterable: false }),
            resource: Resource::Texture(find),
        }
    }

    /// An array of textures of floats.
    pub fn float_layers(find: FindTexture) -> Self {
        Self {
            layout: binding_types::texture_2d_array(TextureSampleType::Float { filterable: false }),
            resource: Resource::Texture(find),
        }
    }

    /// A texture of integers.
    pub fn integers(find: FindTexture) -> Self {
        Self {
            layout: integers(),
            resource: Resource::Texture(find),
        }
    }

    /// A texture that the pass writes.
    pub fn written(format: TextureFormat, find: FindTexture) -> Self {
        Self {
            layout: binding_types::texture_storage_2d(format, StorageTextureAccess::WriteOnly),
            resource: Resource::Texture(find),
        }
    }

    /// A texture that the pass reads and writes.
    pub fn read_written(format: TextureFormat, find: FindTexture) -> Self {
        Self {
            layout: binding_types::texture_storage_2d(format, StorageTextureAccess::ReadWrite),
            resource: Resource::Texture(find),
        }
    }

    /// A buffer of words.
    pub fn words(find: FindBuffer) -> Self {
        Self {
            layout: binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4)),
            resource: Resource::Buffer(find),
        }
    }

    /// A buffer that the pass writes, of at least this number of words.
    pub fn written_words(at_least: u64, find: FindBuffer) -> Self {
        Self {
            layout: binding_types::storage_buffer_sized(false, NonZeroU64::new(4 * at_least)),
            resource: Resource::Buffer(find),
        }
    }

    /// A resource that isn't a target of the view: it is passed to [`Group0::entries`].
    pub fn given(layout: BindGroupLayoutEntryBuilder) -> Self {
        Self {
            layout,
            resource: Resource::Given,
        }
    }
}

/// Layout of a texture of integers.
pub(crate) fn integers() -> BindGroupLayoutEntryBuilder {
    binding_types::texture_2d(TextureSampleType::Uint)
}

/// Number of the screen's binding in all variants that read it: `trace/screen.wesl`.
const SCREEN_BINDING: u32 = 15;

/// Group 0 of a pass over the G-buffer.
pub(crate) struct Group0 {
    bindings: Vec<Binding>,
    /// Binding [`SCREEN_BINDING`] is the screen.
    has_screen: bool,
    pub layout: BindGroupLayoutDescriptor,
}

impl Group0 {
    pub fn new(label: &str, stages: ShaderStages, bindings: Vec<Binding>) -> Self {
        let gbuffer = DynamicBindGroupLayoutEntries::sequential(
            stages,
            (
                binding_types::uniform_buffer::<ViewUniform>(true),
                binding_types::uniform_buffer::<GpuReflectionView>(false),
                // Depth as floats: Bevy's is a depth texture, and a front layer's is written by a compute shader.
                binding_types::texture_2d(TextureSampleType::Float { filterable: false }),
                integers(),
                binding_types::texture_2d(TextureSampleType::Float { filterable: false }),
            ),
        );
        let entries = bindings
            .iter()
            .fold(gbuffer, |entries, binding| entries.extend_sequential((binding.layout,)));
        Self {
            layout: BindGroupLayoutDescriptor::new(format!("{label}_layout"), &entries),
            has_screen: false,
            bindings,
        }
    }

    /// The group with the screen, for a compute pass.
    fn with_screen(&self) -> Self {
        let mut layout = self.layout.clone();
        let screen = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
        layout.entries.push(screen.build(SCREEN_BINDING, ShaderStages::COMPUTE));
        Self {
            bindings: self.bindings.clone(),
            has_screen: true,
            layout,
        }
    }

    /// The contents of the group. `given` are the resources for bindings declared by [`Binding::given`], in order. Returns
    /// `None` if the view lacks a target.
    pub fn entries<'a>(
        &self,
        context: &PassContext<'a>,
        given: &[BindingResource<'a>],
    ) -> Option<DynamicBindGroupEntries<'a>> {
        let GBufferBindings {
            view,
            settings,
            depth,
            gbuffer,
            normals,
        } = &context.gbuffer;
        let (view, settings) = (view.clone(), settings.clone());
        let mut entries = DynamicBindGroupEntries::sequential((view, settings, *depth, *gbuffer, *normals));
        let mut given = given.iter();
        for binding in &self.bindings {
            let resource = match binding.resource {
                Resource::Texture(find) => find(context)?.into_binding(),
                Resource::Buffer(find) => find(context)?.as_entire_binding(),
                Resource::Given => given.next()?.clone(),
            };
            entries = entries.extend_sequential((resource,));
        }
        if self.has_screen {
            entries = entries.extend_with_indices(((SCREEN_BINDING, context.screen?),));
        }
        Some(entries)
    }

    /// The group with its contents; see [`Self::entries`].
    pub fn bind_group(
        &self,
        label: Option<&str>,
        device: &RenderDevice,
        context: &PassContext,
        given: &[BindingResource],
    ) -> Option<BindGroup> {
        let entries = self.entries(context, given)?;
        let layout = context.cache.get_bind_group_layout(&self.layout);
        Some(device.create_bind_group(label, &layout, &entries))
    }
}

/// Bind groups of a pass besides group 0.
pub(crate) enum OtherGroups {
    None,
    /// The environment as group 2. Group 1 is empty.
    Environment,
    /// The scene as group 1, with this layout, and the environment as group 2.
    SceneAndEnvironment(BindGroupLayoutDescriptor),
}

impl OtherGroups {
    fn layouts(&self) -> Vec<BindGroupLayoutDescriptor> {
        match self {
            Self::None => vec![],
            Self::Environment => vec![empty_layout(), environment::layout_descriptor()],
            Self::SceneAndEnvironment(scene) => vec![scene.clone(), environment::layout_descriptor()],
        }
    }
}

fn empty_layout() -> BindGroupLayoutDescriptor {
    BindGroupLayoutDescriptor::new("glint_empty_layout", &[])
}

/// Shader that a [`GBufferPass`] compiles for a key.
pub(crate) struct PassShader {
    pub shader: Handle<Shader>,
    pub defs: Vec<ShaderDefVal>,
    /// `None` if the shader has a single entry point.
    pub entry_point: Option<&'static str>,
}

/// A compute pass over the G-buffer, in variants by `K` that are compiled on first request.
pub(crate) struct GBufferPass<K = ()> {
    /// Label of the bind group, the pipelines and the pass.
    label: &'static str,
    group_0: Group0,
    /// The group of variants that read the screen, and a test for these.
    with_screen: Option<(Group0, fn(&K) -> bool)>,
    others: OtherGroups,
    queued: HashMap<K, CachedComputePipelineId>,
}

impl<K: Clone + Eq + Hash> GBufferPass<K> {
    /// Creates a pass without compiled variants.
    pub fn new(label: &'static str, bindings: Vec<Binding>, others: OtherGroups) -> Self {
        Self {
            label,
            group_0: Group0::new(label, ShaderStages::COMPUTE, bindings),
            with_screen: None,
            others,
            queued: HashMap::default(),
        }
    }

    /// Binds the screen in variants that read it.
    pub fn with_screen(mut self, reads: fn(&K) -> bool) -> Self {
        self.with_screen = Some((self.group_0.with_screen(), reads));
        self
    }

    fn group_0_of(&self, key: &K) -> &Group0 {
        let with_screen = self.with_screen.as_ref().filter(|(_, reads)| reads(key));
        with_screen.map_or(&self.group_0, |(group, _)| group)
    }

    /// Queues a variant, unless it already was.
    pub fn queue(&mut self, key: K, cache: &PipelineCache, shader: impl FnOnce() -> PassShader) {
        if self.queued.contains_key(&key) {
            return;
        }
        let PassShader {
            shader,
            defs,
            entry_point,
        } = shader();
        let mut layout = vec![self.group_0_of(&key).layout.clone()];
        layout.extend(self.others.layouts());
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(self.label.into()),
            layout,
            shader,
            shader_defs: defs,
            entry_point: entry_point.map(Into::into),
            ..default()
        });
        self.queued.insert(key, id);
    }

    /// Returns `None` until the variant is compiled.
    pub fn pipeline<'a>(&self, key: &K, cache: &'a PipelineCache) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(*self.queued.get(key)?)
    }

    /// Variants that are compiled.
    pub fn compiled<'a>(&'a self, cache: &'a PipelineCache) -> impl Iterator<Item = &'a K> {
        let ids = self.queued.iter();
        ids.filter_map(|(key, &id)| cache.get_compute_pipeline(id).map(|_| key))
    }

    /// Variants that can't be compiled, except for variants with modules that are still being loaded.
    pub fn errors<'a>(&'a self, cache: &'a PipelineCache) -> impl Iterator<Item = (&'a K, &'a ShaderCacheError)> {
        self.queued
            .iter()
            .filter_map(|(key, &id)| Some((key, lasting_error(cache.get_compute_pipeline_state(id))?)))
    }

    /// Begins the pass in the first compiled variant, with all its groups set; `None` if there is none, or if the view lacks a
    /// target. [`Group0::entries`] describes `given`.
    pub fn begin<'a>(
        &self,
        ctx: &'a mut RenderContext,
        context: &PassContext,
        keys: impl IntoIterator<Item = K>,
        given: &[BindingResource],
    ) -> Option<ComputePass<'a>> {
        let mut variants = keys.into_iter();
        let (pipeline, group_0) =
            variants.find_map(|key| Some((self.pipeline(&key, context.cache)?, self.group_0_of(&key))))?;
        let label = Some(self.label);
        let device = ctx.render_device();
        let group_0 = group_0.bind_group(label, device, context, given)?;
        let empty = matches!(self.others, OtherGroups::Environment).then(|| {
            let layout = context.cache.get_bind_group_layout(&empty_layout());
            device.create_bind_group("glint_empty", &layout, &[])
        });
        let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
            label,
            timestamp_writes: None,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group_0, &[context.view_offset]);
        match &self.others {
            OtherGroups::None => {}
            OtherGroups::Environment => pass.set_bind_group(1, empty.as_deref(), &[]),
            OtherGroups::SceneAndEnvironment(_) => pass.set_bind_group(1, context.scene, &[]),
        }
        if !matches!(self.others, OtherGroups::None) {
            pass.set_bind_group(2, context.environment, &[]);
        }
        Some(pass)
    }
}

/// The error of a pipeline. Modules that are still being loaded also cause errors, but only for a short time.
pub(crate) fn lasting_error(state: &CachedPipelineState) -> Option<&ShaderCacheError> {
    match state {
        CachedPipelineState::Err(
            ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
        ) => None,
        CachedPipelineState::Err(error) => Some(error),
        _ => None,
    }
}
