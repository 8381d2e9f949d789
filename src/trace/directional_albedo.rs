//! Directional albedo of the GGX reflection lobe: the fraction of a white furnace that it reflects towards the viewer.
//!
//! The albedo is `F0 * A + F90 * B` with Schlick's Fresnel term; A and B depend only on alpha and n.v. Bevy's own split-sum factors are
//! approximations that differ from the lobe by several percent. Dividing by the exact albedo makes traced reflections match the
//! approximation that Bevy uses for the rest of the frame.
//!
//! Bilinear lookups need smooth functions, so the table stores, in two channels:
//! - `A + B` over `x = sqrt(c (1 + alpha) / (c + alpha))`, with c = n.v: near the horizon, Smith's masking depends on c / alpha, which
//!   `x` spreads evenly for every alpha;
//! - `(B / (A + B))^(1/5)` over `x = sqrt(c)`: the mean Fresnel weight without its fifth power. For a mirror it is `1 - c`.
//!
//! Rows are perceptual roughness, `sqrt(alpha)`, from 0 to 1. Both coordinates put the first and last texel on 0 and 1.

use core::f32::consts::PI;

/// Texels along each side of the table.
pub const ALBEDO_TABLE_SIZE: usize = 40;
/// Lobes up to this alpha are exact mirrors.
#[cfg(feature = "internals")]
pub const MIRROR_ALPHA: f32 = 0.001;
/// Floor of n.v.
#[cfg(feature = "internals")]
pub const MIN_VIEW_COSINE: f32 = 1e-4;

/// Points of the quadrature over the polar angle.
const POLAR: usize = 24;
/// Points of the quadrature over half a turn.
const AZIMUTH: usize = 32;
/// Views closer to the horizon look like this one.
const TABLE_MIN_COSINE: f32 = 1e-5;

/// The table on the CPU; see the module's documentation for coordinates and channels.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectionalAlbedo {
    texels: Vec<[f32; 2]>,
}

impl Default for DirectionalAlbedo {
    fn default() -> Self {
        Self::new()
    }
}

impl DirectionalAlbedo {
    /// Integrates the table. Takes about 10 ms, and yields the same bits each time.
    pub fn new() -> Self {
        let quadrature = Quadrature::new();
        let last = (ALBEDO_TABLE_SIZE - 1) as f32;
        let texels = (0..ALBEDO_TABLE_SIZE * ALBEDO_TABLE_SIZE)
            .map(|i| {
                let x = (i % ALBEDO_TABLE_SIZE) as f32 / last;
                let row = (i / ALBEDO_TABLE_SIZE) as f32 / last;
                let (alpha, x2) = (row * row, x * x);
                if alpha == 0.0 {
                    return [1.0, 1.0 - x2];
                }
                let [total, _] = quadrature.integrate(alpha, x2 * alpha / (1.0 + alpha - x2));
                let [total_fresnel, fresnel] = quadrature.integrate(alpha, x2);
                [total, (fresnel / total_fresnel).max(0.0).powf(0.2)]
            })
            .collect();
        Self { texels }
    }

    /// Texels in rows of [`ALBEDO_TABLE_SIZE`].
    pub fn texels(&self) -> &[[f32; 2]] {
        &self.texels
    }
}

/// CPU version of the shader, for tests.
#[cfg(feature = "internals")]
impl DirectionalAlbedo {
    /// `[A, B]` at an alpha and an n.v (both 0 to 1), as in `directional_albedo` of `albedo.wesl`.
    pub fn lookup(&self, alpha: f32, n_dot_v: f32) -> [f32; 2] {
        let alpha = if alpha.is_finite() { alpha.clamp(0.0, 1.0) } else { 1.0 };
        let cosine = if n_dot_v.is_finite() { n_dot_v } else { 1.0 }.clamp(MIN_VIEW_COSINE, 1.0);
        let (total, fresnel_root) = if alpha <= MIRROR_ALPHA {
            (1.0, 1.0 - cosine)
        } else {
            let row = alpha.sqrt();
            let x = (cosine * (1.0 + alpha) / (cosine + alpha)).sqrt();
            (self.bilinear(x, row, 0), self.bilinear(cosine.sqrt(), row, 1))
        };
        let b = total * fresnel_root.powi(5);
        [total - b, b]
    }

    fn bilinear(&self, x: f32, y: f32, channel: usize) -> f32 {
        let last = ALBEDO_TABLE_SIZE - 1;
        let split = |position: f32| {
            let position = position.clamp(0.0, 1.0) * last as f32;
            let low = (position as usize).min(last);
            (low, (low + 1).min(last), position - low as f32)
        };
        let (x0, x1, fx) = split(x);
        let (y0, y1, fy) = split(y);
        let texel = |x: usize, y: usize| self.texels[y * ALBEDO_TABLE_SIZE + x][channel];
        let top = texel(x0, y0) + (texel(x1, y0) - texel(x0, y0)) * fx;
        let bottom = texel(x0, y1) + (texel(x1, y1) - texel(x0, y1)) * fx;
        top + (bottom - top) * fy
    }
}

/// Nodes and weights over the square that the bounded sampler of `sampling.wesl` warps into reflected directions.
struct Quadrature {
    polar: [[f32; 2]; POLAR],
    cosine: [f32; AZIMUTH],
    sine: [f32; AZIMUTH],
}

impl Quadrature {
    fn new() -> Self {
        let azimuth = |i: usize| PI * (i as f32 + 0.5) / AZIMUTH as f32;
        // The far end of the cap contains the lobe's long tail: t -> 1 - (1 - t)^2 puts more nodes there.
        let polar = gauss_legendre::<POLAR>().map(|[t, weight]| {
            let rest = 1.0 - t;
            [(1.0 - rest * rest) as f32, (2.0 * weight * rest) as f32]
        });
        Self {
            polar,
            cosine: core::array::from_fn(|i| azimuth(i).cos()),
            sine: core::array::from_fn(|i| azimuth(i).sin()),
        }
    }

    /// `[A + B, B]`: means of the sample's weight, and of the weight times `(1 - h.v)^5`.
    fn integrate(&self, alpha: f32, n_dot_v: f32) -> [f32; 2] {
        let vz = n_dot_v.clamp(TABLE_MIN_COSINE, 1.0);
        let vx = (1.0 - vz * vz).sqrt();
        let a2 = alpha * alpha;
        let root_v = (a2 * vx * vx + vz * vz).sqrt();
        let (sx, sz) = (alpha * vx / root_v, vz / root_v);
        let s2 = (1.0 + vx) * (1.0 + vx);
        let k = (1.0 - a2) * s2 / (s2 + a2 * vz * vz);

        // One sum per azimuth, so that the loop over azimuths vectorises.
        let mut total = [0.0; AZIMUTH];
        let mut fresnel = [0.0; AZIMUTH];
        for [t, weight] in self.polar {
            let drop = t * (1.0 + k * sz);
            let sine = (drop * (2.0 - drop)).max(0.0).sqrt();
            let hz = sz + 1.0 - drop;
            for i in 0..AZIMUTH {
                let hx = alpha * (sx + sine * self.cosine[i]);
                let hy = alpha * sine * self.sine[i];
                let inverse_square = 1.0 / (hx * hx + hy * hy + hz * hz).max(1e-30);
                let projection = vx * hx + vz * hz;
                let lz = (2.0 * projection * hz * inverse_square - vz).max(0.0);
                let root_l = (a2 + (1.0 - a2) * lz * lz).sqrt();
                let contribution = weight * lz / (lz * root_v + vz * root_l);
                let x = 1.0 - projection * inverse_square.sqrt();
                total[i] += contribution;
                fresnel[i] += contribution * (x * x) * (x * x) * x;
            }
        }
        let scale = (k * vz + root_v) / AZIMUTH as f32;
        [scale * total.iter().sum::<f32>(), scale * fresnel.iter().sum::<f32>()]
    }
}

/// Nodes within 0..1 and weights that sum to 1, by Newton's method on Legendre's polynomial.
fn gauss_legendre<const N: usize>() -> [[f64; 2]; N] {
    core::array::from_fn(|i| {
        let mut x = (core::f64::consts::PI * (i as f64 + 0.75) / (N as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..16 {
            let (mut p0, mut p1) = (1.0, x);
            for k in 2..=N {
                let k = k as f64;
                (p0, p1) = (p1, ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k);
            }
            slope = N as f64 * (x * p1 - p0) / (x * x - 1.0);
            x -= p1 / slope;
        }
        [0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope)]
    })
}
