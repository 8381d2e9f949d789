//! Seeded random numbers and noise that tiles.

use bevy::math::{Vec2, ops, vec2};
use rand_xoshiro::{
    SplitMix64,
    rand_core::{Rng, SeedableRng},
};

/// A small seeded generator (`SplitMix64`): the same numbers on every machine.
#[derive(Clone, Debug)]
pub struct Random(SplitMix64);

impl Random {
    /// A generator that always yields the same sequence for the same seed.
    pub fn new(seed: u64) -> Self {
        // Similar seeds start far apart.
        let state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0xd1b5_4a32_d192_ed03;
        Self(SplitMix64::seed_from_u64(state))
    }

    /// The generator of one part of something seeded: numbers that other parts draw don't change its sequence.
    pub fn of_part(seed: u64, part: usize) -> Self {
        Self::new(seed ^ (part as u64 + 1).wrapping_mul(0xff51_afd7_ed55_8ccd))
    }

    /// The next 32 random bits.
    pub fn bits(&mut self) -> u32 {
        // The upper half: the generator's own 32 bits are mixed differently.
        (self.0.next_u64() >> 32) as u32
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / 16_777_216.0
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `end`; 0 if `end` is 0.
    pub fn below(&mut self, end: usize) -> usize {
        self.bits() as usize % end.max(1)
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// One item of a slice, which must not be empty.
    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }
}

/// Hash of a lattice point to `[0, 1)`.
pub fn hash(x: i32, y: i32, seed: u32) -> f32 {
    let mut h =
        (x as u32).wrapping_mul(0x85eb_ca6b) ^ (y as u32).wrapping_mul(0xc2b2_ae35) ^ seed.wrapping_mul(0x27d4_eb2f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    (h >> 8) as f32 / 16_777_216.0
}

/// Value noise in `[0, 1]` with the given period in lattice cells (both directions).
pub fn noise(p: Vec2, period: i32, seed: u32) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let period = period.max(1);
    let wrap = |v: i32| v.rem_euclid(period);
    let (x0, y0) = (wrap(cell.x as i32), wrap(cell.y as i32));
    let (x1, y1) = (
        if x0 + 1 == period { 0 } else { x0 + 1 },
        if y0 + 1 == period { 0 } else { y0 + 1 },
    );
    let row = |y: i32| {
        let left = hash(x0, y, seed);
        left + (hash(x1, y, seed) - left) * s.x
    };
    let (low, high) = (row(y0), row(y1));
    low + (high - low) * s.y
}

/// Fractal noise in `[0, 1]` over the unit square, tiling with period one; `frequency` is the number of cells of the first octave.
pub fn fractal(uv: Vec2, frequency: i32, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut amplitude, mut cells) = (0.0, 0.0, 1.0, frequency.max(1));
    for octave in 0..octaves {
        sum += amplitude * noise(uv * cells as f32, cells, seed.wrapping_add(octave));
        weight += amplitude;
        amplitude *= 0.5;
        cells *= 2;
    }
    if weight > 0.0 { sum / weight } else { 0.0 }
}

/// Veins of marble in `[0, 1]` (1 on a vein), tiling with period one.
pub fn veins(uv: Vec2, frequency: i32, seed: u32) -> f32 {
    let warp = vec2(fractal(uv, frequency, 4, seed), fractal(uv, frequency, 4, seed + 31)) - 0.5;
    let n = fractal(uv + warp * 0.35, frequency, 5, seed + 77);
    ops::powf((1.0 - (n - 0.5).abs() * 2.0).clamp(0.0, 1.0), 14.0)
}

/// Hermite step from 0 at `low` to 1 at `high`; `low` can exceed `high`.
pub fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let width = high - low;
    if width == 0.0 {
        return if x < low { 0.0 } else { 1.0 };
    }
    let t = ((x - low) / width).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_are_those_that_scenes_were_made_with() {
        let recorded = [
            (0, [755_968_199, 1_971_679_092, 2_255_797_186, 1_545_423_271]),
            (7, [4_230_084_972, 599_483_748, 2_218_828_256, 2_345_181_078]),
            (2026, [57_950_561, 843_808_686, 1_689_274_730, 1_941_735_309]),
            (u64::MAX, [1_429_582_393, 1_735_483_275, 2_990_387_105, 2_676_749_386]),
        ];
        for (seed, bits) in recorded {
            let mut random = Random::new(seed);
            assert_eq!([(); 4].map(|()| random.bits()), bits, "{seed}");
        }
        let mut random = Random::new(7);
        assert!((0..1000).all(|_| (2.0..3.0).contains(&random.range(2.0, 3.0))));
        assert_eq!(random.below(0), 0);
        assert_ne!(Random::of_part(7, 0).bits(), Random::of_part(7, 1).bits());
    }
}
