//! A campaign: many thousands of scenes in any number of runs. A folder stores the tried scenes and the failures, and the pairs of
//! ingredients that occurred together are counted.

use crate::{
    generators::Generator,
    options::{Options, Tracer},
    protocol::Case,
    scenario::Scenario,
    word::word,
};
use core::{fmt, ops::Range};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

const STATE: &str = "campaign.json";

/// Results so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct State {
    /// Seeds that were tried, by tracer.
    tried: BTreeMap<String, Range<u64>>,
    /// Recipes that failed, the simplest of each kind, by problem.
    failures: BTreeMap<String, Case>,
}

/// A campaign of `count` scenes.
#[derive(Clone, Debug)]
pub struct Campaign {
    folder: PathBuf,
    count: u64,
    state: State,
}

impl Campaign {
    /// Continues the campaign of a folder, or begins one there. Fails if the folder can't be created, or its content can't be read.
    pub fn open(folder: &Path, count: u64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let state = match fs::read_to_string(folder.join(STATE)) {
            Ok(text) => serde_json::from_str(&text)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => State::default(),
            Err(error) => return Err(error),
        };
        Ok(Self {
            folder: folder.to_owned(),
            count,
            state,
        })
    }

    /// The first seed that no scene of this tracer had yet.
    pub fn next_seed(&self, tracer: Tracer, first: u64) -> u64 {
        self.state.tried.get(&word(&tracer)).map_or(first, |tried| tried.end)
    }

    /// Scenes that remain to be tried.
    pub fn left(&self) -> u64 {
        let tried: u64 = self.state.tried.values().map(|seeds| seeds.end - seeds.start).sum();
        self.count.saturating_sub(tried)
    }

    /// Recipes that failed, and should be repeated.
    pub fn recipes(&self) -> Vec<Options> {
        self.state
            .failures
            .values()
            .map(|failure| failure.repeat.clone())
            .collect()
    }

    pub fn forget(&mut self, recipe: &Options) {
        self.state.failures.retain(|_, failure| failure.repeat != *recipe);
    }

    /// Records that the scenes of these seeds were tried, and their failures; writes it down. Fails if the folder can't be written.
    pub fn note(&mut self, tracer: Tracer, seeds: Range<u64>, failures: &[Case]) -> io::Result<()> {
        let tried = self
            .state
            .tried
            .entry(word(&tracer))
            .or_insert(seeds.start..seeds.start);
        tried.end = tried.end.max(seeds.end);
        for failure in failures {
            let known = self
                .state
                .failures
                .entry(kind_of(failure))
                .or_insert_with(|| failure.clone());
            if ingredients(failure) < ingredients(known) {
                *known = failure.clone();
            }
        }
        let text = serde_json::to_string_pretty(&self.state)?;
        // Whole or not at all, if the run is ended.
        let new = self.folder.join("campaign.new");
        fs::write(&new, text)?;
        fs::rename(new, self.folder.join(STATE))
    }
}

/// Failures with the same text, apart from numbers, are of one kind.
fn kind_of(failure: &Case) -> String {
    let first = failure.problems.first().map_or("", String::as_str);
    first.chars().filter(|c| !c.is_ascii_digit()).take(160).collect()
}

fn ingredients(failure: &Case) -> usize {
    failure.repeat.keep.as_ref().map_or(usize::MAX, |keep| keep.0.len())
}

impl fmt::Display for Campaign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "==> the campaign so far, of {} scenes:", self.count)?;
        for (tracer, seeds) in &self.state.tried {
            writeln!(f, "    {tracer}: {} scenes of seeds {seeds:?}", seeds.end - seeds.start)?;
        }
        for (kind, failure) in &self.state.failures {
            writeln!(
                f,
                "    fails: {kind}\n        again: cargo xtask stress {}",
                failure.repeat
            )?;
        }
        let seeds: BTreeSet<u64> = self.state.tried.values().cloned().flatten().collect();
        let scenarios = seeds.into_iter().map(|seed| Scenario::random(seed, None));
        write!(f, "{}", Coverage::of(scenarios))
    }
}

/// Pairs of ingredients that have met in a scene, by kind of ingredient.
struct Coverage {
    kinds: Vec<&'static str>,
    /// Pairs that have met, and all of them, by the kinds of both.
    pairs: BTreeMap<(usize, usize), [usize; 2]>,
}

impl Coverage {
    fn of(scenarios: impl Iterator<Item = Scenario>) -> Self {
        let all = Generator::all();
        let mut kinds: Vec<&'static str> = all.iter().map(|generator| generator.kind()).collect();
        kinds.dedup();
        let mut met = BTreeSet::new();
        for scenario in scenarios {
            let generators = scenario.generators.iter();
            let present = generators.filter_map(|(_, generator)| all.iter().position(|other| other == generator));
            met.extend(pairs_of(&present.collect()));
        }
        let kind_of = |index: usize| kinds.iter().position(|kind| *kind == all[index].kind());
        let mut pairs = BTreeMap::<_, [usize; 2]>::new();
        for (a, b) in pairs_of(&(0..all.len()).collect()) {
            if let Some(kinds) = kind_of(a).zip(kind_of(b)) {
                let counts = pairs.entry(kinds).or_default();
                counts[0] += usize::from(met.contains(&(a, b)));
                counts[1] += 1;
            }
        }
        Self { kinds, pairs }
    }
}

/// Pairs of indices, the lower one first.
fn pairs_of(indices: &BTreeSet<usize>) -> impl Iterator<Item = (usize, usize)> + '_ {
    indices.iter().flat_map(|a| indices.range(a + 1..).map(|b| (*a, *b)))
}

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [met, all] = self
            .pairs
            .values()
            .fold([0, 0], |sum, counts| [sum[0] + counts[0], sum[1] + counts[1]]);
        writeln!(
            f,
            "==> {met} of {all} pairs of ingredients have met, in percent by kind:"
        )?;
        write!(f, "    {:12}", "")?;
        for kind in &self.kinds {
            write!(f, "{kind:>13}")?;
        }
        for (row, kind) in self.kinds.iter().enumerate() {
            write!(f, "\n    {kind:12}")?;
            for column in 0..self.kinds.len() {
                match self.pairs.get(&(row, column)) {
                    Some([met, all]) => write!(f, "{:>13}", 100 * met / all)?,
                    None => write!(f, "{:>13}", "")?,
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::tests::parse;

    fn failure(problem: &str, options: &str) -> Case {
        Case {
            what: "a scene".into(),
            problems: vec![problem.into()],
            repeat: parse(options).unwrap(),
        }
    }

    #[test]
    fn a_campaign_goes_on_where_it_was_left() {
        let folder = tempfile::tempdir().unwrap();
        let mut campaign = Campaign::open(folder.path(), 100).unwrap();
        assert_eq!((campaign.next_seed(Tracer::Bvh, 7), campaign.left()), (7, 100));
        let failures = [
            failure("Target: camera 4v0: 3 of 9 texels", "--seed 8 --keep 0,1,2"),
            failure("Target: camera 11v2: 5 of 6 texels", "--seed 20 --keep 4"),
            failure("Panic: index 4 out of range", "--seed 9 --keep 1"),
        ];
        campaign.note(Tracer::Bvh, 7..30, &failures).unwrap();
        campaign.note(Tracer::RayQuery, 7..17, &[]).unwrap();
        let mut campaign = Campaign::open(folder.path(), 100).unwrap();
        assert_eq!((campaign.next_seed(Tracer::Bvh, 7), campaign.left()), (30, 67));
        let recipes = campaign.recipes();
        assert_eq!(recipes.len(), 2, "{campaign}");
        assert!(
            recipes.contains(&failures[1].repeat),
            "the simplest of its kind: {campaign}"
        );
        campaign.forget(&failures[1].repeat);
        assert_eq!(campaign.recipes().len(), 1);
    }

    #[test]
    fn pairs_that_meet_are_counted() {
        let all = Generator::all();
        let scenario = |generators: &[Generator]| Scenario::new(1, bevy::math::UVec2::ONE, 1, generators.to_vec());
        let of_a_kind = [all[0], all[1]];
        let (first, last) = (all[0], all[all.len() - 1]);
        let coverage = Coverage::of([scenario(&of_a_kind), scenario(&[last, first, last])].into_iter());
        let met = |a, b| coverage.pairs[&(a, b)][0];
        assert_eq!((met(0, 0), met(0, coverage.kinds.len() - 1)), (1, 1));
        let counts = coverage.pairs.values();
        let [met, all_pairs] = counts.fold([0, 0], |sum, counts| [sum[0] + counts[0], sum[1] + counts[1]]);
        assert_eq!((met, all_pairs), (2, all.len() * (all.len() - 1) / 2));
        assert_eq!(coverage.kinds.len(), 10);
    }
}
