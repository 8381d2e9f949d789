//! Runs one compute shader of this crate on whatever adapter there is.
#![allow(
    unsafe_code,
    reason = "wgpu asks for it to leave out run-time checks and to enable ray queries"
)]

use bevy::tasks::block_on;
use wgpu::util::DeviceExt;

pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
}

impl Gpu {
    /// None where there is no adapter, unless `GLINT_REQUIRE_GPU` is 1.
    pub fn new() -> Option<Self> {
        match block_on(Self::request()) {
            Ok(gpu) => Some(gpu),
            Err(reason) => {
                assert!(
                    std::env::var("GLINT_REQUIRE_GPU").as_deref() != Ok("1"),
                    "no GPU: {reason}"
                );
                println!("skipped, no GPU: {reason}");
                None
            }
        }
    }

    async fn request() -> Result<Self, String> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = instance
            .request_adapter(&Default::default())
            .await
            .map_err(|error| error.to_string())?;
        let info = adapter.get_info();
        println!(
            "adapter: {} ({:?}, {} {})",
            info.name, info.backend, info.driver, info.driver_info
        );
        let (device, queue) = adapter
            .request_device(&Default::default())
            .await
            .map_err(|error| error.to_string())?;
        Ok(Self { device, queue })
    }

    /// Dispatches `main` of a flattened shader, one invocation of a workgroup of 64 for each output.
    ///
    /// Binding 0 holds `inputs`, binding 1 receives the outputs, textures stand at the bindings given with them.
    pub fn run<I: bytemuck::NoUninit, O: bytemuck::Pod>(
        &self,
        wgsl: &str,
        inputs: &[I],
        count: usize,
        textures: &[(u32, wgpu::TextureView)],
    ) -> Vec<O> {
        // Bevy compiles shaders without run-time checks; so does this.
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(wgsl.into()),
        };
        // SAFETY: the shaders guard their indices and loops themselves, as they have to under Bevy.
        let module = unsafe {
            self.device
                .create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked())
        };
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: None,
        });
        let input = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(inputs),
            usage: wgpu::BufferUsages::STORAGE,
        });
        let size = (count * size_of::<O>()) as u64;
        let buffer = |usage| {
            let descriptor = wgpu::BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            };
            self.device.create_buffer(&descriptor)
        };
        let output = buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        let readback = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let mut entries = vec![
            wgpu::BindGroupEntry {
                binding: 0,
                resource: input.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 1,
                resource: output.as_entire_binding(),
            },
        ];
        entries.extend(textures.iter().map(|(binding, view)| wgpu::BindGroupEntry {
            binding: *binding,
            resource: wgpu::BindingResource::TextureView(view),
        }));
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(count.div_ceil(64) as u32, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&output, 0, &readback, 0, size);
        self.queue.submit([encoder.finish()]);
        readback.map_async(wgpu::MapMode::Read, .., |result| result.unwrap());
        self.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
        let mapped = readback.get_mapped_range(..).unwrap();
        bytemuck::pod_collect_to_vec(&mapped)
    }

    pub fn texture(
        &self,
        format: wgpu::TextureFormat,
        [width, height, layers]: [u32; 3],
        texels: &[u8],
    ) -> wgpu::Texture {
        let descriptor = wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: layers,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        };
        self.device
            .create_texture_with_data(&self.queue, &descriptor, Default::default(), texels)
    }
}
