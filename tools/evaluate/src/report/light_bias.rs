//! Bias of the reflected light, with its interval.

use super::stats::{Interval, t_quantile};
use crate::state::TrueSums;

/// A bias in percent of the reflected light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightBias {
    /// Above 0, too much light is reflected.
    pub percent: f64,
    /// The 95 % confidence interval; `None` of a single run.
    pub interval: Option<Interval>,
}

/// The truth of a view, and the sums of each run of a technique in it.
pub type View<'a> = (&'a TrueSums, &'a [Vec<f64>]);

fn total<'a>(blocks: impl IntoIterator<Item = &'a f64>) -> f64 {
    blocks.into_iter().sum()
}

/// Variances of independent parts of a sum, each with its degrees of freedom.
#[derive(Default)]
struct Variance {
    sum: f64,
    /// Term of Welch and Satterthwaite: squares over degrees of freedom.
    squares: f64,
}

impl Variance {
    fn add(&mut self, variance: f64, freedom: f64) {
        self.sum += variance;
        self.squares += variance * variance / freedom;
    }

    /// Half of the width of the 95 % interval.
    fn half_width(&self) -> f64 {
        if self.squares > 0.0 {
            t_quantile(self.sum * self.sum / self.squares) * self.sum.sqrt()
        } else {
            0.0
        }
    }
}

/// The bias over all views together, so that a dark view doesn't weigh more than a bright one; `None` if nothing reflects.
///
/// The interval covers the effect of noise on the bias of just these views: it comes from runs that differ only in their noise, not from
/// the spread of the bias over positions, which is no noise. Noise is correlated within a block of pixels, and hardly between blocks.
/// Each block of each view is therefore a part with a variance from the runs, and two runs of a hundred blocks have a hundred degrees of
/// freedom. The difference of the ground truth's halves adds its noise.
pub fn light_bias(views: &[View]) -> Option<LightBias> {
    let truth: f64 = views
        .iter()
        .map(|(truth, _)| 0.5 * (total(&truth.halves[0]) + total(&truth.halves[1])))
        .sum();
    let least = views.iter().map(|(_, runs)| runs.len()).min()?;
    if least == 0 || truth <= 0.0 {
        return None;
    }
    let mut shown = 0.0;
    let mut variance = Variance::default();
    for (_, runs) in views {
        let count = runs.len() as f64;
        for block in 0..runs[0].len() {
            let values = runs.iter().map(|blocks| blocks[block]);
            let mean = values.clone().sum::<f64>() / count;
            shown += mean;
            if least > 1 {
                let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
                variance.add(squares / ((count - 1.0) * count), count - 1.0);
            }
        }
    }
    let ratio = shown / truth;
    for (truth, _) in views {
        for (first, second) in truth.halves[0].iter().zip(&truth.halves[1]) {
            variance.add((0.5 * ratio * (first - second)).powi(2), 1.0);
        }
    }
    let percent = 100.0 * (ratio - 1.0);
    let half = 100.0 * variance.half_width() / truth;
    Some(LightBias {
        percent,
        interval: (least > 1).then_some(Interval {
            low: percent - half,
            high: percent + half,
        }),
    })
}

/// The difference of the two halves of the ground truth, in percent of the reflected light: a bias below it is meaningless. The halves
/// complement each other in their low-discrepancy sequence, so the error of the whole is less than half of this.
pub fn light_floor<'a>(views: impl IntoIterator<Item = &'a TrueSums>) -> Option<f64> {
    let (mut first, mut second) = (0.0, 0.0);
    for view in views {
        first += total(&view.halves[0]);
        second += total(&view.halves[1]);
    }
    let truth = 0.5 * (first + second);
    (truth > 0.0).then(|| 100.0 * (first - second) / truth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glint_scenes::Random;

    const BLOCKS: usize = 40;

    /// About normal, with a variance of 1.
    fn noise(random: &mut Random) -> f64 {
        let uniform = |random: &mut Random| random.below(1 << 20) as f64 / f64::from(1 << 20);
        (0..12).map(|_| uniform(random)).sum::<f64>() - 6.0
    }

    /// Light of 10 in each block with some noise.
    fn blocks(random: &mut Random, factor: f64, sigma: f64) -> Vec<f64> {
        (0..BLOCKS).map(|_| 10.0 * factor + sigma * noise(random)).collect()
    }

    fn truth(random: &mut Random, sigma: f64) -> TrueSums {
        TrueSums {
            halves: [0, 1].map(|_| blocks(random, 1.0, sigma)),
            pixels: 1,
            ..TrueSums::default()
        }
    }

    fn bias_of(random: &mut Random, factor: f64) -> (LightBias, f64) {
        let views = [0, 1].map(|_| {
            let truth = truth(random, 0.1);
            (truth, [0, 1].map(|_| blocks(random, factor, 0.2)))
        });
        let views: Vec<View> = views.iter().map(|(truth, runs)| (truth, &runs[..])).collect();
        let floor = light_floor(views.iter().map(|(truth, _)| *truth)).unwrap();
        (light_bias(&views).unwrap(), floor)
    }

    #[test]
    fn light_that_is_scaled_shows() {
        let mut random = Random::new(5);
        for (factor, expected) in [(1.02, 2.0), (1.0, 0.0), (0.97, -3.0)] {
            let (bias, floor) = bias_of(&mut random, factor);
            assert!((bias.percent - expected).abs() < 0.5, "{bias:?}");
            let interval = bias.interval.unwrap();
            assert!(interval.low < bias.percent && bias.percent < interval.high);
            assert!(interval.high - interval.low < 1.2, "{interval:?}");
            assert!(floor.abs() < 0.6, "{floor}");
        }
    }

    #[test]
    fn intervals_hold_the_bias_as_often_as_they_say() {
        let mut random = Random::new(9);
        let trials = 1000;
        let held = (0..trials).filter(|_| {
            let interval = bias_of(&mut random, 1.02).0.interval.unwrap();
            (interval.low..=interval.high).contains(&2.0)
        });
        let share = held.count() as f64 / f64::from(trials);
        assert!((0.92..0.98).contains(&share), "{share}");
    }

    #[test]
    fn one_run_has_no_interval_and_darkness_no_bias() {
        let mut random = Random::new(1);
        let truth = truth(&mut random, 0.0);
        let run = [vec![10.2; BLOCKS]];
        let bias = light_bias(&[(&truth, &run)]).unwrap();
        assert!((bias.percent - 2.0).abs() < 1e-9 && bias.interval.is_none());
        assert_eq!(light_bias(&[(&truth, &[])]), None);
        assert_eq!(light_bias(&[]), None);
        let dark = TrueSums::default();
        assert_eq!(light_bias(&[(&dark, &[Vec::new()])]), None);
        assert_eq!(light_floor([&dark]), None);
        // Without any noise the interval is a point.
        let bias = light_bias(&[(&truth, &[run[0].clone(), run[0].clone()])]).unwrap();
        let interval = bias.interval.unwrap();
        assert!((interval.high - interval.low).abs() < 1e-9);
    }
}
