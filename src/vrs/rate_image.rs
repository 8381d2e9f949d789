//! The shading-rate attachment of a view: an image that wgpu can't create, and the buffer from which it is filled.

use super::device::{Vulkan, failed, raw_buffer};
use crate::device::try_allocate;
use ash::vk;
use bevy::{
    math::UVec2,
    render::{
        render_resource::{Buffer, BufferDescriptor, BufferUsages},
        renderer::RenderDevice,
    },
};
use std::sync::Arc;

const FORMAT: vk::Format = vk::Format::R8_UINT;

/// Layout of an attachment's bytes in their buffer; the attachment shader uses the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RateRows {
    /// Words of four texels.
    pub words: u32,
    pub rows: u32,
}

impl RateRows {
    pub fn new(tiles: UVec2) -> Self {
        Self {
            words: tiles.x.div_ceil(4),
            rows: tiles.y,
        }
    }

    pub fn total_words(self) -> u32 {
        self.words * self.rows
    }

    /// Region to copy into the attachment.
    pub fn region(self, tiles: UVec2) -> vk::BufferImageCopy {
        vk::BufferImageCopy::default()
            .buffer_row_length(self.words * 4)
            .buffer_image_height(self.rows)
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: 0,
                layer_count: 1,
            })
            .image_extent(vk::Extent3D {
                width: tiles.x,
                height: tiles.y,
                depth: 1,
            })
    }
}

/// One texel per tile.
pub(super) struct RateImage {
    vulkan: Arc<Vulkan>,
    pub image: vk::Image,
    pub view: vk::ImageView,
    memory: vk::DeviceMemory,
    pub tiles: UVec2,
    /// Buffer that the attachment shader writes.
    pub words: Buffer,
    /// Raw handle of `words`.
    pub raw_words: vk::Buffer,
}

impl RateImage {
    pub fn new(vulkan: &Arc<Vulkan>, device: &RenderDevice, tiles: UVec2) -> Result<Self, String> {
        let tiles = tiles.max(UVec2::ONE);
        let create = || {
            device.create_buffer(&BufferDescriptor {
                label: Some("glint_vrs_rates"),
                size: 4 * u64::from(RateRows::new(tiles).total_words()),
                usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        let words = try_allocate(device, create).ok_or("the device has no memory for shading-rate attachments")?;
        let mut image = Self {
            vulkan: Arc::clone(vulkan),
            image: vk::Image::null(),
            view: vk::ImageView::null(),
            memory: vk::DeviceMemory::null(),
            tiles,
            raw_words: raw_buffer(&words)?,
            words,
        };
        image.create()?;
        Ok(image)
    }

    fn create(&mut self) -> Result<(), String> {
        let raw = &self.vulkan.raw;
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D {
                width: self.tiles.x,
                height: self.tiles.y,
                depth: 1,
            })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(vk::ImageUsageFlags::FRAGMENT_SHADING_RATE_ATTACHMENT_KHR | vk::ImageUsageFlags::TRANSFER_DST)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED);
        // SAFETY: the device has the extension of the usage, and the format supports it (`init.rs`).
        self.image = unsafe { raw.create_image(&info, None) }.map_err(failed("making the shading-rate attachment"))?;
        // SAFETY: the image is of this device.
        let requirements = unsafe { raw.get_image_memory_requirements(self.image) };
        let Some(memory_type) = self.vulkan.device_memory_type(requirements.memory_type_bits) else {
            return Err("the device has no memory for shading-rate attachments".into());
        };
        let info = vk::MemoryAllocateInfo::default()
            .allocation_size(requirements.size)
            .memory_type_index(memory_type);
        // SAFETY: the type exists.
        self.memory =
            unsafe { raw.allocate_memory(&info, None) }.map_err(failed("allocating the shading-rate attachment"))?;
        // SAFETY: the memory is large enough for the image, of an allowed type, and not bound to anything else.
        unsafe { raw.bind_image_memory(self.image, self.memory, 0) }
            .map_err(failed("binding the shading-rate attachment"))?;
        let info = vk::ImageViewCreateInfo::default()
            .image(self.image)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(FORMAT)
            .subresource_range(WHOLE);
        // SAFETY: the image has memory, and the view its format.
        self.view =
            unsafe { raw.create_image_view(&info, None) }.map_err(failed("viewing the shading-rate attachment"))?;
        Ok(())
    }
}

/// The whole of a simple image.
pub(super) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

impl Drop for RateImage {
    fn drop(&mut self) {
        let raw = &self.vulkan.raw;
        // SAFETY: command buffers keep their resources until they are done; null handles are ignored.
        unsafe {
            raw.destroy_image_view(self.view, None);
            raw.destroy_image(self.image, None);
            raw.free_memory(self.memory, None);
        }
    }
}
