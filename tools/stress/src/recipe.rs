//! What a hostile scene is made of: a seed and a list of ingredients, drawn at random, and made simpler until only what hurts is left.

use crate::{ingredients::Ingredient, random::Random};
use bevy::math::UVec2;

/// Sizes of pictures: one pixel, odd ones, and ordinary ones, small enough for a CPU.
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
/// Most ingredients of a random scene.
const MOST: usize = 9;
/// One of so many random scenes may hold something heavy.
const HEAVY_SHARE: f32 = 0.02;

/// A hostile scene before it is built. The same recipe always makes the same scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// Everything random follows from it.
    pub seed: u64,
    /// Pixels of each camera.
    pub size: UVec2,
    /// Frames to render once all is loaded.
    pub frames: u32,
    /// What is in the scene, each with its place in the recipe that it was first in: what it draws at random depends on that.
    pub ingredients: Vec<(usize, Ingredient)>,
    /// An ingredient that every recipe of this run has, first in the list.
    pub required: Option<Ingredient>,
}

impl Recipe {
    /// A recipe of these ingredients.
    #[must_use]
    pub fn new(seed: u64, size: UVec2, frames: u32, ingredients: Vec<Ingredient>) -> Self {
        Self {
            seed,
            size,
            frames,
            ingredients: ingredients.into_iter().enumerate().collect(),
            required: None,
        }
    }

    /// A random recipe; `required` is in it.
    #[must_use]
    pub fn random(seed: u64, required: Option<Ingredient>) -> Self {
        let mut random = Random::new(seed);
        let size = random.pick(&SIZES);
        let frames = 2 + random.below(9) as u32;
        let all = Ingredient::all();
        let light: Vec<_> = all
            .iter()
            .copied()
            .filter(|ingredient| !ingredient.is_heavy())
            .collect();
        let heavy: Vec<_> = all.iter().copied().filter(|ingredient| ingredient.is_heavy()).collect();
        let count = 1 + random.below(MOST);
        let mut ingredients: Vec<_> = required.into_iter().collect();
        ingredients.extend((0..count).map(|_| random.pick(&light)));
        if random.chance(HEAVY_SHARE) {
            ingredients.push(random.pick(&heavy));
        }
        Self {
            required,
            ..Self::new(seed, size, frames, ingredients)
        }
    }

    /// Recipes that together hold every ingredient that isn't heavy, dealt out evenly.
    #[must_use]
    pub fn cover(seed: u64, size: UVec2, frames: u32) -> Vec<Self> {
        let all = Ingredient::all();
        let light = || all.iter().copied().filter(|ingredient| !ingredient.is_heavy());
        // Of those kinds a scene takes only one at a time.
        let exclusive = |ingredient: &Ingredient| {
            matches!(
                ingredient,
                Ingredient::Surroundings(_) | Ingredient::View(_) | Ingredient::Settings(_) | Ingredient::Event(_)
            )
        };
        let mut decks: Vec<Vec<Ingredient>> = Vec::new();
        for ingredient in light().filter(exclusive) {
            let same = |other: &Ingredient| core::mem::discriminant(other) == core::mem::discriminant(&ingredient);
            match decks.iter_mut().find(|deck| deck.first().is_some_and(same)) {
                Some(deck) => deck.push(ingredient),
                None => decks.push(vec![ingredient]),
            }
        }
        let count = decks.iter().map(Vec::len).max().unwrap_or(1).max(1);
        let mut dealt = vec![Vec::new(); count];
        for deck in decks {
            for (hand, ingredient) in dealt.iter_mut().zip(deck) {
                hand.push(ingredient);
            }
        }
        for (index, ingredient) in light().filter(|ingredient| !exclusive(ingredient)).enumerate() {
            dealt[index % count].push(ingredient);
        }
        let recipe = |(index, ingredients): (usize, Vec<Ingredient>)| {
            Self::new(seed.wrapping_add(index as u64), size, frames, ingredients)
        };
        dealt.into_iter().enumerate().map(recipe).collect()
    }

    /// Only the ingredients with these places.
    #[must_use]
    pub fn keep(mut self, places: &[usize]) -> Self {
        self.ingredients.retain(|(place, _)| places.contains(place));
        self
    }

    /// Without what takes very much memory or time.
    #[must_use]
    pub fn without_heavy(mut self) -> Self {
        self.ingredients.retain(|(_, ingredient)| !ingredient.is_heavy());
        self
    }

    /// Simpler recipes, the simplest first: half of the ingredients, all but one of them, fewer frames, a smaller picture.
    #[must_use]
    pub fn shrink(&self) -> Vec<Self> {
        let mut simpler = Vec::new();
        let count = self.ingredients.len();
        let with = |ingredients: Vec<(usize, Ingredient)>| Self {
            ingredients,
            ..self.clone()
        };
        if count > 3 {
            let (first, second) = self.ingredients.split_at(count / 2);
            simpler.extend([with(first.to_vec()), with(second.to_vec())]);
        }
        for left_out in 0..count {
            let mut rest = self.ingredients.clone();
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

    /// The options that make this recipe again.
    #[must_use]
    pub fn options(&self) -> String {
        let places: Vec<_> = self.ingredients.iter().map(|(place, _)| place.to_string()).collect();
        let keep = if places.is_empty() {
            "none".to_owned()
        } else {
            places.join(",")
        };
        let only = self
            .required
            .map(|ingredient| format!(" --only {}", ingredient.name()))
            .unwrap_or_default();
        let Self { seed, size, frames, .. } = self;
        format!(
            "--seed {seed} --keep {keep} --frames {frames} --size {}x{}{only}",
            size.x, size.y
        )
    }

    /// Names of the ingredients.
    #[must_use]
    pub fn describe(&self) -> String {
        let names: Vec<_> = self
            .ingredients
            .iter()
            .map(|(_, ingredient)| ingredient.name())
            .collect();
        if names.is_empty() {
            "nothing but the ordinary scene".to_owned()
        } else {
            names.join(", ")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn recipes_follow_from_their_seeds() {
        for seed in 0..50 {
            assert_eq!(Recipe::random(seed, None), Recipe::random(seed, None));
        }
        let different: BTreeSet<_> = (0..50).map(|seed| Recipe::random(seed, None).describe()).collect();
        assert!(different.len() > 40);
    }

    #[test]
    fn simpler_recipes_are_simpler_and_come_to_an_end() {
        let weight = |recipe: &Recipe| {
            recipe.ingredients.len() as u64 * 1000
                + u64::from(recipe.frames) * 10
                + u64::from(recipe.size.max_element())
        };
        for seed in 0..20 {
            let mut recipe = Recipe::random(seed, None);
            let mut steps = 0;
            while let Some(simpler) = recipe.shrink().pop() {
                assert!(weight(&simpler) < weight(&recipe), "{recipe:?} to {simpler:?}");
                recipe = simpler;
                steps += 1;
                assert!(steps < 100);
            }
            assert!(recipe.ingredients.is_empty());
        }
    }

    #[test]
    fn a_kept_part_draws_what_it_drew_before() {
        let recipe = Recipe::random(3, None);
        let last = recipe.ingredients.len() - 1;
        let kept = recipe.clone().keep(&[last]);
        assert_eq!(kept.ingredients, recipe.ingredients[last..]);
        assert!(
            kept.options().contains(&format!("--keep {last} ")),
            "{}",
            kept.options()
        );
    }

    #[test]
    fn the_cover_holds_everything_once() {
        let mut seen = Vec::new();
        for recipe in Recipe::cover(1, UVec2::splat(8), 2) {
            seen.extend(recipe.ingredients.into_iter().map(|(_, ingredient)| ingredient));
        }
        let all: Vec<_> = Ingredient::all()
            .into_iter()
            .filter(|ingredient| !ingredient.is_heavy())
            .collect();
        assert_eq!(seen.len(), all.len());
        assert!(all.iter().all(|ingredient| seen.contains(ingredient)));
    }
}
