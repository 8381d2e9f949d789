//! Raw wgpu for shader tests: a device, buffers, one dispatch, and reading back.
//!
//! ```ignore
//! let Some(gpu) = Gpu::new() else { return };
//! let wgsl = wesl::flatten(include_str!("x.wesl"), &[], &[]);
//! let pipeline = gpu.pipeline(&wgsl, "main", Checks::Off);
//! let output = gpu.buffer(&[0u32; 64]);
//! gpu.dispatch(&pipeline, &[&[(0, &output)]], 1);
//! let values: Vec<u32> = gpu.read(&output);
//! // The same in one call, with an input for each output.
//! let values: Vec<u32> = gpu.run(&wgsl, &inputs, &[]);
//! ```
//!
//! Without an adapter `Gpu::new` prints the reason and returns `None`, so that the test passes without running. With `GLINT_REQUIRE_GPU=1`
//! in the environment it fails instead. `WGPU_ADAPTER_NAME` selects an adapter by a part of its name.
#![allow(
    unsafe_code,
    reason = "wgpu asks for it to leave out run-time checks and to enable ray queries"
)]

use crate::{
    compute::{dispatch_with, entry},
    wesl::Shaders,
};
use bevy::math::uvec2;
use bytemuck::Pod;
use std::{
    collections::HashMap,
    sync::{Mutex, OnceLock, PoisonError},
};
use wgpu::util::DeviceExt;

pub struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub info: wgpu::AdapterInfo,
    /// By source, entry point and checks. A driver takes longer to compile most of them than to run them.
    pipelines: Mutex<HashMap<(String, String, Checks), wgpu::ComputePipeline>>,
}

/// Run-time checks in shaders: Bevy compiles without any, a browser always has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Checks {
    On,
    Off,
}

impl Gpu {
    /// A device with everything the adapter offers, as Bevy opens it by default. All tests share it.
    pub fn new() -> Option<&'static Self> {
        static SHARED: OnceLock<Result<Gpu, String>> = OnceLock::new();
        match SHARED.get_or_init(|| block_on(Self::open())) {
            Ok(gpu) => {
                println!(
                    "adapter: {} ({}, {:?})",
                    gpu.info.name, gpu.info.driver_info, gpu.info.backend
                );
                Some(gpu)
            }
            Err(error) => {
                assert!(
                    !std::env::var("GLINT_REQUIRE_GPU").is_ok_and(|v| v == "1"),
                    "no GPU: {error}"
                );
                println!("skipped, no GPU: {error}");
                None
            }
        }
    }

    async fn open() -> Result<Self, String> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let wanted = std::env::var("WGPU_ADAPTER_NAME").unwrap_or_default().to_lowercase();
        let mut adapters = instance.enumerate_adapters(wgpu::Backends::all()).await;
        adapters.retain(|a| a.get_info().name.to_lowercase().contains(&wanted));
        adapters.sort_by_key(|a| match a.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            _ => 3,
        });
        let adapter = adapters.first().ok_or("no adapter")?;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                required_features: adapter.features() - wgpu::Features::MAPPABLE_PRIMARY_BUFFERS,
                required_limits: adapter.limits(),
                // SAFETY: no code here relies on the soundness of experimental features.
                experimental_features: unsafe { wgpu::ExperimentalFeatures::enabled() },
                ..Default::default()
            })
            .await
            .map_err(|error| error.to_string())?;
        Ok(Self {
            device,
            queue,
            info: adapter.get_info(),
            pipelines: Mutex::default(),
        })
    }

    /// Errors of the shader end the test with naga's message.
    fn module(&self, wgsl: &str, checks: Checks) -> wgpu::ShaderModule {
        let source = wgpu::ShaderSource::Wgsl(wgsl.into());
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some("test"),
            source,
        };
        match checks {
            Checks::On => self.device.create_shader_module(descriptor),
            // SAFETY: the tests' shaders come from this repository.
            Checks::Off => unsafe {
                self.device
                    .create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked())
            },
        }
    }

    /// A buffer for any use as a storage or uniform binding. Never empty, since a binding cannot be.
    pub fn buffer<T: Pod>(&self, data: &[T]) -> wgpu::Buffer {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let contents = if bytes.is_empty() { &[0; 256] } else { bytes };
        use wgpu::BufferUsages as Usage;
        let usage = Usage::STORAGE | Usage::UNIFORM | Usage::COPY_SRC | Usage::COPY_DST;
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents,
            usage,
        })
    }

    /// A pipeline with automatic layout.
    pub fn pipeline(&self, wgsl: &str, entry: &str, checks: Checks) -> wgpu::ComputePipeline {
        self.cached_pipeline(wgsl, entry, checks, |module| {
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: None,
                module,
                entry_point: Some(entry),
                compilation_options: Default::default(),
                cache: None,
            })
        })
    }

    /// The pipeline of an earlier call with this source, entry point and checks, or a new one.
    pub fn cached_pipeline(
        &self,
        wgsl: &str,
        entry: &str,
        checks: Checks,
        create: impl FnOnce(&wgpu::ShaderModule) -> wgpu::ComputePipeline,
    ) -> wgpu::ComputePipeline {
        let key = (wgsl.to_owned(), entry.to_owned(), checks);
        let pipelines = || self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = pipelines().get(&key) {
            return pipeline.clone();
        }
        // Without the lock, so that other tests continue meanwhile.
        let pipeline = create(&self.module(wgsl, checks));
        pipelines().insert(key, pipeline.clone());
        pipeline
    }

    /// Runs `workgroups` groups of a pipeline with automatic layout along x: by group, the bindings that the entry point uses, and no
    /// others.
    pub fn dispatch(&self, pipeline: &wgpu::ComputePipeline, groups: &[&[(u32, &wgpu::Buffer)]], workgroups: u32) {
        let groups: Vec<Vec<_>> = groups
            .iter()
            .map(|buffers| {
                let buffers = buffers.iter();
                buffers
                    .map(|(binding, buffer)| entry(*binding, buffer.as_entire_binding()))
                    .collect()
            })
            .collect();
        let groups: Vec<_> = groups.iter().map(Vec::as_slice).collect();
        dispatch_with(self, pipeline, &groups, uvec2(workgroups, 1));
    }

    /// Runs `main` of a flattened shader, with workgroups of 64, and returns an output for each input.
    ///
    /// Binding 0 is the inputs, binding 1 receives the outputs, and textures are bound at the given bindings.
    pub fn run<I: Pod, O: Pod>(&self, wgsl: &str, inputs: &[I], textures: &[(u32, wgpu::TextureView)]) -> Vec<O> {
        let textures = textures.iter();
        let textures = textures.map(|(binding, view)| entry(*binding, wgpu::BindingResource::TextureView(view)));
        self.run_with(wgsl, inputs, &textures.collect::<Vec<_>>(), &[])
    }

    /// Like [`run`](Self::run), with further bindings in the first group, and further groups.
    pub fn run_with<I: Pod, O: Pod>(
        &self,
        wgsl: &str,
        inputs: &[I],
        bindings: &[wgpu::BindGroupEntry],
        groups: &[&[wgpu::BindGroupEntry]],
    ) -> Vec<O> {
        let pipeline = self.pipeline(wgsl, "main", Checks::Off);
        let (input, output) = (self.buffer(inputs), self.buffer(&vec![O::zeroed(); inputs.len()]));
        let own = [
            entry(0, input.as_entire_binding()),
            entry(1, output.as_entire_binding()),
        ];
        let first = [&own[..], bindings].concat();
        let workgroups = uvec2(inputs.len().div_ceil(64) as u32, 1);
        dispatch_with(self, &pipeline, &[&[&first[..]][..], groups].concat(), workgroups);
        self.read(&output)
    }

    /// Waits for the GPU and copies the buffer.
    pub fn read<T: Pod>(&self, buffer: &wgpu::Buffer) -> Vec<T> {
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: buffer.size(),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, buffer.size());
        self.queue.submit([encoder.finish()]);
        staging
            .slice(..)
            .map_async(wgpu::MapMode::Read, |result| result.expect("buffer maps"));
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .expect("device answers");
        let bytes = staging.slice(..).get_mapped_range().expect("buffer is mapped").to_vec();
        bytemuck::pod_collect_to_vec(&bytes)
    }
}

/// The device, with all shader modules.
pub fn gpu() -> Option<(&'static Gpu, Shaders)> {
    Some((Gpu::new()?, Shaders::load()))
}

fn block_on<T>(future: impl Future<Output = T>) -> T {
    let mut future = std::pin::pin!(future);
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    loop {
        if let std::task::Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        std::thread::yield_now();
    }
}
