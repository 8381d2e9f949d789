//! Aligned tables and the same values as CSV.

use std::{fmt::Display, path::Path};

/// A measured value.
struct Value {
    subject: String,
    variant: String,
    measure: String,
    value: f64,
    unit: &'static str,
}

/// All measured values.
#[derive(Default)]
pub struct Csv(Vec<Value>);

impl Csv {
    /// Adds a value. `subject` is a scene or a mesh, `variant` a tracer or a quality.
    pub fn add(&mut self, subject: impl Display, variant: &str, measure: &str, value: f64, unit: &'static str) {
        self.0.push(Value {
            subject: subject.to_string(),
            variant: variant.to_owned(),
            measure: measure.to_owned(),
            value,
            unit,
        });
    }

    /// True until something is measured.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Writes the file, one value in a line, with `adapter` and `size` in each.
    pub fn save(&self, path: &Path, adapter: &str, size: &str) -> Result<(), String> {
        let write = || -> csv::Result<()> {
            let mut writer = csv::Writer::from_path(path)?;
            writer.write_record(["adapter", "size", "subject", "variant", "measure", "value", "unit"])?;
            for value in &self.0 {
                let number = value.value.to_string();
                let Value {
                    subject,
                    variant,
                    measure,
                    unit,
                    ..
                } = value;
                writer.write_record([adapter, size, subject, variant, measure, &number, unit])?;
            }
            writer.flush()?;
            Ok(())
        };
        write().map_err(|error| format!("{} could not be written: {error}", path.display()))
    }
}

/// A table with its first column aligned to the left and all others to the right.
pub struct Table {
    title: String,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// `columns` are the names of the columns with ` | ` between them.
    pub fn new(title: impl Into<String>, columns: &str) -> Self {
        Self {
            title: title.into(),
            rows: vec![columns.split(" | ").map(str::to_owned).collect()],
        }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// Prints the table unless it has no rows.
    pub fn print(&self) {
        if self.rows.len() < 2 {
            return;
        }
        println!("\n{}", self.title);
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        for row in &self.rows {
            let cells = row.iter().zip(&widths).enumerate().map(|(i, (cell, &width))| {
                if i == 0 {
                    format!("{cell:<width$}")
                } else {
                    format!("{cell:>width$}")
                }
            });
            println!("  {}", cells.collect::<Vec<_>>().join("  ").trim_end());
        }
    }
}

/// A share of sorted values from below: 0.5 is the median. `None` without values.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let place = share.clamp(0.0, 1.0) * last as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    Some(low + (high - low) * place.fract())
}

/// A number with `digits` decimals, or a dash without a measurement.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Mebibytes.
pub fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
