//! Runs the pass that determines rates on a G-buffer made by a test.

use super::{frame::Frame, reference::Case};
use crate::{
    compute::{READ, WRITTEN, dispatch, empty_texture, read_texture, texture},
    gpu::{Checks, Gpu},
    wesl::Shaders,
};
use bevy::{math::UVec2, shader::ShaderDefVal};
use wgpu::{
    BindGroupLayoutEntry, BindingResource, BindingType, BufferBindingType, ShaderStages, StorageTextureAccess,
    TextureFormat, TextureSampleType, TextureUsages, TextureViewDimension,
};

/// What buffers and textures hold before the pass.
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

/// Runs the entry point of a module, by its name in `shaders`, with shader definitions.
pub fn determine_rates(gpu: &Gpu, shaders: &mut Shaders, name: &str, defs: &[&'static str], case: &Case) -> Output {
    let defs: Vec<ShaderDefVal> = defs.iter().map(|def| ShaderDefVal::from(*def)).collect();
    let (wgsl, parsed) = shaders.expect(name, &defs);

    let (trace, tiles) = (case.trace_size(), case.tile_count());
    let Frame { words, normals, .. } = &case.frame;
    let words = texture(
        gpu,
        TextureFormat::Rgba32Uint,
        case.frame.size,
        READ,
        bytemuck::cast_slice(words),
    );
    let normals = texture(
        gpu,
        TextureFormat::Rgb10a2Unorm,
        case.frame.size,
        READ,
        bytemuck::cast_slice(normals),
    );
    let depth = empty_texture(
        gpu,
        TextureFormat::Depth32Float,
        case.frame.size,
        READ | TextureUsages::RENDER_ATTACHMENT,
    );
    let untouched = |size: UVec2, words: u32| vec![UNTOUCHED; (size.x * size.y * words) as usize];
    let rates = texture(
        gpu,
        TextureFormat::R32Uint,
        tiles,
        WRITTEN,
        bytemuck::cast_slice(&untouched(tiles, 1)),
    );
    let records = texture(
        gpu,
        TextureFormat::Rgba32Uint,
        trace,
        WRITTEN,
        bytemuck::cast_slice(&untouched(trace, 4)),
    );
    let image = texture(
        gpu,
        TextureFormat::R32Uint,
        case.image_size,
        READ,
        bytemuck::cast_slice(&case.image),
    );
    let view = gpu.buffer(&case.view_uniform(&parsed));
    let settings = gpu.buffer(&case.settings_uniform(&parsed));
    let blocks = gpu.buffer(&untouched(trace, 1));
    let mirrors = gpu.buffer(&untouched(case.size, 1));
    let active = gpu.buffer(&untouched(tiles, 1));
    let arguments = gpu.buffer(&[0u32; 15]);

    let texture_view = |texture: &wgpu::Texture| texture.create_view(&Default::default());
    let views = [&depth, &words, &normals, &rates, &records, &image].map(texture_view);
    let resources = [
        view.as_entire_binding(),
        settings.as_entire_binding(),
        BindingResource::TextureView(&views[0]),
        BindingResource::TextureView(&views[1]),
        BindingResource::TextureView(&views[2]),
        BindingResource::TextureView(&views[3]),
        blocks.as_entire_binding(),
        mirrors.as_entire_binding(),
        active.as_entire_binding(),
        arguments.as_entire_binding(),
        BindingResource::TextureView(&views[4]),
        BindingResource::TextureView(&views[5]),
    ];
    let entries: Vec<_> = resources
        .into_iter()
        .enumerate()
        .map(|(index, resource)| wgpu::BindGroupEntry {
            binding: index as u32,
            resource,
        })
        .collect();
    let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: None,
        entries: &layout_entries(),
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
    dispatch(gpu, &pipeline, &entries, tiles);

    let arguments: Vec<u32> = gpu.read(&arguments);
    let list = |buffer: &wgpu::Buffer, count: u32| {
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
        rates: read_texture(gpu, &rates, tiles, 1),
        records: bytemuck::cast_slice(&read_texture(gpu, &records, trace, 4)).to_vec(),
        blocks: list(&blocks, arguments[12]),
        mirrors: list(&mirrors, arguments[13]),
        tiles: list(&active, arguments[14]),
        arguments,
    }
}

/// As in `src/rate/classify.rs`.
fn layout_entries() -> Vec<BindGroupLayoutEntry> {
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
    [
        uniform,
        uniform,
        sampled(TextureSampleType::Depth),
        sampled(TextureSampleType::Uint),
        sampled(TextureSampleType::Float { filterable: false }),
        written(TextureFormat::R32Uint),
        storage,
        storage,
        storage,
        storage,
        written(TextureFormat::Rgba32Uint),
        sampled(TextureSampleType::Uint),
    ]
    .into_iter()
    .enumerate()
    .map(|(binding, ty)| BindGroupLayoutEntry {
        binding: binding as u32,
        visibility: ShaderStages::COMPUTE,
        ty,
        count: None,
    })
    .collect()
}
