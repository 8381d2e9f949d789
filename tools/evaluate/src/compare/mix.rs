//! The least error of an image that takes each tile from one of two techniques.
//!
//! This bounds the gain of a choice by tile before it is built. Tiles are chosen by the errors of later runs and judged by the first
//! one: with the same runs for both, the choice would follow their noise.

use super::{
    image::{load, reflection_alone},
    metrics::flip,
};
use crate::job::{ImageKind, image_file};
use std::{fmt::Write, fs, path::Path};

/// Pixels of a tile in each direction, as in the denoiser.
const TILE: usize = 16;
/// Growth of the error that counts as none.
const ALLOWED: f64 = 1.01;

/// Errors of a tile's pixels with both techniques.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tile {
    /// In the first run.
    judged: [f64; 2],
    /// In the others.
    chosen: [f64; 2],
}

/// Prints, for each scene of a folder of results, how much error a share of tiles of the second technique adds to the first one's.
pub fn table(out: &Path, names: [&str; 2], runs: u32) -> Result<String, String> {
    let images = out.join("images");
    let folders = fs::read_dir(&images).map_err(|error| format!("{} can't be read: {error}", images.display()))?;
    let mut scenes: Vec<_> = folders.filter_map(|entry| Some(entry.ok()?.path())).collect();
    scenes.sort();
    let mut text = String::from(
        "| scene | tiles | half of them | all of them | share at an error within 1 % |\n|---|---:|---:|---:|---:|\n",
    );
    for scene in scenes {
        let mut tiles = Vec::new();
        let views = (0..).map(|view| scene.join(format!("view-{view}")));
        // Images of further tracers are elsewhere than their truth.
        for view in views.take_while(|view| view.join("converged.png").exists()) {
            tiles.extend(tiles_of(&view, names, runs)?);
        }
        if tiles.is_empty() {
            continue;
        }
        let errors = mixed_errors(tiles);
        let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
        let share = errors.iter().rposition(|&error| error <= ALLOWED).unwrap_or(0);
        _ = writeln!(
            text,
            "| {} | {} | {:.3} | {:.3} | {:.0} % |",
            scene.file_name().unwrap_or_default().to_string_lossy(),
            errors.len() - 1,
            at(0.5),
            at(1.0),
            100.0 * share as f64 / (errors.len() - 1).max(1) as f64
        );
    }
    Ok(text)
}

/// The error relative to the first technique's after each tile that changes to the second one, the best first.
fn mixed_errors(mut tiles: Vec<Tile>) -> Vec<f64> {
    tiles.retain(|tile| tile.judged != [0.0; 2]);
    let change = |tile: &Tile| tile.chosen[1] - tile.chosen[0];
    tiles.sort_by(|a, b| change(a).total_cmp(&change(b)));
    let all: f64 = tiles.iter().map(|tile| tile.judged[0]).sum();
    let mut mixed = all;
    let mut errors = vec![1.0];
    for tile in tiles {
        mixed += tile.judged[1] - tile.judged[0];
        errors.push(mixed / all);
    }
    errors
}

fn tiles_of(view: &Path, names: [&str; 2], runs: u32) -> Result<Vec<Tile>, String> {
    let dark = load(&view.join("dark.png"))?;
    let truth = reflection_alone(&load(&view.join("converged.png"))?, &dark)?;
    let columns = (truth.width() as usize).div_ceil(TILE);
    let mut tiles = vec![Tile::default(); columns * (truth.height() as usize).div_ceil(TILE)];
    for run in 0..runs {
        for (technique, name) in names.iter().enumerate() {
            let kind = if run == 0 {
                ImageKind::Final
            } else {
                ImageKind::Run(run)
            };
            let image = load(&image_file(view, name, kind))?;
            let map = flip(&truth, &reflection_alone(&image, &dark)?)?;
            for (index, error) in map.values().into_iter().enumerate() {
                let (x, y) = (index % truth.width() as usize, index / truth.width() as usize);
                let tile = &mut tiles[y / TILE * columns + x / TILE];
                let sums = if run == 0 { &mut tile.judged } else { &mut tile.chosen };
                sums[technique] += f64::from(error);
            }
        }
    }
    Ok(tiles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_tiles_change_first() {
        let tile = |first: f64, second: f64| Tile {
            judged: [first, second],
            chosen: [first, second],
        };
        let errors = mixed_errors(vec![tile(2.0, 4.0), tile(0.0, 0.0), tile(2.0, 1.0)]);
        assert_eq!(errors, [1.0, 0.75, 1.25]);
    }
}
