//! `src/trace/{sampling,noise,brdf}.wesl` in Rust, line by line, for tests.
use bevy::math::{FloatExt, Mat3, UVec2, Vec2, Vec3, vec2, vec3};
use core::f32::consts::PI;

pub const MIRROR_ALPHA: f32 = 0.001;
pub const MIN_VIEW_COSINE: f32 = 1e-4;
pub const MIN_DIRECTION_COSINE: f32 = 1e-6;

#[derive(Clone, Copy, Debug)]
pub struct ReflectionSample {
    pub direction: Vec3,
    pub weight: f32,
    pub inverse_pdf: f32,
    pub half_dot_view: f32,
    pub valid: bool,
}

pub type Sampler = fn(Vec3, f32, Vec2) -> ReflectionSample;
pub type Pdf = fn(Vec3, Vec3, f32) -> f32;

pub fn orthonormal_basis(normal: Vec3) -> Mat3 {
    let sign = if normal.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    Mat3::from_cols(
        vec3(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        vec3(b, sign + normal.y * normal.y * a, -normal.y),
        normal,
    )
}

fn is_usable_view(view: Vec3) -> bool {
    let length_squared = view.dot(view);
    length_squared.is_finite() && length_squared > 1e-12
}

pub fn guard_view(view: Vec3) -> Vec3 {
    if !is_usable_view(view) {
        return Vec3::Z;
    }
    let unit = view / view.length();
    let z = if unit.z < 0.0 { -0.25 * unit.z } else { unit.z };
    vec3(unit.x, unit.y, z.max(MIN_VIEW_COSINE)).normalize()
}

pub fn guard_alpha(alpha: f32) -> f32 {
    if alpha.is_finite() { alpha.clamp(0.0, 1.0) } else { 1.0 }
}

pub fn d_ggx(h: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let e = h.x * h.x + h.y * h.y + a2 * h.z * h.z;
    a2 / (PI * (e * e).max(1e-30))
}

pub fn smith_root(alpha: f32, cosine: f32) -> f32 {
    let a2 = alpha * alpha;
    (a2 + (1.0 - a2) * cosine * cosine).sqrt()
}

pub fn g1_smith(alpha: f32, cosine: f32) -> f32 {
    2.0 * cosine / (cosine + smith_root(alpha, cosine)).max(1e-20)
}

pub fn v_smith_correlated(alpha: f32, n_dot_v: f32, n_dot_l: f32) -> f32 {
    0.5 / (n_dot_l * smith_root(alpha, n_dot_v) + n_dot_v * smith_root(alpha, n_dot_l)).max(1e-20)
}

fn is_delta_or_below(direction: Vec3, alpha: f32) -> bool {
    alpha <= MIRROR_ALPHA
        || !direction.is_finite()
        || direction.z.partial_cmp(&MIN_DIRECTION_COSINE) != Some(core::cmp::Ordering::Greater)
}

pub fn specular_lobe(view: Vec3, direction: Vec3, alpha: f32) -> f32 {
    let a = guard_alpha(alpha);
    if is_delta_or_below(direction, a) {
        return 0.0;
    }
    let v = guard_view(view);
    d_ggx((v + direction).normalize(), a) * v_smith_correlated(a, v.z, direction.z) * direction.z
}

fn cap_bound(v: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let s = 1.0 + v.truncate().length();
    let s2 = s * s;
    (1.0 - a2) * s2 / (s2 + a2 * v.z * v.z)
}

fn mirrored(v: Vec3, valid: bool) -> ReflectionSample {
    ReflectionSample {
        direction: vec3(-v.x, -v.y, v.z),
        weight: if valid { 1.0 } else { 0.0 },
        inverse_pdf: 0.0,
        half_dot_view: v.z,
        valid,
    }
}

pub fn sample_reflection(view: Vec3, alpha: f32, u: Vec2) -> ReflectionSample {
    let v = guard_view(view);
    if !is_usable_view(view) || !u.is_finite() {
        return mirrored(v, false);
    }
    let a = guard_alpha(alpha);
    if a <= MIRROR_ALPHA {
        return mirrored(v, true);
    }
    let k = cap_bound(v, a);
    let root_v = smith_root(a, v.z);
    let v_std = vec3(a * v.x, a * v.y, v.z) / root_v;
    let drop = u.y.clamp(0.0, 1.0) * (1.0 + k * v_std.z);
    let sine = (drop * (2.0 - drop)).max(0.0).sqrt();
    let phi = 2.0 * PI * u.x;
    let half_std = v_std + vec3(sine * phi.cos(), sine * phi.sin(), 1.0 - drop);
    let stretched = vec3(a * half_std.x, a * half_std.y, half_std.z);
    let stretched_squared = stretched.dot(stretched);
    if stretched_squared <= 1e-30 {
        return mirrored(v, false);
    }
    let h = stretched / stretched_squared.sqrt();
    let h_dot_v = v.dot(h);
    let direction = 2.0 * h_dot_v * h - v;
    let n_dot_l = direction.z;
    let root_l = smith_root(a, n_dot_l);
    let spread = half_std.dot(half_std) / stretched_squared;
    let inverse_pdf = 2.0 * PI * (k * v.z + root_v) * (a * spread) * (a * spread);
    let weight = n_dot_l * (k * v.z + root_v) / (n_dot_l * root_v + v.z * root_l).max(1e-20);
    if !direction.is_finite() || !weight.is_finite() || !inverse_pdf.is_finite() || n_dot_l <= MIN_DIRECTION_COSINE {
        return mirrored(v, false);
    }
    ReflectionSample {
        direction,
        weight,
        inverse_pdf,
        half_dot_view: h_dot_v.clamp(0.0, 1.0),
        valid: true,
    }
}

pub fn reflection_pdf(view: Vec3, direction: Vec3, alpha: f32) -> f32 {
    let a = guard_alpha(alpha);
    if is_delta_or_below(direction, a) {
        return 0.0;
    }
    let v = guard_view(view);
    d_ggx((v + direction).normalize(), a) / (2.0 * (cap_bound(v, a) * v.z + smith_root(a, v.z)))
}

pub fn sample_reflection_ndf(view: Vec3, alpha: f32, u: Vec2) -> ReflectionSample {
    let v = guard_view(view);
    if !is_usable_view(view) || !u.is_finite() {
        return mirrored(v, false);
    }
    let a = guard_alpha(alpha);
    if a <= MIRROR_ALPHA {
        return mirrored(v, true);
    }
    let a2 = a * a;
    let t = u.y.clamp(0.0, 1.0);
    let scale = 1.0 / (1.0 - t + a2 * t);
    let cosine = ((1.0 - t) * scale).max(0.0).sqrt();
    let sine = (a2 * t * scale).sqrt();
    let phi = 2.0 * PI * u.x;
    let h = vec3(sine * phi.cos(), sine * phi.sin(), cosine);
    let h_dot_v = v.dot(h);
    let direction = 2.0 * h_dot_v * h - v;
    let weight = 4.0 * v_smith_correlated(a, v.z, direction.z) * direction.z * h_dot_v / cosine.max(1e-20);
    let inverse_pdf = 4.0 * h_dot_v / (d_ggx(h, a) * cosine).max(1e-20);
    let finite = direction.is_finite() && weight.is_finite() && inverse_pdf.is_finite();
    if !finite || direction.z <= MIN_DIRECTION_COSINE || h_dot_v <= 0.0 {
        return mirrored(v, false);
    }
    ReflectionSample {
        direction,
        weight,
        inverse_pdf,
        half_dot_view: h_dot_v.clamp(0.0, 1.0),
        valid: true,
    }
}

pub fn reflection_pdf_ndf(view: Vec3, direction: Vec3, alpha: f32) -> f32 {
    let a = guard_alpha(alpha);
    if is_delta_or_below(direction, a) {
        return 0.0;
    }
    let v = guard_view(view);
    let h = (v + direction).normalize();
    d_ggx(h, a) * h.z / (4.0 * v.dot(h)).max(1e-20)
}

pub fn pcg(input: u32) -> u32 {
    let state = input.wrapping_mul(747796405).wrapping_add(2891336453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277803737);
    (word >> 22) ^ word
}

pub fn pixel_seed(pixel: UVec2) -> u32 {
    pcg(pixel.x.wrapping_add(pcg(pixel.y)))
}

pub fn unit_float(bits: u32) -> f32 {
    (bits >> 8) as f32 / (1 << 24) as f32
}

pub fn radical_inverse_3(index: u32) -> u32 {
    let (mut rest, mut digit_value, mut result) = (index, 0x5555_5555, 0);
    while rest != 0 {
        result += (rest % 3) * digit_value;
        digit_value /= 3;
        rest /= 3;
    }
    result
}

pub fn halton_rotated(pixel: UVec2, index: u32) -> Vec2 {
    let seed = pixel_seed(pixel);
    vec2(
        unit_float(index.reverse_bits().wrapping_add(seed)),
        unit_float(radical_inverse_3(index).wrapping_add(pcg(seed))),
    )
}

pub fn owen_scramble_reversed(reversed: u32, seed: u32) -> u32 {
    let mut x = reversed;
    x ^= x.wrapping_mul(0x3d20adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x05526c56);
    x ^= x.wrapping_mul(0x53a22864);
    x
}

pub fn sobol_1_reversed(index: u32) -> u32 {
    let mut x = index;
    x ^= x >> 16;
    x ^= (x & 0xff00ff00) >> 8;
    x ^= (x & 0xf0f0f0f0) >> 4;
    x ^= (x & 0xcccccccc) >> 2;
    x ^= (x & 0xaaaaaaaa) >> 1;
    x
}

pub fn sobol(pixel: UVec2, index: u32, dimension: u32) -> Vec2 {
    let seed = pcg(pixel_seed(pixel) ^ dimension.wrapping_mul(0x9e3779b9));
    let seed_x = pcg(seed);
    let seed_y = pcg(seed_x);
    let shuffled = owen_scramble_reversed(index.reverse_bits(), seed).reverse_bits();
    vec2(
        unit_float(owen_scramble_reversed(shuffled, seed_x).reverse_bits()),
        unit_float(owen_scramble_reversed(sobol_1_reversed(shuffled), seed_y).reverse_bits()),
    )
}

pub fn specular_f90(f0: Vec3) -> f32 {
    (16.5 * (f0.x + f0.y + f0.z)).clamp(0.0, 1.0)
}

pub fn fresnel_schlick(f0: Vec3, f90: f32, half_dot_view: f32) -> Vec3 {
    f0 + (Vec3::splat(f90) - f0) * (1.0 - half_dot_view).clamp(0.0, 1.0).powi(5)
}

/// The polynomial of Bevy's `F_AB`.
pub fn f_ab(perceptual_roughness: f32, n_dot_v: f32) -> Vec2 {
    let r = |scale: f32, offset: f32| perceptual_roughness * scale + offset;
    let (x, y) = (r(-1.0, 1.0), r(-0.0275, 0.0425));
    let a004 = (x * x).min((-9.28 * n_dot_v).exp2()) * x + y;
    vec2(-1.04 * a004 + r(-0.572, 1.04), 1.04 * a004 + r(0.022, -0.04)).max(Vec2::splat(0.00005))
}

/// `[FssEss, FmsEms, Edss]`.
pub fn compute_multiscatter(f0: Vec3, f_ab: Vec2, specular_occlusion: f32) -> [Vec3; 3] {
    let ems = 1.0 - (f_ab.x + f_ab.y);
    let fss_ess = (f0 * f_ab.x + f_ab.y) * specular_occlusion;
    let f_average = f0 + (Vec3::ONE - f0) / 21.0;
    let fms_ems = fss_ess * f_average / (Vec3::ONE - ems * f_average) * ems;
    [fss_ess, fms_ems, Vec3::ONE - (fss_ess + fms_ems)]
}

pub fn reflection_throughput(
    reflection: &ReflectionSample,
    f0: Vec3,
    f90: f32,
    albedo: [f32; 2],
    fss_ess: Vec3,
) -> Vec3 {
    if !reflection.valid {
        return Vec3::ZERO;
    }
    let fresnel = fresnel_schlick(f0, f90, reflection.half_dot_view);
    let lobe_albedo = f0 * albedo[0] + Vec3::splat(f90 * albedo[1]);
    reflection.weight * fresnel / lobe_albedo.max(Vec3::splat(1e-6)) * fss_ess
}

/// A view with the given n.v, turned by `azimuth` about the normal.
pub fn view_at(n_dot_v: f32, azimuth: f32) -> Vec3 {
    let sine = (1.0 - n_dot_v * n_dot_v).max(0.0).sqrt();
    vec3(sine * azimuth.cos(), sine * azimuth.sin(), n_dot_v)
}

/// `mix` of two F0 as in `calculate_f0`.
pub fn calculate_f0(base_color: Vec3, metallic: f32, reflectance: Vec3) -> Vec3 {
    let dielectric = 0.16 * reflectance * reflectance;
    vec3(
        dielectric.x.lerp(base_color.x, metallic),
        dielectric.y.lerp(base_color.y, metallic),
        dielectric.z.lerp(base_color.z, metallic),
    )
}

/// Views, roughnesses and numbers that no sampler may fail with.
pub fn hostile_inputs() -> Vec<(Vec3, f32, Vec2)> {
    let (nan, infinite) = (f32::NAN, f32::INFINITY);
    let odd = [
        nan, infinite, -infinite, 0.0, -0.0, 1e-30, -1e-6, 1e-4, 0.5, 1.0, -1.0, 3e38,
    ];
    let numbers = [(0.0, 0.0), (0.99999994, 0.99999994), (0.5, 1.0), (nan, 0.5), (0.3, 5.0)];
    let mut inputs = Vec::new();
    for (x, z) in odd.iter().flat_map(|&x| odd.map(|z| (x, z))) {
        for alpha in [0.0, -1.0, 0.00101, 0.3, 1.0, 7.0, nan, infinite] {
            inputs.extend(numbers.map(|u| (vec3(x, 0.1, z), alpha, Vec2::from(u))));
        }
    }
    inputs
}

/// Whether two numbers differ by at most this fraction, or by that of 0.001.
pub fn close(a: f32, b: f32, tolerance: f32) -> bool {
    (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1e-3)
}

/// The next bits of `SplitMix64`.
pub fn split_mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Independent random numbers.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f32 {
        unit_float((split_mix(&mut self.0) >> 32) as u32)
    }

    pub fn next2(&mut self) -> Vec2 {
        vec2(self.next(), self.next())
    }

    pub fn direction(&mut self) -> Vec3 {
        let mut number = || self.next() * 2.0 - 1.0;
        vec3(number(), number(), number()).normalize_or(Vec3::Z)
    }
}
