//! A GPU buffer that grows and hands out slices of itself.
//!
//! Bindings stay few when all meshes share one buffer. `slice_allocator` decides where slices lie and how large the buffer has to be;
//! [`Arena`] owns the buffer.
//!
//! # Growth
//!
//! A larger buffer is filled in parts, one in each frame, so that no frame waits for the copy of a large one ([`Arena::advance`]). It
//! then replaces the old buffer. Until then, slices beyond the end of the old buffer are not [in reach](Arena::is_in_reach): callers wait
//! if they can, and a write to such a slice copies the rest at once.
//!
//! # Stranded slices
//!
//! Slices that were taken while the buffer was full, and outlive the others, would keep the buffer large. The arena never moves them,
//! but tells their owners ([`Arena::is_stranded`]), who free them and ask for others. Merged trees, meshes, masks and trees over instances are made again; poses stay.
//!
//! # Order of writes
//!
//! [`Arena::write`] goes through the queue: the bytes land when the next submission starts, before any of its commands. Each part of a
//! copy is submitted at once. Writes before a part is copied therefore reach the old buffer ahead of the copy and are copied with it, and
//! later writes go to both buffers. Commands recorded in the same frame with a bind group of the old buffer still see valid content. A
//! freed slice can be reused and overwritten in the same frame: all references to it must be updated in that frame too.

mod slice_allocator;

use crate::device::{MemoryRetry, try_allocate};
use bevy::render::{
    render_resource::{Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor},
    renderer::{RenderDevice, RenderQueue},
};
use core::ops::Range;
use slice_allocator::{SliceAllocator, next_id};
use std::collections::BTreeMap;
use wgpu::COPY_BUFFER_ALIGNMENT;

pub use slice_allocator::ArenaSlice;

/// Bytes of a buffer that are copied to its replacement in one frame, at least: a few milliseconds where the GPU is a CPU.
const LEAST_PART: u64 = 4 << 20;
/// Frames that the replacement of a large buffer takes.
const PARTS: u64 = 32;

/// Frames until owners of stranded slices are asked to move them, doubled each time that this didn't help. More keeps the buffer large
/// for longer; fewer moves slices that the next level would have freed anyway. Half a second at 60 Hz, not tuned.
const STRANDED_FRAMES: u32 = 32;

/// A buffer on its way to replace another one. Nothing is in it alone.
struct Replacement {
    buffer: Buffer,
    /// Bytes from the start on that are copied, or cleared behind the end of the old buffer.
    done: u64,
    /// Ranges of bytes, by their start, that shaders have written meanwhile: they are copied at the end.
    written: BTreeMap<u64, u64>,
}

/// A storage buffer of `u32` words that grows by half whenever its slices need more room, up to the limits of the device.
///
/// It never moves slices inside the buffer: [`ArenaSlice::base`] stays valid when the buffer is replaced. While it grows, the old and the
/// new buffer exist side by side; where the device has no memory for both, it stays as it is.
pub struct Arena {
    device: RenderDevice,
    label: &'static str,
    usages: BufferUsages,
    allocator: SliceAllocator,
    buffer: Buffer,
    /// A larger buffer, for slices that [`Self::buffer`] does not reach, or a smaller one.
    replacement: Option<Replacement>,
    /// [`LEAST_PART`]; less in tests, for which a large buffer would be too large for some devices.
    least_part: u64,
    /// Bytes that the device had no memory for, since a slice was given back last.
    refused: u64,
    /// When it is asked for them again.
    retry: MemoryRetry,
    /// The device can be asked in this frame.
    may_ask_again: bool,
    generation: u64,
    stranded: Stranded,
}

/// The slices that should move in this frame, if there are any.
struct Stranded {
    /// They end behind this unit.
    from: Option<u32>,
    /// Frames until the next attempt, and from there to the one after it.
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
    /// Takes the result of [`SliceAllocator::stranded_from`] in this frame.
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
    /// An arena with slices at multiples of `unit_words` words, and a buffer of up to `max_bytes`, within the device's limits. `usages`
    /// are added to `STORAGE | COPY_SRC | COPY_DST`.
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
        }
    }

    /// Takes `words` words, at least one unit. `None` if they do not fit in [`Self::max_bytes`], if the device has no memory for
    /// them, or if there are more than some 130 000 slices: the caller has to do without and tell the user.
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
            // A smaller buffer would not do any more.
            let end = self.allocator.bytes(end);
            self.replacement.take_if(|replacement| replacement.buffer.size() < end);
        }
        Some(slice)
    }

    /// Makes a buffer of the capacity that the allocator wants, or one that ends here.
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

    /// Gives a slice back. Slices of other arenas, such as that of a lost device, are ignored.
    pub fn free(&mut self, slice: ArenaSlice) {
        self.allocator.free(slice);
        self.refused = u64::MAX;
    }

    /// Carries on with a replacement of the buffer, once in each frame. Begins one by a smaller buffer where most is free at the end.
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
                // It isn't needed any more.
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

    /// Returns whether it is time to retry an allocation that the device refused.
    pub fn may_ask_again(&self) -> bool {
        self.may_ask_again
    }

    /// Returns whether the device has lately had no memory for a larger buffer.
    pub fn lacks_memory(&self) -> bool {
        self.refused != u64::MAX
    }

    /// Returns whether a slice keeps the buffer large. In this frame, its owner should free it and take another one, or begin to.
    pub fn is_stranded(&self, slice: &ArenaSlice) -> bool {
        let end = slice.end(self.allocator.unit_words);
        self.stranded.from.is_some_and(|from| end > from)
    }

    /// Returns whether [`Self::is_stranded`] is true of any slice in this frame.
    pub fn has_stranded_slices(&self) -> bool {
        self.stranded.from.is_some()
    }

    /// Returns whether a slice can be written without a copy of a large buffer: if not, that can be done in one of the next frames.
    pub fn is_in_reach(&self, slice: &ArenaSlice) -> bool {
        let is_small = |replacement: &Replacement| replacement.buffer.size() <= LEAST_PART;
        self.is_resident(slice) || self.replacement.as_ref().is_some_and(is_small)
    }

    fn is_resident(&self, slice: &ArenaSlice) -> bool {
        self.allocator.bytes(slice.end(self.allocator.unit_words)) <= self.buffer.size()
    }

    /// Writes from the start of the slice on, before the commands of the next submission. Words beyond the slice's end are left
    /// out, and so are those for another arena's slice.
    pub fn write(&mut self, queue: &RenderQueue, slice: &ArenaSlice, words: &[u32]) {
        self.write_from(queue, slice, 0, words);
    }

    /// Writes from the given word of the slice on.
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

    /// Notes that commands of this frame write to a slice, and that nothing asks for other room before they are submitted.
    /// [`Self::buffer`] reaches it from then on.
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

    /// Copies this number of bytes to the replacement, which replaces the buffer after the last of them.
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
        // At once: later writes to the new buffer must not be overtaken by the copy.
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

    /// The current buffer. Bind groups with it have to be rebuilt when [`Self::generation`] changes.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Changes whenever the buffer object is replaced, and is unlike that of any other arena.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Bytes in slices, in whole units.
    pub fn used_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.used_units)
    }

    /// Bytes of the buffer.
    pub fn capacity_bytes(&self) -> u64 {
        self.buffer.size()
    }

    /// Bytes that the buffer can grow to.
    pub fn max_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.max_units)
    }
}

/// Bytes of a large buffer that are copied in one frame. Copies have to begin and end at multiples of a word.
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
