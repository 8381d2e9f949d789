//! Bias of the reflected light, with its interval.

use crate::{
    state::{ShownSums, TrueSums},
    stats::{Estimate, Variance, mean_and_variance},
};

/// The bias in percent of the reflected light: above 0, too much light is reflected. It is of all views together, so that a dark view
/// doesn't weigh more than a bright one. `None` if nothing reflects.
///
/// The interval covers the effect of noise on the bias of just these views: it comes from runs that differ only in their noise, not from
/// the spread of the bias over positions, which is no noise. Noise is correlated within a block of pixels, and hardly between blocks.
/// Each block of each view is therefore a part with a variance from the runs, and two runs of a hundred blocks have a hundred degrees of
/// freedom. The difference of the ground truth's halves adds its noise. A single run has no interval.
///
/// `truth` and `shown` contain one item per view. `runs` picks the sums of each run; views without any don't count.
pub fn light_bias(truth: &[TrueSums], shown: &[ShownSums], runs: fn(&ShownSums) -> &[Vec<f64>]) -> Option<Estimate> {
    let views = truth.iter().zip(shown.iter().map(runs));
    let views: Vec<(&TrueSums, &[Vec<f64>])> = views.filter(|(_, runs)| !runs.is_empty()).collect();
    let [first, second] = halves(views.iter().map(|(truth, _)| *truth));
    let truth = 0.5 * (first + second);
    let least = views.iter().map(|(_, runs)| runs.len()).min()?;
    if truth <= 0.0 {
        return None;
    }
    let mut shown = 0.0;
    let mut variance = Variance::default();
    for (_, runs) in &views {
        let count = runs.len() as f64;
        for block in 0..runs[0].len() {
            let (mean, square) = mean_and_variance(runs.iter().map(|blocks| blocks[block]));
            shown += mean;
            variance.add(square / count, count - 1.0);
        }
    }
    let ratio = shown / truth;
    for (truth, _) in &views {
        for (first, second) in truth.halves[0].iter().zip(&truth.halves[1]) {
            variance.add((0.5 * ratio * (first - second)).powi(2), 1.0);
        }
    }
    let bias = Estimate {
        value: shown,
        interval: (least > 1).then(|| variance.around(shown)),
    };
    Some(bias.map(|shown| 100.0 * (shown / truth - 1.0)))
}

/// Sums of the reflected light by the two halves of the ground truth.
fn halves<'a>(views: impl Iterator<Item = &'a TrueSums> + Clone) -> [f64; 2] {
    [0, 1].map(|half| views.clone().flat_map(|truth| &truth.halves[half]).sum())
}

/// The difference of the two halves of the ground truth, in percent of the reflected light: a bias below it is meaningless. The halves
/// complement each other in their low-discrepancy sequence, so the error of the whole is less than half of this.
pub fn light_floor(truth: &[TrueSums]) -> Option<f64> {
    let [first, second] = halves(truth.iter());
    let whole = 0.5 * (first + second);
    (whole > 0.0).then(|| 100.0 * (first - second) / whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::normal;
    use glint_scenes::Random;

    const BLOCKS: usize = 40;

    /// Light of 10 in each block with some noise.
    fn blocks(random: &mut Random, factor: f64, sigma: f64) -> Vec<f64> {
        (0..BLOCKS).map(|_| 10.0 * factor + sigma * normal(random)).collect()
    }

    fn truth(random: &mut Random, sigma: f64) -> TrueSums {
        TrueSums {
            halves: [0, 1].map(|_| blocks(random, 1.0, sigma)),
            pixels: 1,
            ..TrueSums::default()
        }
    }

    fn in_motion(truth: &[TrueSums], shown: &[ShownSums]) -> Option<Estimate> {
        light_bias(truth, shown, |shown| &shown.motion)
    }

    fn bias_of(random: &mut Random, factor: f64) -> (Estimate, f64) {
        let truth = [0, 1].map(|_| truth(random, 0.1));
        let shown = [0, 1].map(|_| ShownSums {
            motion: (0..2).map(|_| blocks(random, factor, 0.2)).collect(),
            still: Vec::new(),
        });
        (in_motion(&truth, &shown).unwrap(), light_floor(&truth).unwrap())
    }

    #[test]
    fn light_that_is_scaled_shows() {
        let mut random = Random::new(5);
        for (factor, expected) in [(1.02, 2.0), (1.0, 0.0), (0.97, -3.0)] {
            let (bias, floor) = bias_of(&mut random, factor);
            let (low, high) = bias.interval.unwrap();
            assert!((bias.value - expected).abs() < 0.5, "{bias:?}");
            assert!(low < bias.value && bias.value < high && high - low < 1.2, "{bias:?}");
            assert!(floor.abs() < 0.6, "{floor}");
        }
    }

    #[test]
    fn intervals_hold_the_bias_as_often_as_they_say() {
        let mut random = Random::new(9);
        let trials = 1000;
        let held = (0..trials).filter(|_| {
            let (low, high) = bias_of(&mut random, 1.02).0.interval.unwrap();
            (low..=high).contains(&2.0)
        });
        let share = held.count() as f64 / f64::from(trials);
        assert!((0.92..0.98).contains(&share), "{share}");
    }

    #[test]
    fn one_run_has_no_interval_and_darkness_no_bias() {
        let mut random = Random::new(1);
        let truth = [truth(&mut random, 0.0)];
        let of = |motion: Vec<Vec<f64>>| {
            let still = Vec::new();
            in_motion(&truth, &[ShownSums { motion, still }])
        };
        let run = vec![10.2; BLOCKS];
        let bias = of(vec![run.clone()]).unwrap();
        assert!((bias.value - 2.0).abs() < 1e-9 && bias.interval.is_none());
        assert_eq!(of(Vec::new()), None);
        assert_eq!(in_motion(&[], &[]), None);
        let dark = [TrueSums::default()];
        let shown = ShownSums {
            motion: vec![Vec::new()],
            still: Vec::new(),
        };
        assert_eq!((in_motion(&dark, &[shown]), light_floor(&dark)), (None, None));
        // Without any noise the interval is a point.
        let (low, high) = of(vec![run.clone(), run]).unwrap().interval.unwrap();
        assert!((high - low).abs() < 1e-9);
    }
}
