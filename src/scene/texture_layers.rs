//! Small copies of material textures in the layers of one array texture, for devices that can't index bindings freely.

use crate::device::try_allocate;
use bevy::{
    asset::{AssetServer, load_embedded_asset},
    ecs::world::World,
    platform::collections::HashSet,
    render::{
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedRenderPipelineId,
            ColorTargetState, ColorWrites, CommandEncoder, CommandEncoderDescriptor, Extent3d, FilterMode,
            FragmentState, LoadOp, MipmapFilterMode, Operations, PipelineCache, RenderPassColorAttachment,
            RenderPassDescriptor, RenderPipeline, RenderPipelineDescriptor, Sampler, SamplerBindingType,
            SamplerDescriptor, ShaderStages, StoreOp, Texture, TextureDescriptor, TextureDimension, TextureFormat,
            TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension, VertexState,
            binding_types::{sampler, texture_2d},
        },
        renderer::{RenderDevice, RenderQueue},
    },
};

/// Width and height of a layer.
pub const LAYER_SIZE: u32 = 256;
const LEVELS: u32 = LAYER_SIZE.ilog2() + 1;
const FIRST_LAYERS: u32 = 16;
/// The sRGB curve spends its 8 bits on dark colours, where they matter most. Data such as roughness is encoded and decoded with the same
/// curve, and loses half a bit in the middle of its range.
const FORMAT: TextureFormat = TextureFormat::Rgba8UnormSrgb;

pub(super) struct TextureLayers {
    texture: Texture,
    view: TextureView,
    limit: u32,
    layers: u32,
    /// Source of each layer's copy.
    sources: Vec<Option<TextureView>>,
    outdated: HashSet<u32>,
    sampler: Sampler,
    layout: BindGroupLayoutDescriptor,
    pipeline: CachedRenderPipelineId,
    ready: bool,
}

fn create_texture(device: &RenderDevice, layers: u32) -> (Texture, TextureView) {
    let texture = device.create_texture(&TextureDescriptor {
        label: Some("glint_texture_layers"),
        size: Extent3d {
            width: LAYER_SIZE,
            height: LAYER_SIZE,
            depth_or_array_layers: layers,
        },
        mip_level_count: LEVELS,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format: FORMAT,
        usage: TextureUsages::TEXTURE_BINDING | TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    let view = texture.create_view(&TextureViewDescriptor {
        dimension: Some(TextureViewDimension::D2Array),
        ..Default::default()
    });
    (texture, view)
}

impl TextureLayers {
    pub fn new(world: &World, limit: u32) -> Self {
        let device = world.resource::<RenderDevice>();
        let layers = FIRST_LAYERS.min(limit);
        let (texture, view) = create_texture(device, layers);
        let sampler_descriptor = SamplerDescriptor {
            label: Some("glint_downsample"),
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            mipmap_filter: MipmapFilterMode::Nearest,
            ..Default::default()
        };
        let layout = BindGroupLayoutDescriptor::new(
            "glint_downsample",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (
                    texture_2d(TextureSampleType::Float { filterable: true }),
                    sampler(SamplerBindingType::Filtering),
                ),
            ),
        );
        let shader = load_embedded_asset!(world.resource::<AssetServer>(), "texture_layers.wesl");
        let pipeline = world
            .resource::<PipelineCache>()
            .queue_render_pipeline(RenderPipelineDescriptor {
                label: Some("glint_downsample".into()),
                layout: vec![layout.clone()],
                vertex: VertexState {
                    shader: shader.clone(),
                    entry_point: Some("vertex".into()),
                    ..Default::default()
                },
                fragment: Some(FragmentState {
                    shader,
                    entry_point: Some("downsample".into()),
                    targets: vec![Some(ColorTargetState {
                        format: FORMAT,
                        blend: None,
                        write_mask: ColorWrites::ALL,
                    })],
                    ..Default::default()
                }),
                ..Default::default()
            });
        Self {
            texture,
            view,
            limit,
            layers,
            sources: Vec::new(),
            outdated: HashSet::default(),
            sampler: device.create_sampler(&sampler_descriptor),
            layout,
            pipeline,
            ready: false,
        }
    }

    /// The array of all layers.
    pub fn view(&self) -> &TextureView {
        &self.view
    }

    /// Returns whether textures can be copied yet.
    pub fn is_ready(&mut self, pipelines: &PipelineCache) -> bool {
        self.ready |= pipelines.get_render_pipeline(self.pipeline).is_some();
        self.ready
    }

    /// Copies `source` to `layer` in the next [`Self::flush`]. Returns false if the device lacks memory for that number of layers.
    pub fn copy(&mut self, device: &RenderDevice, layer: u32, source: &TextureView) -> bool {
        if layer >= self.limit {
            return false;
        }
        if layer >= self.layers {
            let layers = (layer + 1).next_power_of_two().min(self.limit);
            let Some(created) = try_allocate(device, || create_texture(device, layers)) else {
                return false;
            };
            self.layers = layers;
            (self.texture, self.view) = created;
            let filled = self.sources.iter().enumerate().filter(|(_, source)| source.is_some());
            self.outdated.extend(filled.map(|(layer, _)| layer as u32));
        }
        let place = layer as usize;
        if place >= self.sources.len() {
            self.sources.resize(place + 1, None);
        }
        self.sources[place] = Some(source.clone());
        self.outdated.insert(layer);
        true
    }

    /// Releases the source of a layer that is no longer used.
    pub fn forget(&mut self, layer: u32) {
        if let Some(source) = self.sources.get_mut(layer as usize) {
            *source = None;
        }
        self.outdated.remove(&layer);
    }

    /// Releases all copies and their sources.
    pub fn clear(&mut self, device: &RenderDevice) {
        self.sources.clear();
        self.outdated.clear();
        let first = FIRST_LAYERS.min(self.limit);
        if self.layers > first {
            self.layers = first;
            (self.texture, self.view) = create_texture(device, first);
        }
    }

    /// Copies outdated layers.
    pub fn flush(&mut self, device: &RenderDevice, queue: &RenderQueue, pipelines: &PipelineCache) {
        if self.outdated.is_empty() {
            return;
        }
        let Some(pipeline) = pipelines.get_render_pipeline(self.pipeline) else {
            return;
        };
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("glint_texture_layers"),
        });
        for layer in std::mem::take(&mut self.outdated) {
            let Some(Some(source)) = self.sources.get(layer as usize) else {
                continue;
            };
            let mut previous = source.clone();
            for level in 0..LEVELS {
                let target = self.texture.create_view(&TextureViewDescriptor {
                    label: Some("glint_texture_layer_level"),
                    dimension: Some(TextureViewDimension::D2),
                    base_mip_level: level,
                    mip_level_count: Some(1),
                    base_array_layer: layer,
                    array_layer_count: Some(1),
                    ..Default::default()
                });
                self.downsample(device, pipelines, &mut encoder, pipeline, &previous, &target);
                previous = target;
            }
        }
        queue.submit([encoder.finish()]);
    }

    fn downsample(
        &self,
        device: &RenderDevice,
        pipelines: &PipelineCache,
        encoder: &mut CommandEncoder,
        pipeline: &RenderPipeline,
        source: &TextureView,
        target: &TextureView,
    ) {
        let bind_group = device.create_bind_group(
            "glint_downsample",
            &pipelines.get_bind_group_layout(&self.layout),
            &BindGroupEntries::sequential((source, &self.sampler)),
        );
        let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some("glint_downsample"),
            color_attachments: &[Some(RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: Operations {
                    load: LoadOp::Clear(Default::default()),
                    store: StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
    }
}
