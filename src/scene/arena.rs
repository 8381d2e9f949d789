//! A GPU buffer that grows and hands out slices of itself.
//!
//! All meshes share one buffer, so few bindings are needed. `slice_allocator` decides where slices lie and how large the buffer has to
//! be; [`Arena`] owns the buffer.
//!
//! # Growth
//!
//! Growing copies the buffer in parts, one per frame, so that no frame waits for a large copy ([`Arena::advance`]). The new buffer then
//! replaces the old one. Until then, slices beyond the end of the old buffer are not [in reach](Arena::is_in_reach): callers wait if they
//! can, and a write to such a slice copies the rest at once.
//!
//! # Stranded slices
//!
//! Slices that were allocated while the buffer was full, and outlive the others, would keep the buffer large. The arena never moves
//! slices. Instead, owners poll [`Arena::is_stranded`], free such slices and allocate new ones. Merged trees, meshes, masks and
//! TLASes are rebuilt; poses stay.
//!
//! # Order of writes
//!
//! [`Arena::write`] goes through the queue: the bytes are written when the next submission starts, before any of its commands. Each part of
//! a copy is submitted at once. Writes before a part is copied therefore reach the old buffer ahead of the copy and are copied with it, and
//! later writes go to both buffers. The dispatches of [`Arena::clear_units`] are submitted at once, too. Commands recorded in the same
//! frame with a bind group of the old buffer still see valid content. A freed slice can be reused and overwritten in the same frame: all
//! references to it must be updated in that frame too.

mod slice_allocator;

use super::{
    scatter::{Scatter, ScatterKernels},
    upload::runs,
};
use crate::device::{MemoryRetry, try_allocate};
use bevy::render::{
    render_resource::{Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor, PipelineCache},
    renderer::{RenderDevice, RenderQueue},
};
use core::ops::Range;
use slice_allocator::{SliceAllocator, next_id};
use std::collections::BTreeMap;
use wgpu::COPY_BUFFER_ALIGNMENT;

pub use slice_allocator::ArenaSlice;

/// Minimum number of bytes copied to a replacement per frame: a few milliseconds on a CPU driver.
const LEAST_PART: u64 = 4 << 20;
/// Number of units up to which [`Arena::clear_units`] sorts them to find runs. A higher number finds few runs among more units, and takes
/// longer to sort those that have many; not tuned.
const MOST_SORTED: usize = 4096;
/// Maximum number of runs that it clears without a kernel. A higher number makes more writes, of about a microsecond each; a lower one
/// dispatches more often, which has a fixed cost; not tuned.
const FEW_WRITES: usize = 32;
/// Frames that it takes to replace a large buffer.
const PARTS: u64 = 32;

/// Frames until owners of stranded slices are asked to move them, doubled after each attempt that didn't help. A higher number keeps the
/// buffer large for longer; a lower one moves slices that the next level would have freed anyway. Half a second at 60 Hz, not tuned.
const STRANDED_FRAMES: u32 = 32;

/// A buffer that is about to replace another one, which still contains all of its data.
struct Replacement {
    buffer: Buffer,
    /// Number of bytes copied so far, from the start. Bytes beyond the end of the old buffer are cleared instead.
    done: u64,
    /// Byte ranges that shaders have written meanwhile, keyed by their start. They are copied last.
    written: BTreeMap<u64, u64>,
}

/// A storage buffer of `u32` words that grows by half whenever its slices need more room, up to the limits of the device.
///
/// It never moves slices inside the buffer: [`ArenaSlice::base`] stays valid when the buffer is replaced. While the arena grows, the old
/// and the new buffer exist side by side. If the device lacks memory for both, it doesn't grow.
pub struct Arena {
    device: RenderDevice,
    label: &'static str,
    usages: BufferUsages,
    allocator: SliceAllocator,
    buffer: Buffer,
    /// A larger buffer, for slices beyond the end of [`Self::buffer`], or a smaller one.
    replacement: Option<Replacement>,
    /// [`LEAST_PART`]; less in tests, since some devices can't allocate a buffer of many such parts.
    least_part: u64,
    /// Size in bytes that the device has refused since the last slice was freed.
    refused: u64,
    /// When to retry a refused allocation.
    retry: MemoryRetry,
    /// Refused allocations can be retried in this frame.
    may_ask_again: bool,
    generation: u64,
    stranded: Stranded,
    /// Clears many units, once its kernel is compiled.
    scatter: Option<Scatter>,
}

/// Slices that should move in this frame.
struct Stranded {
    /// Slices that end beyond this unit are stranded.
    from: Option<u32>,
    /// Frames until the next attempt, and from that one to the next.
    wait: u32,
    pause: u32,
}

impl Default for Stranded {
    fn default() -> Self {
        Self {
            from: None,
            wait: STRANDED_FRAMES,
            pause: STRANDED_FRAMES,
        }
    }
}

impl Stranded {
    /// Updates for a frame, with the result of [`SliceAllocator::stranded_from`].
    fn advance(&mut self, found: Option<u32>) {
        self.from = None;
        if found.is_none() {
            *self = Self::default();
        } else if self.wait > 0 {
            self.wait -= 1;
        } else {
            self.from = found;
            self.pause = self.pause.saturating_mul(2);
            self.wait = self.pause;
        }
    }
}

impl Arena {
    /// Creates an arena that allocates in multiples of `unit_words` words, with a buffer of up to `max_bytes`, within the device's
    /// limits. `usages` are added to `STORAGE | COPY_SRC | COPY_DST`.
    pub fn new(
        device: &RenderDevice,
        label: &'static str,
        usages: BufferUsages,
        unit_words: u32,
        max_bytes: u64,
    ) -> Self {
        let limits = device.limits();
        let max_bytes = max_bytes
            .min(limits.max_buffer_size)
            .min(limits.max_storage_buffer_binding_size);
        let usages = usages | BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let allocator = SliceAllocator::new(unit_words, max_bytes);
        let buffer = create_buffer(device, label, usages, allocator.bytes(allocator.capacity_units));
        Self {
            device: device.clone(),
            label,
            usages,
            allocator,
            buffer,
            replacement: None,
            least_part: LEAST_PART,
            refused: u64::MAX,
            retry: MemoryRetry::default(),
            may_ask_again: false,
            generation: next_id(),
            stranded: Stranded::default(),
            scatter: None,
        }
    }

    /// Allocates `words` words, at least one unit. Returns `None` if they don't fit in [`Self::max_bytes`], if the device lacks memory,
    /// or if there are more than about 130 000 slices: the caller has to do without and warn the user.
    pub fn allocate(&mut self, words: u32) -> Option<ArenaSlice> {
        let before = self.allocator.capacity_units;
        let slice = self.allocator.allocate(words)?;
        let end = slice.end(self.allocator.unit_words);
        if self.allocator.capacity_units > before {
            if !self.make_room_up_to(end) {
                self.allocator.free(slice);
                self.allocator.capacity_units = before;
                return None;
            }
        } else {
            // A replacement that is too small for the slice is dropped.
            let end = self.allocator.bytes(end);
            self.replacement.take_if(|replacement| replacement.buffer.size() < end);
        }
        Some(slice)
    }

    /// Creates a buffer of the capacity that the allocator wants, or else one that ends at `end`.
    fn make_room_up_to(&mut self, end: u32) -> bool {
        for units in [self.allocator.capacity_units, end] {
            let size = self.allocator.bytes(units);
            if size >= self.refused {
                continue;
            }
            if self.begin_replacement(size) {
                self.allocator.capacity_units = units;
                return true;
            }
            self.refuse(size);
        }
        false
    }

    fn refuse(&mut self, size: u64) {
        self.refused = size;
        self.retry.begin();
    }

    fn begin_replacement(&mut self, size: u64) -> bool {
        let create = || create_buffer(&self.device, self.label, self.usages, size);
        let buffer = try_allocate(&self.device, create);
        let is_there = buffer.is_some();
        if let Some(buffer) = buffer {
            self.replacement = Some(Replacement {
                buffer,
                done: 0,
                written: BTreeMap::new(),
            });
        }
        is_there
    }

    /// Frees a slice. Slices of other arenas, such as that of a lost device, are ignored.
    pub fn free(&mut self, slice: ArenaSlice) {
        self.allocator.free(slice);
        self.refused = u64::MAX;
    }

    /// Continues to replace the buffer; call once per frame. Starts to shrink the buffer if most of its end is free.
    pub fn advance(&mut self, queue: &RenderQueue) {
        self.may_ask_again = self.retry.is_due();
        if self.may_ask_again {
            self.refused = u64::MAX;
        }
        self.stranded.advance(self.allocator.stranded_from());
        if let Some(units) = self.allocator.smaller_capacity() {
            let size = self.allocator.bytes(units);
            let is_growth = |replacement: &mut Replacement| replacement.buffer.size() > self.buffer.size();
            if size <= self.buffer.size() && self.replacement.take_if(is_growth).is_some() {
                // The replacement isn't needed any more.
                self.allocator.capacity_units = (self.buffer.size() / self.allocator.bytes(1)) as u32;
            }
            let is_wanted = size < self.buffer.size() && size < self.refused && self.replacement.is_none();
            if is_wanted && !self.begin_replacement(size) {
                self.refuse(size);
            }
        }
        if let Some(replacement) = &self.replacement {
            let part = part_of(replacement.buffer.size()).max(self.least_part);
            self.carry_on(part, queue);
        }
    }

    /// Returns whether callers should retry an allocation that the device refused.
    pub fn may_ask_again(&self) -> bool {
        self.may_ask_again
    }

    /// Returns whether the device has lately refused memory for a larger buffer.
    pub fn lacks_memory(&self) -> bool {
        self.refused != u64::MAX
    }

    /// Returns whether a slice keeps the buffer large. Its owner should free it in this frame and allocate a new one, or start to.
    pub fn is_stranded(&self, slice: &ArenaSlice) -> bool {
        let end = slice.end(self.allocator.unit_words);
        self.stranded.from.is_some_and(|from| end > from)
    }

    /// Returns whether [`Self::is_stranded`] is true for any slice in this frame.
    pub fn has_stranded_slices(&self) -> bool {
        self.stranded.from.is_some()
    }

    /// Returns whether a slice can be written without copying a large buffer first. If not, a later frame can write it.
    pub fn is_in_reach(&self, slice: &ArenaSlice) -> bool {
        let is_small = |replacement: &Replacement| replacement.buffer.size() <= LEAST_PART;
        self.is_resident(slice) || self.replacement.as_ref().is_some_and(is_small)
    }

    fn is_resident(&self, slice: &ArenaSlice) -> bool {
        self.allocator.bytes(slice.end(self.allocator.unit_words)) <= self.buffer.size()
    }

    /// Writes from the start of the slice, before the commands of the next submission. Words beyond the slice's end are dropped, and so
    /// are writes to another arena's slice.
    pub fn write(&mut self, queue: &RenderQueue, slice: &ArenaSlice, words: &[u32]) {
        self.write_from(queue, slice, 0, words);
    }

    /// Writes from the given word of the slice.
    pub fn write_from(&mut self, queue: &RenderQueue, slice: &ArenaSlice, first: usize, words: &[u32]) {
        let room = (slice.words as usize).saturating_sub(first);
        debug_assert!(slice.arena == self.allocator.id && words.len() <= room);
        if slice.arena != self.allocator.id {
            return;
        }
        self.make_resident(queue, slice);
        let words = &words[..words.len().min(room)];
        if words.is_empty() {
            return;
        }
        let offset = slice.byte_offset() + 4 * first as u64;
        queue.write_buffer(&self.buffer, offset, bytemuck::cast_slice(words));
        if let Some(Replacement { buffer, done, .. }) = &self.replacement
            && *done > offset
        {
            let copied = words.len().min(((done - offset) / 4) as usize);
            queue.write_buffer(buffer, offset, bytemuck::cast_slice(&words[..copied]));
        }
    }

    /// Takes over the kernel for [`Self::clear_units`]. Units must be multiples of four words.
    pub fn follow_kernel(&mut self, kernels: &ScatterKernels, cache: &PipelineCache) {
        if self.scatter.is_none() {
            self.scatter = kernels.scatter(4 * self.allocator.unit_words as usize, cache);
        }
    }

    /// Returns whether [`Self::clear_units`] needs few writes for any number of units.
    pub fn clears_many(&self) -> bool {
        self.scatter.is_some()
    }

    /// Sets units of a slice to zero, at these positions in any order.
    pub fn clear_units(&mut self, queue: &RenderQueue, slice: &ArenaSlice, mut units: Vec<u32>) {
        let is_short = units.len() <= MOST_SORTED;
        if is_short {
            units.sort_unstable();
        }
        let takes_many_writes = !is_short || runs(&units, 0).count() > FEW_WRITES;
        if takes_many_writes && self.scatter_zeros(queue, slice, &mut units) {
            return;
        }
        units.sort_unstable();
        for run in runs(&units, 0) {
            let unit = self.allocator.unit_words as usize;
            self.write_from(queue, slice, run.start * unit, &vec![0; run.len() * unit]);
        }
    }

    /// Returns false and writes nothing, or only some of the zeros, if the kernel is missing or lacks memory. Units beyond the slice are
    /// dropped.
    fn scatter_zeros(&mut self, queue: &RenderQueue, slice: &ArenaSlice, units: &mut Vec<u32>) -> bool {
        if slice.arena != self.allocator.id || self.scatter.is_none() {
            return false;
        }
        self.make_resident(queue, slice);
        let Some(scatter) = &mut self.scatter else { return false };
        let unit = self.allocator.unit_words;
        let (first, end) = (slice.base() / unit, slice.words / unit);
        // In place: there can be hundreds of thousands.
        units.retain(|place| *place < end);
        units.iter_mut().for_each(|place| *place += first);
        let zeros = vec![0_u8; 4 * unit as usize];
        let most = scatter.most();
        let mut write = |buffer: &Buffer, places: &[u32]| {
            let zeros = || core::iter::once(zeros.as_slice());
            let mut parts = places.chunks(most);
            parts.all(|places| scatter.write(buffer, zeros(), places, &self.device, queue))
        };
        let mut is_done = write(&self.buffer, units);
        if let Some(Replacement { buffer, done, .. }) = self.replacement.as_ref().filter(|_| is_done) {
            // The rest is yet to be copied.
            let copied = units.iter().filter(|place| self.allocator.bytes(**place) < *done);
            is_done = write(buffer, &copied.copied().collect::<Vec<u32>>());
        }
        units.iter_mut().for_each(|place| *place -= first);
        is_done
    }

    /// Call before recording commands of this frame that write to a slice. Until they are submitted, nothing may be allocated. From then
    /// on, [`Self::buffer`] contains the slice.
    pub fn begin_gpu_write(&mut self, queue: &RenderQueue, slice: &ArenaSlice) {
        self.make_resident(queue, slice);
        if let Some(replacement) = &mut self.replacement {
            let end = slice.byte_offset() + 4 * u64::from(slice.words);
            let last = replacement.written.entry(slice.byte_offset()).or_default();
            *last = end.max(*last);
        }
    }

    fn make_resident(&mut self, queue: &RenderQueue, slice: &ArenaSlice) {
        if !self.is_resident(slice) {
            self.carry_on(u64::MAX, queue);
        }
    }

    /// Copies this number of bytes to the replacement. After the last of them, it replaces the buffer.
    fn carry_on(&mut self, bytes: u64, queue: &RenderQueue) {
        let Some(mut replacement) = self.replacement.take() else {
            return;
        };
        let Replacement { buffer, done, written } = &mut replacement;
        let (old, size) = (self.buffer.size(), buffer.size());
        let end = done.saturating_add(bytes).min(size);
        let descriptor = CommandEncoderDescriptor {
            label: Some(self.label),
        };
        let mut encoder = self.device.create_command_encoder(&descriptor);
        let mut copy = |range: Range<u64>| {
            let end = range.end.min(old).min(size);
            if range.start < end {
                encoder.copy_buffer_to_buffer(&self.buffer, range.start, buffer, range.start, end - range.start);
            }
        };
        copy(*done..end);
        if end == size {
            written.iter().for_each(|(begin, end)| copy(*begin..*end));
        }
        let cleared = (*done).max(old)..end;
        if cleared.start < cleared.end {
            encoder.clear_buffer(buffer, cleared.start, Some(cleared.end - cleared.start));
        }
        // Submitted at once, so that later writes to the new buffer come after the copy.
        queue.submit([encoder.finish()]);
        *done = end;
        if end < size {
            self.replacement = Some(replacement);
        } else {
            self.allocator.capacity_units = (size / self.allocator.bytes(1)) as u32;
            self.buffer = replacement.buffer;
            self.generation = next_id();
        }
    }

    /// The current buffer. Bind groups with it must be rebuilt when [`Self::generation`] changes.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Changes whenever the buffer object is replaced; unique across arenas.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Allocated bytes, in whole units.
    pub fn used_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.used_units)
    }

    /// Size of the buffer in bytes.
    pub fn capacity_bytes(&self) -> u64 {
        self.buffer.size()
    }

    /// Size in bytes up to which the buffer can grow.
    pub fn max_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.max_units)
    }
}

/// Bytes of a large buffer to copy in one frame. Copies must begin and end at multiples of a word.
fn part_of(size: u64) -> u64 {
    (size / PARTS).next_multiple_of(COPY_BUFFER_ALIGNMENT)
}

fn create_buffer(device: &RenderDevice, label: &str, usage: BufferUsages, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
mod tests;
