//! The order of hits on the CPU: `coplanar.wesl` for `bvh/traverse.rs`.

use super::bias_of;
use crate::scene::gpu_types::INSTANCE_DRAWN_SHIFT;

/// The order of surfaces in the same place.
#[derive(Clone, Copy, Debug)]
pub struct DrawnOrder<'a> {
    /// `INSTANCE_` flags of all instances.
    pub flags: &'a [u32],
    /// The largest depth bias of all instances, at least 0.
    pub largest_bias: f32,
    /// Difference to the smallest one.
    pub bias_range: f32,
}

const BIAS_STEP: f32 = 8.43e-8;
const RANK_STEP: f32 = 3.8e-6;
const PHASE_RANK: f32 = 0.15;
const BIAS_RANKS: f32 = 4.0;
const MOST_RANKS: f32 = 5.5;

impl DrawnOrder<'_> {
    /// The distance by which the hit of an instance is compared with others. `origin_size` is the largest coordinate of the ray's origin.
    pub fn distance(&self, t: f32, instance: u32, origin_size: f32) -> f32 {
        let flags = self.flags[instance as usize];
        let bias = bias_of(flags);
        let phase = (flags >> INSTANCE_DRAWN_SHIFT & 7) as f32;
        let rank = bias.clamp(-BIAS_RANKS, BIAS_RANKS) + PHASE_RANK * phase;
        t + t * ((self.largest_bias - bias) * BIAS_STEP) + (t + origin_size) * ((MOST_RANKS - rank) * RANK_STEP)
    }

    /// Upper bound of these distances at `t`.
    pub fn last(&self, t: f32, origin_size: f32) -> f32 {
        t + t * (self.bias_range * BIAS_STEP) + (t + origin_size) * ((MOST_RANKS + BIAS_RANKS) * RANK_STEP)
    }
}
