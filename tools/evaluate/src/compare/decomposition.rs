//! Splits the error of reflected light into noise, which differs from run to run, and bias, which doesn't: lag, blur and ghosts.
//!
//! Both are mean squares of linear luminance before tone mapping, since only squares of noise and bias add up to the squared error. FLIP
//! has no such sum.

use super::reflected_light::TrueLight;
use crate::{state::Split, stats::mean_and_variance};
use image::{Rgb, RgbImage};

/// Contrast at which colours of the maps are saturated.
const MAP_RANGE: f64 = 0.1;

/// Noise and bias of a technique in a view, in numbers and as images.
pub struct Decomposition {
    /// Mean squares over all pixels.
    pub split: Split,
    /// Standard deviation between runs: white is [`MAP_RANGE`].
    pub noise: RgbImage,
    /// The mean of the runs against the truth: red for too bright, blue for too dark, black for correct.
    pub bias: RgbImage,
}

/// Compares frames that differ only in their noise with the truth; `None` unless there are at least two, all of the truth's size.
///
/// The mean of the runs still has some of their noise, and the truth has its own noise. Both would count as bias, so both variances are
/// subtracted from the squared bias. The truth's variance comes from the difference of its halves. The result for a technique without
/// bias is about 0, and can be negative.
pub fn decompose(truth: &TrueLight, runs: &[Vec<f32>]) -> Option<Decomposition> {
    let pixels = truth.without().len();
    if runs.len() < 2 || pixels == 0 || runs.iter().any(|run| run.len() != pixels) {
        return None;
    }
    let halves = truth.halves();
    let whole = |index: usize| 0.5 * (f64::from(halves[0][index]) + f64::from(halves[1][index]));
    let frame_mean = (0..pixels).map(whole).sum::<f64>() / pixels as f64;
    let (width, height) = (truth.width(), (pixels as u32).div_ceil(truth.width().max(1)));
    let (mut noise_map, mut bias_map) = (RgbImage::new(width, height), RgbImage::new(width, height));
    let pixel = |index: usize| {
        let expected = whole(index);
        let (mean, variance) = mean_and_variance(runs.iter().map(|run| f64::from(run[index])));
        let of_truth = 0.25 * f64::from(halves[0][index] - halves[1][index]).powi(2);
        let difference = mean - expected;
        let bias = difference.powi(2) - variance / runs.len() as f64 - of_truth;
        // The difference in a highlight that is ten times as bright is visible only if it is ten times as large. Only the ground truth
        // determines the brightness of a pixel: weights that followed the runs would follow their noise, and its rare bright values
        // would look like bias.
        let scale = (expected.max(0.0) + frame_mean).max(1e-9);
        let (x, y) = (index as u32 % width, index as u32 / width);
        noise_map[(x, y)] = Rgb([level(variance.sqrt() / scale); 3]);
        let signed = (difference / scale).clamp(-MAP_RANGE, MAP_RANGE);
        bias_map[(x, y)] = if signed > 0.0 {
            Rgb([level(signed), level(0.5 * signed), level(0.2 * signed)])
        } else {
            Rgb([level(-0.2 * signed), level(-0.5 * signed), level(-signed)])
        };
        Split {
            light: expected - f64::from(truth.without()[index]),
            noise: variance,
            bias,
            contrast_noise: variance / scale.powi(2),
            contrast_bias: bias / scale.powi(2),
        }
    };
    let split = Split::mean((0..pixels).map(pixel));
    Some(Decomposition {
        split,
        noise: noise_map,
        bias: bias_map,
    })
}

/// A contrast as a byte.
fn level(contrast: f64) -> u8 {
    (255.0 * (contrast / MAP_RANGE).clamp(0.0, 1.0)) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        compare::reflected_light::{Objects, Surroundings},
        stats::normal,
    };
    use glint_scenes::Random;

    const WIDTH: u32 = 160;
    const PIXELS: usize = 160 * 120;
    const RUNS: usize = 4;
    const WITHOUT: f32 = 0.2;
    const LIGHT: f32 = 0.5;
    const TRUTH_NOISE: f32 = 0.05;

    fn plane(mut value: impl FnMut(usize) -> f32) -> Vec<f32> {
        (0..PIXELS).map(&mut value).collect()
    }

    fn truth(random: &mut Random) -> TrueLight {
        let surroundings = Surroundings {
            without: plane(|_| WITHOUT),
            in_white: plane(|_| 1.0),
            distance: plane(|_| 1.0),
            objects: Objects::default(),
        };
        let half = |random: &mut Random| plane(|_| WITHOUT + LIGHT + TRUTH_NOISE * normal(random) as f32);
        let halves = [half(random), half(random)];
        TrueLight::new(WIDTH, surroundings, halves)
    }

    /// Runs of a technique with columns that are alternately too bright and too dark.
    fn runs(random: &mut Random, bias: f32, noise: f32) -> Vec<Vec<f32>> {
        let frame = |random: &mut Random| {
            plane(|index| {
                let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
                WITHOUT + LIGHT + sign * bias + noise * normal(random) as f32
            })
        };
        (0..RUNS).map(|_| frame(random)).collect()
    }

    #[test]
    fn known_noise_and_bias_are_found() {
        let mut random = Random::new(11);
        let truth = truth(&mut random);
        for (bias, noise) in [(0.03, 0.1), (0.1, 0.02), (0.05, 0.0), (0.0, 0.1)] {
            let found = decompose(&truth, &runs(&mut random, bias, noise)).unwrap().split;
            let (bias, noise) = (f64::from(bias), f64::from(noise));
            assert!(
                (found.noise.sqrt() - noise).abs() < 0.02 * noise + 1e-6,
                "{noise}: {found:?}"
            );
            assert!(
                (found.bias - bias * bias).abs() < 0.04 * bias * bias + 1e-4,
                "{bias}: {found:?}"
            );
            assert!((found.light - f64::from(LIGHT)).abs() < 0.01, "{found:?}");
            // Contrast is relative to the pixel and to the frame, which here have the same luminance.
            let scale = 2.0 * f64::from(WITHOUT + LIGHT);
            assert!(
                (found.contrast_noise.sqrt() * scale - noise).abs() < 0.05 * noise + 1e-6,
                "{found:?}"
            );
        }
    }

    #[test]
    fn noise_of_runs_and_truth_is_no_bias() {
        let mut random = Random::new(3);
        let found = decompose(&truth(&mut random), &runs(&mut random, 0.0, 0.1))
            .unwrap()
            .split;
        // The noise of the mean alone would give a square of 0.0025, and the noise of the truth 0.00125.
        assert!(found.bias.abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn sparse_bright_noise_is_no_bias() {
        let mut random = Random::new(7);
        let truth = truth(&mut random);
        let (bright, share) = (10.0, 0.01);
        let frame = |random: &mut Random| {
            plane(|_| WITHOUT + LIGHT - bright * share + if random.unit() < share { bright } else { 0.0 })
        };
        let runs: Vec<Vec<f32>> = (0..RUNS).map(|_| frame(&mut random)).collect();
        let found = decompose(&truth, &runs).unwrap().split;
        // A variance of 0.99, relative to a pixel and a frame of 0.7 each.
        assert!((found.contrast_noise - 0.505).abs() < 0.05, "{found:?}");
        assert!(found.contrast_bias.abs() < 0.01, "{found:?}");
    }

    #[test]
    fn maps_show_where() {
        let mut random = Random::new(5);
        let truth = truth(&mut random);
        let found = decompose(&truth, &runs(&mut random, 0.4, 0.0)).unwrap();
        let (bright, dark) = (found.bias[(0, 9)].0, found.bias[(1, 9)].0);
        assert!(bright[0] > 200 && bright[2] < 100, "{bright:?}");
        assert!(dark[2] > 200 && dark[0] < 100, "{dark:?}");
        assert_eq!(found.noise[(0, 9)].0, [0; 3]);
        let noisy = decompose(&truth, &runs(&mut random, 0.0, 0.4)).unwrap();
        let mean = noisy.noise.iter().map(|&byte| f64::from(byte)).sum::<f64>() / noisy.noise.len() as f64;
        assert!(mean > 150.0, "{mean}");
    }

    #[test]
    fn one_run_tells_nothing() {
        let mut random = Random::new(1);
        let truth = truth(&mut random);
        assert!(decompose(&truth, &runs(&mut random, 0.1, 0.1)[..1]).is_none());
        assert!(decompose(&truth, &[vec![0.0; 3], vec![0.0; 3]]).is_none());
    }
}
