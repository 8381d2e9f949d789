//! Means, quantiles, variances with their confidence intervals of 95 %, and the Pareto front.

use glint_scenes::Random;

/// A value with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Lower and upper end; `None` of a single sample.
    pub interval: Option<(f64, f64)>,
}

impl Estimate {
    /// The estimate on another scale.
    pub fn map(self, scale: impl Fn(f64) -> f64) -> Self {
        Self {
            value: scale(self.value),
            interval: self.interval.map(|(low, high)| (scale(low), scale(high))),
        }
    }
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// A share of the values from below, interpolated: 0.5 is the median. Values that aren't finite are left out; `None` without any.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let sorted = sorted(values);
    let last = sorted.len().checked_sub(1)?;
    let place = share.clamp(0.0, 1.0) * last as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    Some(low + (high - low) * place.fract())
}

/// The mean of the finite values; `None` without any.
pub fn mean(values: &[f64]) -> Option<f64> {
    let finite = values.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The 95 % confidence interval of the median from order statistics, which assume nothing about the distribution. With fewer than six
/// values it is their range, which has a lower confidence than 95 %.
///
/// Frames along a camera path differ for good reasons, and that spread is part of the interval.
pub fn median_interval(values: &[f64]) -> Option<(f64, f64)> {
    let sorted = sorted(values);
    let last = sorted.len().checked_sub(1)?;
    let rank = outer_rank(sorted.len()).min(last / 2);
    Some((sorted[rank], sorted[last - rank]))
}

/// The largest rank `j` for which at most `j` of `n` fair coins show heads with a probability of at most 2.5 %.
fn outer_rank(n: usize) -> usize {
    let n_real = n as f64;
    if n > 200 {
        return ((n_real - 1.959_964 * n_real.sqrt()) / 2.0 - 1.0).floor().max(0.0) as usize;
    }
    let mut term = 0.5f64.powf(n_real);
    let (mut sum, mut rank) = (term, 0);
    for j in 1..n {
        term *= (n - j + 1) as f64 / j as f64;
        sum += term;
        if sum > 0.025 {
            break;
        }
        rank = j;
    }
    rank
}

/// The ratio `a / b` of two quantities that were measured in the same rounds.
///
/// Each round gives one ratio, so that changes between rounds that affect both (the position on the path, the clock of a warm GPU) cancel
/// out. The estimate is the geometric mean. The interval comes from resampling the rounds, always with the same random numbers. The result
/// is `None` without a common round, and has no interval if there is only one.
pub fn paired_ratio(a: &[Option<f64>], b: &[Option<f64>]) -> Option<Estimate> {
    const RESAMPLES: usize = 2000;
    let usable = |value: &Option<f64>| value.filter(|value| value.is_finite() && *value > 0.0);
    let logs: Vec<f64> = a
        .iter()
        .zip(b)
        .filter_map(|(a, b)| Some((usable(a)? / usable(b)?).ln()))
        .collect();
    let value = mean(&logs)?;
    let mut random = Random::new(0x6c69_6e74);
    let resample = |_| (0..logs.len()).map(|_| logs[random.below(logs.len())]).sum::<f64>() / logs.len() as f64;
    let means: Vec<f64> = (0..RESAMPLES).map(resample).collect();
    let interval = quantile(&means, 0.025).zip(quantile(&means, 0.975));
    let interval = interval.filter(|_| logs.len() > 1);
    Some(Estimate { value, interval }.map(f64::exp))
}

/// The mean of some values and their variance: the sum of squares over one less than their number. Both are NaN if there are too few.
pub fn mean_and_variance(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let (sum, count) = values
        .clone()
        .fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    let mean = sum / count;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    (mean, squares / (count - 1.0))
}

/// The variance of a sum of independent parts, each with its degrees of freedom.
#[derive(Clone, Copy, Default)]
pub struct Variance {
    sum: f64,
    /// Term of Welch and Satterthwaite: squares over degrees of freedom.
    squares: f64,
}

impl Variance {
    /// Adds the variance of a part.
    pub fn add(&mut self, variance: f64, freedom: f64) {
        self.sum += variance;
        self.squares += variance * variance / freedom;
    }

    /// The 95 % interval of a sum.
    pub fn around(&self, sum: f64) -> (f64, f64) {
        // The degrees of freedom of a single part come back with an error of rounding.
        let freedom = self.sum * self.sum / self.squares * (1.0 + 1e-9);
        let half = if self.squares > 0.0 {
            t_quantile(freedom) * self.sum.sqrt()
        } else {
            0.0
        };
        (sum - half, sum + half)
    }
}

/// The mean of values with the interval of Student's distribution; `None` without values.
pub fn student(values: &[f64]) -> Option<Estimate> {
    let count = values.len() as f64;
    let (value, variance) = mean_and_variance(values.iter().copied());
    let mut of_mean = Variance::default();
    of_mean.add(variance / count, count - 1.0);
    (!values.is_empty()).then(|| Estimate {
        value,
        interval: (values.len() > 1).then(|| of_mean.around(value)),
    })
}

/// The 97.5 % quantile of Student's distribution: 95 % lie within it to either side. Degrees of freedom need not be whole, and are rounded
/// down, which widens intervals.
fn t_quantile(freedom: f64) -> f64 {
    const TABLE: [f64; 30] = [
        12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
        2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
    ];
    let place = (freedom.max(1.0) as usize).min(TABLE.len()) - 1;
    // The normal distribution and the first term of its correction.
    if freedom > 30.0 {
        1.960 + 2.5 / freedom
    } else {
        TABLE[place]
    }
}

/// Indices of the points that no other point dominates, by being at most as large in both coordinates and smaller in one. Sorted by the
/// first coordinate. Points that aren't finite are never on the front.
pub fn pareto_front(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len())
        .filter(|&i| points[i].0.is_finite() && points[i].1.is_finite())
        .collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (points[a], points[b]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut best = f64::INFINITY;
    let mut last = None;
    order.retain(|&i| {
        let beats = points[i].1 < best || last == Some(points[i]);
        if beats {
            best = points[i].1;
            last = Some(points[i]);
        }
        beats
    });
    order
}

/// A random number for tests: about normal, with a variance of 1.
#[cfg(test)]
pub fn normal(random: &mut Random) -> f64 {
    (0..12).map(|_| f64::from(random.unit())).sum::<f64>() - 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_and_skip_what_is_not_finite() {
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[1.0, f64::NAN, 2.0], 0.5), Some(1.5));
        assert_eq!(quantile(&[f64::INFINITY], 0.5), None);
        assert_eq!(mean(&[1.0, 3.0, f64::NAN]), Some(2.0));
        assert_eq!(mean(&[]), None);
    }

    #[test]
    fn order_statistics_are_those_of_the_tables() {
        // Ranks (from 0) of the exact two-sided 95 % interval of a median.
        for (n, rank) in [(6, 0), (9, 1), (10, 1), (20, 5), (50, 17), (100, 39)] {
            assert_eq!(outer_rank(n), rank, "{n}");
        }
        // The approximation for large samples meets the exact ranks.
        let n = 201.0f64;
        let exact = outer_rank(200) as f64;
        assert!(((n - 1.959_964 * n.sqrt()) / 2.0 - 1.0 - exact).abs() < 1.5);
        let values: Vec<f64> = (0..20).map(f64::from).collect();
        assert_eq!(median_interval(&values), Some((5.0, 14.0)));
        assert_eq!(median_interval(&[4.0]), Some((4.0, 4.0)));
        assert_eq!(median_interval(&[]), None);
    }

    #[test]
    fn intervals_of_medians_hold_the_median_as_often_as_they_say() {
        let mut random = Random::new(7);
        let trials = 2000;
        let held = (0..trials)
            .filter(|_| {
                let values: Vec<f64> = (0..25).map(|_| random.below(1_000_001) as f64).collect();
                median_interval(&values).is_some_and(|(low, high)| (low..=high).contains(&500_000.0))
            })
            .count();
        let share = held as f64 / f64::from(trials);
        assert!((0.93..0.99).contains(&share), "{share}");
    }

    #[test]
    fn students_distribution_narrows() {
        let values = [0.3, 1.0, 1.9, 2.0, 30.0, 31.0, 60.0, 1e9].map(t_quantile);
        assert_eq!(values[..4], [12.706, 12.706, 12.706, 4.303]);
        assert!(values.windows(2).all(|pair| pair[0] >= pair[1]), "{values:?}");
        assert!((values[6] - 2.000).abs() < 0.003 && (values[7] - 1.960).abs() < 1e-3);
    }

    #[test]
    fn variances_of_parts_add_up() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(mean_and_variance(values.into_iter()), (3.0, 2.5));
        let (low, high) = student(&values).unwrap().interval.unwrap();
        let half = 2.776 * 0.5f64.sqrt();
        assert!((low - 3.0 + half).abs() < 1e-9 && (high - 3.0 - half).abs() < 1e-9);
        // Two equal parts have twice the variance and twice the degrees of freedom.
        let mut two = Variance::default();
        two.add(0.5, 4.0);
        two.add(0.5, 4.0);
        assert!((two.around(0.0).1 - 2.306).abs() < 1e-9);
        assert_eq!(student(&[2.0]).map(|one| (one.value, one.interval)), Some((2.0, None)));
        assert_eq!(student(&[]), None);
    }

    #[test]
    fn paired_ratios_see_through_what_both_share() {
        // The machine slows down by a factor of three; the ratio stays 0.8 within 1 %.
        let b: Vec<Option<f64>> = (0..12).map(|i| Some(1.0 + f64::from(i) / 6.0)).collect();
        let a: Vec<Option<f64>> = b
            .iter()
            .enumerate()
            .map(|(i, b)| b.map(|b| b * if i % 2 == 0 { 0.795 } else { 0.805 }))
            .collect();
        let ratio = paired_ratio(&a, &b).unwrap();
        let (low, high) = ratio.interval.unwrap();
        assert!((ratio.value - 0.8).abs() < 1e-3);
        assert!(low <= 0.8 && (0.8..0.81).contains(&high), "{ratio:?}");
        // Rounds that one of them lacks don't count.
        let once = paired_ratio(&[Some(5.0), None], &[Some(5.0), Some(1.0)]).unwrap();
        assert_eq!((once.value, once.interval), (1.0, None));
        assert_eq!(paired_ratio(&[None], &[Some(1.0)]), None);
    }

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points = [
            (1.0, 5.0),
            (2.0, 3.0),
            (2.5, 3.5),
            (4.0, 1.0),
            (3.0, 3.0),
            (f64::NAN, 0.0),
        ];
        assert_eq!(pareto_front(&points), [0, 1, 3]);
        assert_eq!(pareto_front(&[]), [0usize; 0]);
        // Equal points share their place.
        assert_eq!(pareto_front(&[(1.0, 1.0), (1.0, 1.0)]), [0, 1]);
    }
}
