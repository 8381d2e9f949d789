//! Runs one pass of the denoiser over all tiles of a view.

use crate::common::{
    gpu::{Checks, Gpu},
    wesl::{self, Shaders},
};
use bevy::math::UVec2;
use std::collections::BTreeMap;
use wgpu::{TextureFormat, TextureUsages, util::DeviceExt};

/// Bytes of a uniform, laid out as the shader has it.
pub struct Uniform {
    members: BTreeMap<String, usize>,
    pub bytes: Vec<u8>,
}

impl Uniform {
    pub fn new(module: &naga::Module, name: &str) -> Self {
        let suffix = format!("_{name}");
        for (_, ty) in module.types.iter() {
            let linked = ty.name.as_deref();
            let linked = linked.is_some_and(|linked| linked == name || linked.ends_with(&suffix));
            if let (true, naga::TypeInner::Struct { members, span }) = (linked, &ty.inner) {
                let offset =
                    |member: &naga::StructMember| (member.name.clone().unwrap_or_default(), member.offset as usize);
                return Self {
                    members: members.iter().map(offset).collect(),
                    bytes: vec![0; *span as usize],
                };
            }
        }
        panic!("no struct {name} in the shader");
    }

    pub fn set<T: bytemuck::NoUninit>(&mut self, member: &str, value: &[T]) {
        let value: &[u8] = bytemuck::cast_slice(value);
        let offset = self.members[member];
        self.bytes[offset..offset + value.len()].copy_from_slice(value);
    }
}

/// What all passes of a view share.
pub struct View {
    pub size: UVec2,
    pub tiles: UVec2,
    pub groups_per_tile: u32,
    /// In clip space, of all pixels.
    pub depth: f32,
}

/// One dispatch over all tiles.
pub struct Pass<'a> {
    gpu: &'a Gpu,
    entry: &'static str,
    wgsl: String,
    /// Bindings of the flattened shader, which has what the entry point uses and no more.
    declared: Vec<u32>,
    buffers: Vec<(u32, wgpu::Buffer)>,
    textures: Vec<(u32, wgpu::Texture)>,
    /// Texture and words per texel.
    outputs: Vec<(u32, wgpu::Texture, u32)>,
    size: UVec2,
    groups: u32,
}

impl<'a> Pass<'a> {
    /// `uniforms` makes those of the view and of the settings for a flattened shader.
    pub fn new(
        gpu: &'a Gpu,
        shaders: &mut Shaders,
        entry: &'static str,
        frame: &View,
        uniforms: impl Fn(&naga::Module) -> [Vec<u8>; 2],
    ) -> Self {
        let name = format!("bevy_glint/denoise/{entry}.wesl");
        let wgsl = shaders.flatten(&name, &[]).unwrap_or_else(|error| panic!("{error}"));
        let module = wesl::validate(&wgsl).unwrap_or_else(|error| panic!("{error}"));
        let [view, settings] = uniforms(&module);
        let tiles = frame.tiles;
        let list: Vec<u32> = (0..tiles.y)
            .flat_map(|y| (0..tiles.x).map(move |x| x | (y << 16)))
            .collect();
        let mut arguments = [0u32; 20];
        arguments[11] = list.len() as u32;
        let buffers = vec![
            (0, gpu.buffer(&view)),
            (1, gpu.buffer(&settings)),
            (5, gpu.buffer(&list)),
            (6, gpu.buffer(&arguments)),
        ];
        let declared = module.global_variables.iter();
        let declared = declared.filter_map(|(_, variable)| variable.binding.as_ref().map(|binding| binding.binding));
        let mut pass = Self {
            gpu,
            entry,
            wgsl,
            declared: declared.collect(),
            buffers,
            textures: Vec::new(),
            outputs: Vec::new(),
            size: frame.size,
            groups: tiles.x * tiles.y * frame.groups_per_tile,
        };
        let depth = pass.create(
            TextureFormat::Depth32Float,
            frame.size,
            TextureUsages::RENDER_ATTACHMENT,
        );
        pass.clear_depth(&depth, frame.depth);
        pass.textures.push((2, depth));
        pass
    }

    fn descriptor(format: TextureFormat, size: UVec2, usage: TextureUsages) -> wgpu::TextureDescriptor<'static> {
        wgpu::TextureDescriptor {
            label: None,
            size: extent(size),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: usage | TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        }
    }

    fn create(&self, format: TextureFormat, size: UVec2, usage: TextureUsages) -> wgpu::Texture {
        self.gpu.device.create_texture(&Self::descriptor(format, size, usage))
    }

    pub fn texture(&mut self, binding: u32, format: TextureFormat, size: UVec2, texels: &[u8]) {
        let descriptor = Self::descriptor(format, size, TextureUsages::empty());
        let gpu = self.gpu;
        let texture = gpu
            .device
            .create_texture_with_data(&gpu.queue, &descriptor, Default::default(), texels);
        self.textures.push((binding, texture));
    }

    pub fn output(&mut self, binding: u32, format: TextureFormat, words: u32) {
        let usage = TextureUsages::STORAGE_BINDING | TextureUsages::COPY_SRC;
        let texture = self.create(format, self.size, usage);
        self.outputs.push((binding, texture, words));
    }

    fn clear_depth(&self, depth: &wgpu::Texture, value: f32) {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        drop(encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: None,
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &depth.create_view(&Default::default()),
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(value),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        }));
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Words of the outputs, by rows.
    pub fn run(self) -> Vec<Vec<u32>> {
        let gpu = self.gpu;
        let pipeline = gpu.pipeline(&gpu.module(&self.wgsl, Checks::Off), self.entry);
        let textures = self.textures.iter().map(|(binding, texture)| (*binding, texture));
        let outputs = self.outputs.iter().map(|(binding, texture, _)| (*binding, texture));
        let views: Vec<_> = textures
            .chain(outputs)
            .map(|(binding, texture)| (binding, texture.create_view(&Default::default())))
            .collect();
        let mut entries: Vec<_> = self
            .buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding: *binding,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        entries.extend(views.iter().map(|(binding, view)| wgpu::BindGroupEntry {
            binding: *binding,
            resource: wgpu::BindingResource::TextureView(view),
        }));
        entries.retain(|entry| self.declared.contains(&entry.binding));
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups(self.groups, 1, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        self.outputs
            .iter()
            .map(|(_, texture, words)| read_texture(gpu, texture, self.size, *words))
            .collect()
    }
}

fn extent(size: UVec2) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: size.x,
        height: size.y,
        depth_or_array_layers: 1,
    }
}

/// Words of a texture, by rows.
fn read_texture(gpu: &Gpu, texture: &wgpu::Texture, size: UVec2, words_per_texel: u32) -> Vec<u32> {
    let row = size.x * words_per_texel;
    let padded = (4 * row).next_multiple_of(256) / 4;
    let buffer = gpu.buffer(&vec![0u32; (padded * size.y) as usize]);
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * padded),
                rows_per_image: Some(size.y),
            },
        },
        extent(size),
    );
    gpu.queue.submit([encoder.finish()]);
    let words: Vec<u32> = gpu.read(&buffer);
    words
        .chunks(padded as usize)
        .flat_map(|chunk| chunk[..row as usize].to_vec())
        .collect()
}
