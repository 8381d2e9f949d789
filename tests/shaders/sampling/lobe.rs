//! The reflection lobe: samples against densities, weights against albedos.

use super::reference::*;
use bevy::math::{UVec2, Vec2, Vec3, uvec2, vec2};
use bevy_glint::internals::directional_albedo::DirectionalAlbedo;
use core::f64::consts::PI;

const ALPHAS: [f32; 8] = [0.0011, 0.004, 0.02, 0.1, 0.25, 0.5, 0.8, 1.0];
const COSINES: [f32; 6] = [1.0, 0.9, 0.5, 0.2, 0.05, 0.003];
const SAMPLERS: [(&str, Sampler, Pdf); 2] = [
    ("bounded", sample_reflection, reflection_pdf),
    ("ndf", sample_reflection_ndf, reflection_pdf_ndf),
];

/// Rounding of a direction in 32 bits moves a half vector by that over 2 * h.v: as part of the lobe's width or of h.v.
fn direction_digits(alpha: f32, half_dot_view: f32) -> f32 {
    f32::EPSILON / (2.0 * half_dot_view * alpha.min(half_dot_view))
}

/// Probability of a chi-square value above `x`, by Wilson and Hilferty.
fn chi_square_tail(x: f64, freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    let z = ((x / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
    // Abramowitz & Stegun 7.1.26
    let t = 1.0 / (1.0 + 0.3275911 * (z / 2f64.sqrt()).abs());
    let series = [1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592];
    let tail = 0.5 * series.iter().fold(0.0, |sum, c| (sum + c) * t) * (-z * z / 2.0).exp();
    if z > 0.0 { tail } else { 1.0 - tail }
}

/// Bins over half vectors, in coordinates in which the lobe of any alpha looks the same. The last bin contains lost samples.
const RINGS: usize = 12;
const SECTORS: usize = 12;
const BINS: usize = RINGS * SECTORS + 1;

fn bin_of(view: Vec3, alpha: f32, sample: &ReflectionSample) -> usize {
    if !sample.valid {
        return BINS - 1;
    }
    let h = (view.as_dvec3() + sample.direction.as_dvec3()).normalize();
    let t2 = (h.x * h.x + h.y * h.y) / (h.z * h.z * f64::from(alpha * alpha));
    let ring = ((1.0 - 1.0 / (1.0 + t2).sqrt()) * RINGS as f64) as usize;
    let sector = ((h.y.atan2(h.x) / (2.0 * PI) + 0.5) * SECTORS as f64) as usize;
    ring.min(RINGS - 1) * SECTORS + sector.min(SECTORS - 1)
}

/// Integral of the density over each bin.
fn expected_bins(view: Vec3, alpha: f32, pdf: Pdf) -> Vec<f64> {
    const STEPS: usize = 32;
    let a2 = f64::from(alpha * alpha);
    let mut bins = vec![0.0; BINS];
    for i in 0..RINGS * STEPS {
        for j in 0..SECTORS * STEPS {
            // Points of different sectors are at different parts of the step, so that the horizon, where densities end, is not rounded
            // the same way everywhere.
            let x = (i as f64 + (j as f64 * 0.618_033_988_75).fract()) / (RINGS * STEPS) as f64;
            // tan^2 of half vectors = alpha^2 (1 / rest^2 - 1): smooth for the density of visible normals up to the last ring.
            let rest = 1.0 - x;
            let tan2 = a2 * (1.0 / (rest * rest) - 1.0);
            let cos2 = 1.0 / (1.0 + tan2);
            let (sine, cosine) = ((tan2 * cos2).sqrt(), cos2.sqrt());
            // dω = sin dθ dφ = cos^3 / 2 d(tan^2) dφ
            let measure = cos2 * cosine * a2 / (rest * rest * rest) * 2.0 * PI
                / ((RINGS * STEPS) as f64 * (SECTORS * STEPS) as f64);
            let phi = ((j as f64 + 0.5) / (SECTORS * STEPS) as f64 - 0.5) * 2.0 * PI;
            let h = bevy::math::dvec3(sine * phi.cos(), sine * phi.sin(), cosine);
            let projection = h.dot(view.as_dvec3());
            if projection > 0.0 {
                let direction = 2.0 * projection * h - view.as_dvec3();
                let density = f64::from(pdf(view, direction.as_vec3(), alpha));
                bins[i / STEPS * SECTORS + j / STEPS] += density * 4.0 * projection * measure;
            }
        }
    }
    bins[BINS - 1] = (1.0 - bins.iter().sum::<f64>()).max(0.0);
    bins
}

#[test]
fn samples_follow_their_density() {
    const SAMPLES: usize = 100_000;
    for (name, sample, pdf) in SAMPLERS {
        for alpha in ALPHAS {
            for (case, cosine) in COSINES.into_iter().enumerate() {
                let view = guard_view(view_at(cosine, 0.7 + case as f32));
                // A histogram with steps from rounded directions is useless.
                if direction_digits(alpha, cosine) > 0.01 {
                    continue;
                }
                let mut random = Random(case as u64);
                let mut counts = vec![0usize; BINS];
                for _ in 0..SAMPLES {
                    counts[bin_of(view, alpha, &sample(view, alpha, random.next2()))] += 1;
                }
                // Bins with few samples are not Gaussian, so they share one.
                let (mut statistic, mut freedom, mut rest) = (0.0, -1.0, (0.0, 0.0));
                let mut add = |count: f64, expected: f64| {
                    statistic += (count - expected).powi(2) / expected;
                    freedom += 1.0;
                };
                for (count, expected) in counts.iter().zip(expected_bins(view, alpha, pdf)) {
                    let (count, expected) = (*count as f64, expected * SAMPLES as f64);
                    if expected < 20.0 {
                        rest = (rest.0 + count, rest.1 + expected);
                    } else {
                        add(count, expected);
                    }
                }
                if rest.1 >= 5.0 {
                    add(rest.0, rest.1);
                } else {
                    assert!(
                        rest.0 < 20.0 + rest.1,
                        "{name} alpha {alpha} n.v {cosine}: {} strays",
                        rest.0
                    );
                }
                let probability = chi_square_tail(statistic, freedom);
                // 96 cases: one in a thousand runs of all would fall below by chance.
                assert!(
                    probability > 1e-5,
                    "{name} alpha {alpha} n.v {cosine}: chi2 {statistic:.1} at {freedom} degrees, p {probability:.2e}",
                );
            }
        }
    }
}

#[test]
fn weight_and_inverse_pdf_belong_to_the_direction() {
    let mut worst = [0.0f32; 2];
    for (name, sample, pdf) in SAMPLERS {
        for alpha in ALPHAS {
            for cosine in COSINES {
                let view = guard_view(view_at(cosine, 2.0));
                for index in 0..512 {
                    let drawn = sample(view, alpha, sobol(UVec2::ONE, index, 0));
                    if !drawn.valid || drawn.direction.z < 1e-3 {
                        continue;
                    }
                    assert!((drawn.direction.length() - 1.0).abs() < 1e-5);
                    let density = pdf(view, drawn.direction, alpha);
                    let pdf_error = (density * drawn.inverse_pdf - 1.0).abs();
                    let weight = specular_lobe(view, drawn.direction, alpha) / density;
                    let weight_error = (weight / drawn.weight - 1.0).abs();
                    let digits = direction_digits(alpha, drawn.half_dot_view);
                    assert!(
                        pdf_error < 2e-5 + 8.0 * digits,
                        "{name} {alpha} {cosine}: pdf off by {pdf_error}"
                    );
                    assert!(
                        weight_error < 2e-4 + 8.0 * digits,
                        "{name} {alpha} {cosine}: weight off by {weight_error}"
                    );
                    worst = [worst[0].max(pdf_error), worst[1].max(weight_error)];
                }
            }
        }
    }
    println!("largest relative error: pdf {:.1e}, weight {:.1e}", worst[0], worst[1]);
}

/// `[A + B, B]` by brute force over half vectors, from only Bevy's D and V.
fn brute_force_albedo(alpha: f64, n_dot_v: f64) -> [f64; 2] {
    const RINGS: usize = 600;
    const SECTORS: usize = 256;
    let (a2, vx) = (alpha * alpha, (1.0 - n_dot_v * n_dot_v).max(0.0).sqrt());
    let root = |c: f64| (a2 + (1.0 - a2) * c * c).sqrt();
    let mut sum = [0.0; 2];
    for i in 0..RINGS {
        let s = (i as f64 + 0.5) / RINGS as f64;
        // Most of the lobe and its tail get their share of rings.
        let r = 1.0 - (1.0 - s).powi(3);
        let rest = (1.0 - s).powi(3);
        let tan2 = a2 * r / rest;
        let cos2 = 1.0 / (1.0 + tan2);
        let (sine, cosine) = ((tan2 * cos2).sqrt(), cos2.sqrt());
        let measure = 0.5 * cos2 * cosine * a2 / (rest * rest) * 3.0 * (1.0 - s).powi(2) / RINGS as f64;
        let e = sine * sine + a2 * cos2;
        let d = a2 / (PI * e * e);
        for j in 0..SECTORS {
            let phi = PI * (j as f64 + 0.5) / SECTORS as f64;
            let projection = vx * sine * phi.cos() + n_dot_v * cosine;
            let nl = 2.0 * projection * cosine - n_dot_v;
            if projection > 0.0 && nl > 0.0 {
                let v = 0.5 / (nl * root(n_dot_v) + n_dot_v * root(nl));
                let value = d * v * nl * 4.0 * projection * measure * 2.0 * PI / SECTORS as f64;
                sum[0] += value;
                sum[1] += value * (1.0 - projection).powi(5);
            }
        }
    }
    sum
}

#[test]
fn the_table_is_the_albedo_of_the_lobe() {
    let start = std::time::Instant::now();
    let table = DirectionalAlbedo::new();
    let elapsed = start.elapsed();
    assert_eq!(table, DirectionalAlbedo::new());
    let mut worst = [(0.0, 0.0, 0.0); 4];
    for i in 0..24 {
        let alpha = (0.0332 + (1.0 - 0.0332) * i as f32 / 23.0).powi(2);
        for j in 0..24 {
            let n_dot_v = ((j as f32 + 0.5) / 23.5).powi(3).max(MIN_VIEW_COSINE);
            let [total, fresnel] = brute_force_albedo(alpha.into(), n_dot_v.into());
            let [a, b] = table.lookup(alpha, n_dot_v).map(f64::from);
            for (case, f0) in [1.0, 0.5, 0.04, 0.02].into_iter().enumerate() {
                let error = ((f0 * a + b) / (f0 * (total - fresnel) + fresnel) - 1.0).abs();
                if error > worst[case].0 {
                    worst[case] = (error, alpha, n_dot_v);
                }
            }
        }
    }
    println!("table in {elapsed:?}; largest relative error at F0 1, 0.5, 0.04, 0.02: {worst:?}");
    for (error, alpha, n_dot_v) in worst {
        assert!(error < 0.005, "off by {error} at alpha {alpha}, n.v {n_dot_v}");
    }
    let [a, b] = table.lookup(0.0005, 0.3);
    assert!((a + b - 1.0).abs() < 1e-6 && (b - 0.7f32.powi(5)).abs() < 1e-6);
    for hostile in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 2.0] {
        for [a, b] in [table.lookup(hostile, 0.5), table.lookup(0.5, hostile)] {
            assert!((0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b));
        }
    }
}

#[test]
fn weights_average_to_the_albedo() {
    let table = DirectionalAlbedo::new();
    for alpha in ALPHAS {
        for cosine in COSINES {
            let view = guard_view(view_at(cosine, 4.0));
            let n = 1 << 14;
            let mean = (0..n)
                .map(|i| {
                    let drawn = sample_reflection(view, alpha, sobol(uvec2(3, 8), i, 0));
                    assert!((0.0..=1.0).contains(&drawn.weight));
                    f64::from(drawn.weight)
                })
                .sum::<f64>()
                / f64::from(n);
            let [a, b] = table.lookup(alpha, view.z);
            let error = (mean / f64::from(a + b) - 1.0).abs();
            assert!(error < 0.005, "alpha {alpha} n.v {cosine}: mean weight off by {error}");
        }
    }
}

#[test]
fn a_white_furnace_reflects_the_split_sum() {
    let table = DirectionalAlbedo::new();
    let materials = [
        calculate_f0(Vec3::ZERO, 0.0, Vec3::splat(0.5)),
        calculate_f0(Vec3::ZERO, 0.0, Vec3::splat(0.2)),
        calculate_f0(Vec3::new(1.0, 0.71, 0.29), 1.0, Vec3::ZERO),
        calculate_f0(Vec3::ONE, 1.0, Vec3::ZERO),
        calculate_f0(Vec3::new(0.8, 0.1, 0.05), 0.4, Vec3::splat(0.5)),
    ];
    let mut worst = 0.0f32;
    for f0 in materials {
        for step in 0..=20 {
            let roughness = step as f32 / 20.0;
            for cosine in COSINES {
                let view = guard_view(view_at(cosine, 1.0));
                let f90 = specular_f90(f0);
                let [fss_ess, ..] = compute_multiscatter(f0, f_ab(roughness, view.z), f90);
                let albedo = table.lookup(roughness * roughness, view.z);
                let n = 1 << 13;
                let sum = (0..n).fold(bevy::math::DVec3::ZERO, |sum, i| {
                    let drawn = sample_reflection(view, roughness * roughness, sobol(uvec2(7, 1), i, 0));
                    sum + reflection_throughput(&drawn, f0, f90, albedo, fss_ess).as_dvec3()
                });
                let error = ((sum / f64::from(n)).as_vec3() / fss_ess - 1.0).abs().max_element();
                assert!(
                    error < 0.01,
                    "F0 {f0} roughness {roughness} n.v {cosine}: off by {error}"
                );
                worst = worst.max(error);
            }
        }
    }
    println!("largest relative error in a white furnace: {worst:.2e}");
    let black = reflection_throughput(
        &sample_reflection(Vec3::Z, 0.3, vec2(0.2, 0.4)),
        Vec3::ZERO,
        0.0,
        [0.9, 0.01],
        Vec3::ZERO,
    );
    assert_eq!(black, Vec3::ZERO);
}

#[test]
fn no_input_makes_a_broken_sample() {
    for (_, sample, pdf) in SAMPLERS {
        for (view, alpha, u) in hostile_inputs() {
            let drawn = sample(view, alpha, u);
            assert!(drawn.direction.is_finite() && drawn.weight.is_finite() && drawn.inverse_pdf.is_finite());
            assert!(drawn.direction.z >= 0.0 && (drawn.direction.length() - 1.0).abs() < 1e-4);
            assert!(drawn.weight >= 0.0 && (drawn.valid || drawn.weight == 0.0));
            assert!(pdf(view, drawn.direction, alpha).is_finite());
            assert!(specular_lobe(view, drawn.direction, alpha).is_finite());
        }
        assert!(!sample(Vec3::NAN, 0.3, Vec2::ZERO).valid && !sample(Vec3::Z, 0.3, Vec2::NAN).valid);
    }
}

#[test]
fn mirrors_are_exact_and_the_lobe_grows_out_of_them() {
    for cosine in COSINES {
        let view = guard_view(view_at(cosine, 5.0));
        let mirror = sample_reflection(view, MIRROR_ALPHA, vec2(0.9, 0.9));
        assert_eq!(mirror.direction, Vec3::new(-view.x, -view.y, view.z));
        assert_eq!((mirror.weight, mirror.inverse_pdf, mirror.valid), (1.0, 0.0, true));
        let n = 4096;
        let near = (0..n).filter(|i| {
            let drawn = sample_reflection(view, 0.00101, sobol(UVec2::ZERO, *i, 0));
            drawn.direction.dot(mirror.direction) > 0.999
        });
        assert!(near.count() > n as usize * 99 / 100);
    }
}

#[test]
fn views_below_the_horizon_become_grazing() {
    for z in [-1e-6, -0.05, -0.3, -0.9] {
        let below = view_at(z, 1.2);
        let guarded = guard_view(below);
        assert!(guarded.z > 0.0 && guarded.z < 0.5 && guarded.is_normalized());
        assert!((guard_view(guarded) - guarded).abs().max_element() < 1e-6);
        assert!(guarded.truncate().angle_to(below.truncate()).abs() < 1e-3);
    }
}

#[test]
fn bases_are_orthonormal_everywhere() {
    let mut random = Random(9);
    let poles = [
        Vec3::Z,
        -Vec3::Z,
        Vec3::X,
        Vec3::new(1e-8, 0.0, -1.0).normalize(),
        Vec3::new(1.0, 0.0, -0.0),
    ];
    let spread = core::iter::from_fn(|| {
        Some((Vec3::new(random.next(), random.next(), random.next()) - 0.5).normalize_or(Vec3::Y))
    });
    for normal in poles.into_iter().chain(spread.take(10_000)) {
        let basis = orthonormal_basis(normal);
        let product = basis.transpose() * basis;
        assert!(
            product.abs_diff_eq(bevy::math::Mat3::IDENTITY, 2e-6),
            "{normal}: {product}"
        );
        assert!((basis.determinant() - 1.0).abs() < 2e-6 && basis.z_axis == normal);
    }
}
