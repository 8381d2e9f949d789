//! A hostile scene as data: a seed and a list of generators, drawn at random, and simplified until only the cause of a failure is
//! left.

use crate::{
    generators::{Builder, Generator, HostileScene},
    harness::Harness,
};
use bevy::math::UVec2;
use glint_scenes::Random;

/// Sizes of images: one pixel, odd ones, and ordinary ones that a CPU can afford.
const SIZES: [UVec2; 8] = [
    UVec2::new(1, 1),
    UVec2::new(2, 3),
    UVec2::new(7, 13),
    UVec2::new(33, 17),
    UVec2::new(48, 32),
    UVec2::new(64, 64),
    UVec2::new(97, 61),
    UVec2::new(130, 9),
];
/// Maximum number of generators of a random scenario.
const MOST: usize = 9;
/// Probability of a heavy generator in a random scenario.
const HEAVY: f32 = 0.02;
/// Probability that a random scenario is long, so that objects are merged and views become static.
const LONG: f32 = 0.05;
/// Frames of a long one.
const LONG_FRAMES: u32 = 300;

/// A hostile scene before it is built. The same scenario always builds the same scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Seed of everything random.
    pub seed: u64,
    /// Pixels of each camera.
    pub size: UVec2,
    /// Frames to render once everything is loaded.
    pub frames: u32,
    /// Generators, each with its position in the original scenario, which determines its random numbers.
    pub generators: Vec<(usize, Generator)>,
}

impl Scenario {
    pub fn new(seed: u64, size: UVec2, frames: u32, generators: Vec<Generator>) -> Self {
        Self {
            seed,
            size,
            frames,
            generators: generators.into_iter().enumerate().collect(),
        }
    }

    /// A random scenario that begins with the required generator, if there is one.
    pub fn random(seed: u64, required: Option<Generator>) -> Self {
        let mut random = Random::new(seed);
        let size = random.pick(&SIZES);
        let frames = 2 + random.below(9) as u32;
        let (heavy, light): (Vec<_>, Vec<_>) = Generator::all().into_iter().partition(|generator| generator.is_heavy());
        let count = 1 + random.below(MOST);
        let mut generators: Vec<_> = required.into_iter().collect();
        generators.extend((0..count).map(|_| random.pick(&light)));
        if random.chance(HEAVY) {
            generators.push(random.pick(&heavy));
        }
        let frames = if random.chance(LONG) { LONG_FRAMES } else { frames };
        Self::new(seed, size, frames, generators)
    }

    /// Keeps only the generators at these positions.
    pub fn keep(mut self, positions: &[usize]) -> Self {
        self.generators.retain(|(position, _)| positions.contains(position));
        self
    }

    /// Simpler scenarios, the simplest first: half of the generators, all but one, fewer frames, a smaller image.
    pub fn shrink(&self) -> Vec<Self> {
        let count = self.generators.len();
        let with = |generators: Vec<(usize, Generator)>| Self {
            generators,
            ..self.clone()
        };
        let mut simpler = Vec::new();
        if count > 3 {
            let (first, second) = self.generators.split_at(count / 2);
            simpler.extend([with(first.to_vec()), with(second.to_vec())]);
        }
        for left_out in 0..count {
            let mut rest = self.generators.clone();
            rest.remove(left_out);
            simpler.push(with(rest));
        }
        if self.frames > 1 {
            simpler.push(Self {
                frames: self.frames / 2,
                ..self.clone()
            });
        }
        if self.size.max_element() > 8 {
            simpler.push(Self {
                size: (self.size / 2).max(UVec2::ONE),
                ..self.clone()
            });
        }
        simpler
    }

    /// Names of the generators.
    pub fn describe(&self) -> String {
        let names: Vec<_> = self.generators.iter().map(|(_, generator)| generator.name()).collect();
        if names.is_empty() {
            "the ordinary scene alone".to_owned()
        } else {
            names.join(", ")
        }
    }

    pub fn build(&self, harness: &mut Harness) -> HostileScene {
        let mut builder = Builder::new(harness, self.seed, self.size);
        for (position, generator) in &self.generators {
            builder.scene.random = Random::of_part(self.seed, *position);
            generator.add(&mut builder);
        }
        builder.finish(Random::of_part(self.seed, usize::MAX - 1))
    }
}

/// The scenarios of the tests.
#[cfg(test)]
impl Scenario {
    /// Scenarios that together contain every generator that isn't heavy, distributed evenly.
    pub fn cover(seed: u64, size: UVec2, frames: u32) -> Vec<Self> {
        // A scene takes only one of each of these kinds at a time.
        let is_exclusive = |generator: &Generator| {
            matches!(
                generator,
                Generator::Surroundings(_) | Generator::View(_) | Generator::Settings(_) | Generator::Event(_)
            )
        };
        let light = Generator::all().into_iter().filter(|generator| !generator.is_heavy());
        let (exclusive, shared): (Vec<_>, Vec<_>) = light.partition(is_exclusive);
        let is_same = |a: &Generator, b: &Generator| core::mem::discriminant(a) == core::mem::discriminant(b);
        let kinds: Vec<_> = exclusive.chunk_by(is_same).collect();
        let count = kinds.iter().map(|kind| kind.len()).max().unwrap_or(1);
        let mut lists = vec![Vec::new(); count];
        for kind in kinds {
            for (list, generator) in lists.iter_mut().zip(kind) {
                list.push(*generator);
            }
        }
        for (index, generator) in shared.into_iter().enumerate() {
            lists[index % count].push(generator);
        }
        let scenario = |(index, generators): (usize, Vec<Generator>)| {
            Self::new(seed.wrapping_add(index as u64), size, frames, generators)
        };
        lists.into_iter().enumerate().map(scenario).collect()
    }

    /// Removes generators that take very much memory or time.
    pub fn without_heavy(mut self) -> Self {
        self.generators.retain(|(_, generator)| !generator.is_heavy());
        self
    }

    /// An event changes objects or their meshes.
    pub fn changes_objects(&self) -> bool {
        let mut generators = self.generators.iter();
        generators.any(|(_, generator)| matches!(generator, Generator::Event(event) if event.changes_objects()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn scenarios_follow_from_their_seeds() {
        for seed in 0..50 {
            assert_eq!(Scenario::random(seed, None), Scenario::random(seed, None));
        }
        let different: BTreeSet<_> = (0..50).map(|seed| Scenario::random(seed, None).describe()).collect();
        assert!(different.len() > 40);
    }

    #[test]
    fn simpler_scenarios_come_to_an_end() {
        let weight = |scenario: &Scenario| {
            scenario.generators.len() as u64 * 1000
                + u64::from(scenario.frames) * 10
                + u64::from(scenario.size.max_element())
        };
        for seed in 0..20 {
            let mut scenario = Scenario::random(seed, None);
            let mut steps = 0;
            while let Some(simpler) = scenario.shrink().pop() {
                assert!(weight(&simpler) < weight(&scenario), "{scenario:?} to {simpler:?}");
                scenario = simpler;
                steps += 1;
                assert!(steps < 100);
            }
            assert!(scenario.generators.is_empty());
        }
    }

    #[test]
    fn the_cover_holds_everything_once() {
        let mut seen = Vec::new();
        for scenario in Scenario::cover(1, UVec2::splat(8), 2) {
            seen.extend(scenario.generators.into_iter().map(|(_, generator)| generator));
        }
        let mut all = Generator::all();
        all.retain(|generator| !generator.is_heavy());
        assert_eq!(seen.len(), all.len());
        assert!(all.iter().all(|generator| seen.contains(generator)));
    }
}
