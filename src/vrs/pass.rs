//! The commands of the pass.

use super::{
    descriptors::DescriptorSet,
    device::Vulkan,
    pipeline::RawPipeline,
    rate_image::{RateImage, RateRows, WHOLE},
};
use ash::vk;
use bevy::math::UVec2;
use std::sync::Arc;

/// Commands to record into a command buffer. Before it runs, wgpu has transitioned the targets to `COLOR_TARGET`, the words of the rate
/// image to `COPY_SRC`, and all resources of the sets to the states of their bindings. The commands don't change these states.
pub(super) struct PassCommands<'a> {
    pub vulkan: &'a Vulkan,
    pub pipeline: &'a RawPipeline,
    pub sets: &'a [Arc<DescriptorSet>; 3],
    /// Dynamic offsets of all sets, in their order.
    pub dynamic_offsets: &'a [u32],
    /// `None` at the full rate.
    pub rates: Option<&'a RateImage>,
    pub targets: [vk::ImageView; 2],
    /// Pixels of the targets.
    pub size: UVec2,
    /// Pixels that a texel of the rate image covers in each direction.
    pub tile: u32,
}

impl PassCommands<'_> {
    /// # Safety
    /// `commands` is being recorded outside a pass, and everything in the fields lives until it has run.
    pub unsafe fn record(&self, commands: vk::CommandBuffer) {
        // SAFETY: the caller's promise.
        unsafe {
            self.fill_rates(commands);
            self.draw(commands);
        }
    }

    /// # Safety
    /// As [`record`](Self::record).
    unsafe fn fill_rates(&self, commands: vk::CommandBuffer) {
        let raw = &self.vulkan.raw;
        // Earlier writes of wgpu to the targets become visible and are overwritten.
        let targets = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::COLOR_ATTACHMENT_WRITE)
            .dst_access_mask(vk::AccessFlags::COLOR_ATTACHMENT_READ | vk::AccessFlags::COLOR_ATTACHMENT_WRITE);
        let output = vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT;
        let none = vk::DependencyFlags::empty();
        let Some(rates) = self.rates else {
            // SAFETY: the caller's promise.
            unsafe { raw.cmd_pipeline_barrier(commands, output, output, none, &[targets], &[], &[]) };
            return;
        };
        let image = vk::ImageMemoryBarrier::default()
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(rates.image)
            .subresource_range(WHOLE);
        // The last frame has read it; its contents can be discarded.
        let before = image
            .dst_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .old_layout(vk::ImageLayout::UNDEFINED)
            .new_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL);
        let after = image
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::FRAGMENT_SHADING_RATE_ATTACHMENT_READ_KHR)
            .old_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL)
            .new_layout(vk::ImageLayout::FRAGMENT_SHADING_RATE_ATTACHMENT_OPTIMAL_KHR);
        let (reads, copies) = (
            vk::PipelineStageFlags::FRAGMENT_SHADING_RATE_ATTACHMENT_KHR,
            vk::PipelineStageFlags::TRANSFER,
        );
        let region = RateRows::new(rates.tiles).region(rates.tiles);
        // SAFETY: the caller's promise; the region is inside the buffer and covers the image.
        unsafe {
            raw.cmd_pipeline_barrier(commands, reads, copies, none, &[], &[], &[before]);
            raw.cmd_copy_buffer_to_image(
                commands,
                rates.raw_words,
                rates.image,
                vk::ImageLayout::TRANSFER_DST_OPTIMAL,
                &[region],
            );
            raw.cmd_pipeline_barrier(
                commands,
                copies | output,
                reads | output,
                none,
                &[targets],
                &[],
                &[after],
            );
        }
    }

    /// # Safety
    /// As [`record`](Self::record).
    unsafe fn draw(&self, commands: vk::CommandBuffer) {
        let area = vk::Rect2D {
            offset: vk::Offset2D { x: 0, y: 0 },
            extent: vk::Extent2D {
                width: self.size.x,
                height: self.size.y,
            },
        };
        let attachments = self.targets.map(|view| {
            vk::RenderingAttachmentInfo::default()
                .image_view(view)
                .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
                .load_op(vk::AttachmentLoadOp::LOAD)
                .store_op(vk::AttachmentStoreOp::STORE)
        });
        let mut rates = vk::RenderingFragmentShadingRateAttachmentInfoKHR::default()
            .image_layout(vk::ImageLayout::FRAGMENT_SHADING_RATE_ATTACHMENT_OPTIMAL_KHR)
            .shading_rate_attachment_texel_size(vk::Extent2D {
                width: self.tile,
                height: self.tile,
            });
        let mut info = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(&attachments);
        if let Some(image) = self.rates {
            rates = rates.image_view(image.view);
            info = info.push_next(&mut rates);
        }
        // Flipped, like wgpu's viewports.
        let viewport = vk::Viewport {
            x: 0.0,
            y: self.size.y as f32,
            width: self.size.x as f32,
            height: -(self.size.y as f32),
            min_depth: 0.0,
            max_depth: 1.0,
        };
        let sets = [self.sets[0].raw, self.sets[1].raw, self.sets[2].raw];
        let address = self.sets.iter().find_map(|set| set.acceleration_structure);
        let (raw, graphics) = (&self.vulkan.raw, vk::PipelineBindPoint::GRAPHICS);
        // SAFETY: the caller's promise; pipeline, sets and attachments were made for each other.
        unsafe {
            self.vulkan.begin_rendering(commands, &info);
            raw.cmd_bind_pipeline(commands, graphics, self.pipeline.raw);
            raw.cmd_bind_descriptor_sets(commands, graphics, self.pipeline.layout, 0, &sets, self.dynamic_offsets);
            if let (true, Some(address)) = (self.pipeline.has_address, address) {
                let words = [address as u32, (address >> 32) as u32];
                raw.cmd_push_constants(
                    commands,
                    self.pipeline.layout,
                    vk::ShaderStageFlags::FRAGMENT,
                    0,
                    bytemuck::cast_slice(&words),
                );
            }
            raw.cmd_set_viewport(commands, 0, &[viewport]);
            raw.cmd_set_scissor(commands, 0, &[area]);
            raw.cmd_draw(commands, 3, 1, 0, 0);
            self.vulkan.end_rendering(commands);
        }
    }
}
