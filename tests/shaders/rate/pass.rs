//! Runs the pass that determines rates on a G-buffer made by a test.

use super::{adaptive::Past, frame::Frame, reference::Case};
use crate::{
    compute::{READ, WRITTEN, depth_texture, dispatch, entry, read_texture, texture},
    gpu::{Checks, Gpu},
    wesl::Shaders,
};
use bevy::{math::UVec2, shader::ShaderDefVal};
use wgpu::{
    BindGroupEntry, BindGroupLayoutEntry, BindingResource, BindingType, Buffer, BufferBindingType, ShaderStages,
    StorageTextureAccess, Texture, TextureFormat, TextureSampleType, TextureView, TextureViewDimension,
};

/// Contents of buffers and textures before the pass.
pub const UNTOUCHED: u32 = 0xdead_beef;

/// All that the pass writes.
pub struct Output {
    pub arguments: Vec<u32>,
    /// By rows.
    pub rates: Vec<u32>,
    /// By rows.
    pub records: Vec<[u32; 4]>,
    pub blocks: Vec<u32>,
    pub mirrors: Vec<u32>,
    pub tiles: Vec<u32>,
}

/// All that the pass reads and writes.
struct Resources {
    view: Buffer,
    settings: Buffer,
    depth: Texture,
    words: Texture,
    normals: Texture,
    rates: Texture,
    blocks: Buffer,
    mirrors: Buffer,
    tiles: Buffer,
    arguments: Buffer,
    records: Texture,
    image: Texture,
    /// Textures of the last frame, in the order of their bindings.
    past: Vec<Texture>,
}

impl Resources {
    /// The inputs of a case; outputs are [`UNTOUCHED`]. `module` is the shader; its structs define the layout of uniforms.
    fn new(gpu: &Gpu, case: &Case, module: &naga::Module) -> Self {
        let (trace, tiles) = (case.trace_size(), case.tile_count());
        let untouched = |size: UVec2, words: u32| vec![UNTOUCHED; (size.x * size.y * words) as usize];
        let read = |format, size, texels: &[u32]| texture(gpu, format, size, READ, bytemuck::cast_slice(texels));
        let written = |format, size, words| {
            let texels = untouched(size, words);
            texture(gpu, format, size, WRITTEN, bytemuck::cast_slice(&texels))
        };
        let Frame { words, normals, .. } = &case.frame;
        let past = |past: &Past| {
            vec![
                read(TextureFormat::R32Uint, tiles, &past.rates),
                read(TextureFormat::Rg16Float, case.frame.size, &past.motion),
                read(TextureFormat::Rgba16Float, case.size, past.radiance.as_flattened()),
                read(TextureFormat::R32Uint, case.size, &past.stats),
                read(TextureFormat::Rg32Uint, case.size, past.surface.as_flattened()),
            ]
        };
        Self {
            view: gpu.buffer(&case.view_uniform(module)),
            settings: gpu.buffer(&case.settings_uniform(module)),
            depth: depth_texture(gpu, case.frame.size, case.past.as_ref().map_or(0.0, |past| past.depth)),
            words: read(TextureFormat::Rgba32Uint, case.frame.size, words.as_flattened()),
            normals: read(TextureFormat::Rgb10a2Unorm, case.frame.size, normals),
            rates: written(TextureFormat::R32Uint, tiles, 1),
            blocks: gpu.buffer(&untouched(trace, 1)),
            mirrors: gpu.buffer(&untouched(case.size, 1)),
            tiles: gpu.buffer(&untouched(tiles, 1)),
            arguments: gpu.buffer(&[0u32; 19]),
            records: written(TextureFormat::Rgba32Uint, trace, 4),
            image: read(TextureFormat::R32Uint, case.image_size, &case.image),
            past: case.past.as_ref().map(past).unwrap_or_default(),
        }
    }

    /// Views of the textures, in the order of their bindings.
    fn texture_views(&self) -> Vec<TextureView> {
        let own = [
            &self.depth,
            &self.words,
            &self.normals,
            &self.rates,
            &self.records,
            &self.image,
        ];
        let all = own.into_iter().chain(&self.past);
        all.map(|texture| texture.create_view(&Default::default())).collect()
    }

    fn entries<'a>(&'a self, views: &'a [TextureView]) -> Vec<BindGroupEntry<'a>> {
        let [depth, words, normals, rates, records, image, past @ ..] = views else {
            panic!("{} views", views.len());
        };
        let own = [
            self.view.as_entire_binding(),
            self.settings.as_entire_binding(),
            BindingResource::TextureView(depth),
            BindingResource::TextureView(words),
            BindingResource::TextureView(normals),
            BindingResource::TextureView(rates),
            self.blocks.as_entire_binding(),
            self.mirrors.as_entire_binding(),
            self.tiles.as_entire_binding(),
            self.arguments.as_entire_binding(),
            BindingResource::TextureView(records),
            BindingResource::TextureView(image),
        ];
        (0..)
            .zip(own.into_iter().chain(past.iter().map(BindingResource::TextureView)))
            .map(|(binding, resource)| entry(binding, resource))
            .collect()
    }

    /// Reads the results of the pass, and checks that it wrote nothing beyond the ends of its lists.
    fn read(&self, gpu: &Gpu, case: &Case) -> Output {
        let arguments: Vec<u32> = gpu.read(&self.arguments);
        let list = |buffer: &Buffer, count: u32| {
            let mut words: Vec<u32> = gpu.read(buffer);
            assert!(
                words[(count as usize).min(words.len())..]
                    .iter()
                    .all(|word| *word == UNTOUCHED),
                "written behind the end of a list of {count}"
            );
            words.truncate(count as usize);
            words
        };
        Output {
            rates: read_texture(gpu, &self.rates, case.tile_count(), 1),
            records: bytemuck::cast_slice(&read_texture(gpu, &self.records, case.trace_size(), 4)).to_vec(),
            blocks: list(&self.blocks, arguments[12]),
            mirrors: list(&self.mirrors, arguments[13]),
            tiles: list(&self.tiles, arguments[14]),
            arguments,
        }
    }
}

/// Runs the entry point of a module, by its name in `shaders`, with shader definitions.
pub fn determine_rates(gpu: &Gpu, shaders: &mut Shaders, name: &str, defs: &[&'static str], case: &Case) -> Output {
    let defs: Vec<ShaderDefVal> = defs.iter().map(|def| ShaderDefVal::from(*def)).collect();
    let (wgsl, parsed) = shaders.expect(name, &defs);
    let resources = Resources::new(gpu, case, &parsed);
    let views = resources.texture_views();
    let entries = resources.entries(&views);
    let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: None,
        entries: &layout_entries(case.past.is_some()),
    });
    let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let pipeline = gpu.cached_pipeline(&wgsl, name, Checks::Off, |module| {
        gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: Some(&pipeline_layout),
            module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions {
                // As Bevy does.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    });
    dispatch(gpu, &pipeline, &entries, case.tile_count());
    resources.read(gpu, case)
}

/// As in `src/rate/classify.rs`.
fn layout_entries(with_past: bool) -> Vec<BindGroupLayoutEntry> {
    let uniform = BindingType::Buffer {
        ty: BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let storage = BindingType::Buffer {
        ty: BufferBindingType::Storage { read_only: false },
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let sampled = |sample_type| BindingType::Texture {
        sample_type,
        view_dimension: TextureViewDimension::D2,
        multisampled: false,
    };
    let written = |format| BindingType::StorageTexture {
        access: StorageTextureAccess::WriteOnly,
        format,
        view_dimension: TextureViewDimension::D2,
    };
    let own = [
        uniform,
        uniform,
        sampled(TextureSampleType::Float { filterable: false }),
        sampled(TextureSampleType::Uint),
        sampled(TextureSampleType::Float { filterable: false }),
        written(TextureFormat::R32Uint),
        storage,
        storage,
        storage,
        storage,
        written(TextureFormat::Rgba32Uint),
        sampled(TextureSampleType::Uint),
    ];
    let floats = sampled(TextureSampleType::Float { filterable: false });
    let words = sampled(TextureSampleType::Uint);
    let past = [words, floats, floats, words, words];
    own.into_iter()
        .chain(past.into_iter().filter(|_| with_past))
        .enumerate()
        .map(|(binding, ty)| BindGroupLayoutEntry {
            binding: binding as u32,
            visibility: ShaderStages::COMPUTE,
            ty,
            count: None,
        })
        .collect()
}
