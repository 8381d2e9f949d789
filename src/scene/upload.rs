//! A storage buffer that holds a copy of a slice.

use bevy::render::{
    render_resource::{Buffer, BufferDescriptor, BufferUsages},
    renderer::{RenderDevice, RenderQueue},
};
use bytemuck::{NoUninit, cast_slice};
use core::{marker::PhantomData, ops::Range};

/// Mirrors a slice of `T` on the GPU. It grows by doubling and never shrinks.
pub struct StorageSlice<T> {
    buffer: Buffer,
    label: &'static str,
    generation: u64,
    element: PhantomData<T>,
}

impl<T: NoUninit> StorageSlice<T> {
    /// Room for a few elements, so that there is always something to bind.
    pub fn new(device: &RenderDevice, label: &'static str) -> Self {
        Self {
            buffer: create(device, label, 16 * size_of::<T>() as u64),
            label,
            generation: 0,
            element: PhantomData,
        }
    }

    /// The buffer for binding.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Changes when [`Self::buffer`] becomes another object.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Most elements that one binding can hold.
    pub fn limit(device: &RenderDevice) -> usize {
        let limits = device.limits();
        (limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / size_of::<T>() as u64) as usize
    }

    /// Writes the changed part, or all where the buffer had to grow. Elements over [`Self::limit`] are left out.
    pub fn write(&mut self, data: &[T], changed: Range<usize>, device: &RenderDevice, queue: &RenderQueue) {
        let size = size_of::<T>() as u64;
        let data = &data[..data.len().min(Self::limit(device))];
        let mut changed = changed.start.min(data.len())..changed.end.min(data.len());
        if data.len() as u64 * size > self.buffer.size() {
            let capacity = data.len().next_power_of_two().min(Self::limit(device));
            self.buffer = create(device, self.label, capacity as u64 * size);
            self.generation += 1;
            changed = 0..data.len();
        }
        if changed.start < changed.end {
            queue.write_buffer(&self.buffer, changed.start as u64 * size, cast_slice(&data[changed]));
        }
    }
}

fn create(device: &RenderDevice, label: &'static str, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
