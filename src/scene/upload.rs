//! A storage buffer with a copy of a slice.

use super::scatter::{Scatter, ScatterKernels, create};
use crate::device::{MemoryRetry, try_allocate};
use bevy::{
    log::warn,
    render::{
        render_resource::{Buffer, PipelineCache},
        renderer::{RenderDevice, RenderQueue},
    },
};
use bytemuck::{NoUninit, bytes_of, cast_slice};
use core::{marker::PhantomData, ops::Range};

/// Gap between two changed elements up to which the elements in between are written again, since a separate write costs more.
const GAP: u32 = 64;
/// Number of bytes up to which everything is written again instead of using a kernel, which has a fixed cost.
const CHEAP_BYTES: u64 = 1 << 18;
/// Minimum capacity in elements.
const SMALLEST_ROOM: usize = 16;

/// Copies a slice of `T` to the GPU. The buffer grows by doubling, and shrinks once three quarters of it are free.
pub struct StorageSlice<T> {
    buffer: Buffer,
    label: &'static str,
    len: usize,
    /// Number of elements for which the device lacked memory.
    refused: Option<usize>,
    /// When to retry that.
    retry: MemoryRetry,
    /// The buffer was replaced and not written yet.
    is_empty: bool,
    warned: bool,
    generation: u64,
    /// Uploads large changes, once its kernel is compiled.
    scatter: Option<Scatter>,
    element: PhantomData<T>,
}

impl<T: NoUninit> StorageSlice<T> {
    /// Creates a buffer for a few elements, so that there is always one to bind.
    pub fn new(device: &RenderDevice, label: &'static str) -> Self {
        Self {
            buffer: create(device, label, (SMALLEST_ROOM * size_of::<T>()) as u64),
            label,
            len: 0,
            refused: None,
            retry: MemoryRetry::default(),
            is_empty: false,
            warned: false,
            generation: 0,
            scatter: None,
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

    /// Maximum number of elements in one binding.
    pub fn limit(device: &RenderDevice) -> usize {
        let limits = device.limits();
        (limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / size_of::<T>() as u64) as usize
    }

    /// Number of elements in the buffer: shaders must not read beyond it.
    pub fn count(&self) -> usize {
        self.len
    }

    /// Takes over its kernel once that is compiled. Until then, elements are written one by one.
    pub fn follow_kernel(&mut self, kernels: &ScatterKernels, cache: &PipelineCache) {
        if self.scatter.is_none() {
            self.scatter = kernels.scatter(size_of::<T>(), cache);
        }
    }

    /// Counts a frame. Returns true once the device might have memory for a buffer that it refused: the caller should write something then.
    pub fn may_ask_again(&mut self) -> bool {
        let again = self.retry.is_due();
        if again {
            self.refused = None;
        }
        again
    }

    /// Makes space for this number of elements, or as many as possible, and returns the new capacity. The contents of the buffer can be
    /// lost until the next write.
    pub fn reserve(&mut self, wanted: usize, device: &RenderDevice) -> usize {
        self.reserve_within(Self::limit(device), wanted, device)
    }

    fn reserve_within(&mut self, limit: usize, wanted: usize, device: &RenderDevice) -> usize {
        let size = size_of::<T>() as u64;
        let room = (self.buffer.size() / size) as usize;
        let wanted = wanted.min(limit);
        let needed = wanted.next_power_of_two().max(SMALLEST_ROOM).min(limit);
        let is_too_large = room > SMALLEST_ROOM && 4 * wanted < room && needed < room;
        // This size was refused, so larger ones would be, too.
        let is_refused = self.refused.is_some_and(|refused| wanted >= refused || is_too_large);
        if (wanted > room || is_too_large) && !is_refused {
            self.refused = None;
            match try_allocate(device, || create(device, self.label, needed as u64 * size)) {
                Some(buffer) => {
                    self.buffer = buffer;
                    self.generation += 1;
                    self.is_empty = true;
                    return needed;
                }
                None => {
                    self.refused = Some(wanted);
                    self.retry.begin();
                }
            }
        }
        room.min(limit)
    }

    /// Writes the changed part, or everything if the buffer had to grow. Elements over [`Self::limit`] are left out with a warning.
    pub fn write(&mut self, data: &[T], changed: Range<usize>, device: &RenderDevice, queue: &RenderQueue) {
        self.write_within(Self::limit(device), data, changed, device, queue);
    }

    /// Writes the elements at these sorted indices, or everything if the buffer had to grow.
    pub fn write_elements(&mut self, data: &[T], sorted: &[u32], device: &RenderDevice, queue: &RenderQueue) {
        let (before, was_empty) = (self.generation, self.is_empty);
        self.write(data, 0..0, device, queue);
        if self.generation != before || was_empty {
            return;
        }
        let sorted = &sorted[..sorted.partition_point(|index| (*index as usize) < self.len)];
        let size = size_of::<T>() as u64;
        let changed = sorted.len() as u64 * size;
        let written = runs(sorted, GAP).map(|run| run.len() as u64).sum::<u64>() * size;
        if written > (4 * changed).max(CHEAP_BYTES)
            && let Some(scatter) = &mut self.scatter
        {
            let elements = sorted.iter().map(|place| bytes_of(&data[*place as usize]));
            if scatter.write(&self.buffer, elements, sorted, device, queue) {
                return;
            }
        }
        for run in runs(sorted, GAP) {
            queue.write_buffer(&self.buffer, run.start as u64 * size, cast_slice(&data[run]));
        }
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
        let data = &data[..wanted.min(self.reserve_within(limit, wanted, device))];
        self.len = data.len();
        if self.len < wanted && !self.warned {
            self.warned = true;
            warn!(
                "reflections take {} of {wanted} {}, since the largest storage buffer of this device, or its memory, holds no more; \
                 use fewer, or raise `max_storage_buffer_binding_size` in `WgpuSettings` if the adapter offers it",
                self.len,
                self.label.trim_start_matches("glint_"),
            );
        }
        let mut changed = changed.start.min(data.len())..changed.end.min(data.len());
        if core::mem::take(&mut self.is_empty) {
            changed = 0..data.len();
        }
        if changed.start < changed.end {
            queue.write_buffer(&self.buffer, changed.start as u64 * size, cast_slice(&data[changed]));
        }
    }
}

/// Ranges that contain all of these sorted indices, and up to `gap` others between two of them.
pub fn runs(sorted: &[u32], gap: u32) -> impl Iterator<Item = Range<usize>> + '_ {
    let chunks = sorted.chunk_by(move |a, b| b.saturating_sub(*a) <= gap.saturating_add(1));
    chunks.filter_map(|run| Some(*run.first()? as usize..*run.last()? as usize + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::{REFUSED_FRAMES, REFUSES},
        scene::{scatter::tests::scatter, test_gpu},
    };
    use bevy::render::render_resource::{BufferDescriptor, BufferUsages};

    #[test]
    fn near_indices_share_a_range() {
        let of = |sorted: &[u32], gap| runs(sorted, gap).collect::<Vec<_>>();
        assert!(of(&[], 3).is_empty());
        assert_eq!(of(&[1, 2, 2, 4, 9], 1), [1..5, 9..10]);
        assert_eq!(of(&[1, 3], 0), [1..2, 3..4]);
    }

    #[test]
    fn scattered_elements_land_in_their_places() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        const COUNT: usize = 40_000;
        let mut slice = StorageSlice::<[u32; 8]>::new(&device, "glint_numbers");
        // Created with the usages to be read back.
        slice.buffer = device.create_buffer(&BufferDescriptor {
            label: None,
            size: (COUNT * 32) as u64,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let mut data: Vec<[u32; 8]> = (0..COUNT as u32).map(|i| [i; 8]).collect();
        slice.write(&data, 0..COUNT, &device, &queue);
        // While the kernel is being compiled, elements are written one by one.
        for (step, scatter) in [(9, None), (9, Some(scatter(32, &device))), (300, None)] {
            slice.scatter = slice.scatter.take().or(scatter);
            let sorted: Vec<u32> = (3..COUNT as u32).step_by(step).collect();
            for index in &sorted {
                data[*index as usize] = core::array::from_fn(|i| 7 * index + i as u32 + step as u32);
            }
            slice.write_elements(&data, &sorted, &device, &queue);
        }
        let is_used = slice.scatter.as_ref().is_some_and(Scatter::is_used);
        assert!(is_used, "one in nine is written by a kernel");
        // Without memory for the kernel they are written one by one.
        let sorted: Vec<u32> = (5..COUNT as u32).step_by(8).collect();
        for index in &sorted {
            data[*index as usize] = [3 * index; 8];
        }
        REFUSES.set(true);
        slice.write_elements(&data, &sorted, &device, &queue);
        REFUSES.set(false);
        let words = test_gpu::read(&device, &queue, &slice.buffer);
        assert_eq!(words, data.as_flattened());
    }

    #[test]
    fn a_table_shrinks_and_grows_with_its_elements() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut slice = StorageSlice::<u32>::new(&device, "glint_numbers");
        for (count, room) in [(10, 16), (100, 128), (40, 128), (31, 32), (0, 16), (100, 128)] {
            let data: Vec<u32> = (0..count).collect();
            slice.write_elements(&data, &[], &device, &queue);
            assert_eq!(
                (slice.count(), slice.buffer().size()),
                (data.len(), 4 * room),
                "{count} elements"
            );
        }
    }

    #[test]
    fn what_the_device_has_no_memory_for_is_left_out() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut slice = StorageSlice::<u32>::new(&device, "glint_numbers");
        let data: Vec<u32> = (0..100).collect();
        let write = |slice: &mut StorageSlice<u32>| {
            slice.write(&data, 0..0, &device, &queue);
            slice.count()
        };
        REFUSES.set(true);
        assert_eq!(write(&mut slice), 16);
        REFUSES.set(false);
        assert_eq!(write(&mut slice), 16, "it isn't asked at once");
        // Without any change, even if nothing was freed.
        let frames = (1..=REFUSED_FRAMES).find(|_| slice.may_ask_again());
        assert_eq!((frames, write(&mut slice)), (Some(REFUSED_FRAMES), 100));
        // A smaller one is worth another try.
        REFUSES.set(true);
        assert_eq!(slice.reserve(1000, &device), 128);
        REFUSES.set(false);
        assert_eq!(slice.reserve(999, &device), 1024);
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
