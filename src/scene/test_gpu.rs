//! A device and a shader linker for unit tests.
#![allow(clippy::print_stderr, reason = "a skipped test says why")]

use bevy::{
    asset::{AssetId, uuid::Uuid},
    render::{
        render_resource::{
            BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferInitDescriptor, BufferUsages,
            CommandEncoderDescriptor, MapMode, PipelineCompilationOptions, PollType, RawComputePipelineDescriptor,
            ShaderModuleDescriptor, ShaderSource,
        },
        renderer::{RenderDevice, RenderQueue, initialize_renderer},
        settings::{Backends, RenderResources, WgpuSettings},
    },
    shader::{Shader, ShaderCache, ShaderCacheSource, ShaderDefVal},
    tasks::block_on,
};
use std::sync::OnceLock;
use wgpu::MemoryBudgetThresholds;

/// Opens the machine's first adapter.
fn open(settings: &WgpuSettings) -> Option<(RenderDevice, RenderQueue)> {
    // Bevy panics without an adapter.
    let resources = std::panic::catch_unwind(|| {
        block_on(initialize_renderer(
            Backends::PRIMARY,
            None,
            settings,
            #[cfg(all(
                feature = "hardware-vrs",
                any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
            ))]
            Default::default(),
        ))
    });
    let RenderResources(device, queue, ..) = resources.ok()?;
    Some((device, queue))
}

/// A device that refuses large buffers, because nearly all of its allowed memory is in use; otherwise like [`device`].
pub fn device_of_little_memory() -> Option<(RenderDevice, RenderQueue)> {
    // Percentages of all memory. Some of it is in use already, and a device takes a little.
    let device = (1..=100).step_by(2).find_map(|percents| {
        open(&WgpuSettings {
            instance_memory_budget_thresholds: MemoryBudgetThresholds {
                for_resource_creation: Some(percents),
                for_device_loss: None,
            },
            ..Default::default()
        })
    });
    require(device)
}

/// Returns the device. Without one, prints a message, or fails if the environment requires a GPU.
fn require(device: Option<(RenderDevice, RenderQueue)>) -> Option<(RenderDevice, RenderQueue)> {
    if device.is_none() {
        let is_required = std::env::var_os("GLINT_REQUIRE_GPU").is_some();
        assert!(!is_required, "a GPU is required, but there is no graphics adapter");
        eprintln!("skipped: no graphics adapter");
    }
    device
}

/// The machine's first adapter. Without one, prints a message and returns `None`, or fails if the environment requires a GPU.
pub fn device() -> Option<(RenderDevice, RenderQueue)> {
    static DEVICE: OnceLock<Option<(RenderDevice, RenderQueue)>> = OnceLock::new();
    require(DEVICE.get_or_init(|| open(&WgpuSettings::default())).clone())
}

/// Reads the words of a buffer with the usage `COPY_SRC`, after everything that was queued so far.
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

/// Links `main`, a module that imports from `modules`, to WGSL like Bevy does. Modules are given as (path below `src`, text).
pub fn link(main: &'static str, modules: &[(&str, &'static str)], flags: &[&'static str]) -> String {
    let mut cache = ShaderCache::<String, ()>::new((), |_, source, _| match source {
        ShaderCacheSource::Wgsl(wgsl) => Ok(wgsl),
        ShaderCacheSource::SpirV(_) => Ok(String::new()),
    });
    let id = |index: usize| AssetId::Uuid {
        uuid: Uuid::from_u128(index as u128),
    };
    let main = ("scene/test_main.wesl", main);
    for (index, (path, text)) in std::iter::once(&main).chain(modules).enumerate() {
        cache.set_shader(
            id(index),
            Shader::from_wesl(*text, format!("embedded://bevy_glint/{path}")),
        );
    }
    let flags: Vec<ShaderDefVal> = flags.iter().map(|flag| ShaderDefVal::from(*flag)).collect();
    cache.get(0, id(0), &flags).unwrap().to_string()
}

/// Runs one workgroup of the entry point `main`, which writes `output_words` words to binding 0 of group 0 and reads `input` from
/// binding 0 of group 1.
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
    let bind_groups = [&output, &input].into_iter().zip(0..).map(|(buffer, group)| {
        device.wgpu_device().create_bind_group(&BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(group),
            entries: &[BindGroupEntry {
                binding: 0,
                resource: buffer.as_entire_binding(),
            }],
        })
    });
    let bind_groups: Vec<_> = bind_groups.collect();
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        for (group, bind_group) in (0..).zip(&bind_groups) {
            pass.set_bind_group(group, bind_group, &[]);
        }
        pass.dispatch_workgroups(1, 1, 1);
    }
    queue.submit([encoder.finish()]);
    read(device, queue, &output)
}
