//! A device for unit tests.

use bevy::{
    render::{
        render_resource::{
            BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages,
            CommandEncoderDescriptor, MapMode, PipelineCompilationOptions, PollType, RawComputePipelineDescriptor,
            ShaderModuleDescriptor, ShaderSource,
        },
        renderer::{RenderDevice, RenderQueue, initialize_renderer},
        settings::{Backends, RenderResources, WgpuSettings},
    },
    tasks::block_on,
};
use std::sync::OnceLock;

/// The machine's first adapter; `None`, with a message, if it has none.
pub fn device() -> Option<(RenderDevice, RenderQueue)> {
    static DEVICE: OnceLock<Option<(RenderDevice, RenderQueue)>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| {
        // Bevy panics without an adapter.
        let resources = std::panic::catch_unwind(|| {
            block_on(initialize_renderer(Backends::PRIMARY, None, &WgpuSettings::default()))
        });
        let RenderResources(device, queue, ..) = resources.ok()?;
        Some((device, queue))
    });
    if device.is_none() {
        eprintln!("skipped: no graphics adapter");
    }
    device.clone()
}

/// The words of a buffer with the usage `COPY_SRC`, after everything that was queued so far.
pub fn read(device: &RenderDevice, queue: &RenderQueue, buffer: &Buffer) -> Vec<u32> {
    let target = device.create_buffer(&BufferDescriptor {
        label: None,
        size: buffer.size(),
        usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &target, 0, buffer.size());
    queue.submit([encoder.finish()]);
    device.map_buffer(&target.slice(..), MapMode::Read, |result| result.unwrap());
    device.poll(PollType::wait_indefinitely()).unwrap();
    let bytes = target.slice(..).get_mapped_range().unwrap();
    bytemuck::pod_collect_to_vec(&bytes)
}

/// Runs one workgroup of the entry point `main`: binding 0 is `input`, read only, and binding 1 an array of `output_words`.
pub fn run(device: &RenderDevice, queue: &RenderQueue, wgsl: String, input: &[u32], output_words: usize) -> Vec<u32> {
    let module = device.create_and_validate_shader_module(ShaderModuleDescriptor {
        label: None,
        source: ShaderSource::Wgsl(wgsl.into()),
    });
    let pipeline = device.create_compute_pipeline(&RawComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("main"),
        compilation_options: PipelineCompilationOptions::default(),
        cache: None,
    });
    let input = device.create_buffer_with_data(&BufferInitDescriptor {
        label: None,
        contents: bytemuck::cast_slice(input),
        usage: BufferUsages::STORAGE,
    });
    let output = device.create_buffer(&BufferDescriptor {
        label: None,
        size: output_words as u64 * 4,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let bind_group = device.wgpu_device().create_bind_group(&BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[
            BindGroupEntry {
                binding: 0,
                resource: input.as_entire_binding(),
            },
            BindGroupEntry {
                binding: 1,
                resource: output.as_entire_binding(),
            },
        ],
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(1, 1, 1);
    }
    queue.submit([encoder.finish()]);
    read(device, queue, &output)
}
