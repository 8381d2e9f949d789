//! A storage buffer with a copy of a slice.

use crate::device::{MemoryRetry, try_allocate};
use bevy::{
    asset::{AssetServer, load_embedded_asset},
    ecs::world::World,
    log::warn,
    render::{
        render_resource::{
            BindGroupEntry, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BindingResource, Buffer, BufferBinding,
            BufferDescriptor, BufferUsages, CachedComputePipelineId, CommandEncoderDescriptor, ComputePassDescriptor,
            ComputePipeline, ComputePipelineDescriptor, PipelineCache, ShaderStages,
            binding_types::{storage_buffer_read_only_sized, storage_buffer_sized},
        },
        renderer::{RenderDevice, RenderQueue},
    },
};
use bytemuck::{NoUninit, bytes_of, cast_slice};
use core::{marker::PhantomData, num::NonZeroU64, ops::Range};

/// Gap between two changed elements up to which the elements in between are written again, since a separate write costs more.
const GAP: u32 = 64;
/// Number of bytes up to which everything is written again instead of using a kernel, which has a fixed cost.
const CHEAP_BYTES: u64 = 1 << 18;
/// Minimum capacity in elements.
const SMALLEST_ROOM: usize = 16;
/// Threads of a workgroup in `scatter.wesl`.
const THREADS: u32 = 64;
/// Label of the kernel's input buffers.
const SCATTERED: &str = "glint_scattered";
/// Number of workgroups that every device can dispatch at a time.
const MOST_WORKGROUPS: u32 = 65_535;

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
    /// The kernel of `scatter.wesl`, once it is compiled.
    kernel: Option<ComputePipeline>,
    scattered: Option<Scattered>,
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
            kernel: None,
            scattered: None,
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
        if self.kernel.is_none() {
            self.kernel = kernels.get(size_of::<T>(), cache).cloned();
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
        let workgroups = (changed / 16).div_ceil(u64::from(THREADS));
        let is_scattered = written > (4 * changed).max(CHEAP_BYTES) && workgroups <= u64::from(MOST_WORKGROUPS);
        if is_scattered && self.scatter(data, sorted, workgroups as u32, device, queue) {
            return;
        }
        for run in runs(sorted, GAP) {
            queue.write_buffer(&self.buffer, run.start as u64 * size, cast_slice(&data[run]));
        }
    }

    /// Writes the elements in one piece, and dispatches a kernel that copies them to their positions. Returns false while it is being
    /// compiled, and if the device lacks memory for that.
    fn scatter(
        &mut self,
        data: &[T],
        places: &[u32],
        workgroups: u32,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> bool {
        let Some(kernel) = &self.kernel else { return false };
        let scatter = self.scattered.get_or_insert_with(|| Scattered::new(device));
        let elements = places.iter().map(|place| bytes_of(&data[*place as usize]));
        let bytes = cast_slice(places);
        let is_filled = fill(&mut scatter.elements, size_of::<T>(), elements, device, queue)
            && fill(&mut scatter.places, bytes.len(), core::iter::once(bytes), device, queue);
        if !is_filled {
            return false;
        }
        let part = |buffer, size: usize| {
            BindingResource::Buffer(BufferBinding {
                buffer,
                offset: 0,
                size: NonZeroU64::new(size as u64),
            })
        };
        let entries = [
            part(&scatter.elements, places.len() * size_of::<T>()),
            part(&scatter.places, size_of_val(places)),
            self.buffer.as_entire_binding(),
        ];
        let entries: Vec<_> = (0..)
            .zip(entries)
            .map(|(binding, resource)| BindGroupEntry { binding, resource })
            .collect();
        let layout = kernel.get_bind_group_layout(0).into();
        let bind_group = device.create_bind_group("glint_scatter", &layout, &entries);
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("glint_scatter"),
        });
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("glint_scatter"),
                timestamp_writes: None,
            });
            pass.set_pipeline(kernel);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups(workgroups, 1, 1);
        }
        // Submitted at once, to keep the order of all writes.
        queue.submit([encoder.finish()]);
        true
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

/// Kernels that scatter elements, by the size of an element in bytes. They are compiled from the start, so that the first frame with many
/// movements doesn't wait for them.
pub struct ScatterKernels(Vec<(usize, CachedComputePipelineId)>);

impl ScatterKernels {
    /// Creates kernels for elements of these sizes in bytes, which are multiples of 16.
    pub fn new<const N: usize>(world: &World, sizes: [usize; N]) -> Self {
        let shader = load_embedded_asset!(world.resource::<AssetServer>(), "scatter.wesl");
        let entries = BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                storage_buffer_read_only_sized(false, None),
                storage_buffer_read_only_sized(false, None),
                storage_buffer_sized(false, None),
            ),
        );
        let layout = BindGroupLayoutDescriptor::new("glint_scatter", &entries);
        let kernel = |size: usize| {
            let id = world
                .resource::<PipelineCache>()
                .queue_compute_pipeline(ComputePipelineDescriptor {
                    label: Some("glint_scatter".into()),
                    layout: vec![layout.clone()],
                    shader: shader.clone(),
                    entry_point: Some("scatter".into()),
                    constants: vec![("ROWS".into(), (size / 16) as f64)],
                    ..Default::default()
                });
            (size, id)
        };
        Self(sizes.map(kernel).into())
    }

    fn get<'a>(&self, size: usize, cache: &'a PipelineCache) -> Option<&'a ComputePipeline> {
        let (_, id) = self.0.iter().find(|(of, _)| *of == size)?;
        cache.get_compute_pipeline(*id)
    }
}

/// Input buffers of a kernel, which are reused in later frames.
struct Scattered {
    elements: Buffer,
    places: Buffer,
}

impl Scattered {
    fn new(device: &RenderDevice) -> Self {
        Self {
            elements: create(device, SCATTERED, 4),
            places: create(device, SCATTERED, 4),
        }
    }
}

/// Writes pieces of the same size to the start of a buffer, and replaces the buffer if it is too small or much too large. Returns false
/// if the device lacks memory for another one.
fn fill<'a>(
    buffer: &mut Buffer,
    piece: usize,
    pieces: impl ExactSizeIterator<Item = &'a [u8]>,
    device: &RenderDevice,
    queue: &RenderQueue,
) -> bool {
    let bytes = (pieces.len() * piece) as u64;
    let size = bytes.next_power_of_two();
    if !(size..=8 * size).contains(&buffer.size()) {
        let Some(other) = try_allocate(device, || create(device, SCATTERED, size)) else {
            return false;
        };
        *buffer = other;
    }
    // Avoids an intermediate copy of all pieces.
    let view = NonZeroU64::new(bytes).and_then(|bytes| queue.write_buffer_with(buffer, 0, bytes));
    let Some(mut view) = view else { return false };
    let mut all = view.slice(..);
    for (index, bytes) in pieces.enumerate() {
        all.slice(index * piece..(index + 1) * piece).copy_from_slice(bytes);
    }
    true
}

/// Ranges that contain all of these sorted indices, and up to `gap` others between two of them.
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
    use crate::{
        device::{REFUSED_FRAMES, REFUSES},
        scene::test_gpu,
    };
    use bevy::render::render_resource::{
        PipelineCompilationOptions, RawComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource,
    };

    /// The kernel for elements of two rows.
    fn scatter_pipeline(device: &RenderDevice) -> ComputePipeline {
        let module = device.create_and_validate_shader_module(ShaderModuleDescriptor {
            label: Some("glint_scatter"),
            source: ShaderSource::Wgsl(include_str!("scatter.wesl").into()),
        });
        device.create_compute_pipeline(&RawComputePipelineDescriptor {
            label: Some("glint_scatter"),
            layout: None,
            module: &module,
            entry_point: Some("scatter"),
            compilation_options: PipelineCompilationOptions {
                constants: &[("ROWS", 2.0)],
                ..Default::default()
            },
            cache: None,
        })
    }

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
        for (step, kernel) in [(9, None), (9, Some(scatter_pipeline(&device))), (300, None)] {
            // While the kernel is being compiled, elements are written one by one.
            assert!(slice.kernel.is_some() || slice.scattered.is_none());
            slice.kernel = slice.kernel.take().or(kernel);
            let sorted: Vec<u32> = (3..COUNT as u32).step_by(step).collect();
            for index in &sorted {
                data[*index as usize] = core::array::from_fn(|i| 7 * index + i as u32 + step as u32);
            }
            slice.write_elements(&data, &sorted, &device, &queue);
        }
        assert!(slice.scattered.is_some(), "one in nine is written by a kernel");
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
