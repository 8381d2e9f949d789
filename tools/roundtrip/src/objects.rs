//! The Vulkan objects of a run.

use crate::device::Gpu;
use anyhow::{Result, bail};
use ash::{Device, vk};
use std::slice;

/// Nanoseconds until a pass counts as endless. CPU drivers compile when a pass begins, which takes long.
const LIMIT: u64 = 120_000_000_000;

/// All objects of a run, which end with it.
pub(crate) struct Run<'a> {
    pub gpu: &'a Gpu,
    pub memory: Vec<vk::DeviceMemory>,
    pub buffers: Vec<vk::Buffer>,
    pub images: Vec<vk::Image>,
    pub views: Vec<vk::ImageView>,
    pub samplers: Vec<vk::Sampler>,
    pub sets: Vec<vk::DescriptorSetLayout>,
    pub pool: vk::DescriptorPool,
    pub layout: vk::PipelineLayout,
    pub module: vk::ShaderModule,
    pub pipeline: vk::Pipeline,
    pub commands: vk::CommandBuffer,
    pub fence: vk::Fence,
    pub structures: Vec<vk::AccelerationStructureKHR>,
}

/// A buffer that the CPU can access.
#[derive(Clone, Copy)]
pub(crate) struct Memory {
    pub buffer: vk::Buffer,
    memory: vk::DeviceMemory,
    size: usize,
}

impl<'a> Run<'a> {
    /// Begins to record commands.
    pub fn new(gpu: &'a Gpu) -> Result<Self> {
        let info = vk::CommandBufferAllocateInfo::default()
            .command_pool(gpu.pool)
            .command_buffer_count(1);
        // SAFETY: the pool belongs to the device.
        let commands = unsafe {
            let commands = gpu.vulkan.device.allocate_command_buffers(&info)?[0];
            let info = vk::CommandBufferBeginInfo::default();
            gpu.vulkan.device.begin_command_buffer(commands, &info)?;
            commands
        };
        // Missing objects are null handles, which Vulkan allows to destroy.
        Ok(Self {
            gpu,
            commands,
            memory: Vec::new(),
            buffers: Vec::new(),
            images: Vec::new(),
            views: Vec::new(),
            samplers: Vec::new(),
            sets: Vec::new(),
            structures: Vec::new(),
            pool: vk::DescriptorPool::null(),
            layout: vk::PipelineLayout::null(),
            module: vk::ShaderModule::null(),
            pipeline: vk::Pipeline::null(),
            fence: vk::Fence::null(),
        })
    }

    pub fn device(&self) -> &'a Device {
        &self.gpu.vulkan.device
    }

    /// Makes a buffer with these contents.
    pub fn buffer(&mut self, contents: &[u8], usage: vk::BufferUsageFlags) -> Result<Memory> {
        let size = contents.len().max(16) as u64;
        let info = vk::BufferCreateInfo::default()
            .size(size)
            .usage(usage | vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST);
        let flags = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        // SAFETY: the memory has the size and type that the buffer needs, and is mapped only here.
        unsafe {
            let buffer = self.device().create_buffer(&info, None)?;
            self.buffers.push(buffer);
            let needs = self.device().get_buffer_memory_requirements(buffer);
            let memory = self.gpu.allocate(needs, flags)?;
            self.memory.push(memory);
            self.device().bind_buffer_memory(buffer, memory, 0)?;
            let mapped = self.device().map_memory(memory, 0, size, vk::MemoryMapFlags::empty())?;
            slice::from_raw_parts_mut(mapped.cast::<u8>(), contents.len()).copy_from_slice(contents);
            self.device().unmap_memory(memory);
            Ok(Memory {
                buffer,
                memory,
                size: contents.len(),
            })
        }
    }

    /// The contents of a buffer.
    pub fn read(&self, from: Memory) -> Result<Vec<u8>> {
        // SAFETY: the memory was allocated with this size, no command uses it any more, and it is mapped only here.
        unsafe {
            let flags = vk::MemoryMapFlags::empty();
            let mapped = self.device().map_memory(from.memory, 0, vk::WHOLE_SIZE, flags)?;
            let contents = slice::from_raw_parts(mapped.cast::<u8>(), from.size).to_vec();
            self.device().unmap_memory(from.memory);
            Ok(contents)
        }
    }

    /// Waits for all earlier commands, and moves images to a new layout.
    pub fn barrier(&self, images: &[vk::ImageMemoryBarrier]) {
        let memory = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::MEMORY_WRITE)
            .dst_access_mask(vk::AccessFlags::MEMORY_READ | vk::AccessFlags::MEMORY_WRITE);
        let all = vk::PipelineStageFlags::ALL_COMMANDS | vk::PipelineStageFlags::HOST;
        // SAFETY: the commands are being recorded.
        unsafe {
            self.device().cmd_pipeline_barrier(
                self.commands,
                vk::PipelineStageFlags::ALL_COMMANDS,
                all,
                vk::DependencyFlags::empty(),
                slice::from_ref(&memory),
                &[],
                images,
            );
        }
    }

    pub fn finish(&mut self) -> Result<()> {
        self.barrier(&[]);
        let submit = vk::SubmitInfo::default().command_buffers(slice::from_ref(&self.commands));
        // SAFETY: all resources live until the fence is signaled, or the program ends.
        let waited = unsafe {
            let device = self.device();
            device.end_command_buffer(self.commands)?;
            self.fence = device.create_fence(&vk::FenceCreateInfo::default(), None)?;
            device.queue_submit(self.gpu.queue, slice::from_ref(&submit), self.fence)?;
            device.wait_for_fences(&[self.fence], true, LIMIT)
        };
        if waited == Err(vk::Result::TIMEOUT) {
            // Nothing that the pass uses can be destroyed.
            bail!("the pass doesn't end");
        }
        Ok(waited?)
    }
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        let device = self.device();
        // SAFETY: no command uses any of it, and null handles are ignored.
        unsafe {
            // After a timeout the pass is still running, and the caller ends the program.
            if self.fence != vk::Fence::null() && device.get_fence_status(self.fence) != Ok(true) {
                return;
            }
            device.destroy_fence(self.fence, None);
            device.free_command_buffers(self.gpu.pool, &[self.commands]);
            for structure in &self.structures {
                self.gpu.structures.destroy_acceleration_structure(*structure, None);
            }
            device.destroy_pipeline(self.pipeline, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_shader_module(self.module, None);
            device.destroy_descriptor_pool(self.pool, None);
            let (sets, views, samplers) = (&self.sets, &self.views, &self.samplers);
            sets.iter()
                .for_each(|set| device.destroy_descriptor_set_layout(*set, None));
            views.iter().for_each(|view| device.destroy_image_view(*view, None));
            samplers
                .iter()
                .for_each(|sampler| device.destroy_sampler(*sampler, None));
            let (images, buffers, memory) = (&self.images, &self.buffers, &self.memory);
            images.iter().for_each(|image| device.destroy_image(*image, None));
            buffers.iter().for_each(|buffer| device.destroy_buffer(*buffer, None));
            memory.iter().for_each(|memory| device.free_memory(*memory, None));
        }
    }
}
