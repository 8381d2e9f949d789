//! Comparison of noisy values with limits. A value with too much noise for a decision is neither a failure nor a success.

/// The result of comparing a value with a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitCheck {
    /// The value can be within the limit, and its margin is no wider than the limit.
    Within,
    /// Even the lower end of the interval is beyond the limit.
    Exceeded,
    /// The interval is too wide for a decision.
    Undecided,
}

/// Compares a value that is known within `margin` with a limit.
pub fn check_limit(value: f64, margin: f64, limit: f64) -> LimitCheck {
    if !value.is_finite() || value - margin > limit {
        LimitCheck::Exceeded
    } else if margin <= limit || value + margin <= limit {
        LimitCheck::Within
    } else {
        LimitCheck::Undecided
    }
}

/// Mean of independent values, and its standard error, which is infinite for fewer than two.
pub fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let (mean, deviation) = mean_and_deviation(values);
    (mean, deviation / (values.len().max(1) as f64).sqrt())
}

/// Mean of independent values, and the standard deviation of one of them, which is infinite for fewer than two.
pub fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count.max(1.0);
    if values.len() < 2 {
        return (mean, f64::INFINITY);
    }
    (mean, (squares_around(values, mean) / (count - 1.0)).sqrt())
}

fn squares_around(values: &[f64], mean: f64) -> f64 {
    values.iter().map(|value| (value - mean) * (value - mean)).sum()
}

/// Number of standard errors that cover 95 % of all cases if the error itself was estimated with this many degrees of freedom
/// (Student's t).
pub fn student(degrees: usize) -> f64 {
    const Z: f64 = 1.959_964;
    match degrees {
        0 => f64::INFINITY,
        1 => 12.706,
        2 => 4.303,
        3 => 3.182,
        _ => {
            // Cornish and Fisher's expansion, exact to half a percent from four degrees on.
            let v = degrees as f64;
            let (z3, z5, z7) = (Z.powi(3), Z.powi(5), Z.powi(7));
            let first = (z3 + Z) / (4.0 * v);
            let second = (5.0 * z5 + 16.0 * z3 + 3.0 * Z) / (96.0 * v * v);
            let third = (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * Z) / (384.0 * v * v * v);
            Z + first + second + third
        }
    }
}

/// Difference between the second and the first half of a series, relative to the mean of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Second half minus first half; positive if the series grows.
    pub change: f64,
    /// Half the width of the interval that contains the true change with 95 % probability, from the variance within each half.
    pub margin: f64,
    /// Values in each half.
    pub values: usize,
}

impl Drift {
    /// With fewer values in a half their variance is unknown.
    pub const FEWEST: usize = 3;

    /// Compares the halves of a series. The middle value of an odd number is left out. `None` if there are too few.
    pub fn of(series: &[f64]) -> Option<Self> {
        let values = series.len() / 2;
        if values < Self::FEWEST {
            return None;
        }
        let (early, late) = (&series[..values], &series[series.len() - values..]);
        let [before, after] = [early, late].map(|half| half.iter().sum::<f64>() / values as f64);
        let degrees = 2 * values - 2;
        let variance = (squares_around(early, before) + squares_around(late, after)) / degrees as f64;
        let error = (2.0 * variance / values as f64).sqrt();
        let scale = (0.5 * (before + after)).abs().max(1e-9);
        Some(Self {
            change: (after - before) / scale,
            margin: student(degrees) * error / scale,
            values,
        })
    }

    /// Compares the change, whatever its sign, with a limit.
    pub fn check(&self, limit: f64) -> LimitCheck {
        check_limit(self.change.abs(), self.margin, limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_intervals_leave_it_undecided() {
        assert_eq!(check_limit(0.01, 0.001, 0.005), LimitCheck::Exceeded);
        assert_eq!(check_limit(0.004, 0.001, 0.005), LimitCheck::Within);
        assert_eq!(check_limit(0.0055, 0.001, 0.005), LimitCheck::Within);
        assert_eq!(check_limit(0.01, 0.02, 0.005), LimitCheck::Undecided);
        assert_eq!(check_limit(0.0, f64::INFINITY, 0.005), LimitCheck::Undecided);
        assert_eq!(check_limit(f64::NAN, 0.0, 0.005), LimitCheck::Exceeded);
        assert_eq!(check_limit(-0.1, 0.02, 0.005), LimitCheck::Within);
    }

    #[test]
    fn quantiles_are_those_of_tables() {
        for (degrees, expected) in [(1, 12.706), (4, 2.776), (10, 2.228), (30, 2.042), (1000, 1.962)] {
            let found = student(degrees);
            assert!((found - expected).abs() < 0.005 * expected, "{degrees}: {found}");
        }
    }

    #[test]
    fn errors_shrink_with_the_number_of_values() {
        assert_eq!(mean_and_error(&[]), (0.0, f64::INFINITY));
        assert_eq!(mean_and_error(&[2.0]).1, f64::INFINITY);
        let (mean, error) = mean_and_error(&[1.0, 3.0, 1.0, 3.0]);
        assert_eq!(mean, 2.0);
        assert!((error - (4.0f64 / 3.0).sqrt() / 2.0).abs() < 1e-12);
    }

    #[test]
    fn drift_is_told_from_noise() {
        assert_eq!(Drift::of(&[1.0; 5]), None);
        let steady = Drift::of(&[1.0; 6]).unwrap();
        assert_eq!((steady.change, steady.margin, steady.values), (0.0, 0.0, 3));
        let rising: Vec<f64> = (0..40).map(|lap| 1.0 + 0.001 * f64::from(lap)).collect();
        assert_eq!(Drift::of(&rising).unwrap().check(0.005), LimitCheck::Exceeded);
        // Up and down by 1 % from lap to lap: undecided with few laps, within the limit with many.
        let noise = |laps: usize| -> Vec<f64> { (0..laps).map(|lap| [0.99, 1.01][lap % 2]).collect() };
        assert_eq!(Drift::of(&noise(8)).unwrap().check(0.005), LimitCheck::Undecided);
        assert_eq!(Drift::of(&noise(80)).unwrap().check(0.005), LimitCheck::Within);
        let falling: Vec<f64> = rising.iter().rev().copied().collect();
        assert!(Drift::of(&falling).unwrap().change < 0.0);
    }
}
