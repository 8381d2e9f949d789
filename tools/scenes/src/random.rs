//! Seeded random numbers and noise that tiles.

use bevy::math::{Vec2, ops};

/// A small seeded generator: scenes must come out the same on every machine.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A generator that always yields the same sequence for the same seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0xd1b5_4a32_d192_ed03)
    }

    /// The next 32 random bits (`SplitMix64`).
    pub fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 32) as u32
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / 16_777_216.0
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
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
    let warp = Vec2::new(fractal(uv, frequency, 4, seed), fractal(uv, frequency, 4, seed + 31)) - 0.5;
    let n = fractal(uv + warp * 0.35, frequency, 5, seed + 77);
    ops::powf((1.0 - (n - 0.5).abs() * 2.0).clamp(0.0, 1.0), 14.0)
}

/// Hermite step from 0 at `low` to 1 at `high`; `low` may exceed `high`.
pub fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let width = high - low;
    if width == 0.0 {
        return if x < low { 0.0 } else { 1.0 };
    }
    let t = ((x - low) / width).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Evaluates `value` for `0..count` on all cores, in order.
pub fn parallel<T: Send>(count: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism()
        .map_or(1, usize::from)
        .min(count.max(1));
    let share = count.div_ceil(threads);
    let value = &value;
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|thread| {
                let range = (thread * share).min(count)..((thread + 1) * share).min(count);
                scope.spawn(move || range.map(value).collect::<Vec<T>>())
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    })
}
