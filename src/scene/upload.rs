//! A storage buffer that holds a copy of a slice.

use bevy::{
    log::warn,
    render::{
        render_resource::{Buffer, BufferDescriptor, BufferUsages},
        renderer::{RenderDevice, RenderQueue},
    },
};
use bytemuck::{NoUninit, cast_slice};
use core::{marker::PhantomData, ops::Range};

/// Mirrors a slice of `T` on the GPU. It grows by doubling and never shrinks.
pub struct StorageSlice<T> {
    buffer: Buffer,
    label: &'static str,
    len: usize,
    warned: bool,
    generation: u64,
    element: PhantomData<T>,
}

impl<T: NoUninit> StorageSlice<T> {
    /// Room for a few elements, so that there is always something to bind.
    pub fn new(device: &RenderDevice, label: &'static str) -> Self {
        Self {
            buffer: create(device, label, 16 * size_of::<T>() as u64),
            label,
            len: 0,
            warned: false,
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

    /// Elements that stand in the buffer: shaders must not read beyond.
    pub fn count(&self) -> usize {
        self.len
    }

    /// Writes the changed part, or all where the buffer had to grow. Elements over [`Self::limit`] are left out with a warning.
    pub fn write(&mut self, data: &[T], changed: Range<usize>, device: &RenderDevice, queue: &RenderQueue) {
        self.write_within(Self::limit(device), data, changed, device, queue);
    }

    fn write_within(
        &mut self,
        limit: usize,
        data: &[T],
        changed: Range<usize>,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        let size = size_of::<T>() as u64;
        let wanted = data.len();
        let data = &data[..wanted.min(limit)];
        self.len = data.len();
        if self.len < wanted && !self.warned {
            self.warned = true;
            warn!(
                "reflections take {} of {wanted} {}, since the largest storage buffer of this device holds no more; use \
                 fewer, or raise `max_storage_buffer_binding_size` in `WgpuSettings` if the adapter offers it",
                self.len,
                self.label.trim_start_matches("glint_"),
            );
        }
        let mut changed = changed.start.min(data.len())..changed.end.min(data.len());
        if data.len() as u64 * size > self.buffer.size() {
            let capacity = data.len().next_power_of_two().min(limit);
            self.buffer = create(device, self.label, capacity as u64 * size);
            self.generation += 1;
            changed = 0..data.len();
        }
        if changed.start < changed.end {
            queue.write_buffer(&self.buffer, changed.start as u64 * size, cast_slice(&data[changed]));
        }
    }
}

/// Ranges that hold all of these sorted indices, and up to `gap` others between two of them.
pub fn runs(sorted: &[u32], gap: u32) -> impl Iterator<Item = Range<usize>> + '_ {
    let chunks = sorted.chunk_by(move |a, b| b.saturating_sub(*a) <= gap.saturating_add(1));
    chunks.filter_map(|run| Some(*run.first()? as usize..*run.last()? as usize + 1))
}

fn create(device: &RenderDevice, label: &'static str, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_gpu;

    #[test]
    fn near_indices_share_a_range() {
        let of = |sorted: &[u32], gap| runs(sorted, gap).collect::<Vec<_>>();
        assert_eq!(of(&[], 3), []);
        assert_eq!(of(&[1, 2, 2, 4, 9], 1), [1..5, 9..10]);
        assert_eq!(of(&[1, 3], 0), [1..2, 3..4]);
    }

    #[test]
    fn what_has_no_room_is_left_out() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut slice = StorageSlice::<u32>::new(&device, "glint_numbers");
        for (count, limit, len) in [(10, 100, 10), (100, 100, 100), (300, 100, 100), (50, 100, 50)] {
            let data: Vec<u32> = (0..count).collect();
            slice.write_within(limit, &data, 0..data.len(), &device, &queue);
            assert_eq!(slice.count(), len);
            assert!(slice.buffer().size() >= 4 * len as u64 && slice.buffer().size() <= 400);
        }
        assert!(slice.warned);
    }
}
