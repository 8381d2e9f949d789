//! Good outcomes of earlier runs. A program judges the same input in the same way, and few inputs change from run to run.

use std::collections::BTreeMap;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::batches::Outcome;

/// Outcomes by input. Those of inputs that this run doesn't have are dropped.
pub struct Known {
    file: PathBuf,
    version: String,
    before: BTreeMap<String, String>,
    now: BTreeMap<String, String>,
}

impl Known {
    /// Reads the file, if there is one. `version` is everything that affects outcomes, except for the input.
    pub fn open(file: PathBuf, version: impl Hash) -> Self {
        let text = fs::read_to_string(&file).unwrap_or_default();
        let lines = text.lines().filter_map(|line| line.split_once('\t'));
        Self {
            file,
            version: hash(version),
            before: lines
                .map(|(key, figures)| (key.to_owned(), figures.to_owned()))
                .collect(),
            now: BTreeMap::new(),
        }
    }

    /// The outcomes of all inputs: `judge` finds those of the inputs with these indices, which earlier runs didn't have.
    pub fn complete(
        mut self,
        inputs: &[impl Hash],
        judge: impl FnOnce(&[usize]) -> Result<Vec<Outcome>>,
    ) -> Result<Vec<Outcome>> {
        let mut outcomes: Vec<_> = inputs.iter().map(|input| self.get(input)).collect();
        let new: Vec<usize> = (0..inputs.len()).filter(|index| outcomes[*index].is_none()).collect();
        for (index, outcome) in new.iter().zip(judge(&new)?) {
            self.add(&inputs[*index], &outcome);
            outcomes[*index] = Some(outcome);
        }
        self.save()?;
        Ok(outcomes.into_iter().flatten().collect())
    }

    /// The outcome for an input.
    fn get(&mut self, input: impl Hash) -> Option<Outcome> {
        let key = hash((&self.version, hash(input)));
        let figures = self.before.get(&key)?;
        self.now.insert(key, figures.clone());
        let figures = figures.split('\t').filter_map(|figure| figure.split_once('='));
        Some(Ok(figures
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect()))
    }

    /// Keeps an outcome, if it is good.
    fn add(&mut self, input: impl Hash, outcome: &Outcome) {
        let Ok(figures) = outcome else { return };
        let figures: Vec<_> = figures.iter().map(|(name, value)| format!("{name}={value}")).collect();
        let key = hash((&self.version, hash(input)));
        self.now.insert(key, figures.join("\t"));
    }

    /// Writes the file.
    fn save(self) -> Result<()> {
        let lines = self.now.iter().map(|(key, figures)| format!("{key}\t{figures}\n"));
        // An interrupted run leaves the old file.
        let new = self.file.with_extension("new");
        let written = fs::write(&new, lines.collect::<String>()).and_then(|()| fs::rename(new, &self.file));
        written.with_context(|| self.file.display().to_string())
    }
}

fn hash(value: impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn good_outcomes_of_the_same_input_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let open = |version| Known::open(folder.path().join("known"), version);
        let good: Outcome = Ok(vec![
            ("a".to_owned(), "1".to_owned()),
            ("b c".to_owned(), "2".to_owned()),
        ]);
        let mut known = open(1);
        assert_eq!(known.get("x"), None);
        known.add("x", &good);
        known.add("empty", &Ok(Vec::new()));
        known.add("bad", &Err("wrong".to_owned()));
        known.save().unwrap();
        let mut known = open(1);
        assert_eq!(known.get("x"), Some(good));
        assert_eq!(known.get("empty"), Some(Ok(Vec::new())));
        assert_eq!(known.get("bad"), None);
        assert_eq!(known.get("y"), None);
        assert_eq!(open(2).get("x"), None, "of another program");
        // Not asked for.
        open(1).save().unwrap();
        assert_eq!(open(1).get("x"), None);
    }
}
