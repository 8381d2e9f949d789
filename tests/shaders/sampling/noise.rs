//! Low-discrepancy sequences against their textbooks and their promises.

use super::reference::*;
use bevy::math::{UVec2, Vec2, uvec2, vec2};

#[test]
fn sobol_points_are_stratified_at_any_index() {
    // Direction numbers of the textbook.
    for index in (0..4096).chain([u32::MAX, 0x8000_0001, 123_456_789]) {
        let (mut value, mut direction, mut rest) = (0u32, 1u32 << 31, index);
        while rest != 0 {
            value ^= if rest & 1 == 1 { direction } else { 0 };
            direction ^= direction >> 1;
            rest >>= 1;
        }
        assert_eq!(sobol_1_reversed(index).reverse_bits(), value, "index {index}");
    }
    for base in [0u32, 1 << 16, 5 << 20, u32::MAX - 1023] {
        for pixel in [uvec2(0, 0), uvec2(1, 0), uvec2(1919, 1079)] {
            for dimension in 0..3 {
                for m in [4, 8, 10] {
                    for split in 0..=m {
                        let mut seen = vec![false; 1 << m];
                        for i in 0..1 << m {
                            let p = sobol(pixel, base + i, dimension);
                            let column = (p.x * (1 << split) as f32) as usize;
                            let row = (p.y * (1 << (m - split)) as f32) as usize;
                            let cell = &mut seen[row << split | column];
                            assert!(!*cell, "two of 2^{m} points from {base} in one cell, split {split}");
                            *cell = true;
                        }
                    }
                }
            }
        }
    }
}

/// The random numbers of a sample: its lobe, its direction, and the ones of each bounce.
#[test]
fn dimensions_of_a_sample_are_independent() {
    for pixel in [uvec2(0, 0), uvec2(17, 5), uvec2(1919, 1079)] {
        let columns: Vec<Vec<f64>> = (0..10)
            .flat_map(|dimension| {
                let points = move |pick: fn(Vec2) -> f32| {
                    let numbers = (0..1024).map(move |index| f64::from(pick(sobol(pixel, index, dimension))) - 0.5);
                    numbers.collect()
                };
                [points(|point| point.x), points(|point| point.y)]
            })
            .collect();
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns.iter().enumerate().skip(i + 1) {
                let correlation = 12.0 * a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / 1024.0;
                assert!(
                    correlation.abs() < 0.15,
                    "numbers {i} and {j} at {pixel}: {correlation}"
                );
            }
        }
    }
}

#[test]
fn halton_is_the_textbook_sequence_rotated() {
    let inverse = |mut index: u32, base: u32| {
        let (mut value, mut digit) = (0.0, 1.0);
        while index != 0 {
            digit /= f64::from(base);
            value += f64::from(index % base) * digit;
            index /= base;
        }
        value
    };
    let pixel = uvec2(640, 360);
    let start = halton_rotated(pixel, 0);
    for index in (1..1000).chain((1 << 20)..(1 << 20) + 1000).chain([u32::MAX]) {
        let point = halton_rotated(pixel, index);
        assert!((0.0..1.0).contains(&point.x) && (0.0..1.0).contains(&point.y));
        for (found, base, start) in [(point.x, 2, start.x), (point.y, 3, start.y)] {
            let wanted = (inverse(index, base) + f64::from(start)).fract();
            let error = (f64::from(found) - wanted).abs();
            assert!(
                error.min(1.0 - error) < 2e-7,
                "base {base} index {index}: {found} is not {wanted}"
            );
        }
    }
}

#[test]
fn sequences_converge_faster_than_random_numbers() {
    let view = guard_view(view_at(0.5, 0.3));
    // Radiance that changes over the lobe, as behind a reflector.
    let integrand = |u: Vec2| {
        let drawn = sample_reflection(view, 0.25, u);
        f64::from(drawn.weight * (0.5 + 0.5 * (5.0 * drawn.direction.x).sin() * drawn.direction.z))
    };
    let exact = (0..1 << 20)
        .map(|i| integrand(vec2((i & 1023) as f32 + 0.5, (i >> 10) as f32 + 0.5) / 1024.0))
        .sum::<f64>()
        / f64::from(1 << 20);
    let error = |n: u32, points: &mut dyn FnMut(UVec2, u32) -> Vec2| {
        let square: f64 = (0..64)
            .map(|i| {
                let pixel = uvec2(i % 8, i / 8);
                let mean = (0..n).map(|index| integrand(points(pixel, index))).sum::<f64>() / f64::from(n);
                (mean - exact).powi(2)
            })
            .sum();
        (square / 64.0).sqrt()
    };
    let mut random = Random(1);
    let mut table = Vec::new();
    for n in [16, 64, 256, 1024, 4096] {
        let independent = error(n, &mut |_, _| random.next2());
        let late = error(n, &mut |pixel, index| sobol(pixel, (1 << 20) + index, 0));
        table.push([
            independent,
            error(n, &mut halton_rotated),
            error(n, &mut |p, i| sobol(p, i, 0)),
            late,
        ]);
        let digits = table[table.len() - 1].map(|error| format!("{error:.1e}"));
        println!("n {n}: random, halton, sobol, sobol from 2^20: {}", digits.join(" "));
    }
    let [first, last] = [table[0], table[4]];
    assert!(last[1] < 0.2 * last[0] && last[2] < 0.1 * last[0] && last[3] < 0.1 * last[0]);
    // 256 times the points: random numbers gain 16, a rate of 1/n would gain 256.
    assert!(first[2] / last[2] > 100.0, "sobol gains {}", first[2] / last[2]);
}
