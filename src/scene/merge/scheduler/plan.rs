//! Plans the next build: which of the resting objects are merged, and which chunks they absorb.

use super::{Building, MergeScheduler, Placement, State};
use bevy::math::Vec3A;

/// Upper bound, in multiples of `quiet_frames`, on how long newly moving or settling objects can delay a merge.
const PATIENCE: u64 = 8;
/// Maximum number of absorbed triangles, relative to new ones.
const ABSORBED: u64 = 8;

impl MergeScheduler {
    /// Returns the objects to build next, if a build is due and none is in progress. The caller then has to call
    /// [`Self::finish`], [`Self::fail`] or [`Self::abandon`].
    pub fn plan(&mut self) -> Option<Vec<(u32, Placement)>> {
        let quiet = self.limits.quiet_frames;
        let calm = self.frame >= self.disturbed + quiet || self.frame >= self.awake_since + PATIENCE * quiet;
        if self.building.is_some() || self.is_exhausted() || !calm {
            return None;
        }
        if !self.awake {
            return self.plan_again();
        }
        self.awake = false;
        let mut group = self.affordable();
        while self.triangles(&group) > self.limits.chunk_triangles && group.len() > 1 {
            self.halve(&mut group);
        }
        if group.is_empty() {
            return self.plan_again();
        }
        let mut triangles = self.triangles(&group);
        let mut sizes: Vec<(u64, u32)> = self.chunks.iter().map(|(id, chunk)| (chunk.triangles, *id)).collect();
        sizes.sort_unstable();
        let mut absorbed = Vec::new();
        for (size, id) in sizes {
            if size > (ABSORBED * triangles).max(self.limits.cheap_triangles)
                || triangles + size > self.limits.chunk_triangles
            {
                break;
            }
            triangles += size;
            absorbed.push(id);
            group.extend(self.members(id));
        }
        Some(self.begin(group, absorbed, triangles))
    }

    /// Returns the objects of a tree that was shifted, once nothing was shifted for some frames: its corners have the precision of their
    /// distance from the former origin.
    fn plan_again(&mut self) -> Option<Vec<(u32, Placement)>> {
        if self.frame < self.shifted? + self.limits.quiet_frames {
            return None;
        }
        let Some((id, chunk)) = self.chunks.iter().find(|(_, chunk)| chunk.tree.offset != Vec3A::ZERO) else {
            self.shifted = None;
            return None;
        };
        let (id, triangles) = (*id, chunk.triangles - chunk.cut);
        let group: Vec<u32> = self.members(id).collect();
        Some(self.begin(group, vec![id], triangles))
    }

    /// Objects that are still in a chunk.
    fn members(&self, id: u32) -> impl Iterator<Item = u32> + '_ {
        let members = self.chunks.get(&id).into_iter().flat_map(|chunk| &chunk.members);
        let is_in = move |slot: &u32| {
            let place = self.slots.get(*slot as usize);
            place.is_some_and(|place| place.state == State::Merged(id))
        };
        members.copied().filter(is_in)
    }

    /// Begins to build a tree.
    fn begin(&mut self, group: Vec<u32>, absorbed: Vec<u32>, triangles: u64) -> Vec<(u32, Placement)> {
        for slot in &group {
            self.slots[*slot as usize].building = true;
        }
        let plan: Vec<_> = group
            .iter()
            .filter_map(|slot| Some((*slot, self.details[*slot as usize].placement?)))
            .collect();
        self.building = Some(Building {
            members: group,
            absorbed,
            triangles,
            offset: Vec3A::ZERO,
            stale: false,
        });
        plan
    }

    fn triangles(&self, slots: &[u32]) -> u64 {
        slots.iter().map(|slot| self.slots[*slot as usize].triangles).sum()
    }

    /// The resting objects that fit into the budget, small ones first: rays gain most if many objects are merged.
    fn affordable(&self) -> Vec<u32> {
        let mut room = self.limits.budget_triangles.saturating_sub(self.merged().1);
        let mut sizes: Vec<(u64, u32)> = self
            .resting
            .iter()
            .map(|slot| (self.slots[*slot as usize].triangles, *slot))
            .collect();
        sizes.sort_unstable();
        let fitting = sizes.into_iter().take_while(|(size, _)| {
            let fits = *size <= room;
            room = room.saturating_sub(*size);
            fits
        });
        fitting.map(|(_, slot)| slot).collect()
    }

    /// Keeps the objects on one side of a plane, with about half of the triangles: the first half along the longest axis.
    /// Given at least two objects, at least one is kept and one is dropped.
    fn halve(&self, group: &mut Vec<u32>) {
        let centre = |slot: &u32| self.details[*slot as usize].centre;
        let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for slot in group.iter() {
            min = min.min(centre(slot));
            max = max.max(centre(slot));
        }
        let axis = (max - min).max_position();
        group.sort_unstable_by(|a, b| {
            let order = centre(a)[axis].total_cmp(&centre(b)[axis]);
            order.then(a.cmp(b))
        });
        let half = self.triangles(group) / 2;
        let mut sum = 0;
        let below = group.iter().take_while(|&slot| {
            sum += self.slots[*slot as usize].triangles;
            sum <= half
        });
        let kept = below.count().clamp(1, group.len().saturating_sub(1).max(1));
        group.truncate(kept);
    }
}
