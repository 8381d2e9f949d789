//! Inputs and outputs of the passes over the G-buffer: group 0, which starts with the bindings of `gbuffer.wesl`.
//!
//! Each pass declares a list of [`Binding`]s: the layout of a resource in its shader, together with the resource itself.

use crate::{
    scene::Features,
    settings::ReflectionView,
    targets::{HistoryTargets, PipelineTargets, Targets},
    view::{GpuReflectionView, ReflectionTextures},
    vrs::BindGroupContents,
};
use bevy::{
    app::{App, Plugin},
    ecs::entity::Entity,
    math::{URect, UVec2},
    render::{
        RenderApp,
        render_resource::{
            BindGroup, BindGroupLayoutDescriptor, BindGroupLayoutEntryBuilder, BindingResource, Buffer,
            DynamicBindGroupEntries, IntoBinding, PipelineCache, ShaderStages, StorageTextureAccess, TextureFormat,
            TextureSampleType, TextureView, binding_types,
        },
        renderer::RenderDevice,
        view::ViewUniform,
    },
    shader::load_shader_library,
};
use core::num::NonZeroU64;

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
    /// Features of the scene.
    pub features: Features,
    /// Objects with known motion move in this frame.
    pub knows_motions: bool,
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

/// A binding of group 0.
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

    /// A resource that isn't a target of the view: it is in [`Contents::given`].
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

/// Group 0 of a pass.
pub(crate) struct Group0 {
    /// The first bindings are the ones of `gbuffer.wesl`.
    has_gbuffer: bool,
    bindings: Vec<Binding>,
    /// Without and with the screen.
    layouts: [BindGroupLayoutDescriptor; 2],
}

/// Resources for a group.
#[derive(Clone, Copy, Default)]
pub(crate) struct Contents<'a> {
    /// Resources for bindings declared by [`Binding::given`], in order.
    pub given: &'a [BindingResource<'a>],
    /// Binding [`SCREEN_BINDING`] is the screen.
    pub has_screen: bool,
}

impl Group0 {
    pub fn new(label: &str, stages: ShaderStages, has_gbuffer: bool, bindings: Vec<Binding>) -> Self {
        let floats = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
        let gbuffer = [
            binding_types::uniform_buffer::<ViewUniform>(true),
            binding_types::uniform_buffer::<GpuReflectionView>(false),
            // Depth as floats: Bevy's is a depth texture, and a front layer's is written by a compute shader.
            floats,
            integers(),
            floats,
        ];
        let gbuffer = gbuffer.into_iter().filter(|_| has_gbuffer);
        let all = gbuffer.chain(bindings.iter().map(|binding| binding.layout));
        let entries: Vec<_> = (0..)
            .zip(all)
            .map(|(index, layout)| layout.build(index, stages))
            .collect();
        let with_screen = [&entries[..], &[floats.build(SCREEN_BINDING, stages)]].concat();
        Self {
            has_gbuffer,
            bindings,
            layouts: [("layout", entries), ("layout_with_screen", with_screen)]
                .map(|(name, entries)| BindGroupLayoutDescriptor::new(format!("{label}_{name}"), &entries)),
        }
    }

    pub fn layout(&self, has_screen: bool) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(has_screen)]
    }

    /// Returns `None` if the view lacks a target.
    pub fn entries<'a>(
        &self,
        context: &PassContext<'a>,
        contents: Contents<'a>,
    ) -> Option<DynamicBindGroupEntries<'a>> {
        let mut entries = DynamicBindGroupEntries::new();
        if self.has_gbuffer {
            let GBufferBindings {
                view,
                settings,
                depth,
                gbuffer,
                normals,
            } = &context.gbuffer;
            let (view, settings) = (view.clone(), settings.clone());
            entries = DynamicBindGroupEntries::sequential((view, settings, *depth, *gbuffer, *normals));
        }
        let mut given = contents.given.iter();
        for (index, binding) in (entries.len() as u32..).zip(&self.bindings) {
            let resource = match binding.resource {
                Resource::Texture(find) => find(context)?.into_binding(),
                Resource::Buffer(find) => find(context)?.as_entire_binding(),
                Resource::Given => given.next()?.clone(),
            };
            entries = entries.extend_with_indices(((index, resource),));
        }
        if contents.has_screen {
            entries = entries.extend_with_indices(((SCREEN_BINDING, context.screen?),));
        }
        Some(entries)
    }

    /// The group with its contents; see [`Self::entries`].
    pub fn bind_group(
        &self,
        label: &str,
        device: &RenderDevice,
        context: &PassContext,
        contents: Contents,
    ) -> Option<BindGroup> {
        let entries = self.entries(context, contents)?;
        let layout = self.layout(contents.has_screen);
        Some(context.textures.groups.get(&layout.label, &entries, || {
            let layout = context.cache.get_bind_group_layout(layout);
            device.create_bind_group(label, &layout, &entries)
        }))
    }
}
