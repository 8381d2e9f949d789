//! The Pareto front of time and error: techniques that no other beats in both.

use super::{rows::Row, stats::pareto_front};

/// An error of a row.
pub type ErrorOf = fn(&Row) -> Option<f64>;

/// Flags of the rows that no other row beats in time and error together. Techniques that take no time count.
pub fn on_front(rows: &[&Row], error: ErrorOf) -> Vec<bool> {
    let points: Vec<(f64, f64)> = rows
        .iter()
        .map(|row| (row.total_ms.unwrap_or(f64::NAN), error(row).unwrap_or(f64::NAN)))
        .collect();
    let front = pareto_front(&points);
    (0..rows.len()).map(|index| front.contains(&index)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_without_a_faster_and_closer_one_are_on_the_front() {
        let mut rows = [(2.0, 0.008), (1.0, 0.010), (1.2, 0.011), (0.8, 0.009)]
            .map(|(time, error)| Row::example("atrium", "quarter", time, error));
        let front = |rows: &[Row]| on_front(&rows.iter().collect::<Vec<_>>(), |row| row.flip_final_converged);
        assert_eq!(front(&rows), [true, false, false, true]);
        rows[3].total_ms = None;
        assert_eq!(front(&rows), [true, true, false, false]);
    }
}
