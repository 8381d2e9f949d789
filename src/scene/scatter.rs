//! Writes elements to many positions of a buffer by one dispatch, since each write through the queue costs about a microsecond.

use crate::device::try_allocate;
use bevy::{
    asset::{AssetServer, load_embedded_asset},
    ecs::world::World,
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
use core::num::NonZeroU64;

/// Threads of a workgroup in `scatter.wesl`.
const THREADS: u64 = 64;
/// Label of the input buffers.
const SCATTERED: &str = "glint_scattered";
/// Number of workgroups that every device can dispatch at a time.
const MOST_WORKGROUPS: u64 = 65_535;

/// Kernels that scatter elements, by the size of an element in bytes. They are compiled from the start, so that the first frame with many
/// movements doesn't wait for them.
pub struct ScatterKernels(Vec<(usize, CachedComputePipelineId)>);

impl ScatterKernels {
    /// Creates kernels for elements of these sizes in bytes, which are multiples of 16.
    pub fn new(world: &World, sizes: impl IntoIterator<Item = usize>) -> Self {
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
        Self(sizes.into_iter().map(kernel).collect())
    }

    /// Scatters elements of a size in bytes; `None` while the kernel is being compiled.
    pub fn scatter(&self, size: usize, cache: &PipelineCache) -> Option<Scatter> {
        let (_, id) = self.0.iter().find(|(of, _)| *of == size)?;
        let kernel = cache.get_compute_pipeline(*id)?.clone();
        Some(Scatter {
            kernel,
            size,
            inputs: None,
        })
    }
}

/// Scatters elements of one size.
pub struct Scatter {
    kernel: ComputePipeline,
    /// Size of an element in bytes.
    size: usize,
    /// Elements and their places. They are reused in later frames.
    inputs: Option<[Buffer; 2]>,
}

impl Scatter {
    /// Returns whether elements were scattered before.
    #[cfg(test)]
    pub fn is_used(&self) -> bool {
        self.inputs.is_some()
    }

    /// Maximum number of elements of one [`Self::write`].
    pub fn most(&self) -> usize {
        (MOST_WORKGROUPS * THREADS) as usize / (self.size / 16)
    }

    /// Writes elements to these places of a buffer, in multiples of an element. A single element is written to all places. Returns false
    /// and writes nothing if the places are too many for a dispatch, or if the device lacks memory.
    pub fn write<'a>(
        &mut self,
        buffer: &Buffer,
        elements: impl ExactSizeIterator<Item = &'a [u8]>,
        places: &[u32],
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> bool {
        if places.len() > self.most() {
            return false;
        }
        let create = || create(device, SCATTERED, 4);
        let [element_buffer, place_buffer] = self.inputs.get_or_insert_with(|| [create(), create()]);
        let element_bytes = elements.len() * self.size;
        let bytes = bytemuck::cast_slice(places);
        let is_filled = fill(element_buffer, self.size, elements, device, queue)
            && fill(place_buffer, bytes.len(), core::iter::once(bytes), device, queue);
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
            part(element_buffer, element_bytes),
            part(place_buffer, bytes.len()),
            buffer.as_entire_binding(),
        ];
        let entries: Vec<_> = (0..)
            .zip(entries)
            .map(|(binding, resource)| BindGroupEntry { binding, resource })
            .collect();
        let layout = self.kernel.get_bind_group_layout(0).into();
        let bind_group = device.create_bind_group("glint_scatter", &layout, &entries);
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("glint_scatter"),
        });
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("glint_scatter"),
                timestamp_writes: None,
            });
            pass.set_pipeline(&self.kernel);
            pass.set_bind_group(0, &bind_group, &[]);
            let rows = (places.len() * self.size / 16) as u64;
            pass.dispatch_workgroups(rows.div_ceil(THREADS) as u32, 1, 1);
        }
        // Submitted at once, to keep the order of all writes.
        queue.submit([encoder.finish()]);
        true
    }
}

/// Writes pieces of the same size to the start of a buffer, and replaces the buffer if it is too small or much too large. Returns false
/// if there are none, or if the device lacks memory for another buffer.
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

/// Creates a buffer for storage and copies.
pub(super) fn create(device: &RenderDevice, label: &'static str, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use bevy::render::render_resource::{
        PipelineCompilationOptions, RawComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource,
    };

    /// Scatters elements of this number of bytes.
    pub fn scatter(size: usize, device: &RenderDevice) -> Scatter {
        let module = device.create_and_validate_shader_module(ShaderModuleDescriptor {
            label: Some("glint_scatter"),
            source: ShaderSource::Wgsl(include_str!("scatter.wesl").into()),
        });
        let kernel = device.create_compute_pipeline(&RawComputePipelineDescriptor {
            label: Some("glint_scatter"),
            layout: None,
            module: &module,
            entry_point: Some("scatter"),
            compilation_options: PipelineCompilationOptions {
                constants: &[("ROWS", (size / 16) as f64)],
                ..Default::default()
            },
            cache: None,
        });
        Scatter {
            kernel,
            size,
            inputs: None,
        }
    }
}
