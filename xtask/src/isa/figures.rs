//! The compiler's figures in a file, and the differences from it.

use std::collections::BTreeMap;
use std::fmt::Write;

use anyhow::{Context, Result, bail};

/// Names of the columns, with the driver's names, and the allowed difference from the file in percent.
///
/// Scalar registers spill to lanes of vector registers, vector registers to memory (scratch). The number of registers can change as
/// long as the same number of subgroups fits a SIMD. The last three are the compiler's own counts and estimates.
pub const COLUMNS: [(&str, &str, Option<f64>); 9] = [
    ("VGPRs", "VGPRs", None),
    ("spilled VGPRs", "Spilled VGPRs", Some(0.0)),
    ("spilled SGPRs", "Spilled SGPRs", None),
    ("scratch", "Scratch size", Some(0.0)),
    ("LDS", "LDS size", Some(0.0)),
    ("subgroups", "Subgroups per SIMD", Some(0.0)),
    ("instructions", "Instructions", Some(10.0)),
    ("latency", "Latency", Some(25.0)),
    ("inverse throughput", "Inverse Throughput", Some(25.0)),
];

/// Figures of a pipeline on a GPU: one for each of [`COLUMNS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Figures(pub [u64; COLUMNS.len()]);

impl Figures {
    /// Selects them from the driver's figures.
    pub fn read(told: &[(String, String)]) -> Result<Self> {
        let mut figures = Self::default();
        for (figure, (_, wanted, _)) in figures.0.iter_mut().zip(COLUMNS) {
            let found = told.iter().find(|(name, _)| name == wanted);
            let (_, value) = found.with_context(|| format!("the driver doesn't tell {wanted}"))?;
            *figure = value.parse().with_context(|| format!("{wanted}: {value}"))?;
        }
        Ok(figures)
    }

    /// Returns whether memory serves as registers.
    pub fn spills(&self) -> bool {
        self.0[1] > 0
    }
}

/// Figures by pipeline and GPU.
pub type Table = BTreeMap<(String, String), Figures>;

/// The file's first line, which names the driver, and the table.
pub fn to_text(driver: &str, table: &Table) -> String {
    let names = COLUMNS.map(|(name, ..)| name).join(", ");
    let mut text = format!("# {driver}\n# pass, entry point and definitions, GPU: {names}\n");
    for ((name, gpu), figures) in table {
        let numbers = figures.0.map(|number| format!("{number:>6}")).join(" ");
        // Writing to a string can't fail.
        _ = writeln!(text, "{name:<70} {gpu:<8} {numbers}");
    }
    text
}

/// The driver and the table of a file.
pub fn from_text(text: &str) -> Result<(String, Table)> {
    let driver = text.lines().next().and_then(|line| line.strip_prefix("# "));
    let driver = driver.context("the first line names no driver")?.to_owned();
    let mut table = Table::new();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let words: Vec<_> = line.split_whitespace().collect();
        let Some((names, numbers)) = words.split_at_checked(words.len().saturating_sub(COLUMNS.len())) else {
            bail!("{line}")
        };
        let [names @ .., gpu] = names else { bail!("{line}") };
        let mut figures = Figures::default();
        for (figure, number) in figures.0.iter_mut().zip(numbers) {
            *figure = number.parse().with_context(|| line.to_owned())?;
        }
        table.insert((names.join(" "), (*gpu).to_owned()), figures);
    }
    Ok((driver, table))
}

/// The differences that are too large, a line each. A pipeline that the file lacks counts if it spills.
pub fn changes(file: &Table, found: &Table) -> Vec<String> {
    let mut changes = Vec::new();
    for ((name, gpu), figures) in found {
        let Some(old) = file.get(&(name.clone(), gpu.clone())) else {
            if figures.spills() {
                changes.push(format!(
                    "{name} on {gpu}: spills {} vector registers to memory",
                    figures.0[1]
                ));
            }
            continue;
        };
        for (((column, _, tolerance), old), new) in COLUMNS.iter().zip(old.0).zip(figures.0) {
            let change = 100.0 * (new as f64 - old as f64) / old.max(1) as f64;
            if tolerance.is_some_and(|tolerance| change.abs() > tolerance) {
                changes.push(format!("{name} on {gpu}: {column}: {old} -> {new} ({change:+.0} %)"));
            }
        }
    }
    let gone = file.keys().filter(|key| !found.contains_key(*key));
    changes.extend(gone.map(|(name, gpu)| format!("{name} on {gpu}: no such pipeline")));
    changes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(figures: [u64; COLUMNS.len()]) -> Table {
        Table::from([(("a/b.main X Y".to_owned(), "navi31".to_owned()), Figures(figures))])
    }

    #[test]
    fn files_are_read_as_written() {
        let table = table([96, 0, 9, 0, 1024, 16, 1000, 5000, 700]);
        let (driver, read) = from_text(&to_text("Mesa 25.0.7", &table)).unwrap();
        assert_eq!((driver.as_str(), read), ("Mesa 25.0.7", table));
        assert!(from_text("").is_err());
        assert!(from_text("# Mesa\na navi31 1 2").is_err());
    }

    #[test]
    fn changes_are_told_apart_from_noise() {
        let old = table([96, 0, 9, 0, 1024, 16, 1000, 5000, 700]);
        let told = |figures| changes(&old, &table(figures));
        assert_eq!(told([108, 0, 12, 0, 1024, 16, 1090, 4000, 800]), [""; 0]);
        assert_eq!(
            told([96, 0, 9, 0, 1024, 14, 1200, 5000, 700]),
            [
                "a/b.main X Y on navi31: subgroups: 16 -> 14 (-12 %)",
                "a/b.main X Y on navi31: instructions: 1000 -> 1200 (+20 %)"
            ]
        );
        let spilling = table([96, 2, 9, 64, 1024, 16, 1000, 5000, 700]);
        assert_eq!(changes(&old, &spilling).len(), 2);
        assert_eq!(
            changes(&Table::new(), &spilling),
            ["a/b.main X Y on navi31: spills 2 vector registers to memory"]
        );
        assert_eq!(changes(&Table::new(), &old), [""; 0]);
        assert_eq!(
            changes(&old, &Table::new()),
            ["a/b.main X Y on navi31: no such pipeline"]
        );
    }
}
