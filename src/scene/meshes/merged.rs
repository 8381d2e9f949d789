//! Space for merged trees beside the trees of meshes.

use super::{SceneMeshes, words_of};
use crate::scene::bvh::ITEM_WORDS;
use bevy::render::renderer::RenderQueue;

impl SceneMeshes {
    /// Allocates a merged tree: returns its name and its first item. A quarter of the buffer's maximum size is reserved for meshes.
    pub(in crate::scene) fn allocate_merged(&mut self, items: usize) -> Option<(u64, u32)> {
        let words = words_of(items)?;
        let limit = self.bvh.max_bytes() / 4 * 3;
        if self.bvh.used_bytes() + u64::from(words) * 4 > limit {
            return None;
        }
        let slice = self.bvh.allocate(words)?;
        let (name, first) = (self.next_merged, slice.base() / ITEM_WORDS);
        self.next_merged += 1;
        self.merged.insert(name, slice);
        Some((name, first))
    }

    /// Names of merged trees that keep the buffer large and should be rebuilt.
    pub(in crate::scene) fn stranded_merged(&self) -> Vec<u64> {
        if !self.bvh.has_stranded_slices() {
            return Vec::new();
        }
        let merged = self.merged.iter();
        let stranded = merged.filter(|(_, slice)| self.bvh.is_stranded(slice));
        stranded.map(|(name, _)| *name).collect()
    }

    /// Returns whether a merged tree can be written by now, or is lost.
    pub(in crate::scene) fn is_merged_in_reach(&self, name: u64) -> bool {
        self.merged.get(&name).is_none_or(|slice| self.bvh.is_in_reach(slice))
    }

    /// Writes a part of a merged tree, starting at this word of it. Does nothing if the tree was lost.
    pub(in crate::scene) fn write_merged(&mut self, name: u64, first: usize, words: &[u32], queue: &RenderQueue) {
        let Some(slice) = self.merged.get(&name) else { return };
        let end = first.saturating_add(words.len());
        if words.is_empty() || end > slice.words() as usize {
            return;
        }
        self.bvh.write_from(queue, slice, first, words);
    }

    /// Sets items of a merged tree to zero. Does nothing if the tree was lost.
    pub(in crate::scene) fn clear_merged(&mut self, name: u64, items: Vec<u32>, queue: &RenderQueue) {
        if let Some(slice) = self.merged.get(&name) {
            self.bvh.clear_units(queue, slice, items);
        }
    }

    /// Frees the space of a merged tree, if it still has any.
    pub(in crate::scene) fn free_merged(&mut self, name: u64) {
        if let Some(slice) = self.merged.remove(&name) {
            self.bvh.free(slice);
        }
    }

    /// Returns whether all merged trees were lost since the last call. If so, everything that refers to them must be rebuilt in this frame.
    pub(in crate::scene) fn take_merged_lost(&mut self) -> bool {
        core::mem::take(&mut self.merged_lost)
    }
}
