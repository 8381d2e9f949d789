//! Light that reflections add to a frame, from linear radiance before tone mapping: sums over blocks of pixels, apart for each
//! named object, of the ground truth and of techniques. The frame without reflections is subtracted, so that a small reflection
//! in a bright frame counts in full.

use crate::{
    files::{read_json, write_file, write_json},
    state::TrueSums,
};
use image::{Rgb, RgbImage};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// Edge of a block in pixels. The denoiser's filters reach less far, so that the noise of blocks is nearly independent.
const BLOCK: usize = 64;
/// Edge of a tile of the map in pixels.
const TILE: usize = 8;
/// Pixels with an outline, or with something that doesn't reflect, closer than this don't count.
const MARGIN: usize = 2;
/// Minimum relative step of the inverse distance for an outline. On a plane the inverse distance has hardly any step.
const OUTLINE: f32 = 0.02;
/// Exposed luminance that a pixel must reflect of a white environment. Half floats of bright frames have steps of this size.
const LEAST_REFLECTANCE: f32 = 0.004;
/// Relative error at which the map's colours are saturated.
const MAP_RANGE: f64 = 0.1;

/// Linear luminance (Rec. 709) of each texel; 0 for a non-finite one, which other columns count.
pub fn luminance(texels: &[[f32; 4]]) -> Vec<f32> {
    let values = texels
        .iter()
        .map(|[red, green, blue, _]| 0.212_639 * red + 0.715_169 * green + 0.072_192 * blue);
    values
        .map(|value| if value.is_finite() { value } else { 0.0 })
        .collect()
}

/// Frames that select the pixels that count. They have no noise, so the selection doesn't depend on the noise of the truth.
pub struct Surroundings {
    /// Luminance of all light except reflections.
    pub without: Vec<f32>,
    /// Luminance of Bevy's own lighting in a white environment: pixels that reflect are brighter.
    pub in_white: Vec<f32>,
    /// Distance of each pixel's surface.
    pub distance: Vec<f32>,
    /// Possible objects of each pixel.
    pub objects: Objects,
}

/// Named objects of a scene, and their pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Objects {
    /// Their names.
    pub names: Vec<String>,
    /// For each pixel, one more than the index of its object; 0 without an object.
    pub seen: Vec<u16>,
}

/// The luminance of each pixel of a view in truth.
#[derive(Clone, Debug, PartialEq)]
pub struct TrueLight {
    /// Width of the image in pixels.
    width: usize,
    /// All light except reflections.
    without: Vec<f32>,
    /// For each pixel that counts (it reflects, away from outlines), one more than the index of its cell; 0 for other pixels.
    cells: Vec<u32>,
    /// The object of each cell, as in [`Objects::seen`]. A cell is the part of a block that shows one object.
    objects: Vec<u16>,
    /// Names of the objects.
    names: Vec<String>,
    /// The ground truth of the first half of the samples, and of the second one.
    halves: [Vec<f32>; 2],
}

impl TrueLight {
    /// The light of an image with planes of `width` pixels per row.
    pub fn new(width: u32, surroundings: Surroundings, halves: [Vec<f32>; 2]) -> Self {
        let width = width as usize;
        let counted = counted(width, &surroundings);
        let Surroundings { without, objects, .. } = surroundings;
        let seen = objects.seen.iter().copied().chain(std::iter::repeat(0));
        let shown = counted
            .iter()
            .zip(seen)
            .map(|(&counts, object)| counts.then_some(object));
        Self::with_cells(width, without, halves, objects.names, shown)
    }

    /// Finds cells from the object of each pixel, `None` for pixels that don't count. Cells are numbered in the order of rows of pixels.
    fn with_cells(
        width: usize,
        without: Vec<f32>,
        halves: [Vec<f32>; 2],
        names: Vec<String>,
        shown: impl Iterator<Item = Option<u16>>,
    ) -> Self {
        let (row, columns) = (width.max(1), width.div_ceil(BLOCK));
        let mut objects = Vec::new();
        let mut known = BTreeMap::new();
        let cells = shown.enumerate().map(|(index, object)| {
            let Some(object) = object else { return 0 };
            let block = index / row / BLOCK * columns + index % row / BLOCK;
            *known.entry((block, object)).or_insert_with(|| {
                objects.push(object);
                objects.len() as u32
            })
        });
        let cells = cells.collect();
        Self {
            width,
            without,
            cells,
            objects,
            names,
            halves,
        }
    }

    /// Reads files of [`write`](Self::write). Returns `None` unless they contain an image of that size.
    pub fn read(file: &Path, width: u32, height: u32) -> Option<Self> {
        let (width, pixels) = (width as usize, width as usize * height as usize);
        let [without, objects, first, second] = read_planes(file, pixels)?.try_into().ok()?;
        let names = read_json(&names_file(file))?;
        let shown = objects.iter().map(|object| (*object >= 0.0).then_some(*object as u16));
        Some(Self::with_cells(width, without, [first, second], names, shown))
    }

    /// Writes a file, and another one with the names of objects.
    pub fn write(&self, file: &Path) -> Result<(), String> {
        let [first, second] = &self.halves;
        // Whole numbers of 16 bits are exact in 32 bits of float.
        let object = |&cell: &u32| match cell {
            0 => -1.0,
            cell => f32::from(self.objects[cell as usize - 1]),
        };
        let objects: Vec<f32> = self.cells.iter().map(object).collect();
        write_json(&names_file(file), &self.names)?;
        write_planes(file, &[&self.without, &objects, first, second])
    }

    /// Width of the image in pixels.
    pub fn width(&self) -> u32 {
        self.width as u32
    }

    /// The ground truth by each half of the samples.
    pub fn halves(&self) -> &[Vec<f32>; 2] {
        &self.halves
    }

    /// All light except reflections.
    pub fn without(&self) -> &[f32] {
        &self.without
    }

    fn counts(&self, index: usize) -> bool {
        self.cells[index] > 0
    }

    /// Sums of the truth over cells.
    pub fn sums(&self) -> TrueSums {
        TrueSums {
            halves: [0, 1].map(|half| self.shown(&self.halves[half])),
            pixels: self.cells.iter().filter(|cell| **cell > 0).count(),
            objects: self.objects.clone(),
            names: self.names.clone(),
        }
    }

    /// Sums over cells of the reflected light in a frame.
    pub fn shown(&self, frame: &[f32]) -> Vec<f64> {
        let mut sums = vec![0.0; self.objects.len()];
        for (index, &cell) in self.cells.iter().enumerate().filter(|(_, cell)| **cell > 0) {
            sums[cell as usize - 1] += f64::from(frame[index] - self.without[index]);
        }
        sums
    }

    /// Sums over the tiles of the map.
    fn sum_tiles(&self, value: impl Fn(usize) -> f32) -> Vec<f64> {
        let (width, height) = (self.width, self.without.len() / self.width.max(1));
        let columns = width.div_ceil(TILE);
        let mut sums = vec![0.0; columns * height.div_ceil(TILE)];
        for index in (0..width * height).filter(|index| self.counts(*index)) {
            let (x, y) = (index % width, index / width);
            sums[y / TILE * columns + x / TILE] += f64::from(value(index));
        }
        sums
    }

    /// A map of the error of frames: red for too much reflected light, blue for too little, saturated at 10 %, and black for pixels that
    /// don't count.
    pub fn map(&self, frames: &[Vec<f32>]) -> RgbImage {
        let truth = |index: usize| 0.5 * (self.halves[0][index] + self.halves[1][index]);
        let expected = self.sum_tiles(|index| truth(index) - self.without[index]);
        let error = self.sum_tiles(|index| {
            let sum: f32 = frames.iter().map(|frame| frame[index]).sum();
            sum / frames.len() as f32 - truth(index)
        });
        let (width, height) = (self.width, self.without.len() / self.width.max(1));
        let columns = width.div_ceil(TILE);
        RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let (x, y) = (x as usize, y as usize);
            let tile = y / TILE * columns + x / TILE;
            if !self.counts(y * width + x) || expected[tile] <= 0.0 {
                return Rgb([0; 3]);
            }
            let share = (error[tile] / expected[tile] / MAP_RANGE).clamp(-1.0, 1.0);
            let faded = (255.0 * (1.0 - share.abs())) as u8;
            Rgb(if share > 0.0 {
                [255, faded, faded]
            } else {
                [faded, faded, 255]
            })
        })
    }
}

/// The file of names beside a file of light.
fn names_file(file: &Path) -> PathBuf {
    file.with_extension("objects.json")
}

/// Flags of the pixels whose surroundings reflect and have no outline.
fn counted(width: usize, surroundings: &Surroundings) -> Vec<bool> {
    let Surroundings {
        without,
        in_white,
        distance,
        ..
    } = surroundings;
    let height = without.len() / width.max(1);
    let is_smooth = |index: usize, step: usize| {
        let [before, here, after] = [index - step, index, index + step].map(|index| distance[index].recip());
        (before + after - 2.0 * here).abs() < OUTLINE * here
    };
    let is_good = |index: usize| {
        let (x, y) = (index % width, index / width);
        let has_neighbours = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
        let reflects = in_white[index] - without[index] > LEAST_REFLECTANCE;
        reflects && has_neighbours && is_smooth(index, 1) && is_smooth(index, width)
    };
    let good: Vec<bool> = (0..without.len()).map(is_good).collect();
    let counts = |index: usize| {
        let (x, y) = (index % width, index / width);
        let is_inside = x >= MARGIN && y >= MARGIN && x + MARGIN < width && y + MARGIN < height;
        let mut rows = y.saturating_sub(MARGIN)..=y + MARGIN;
        is_inside
            && rows.all(|y| {
                good[y * width + x - MARGIN..=y * width + x + MARGIN]
                    .iter()
                    .all(|good| *good)
            })
    };
    (0..without.len()).map(counts).collect()
}

/// Writes planes of numbers, one after the other.
pub fn write_planes(file: &Path, planes: &[&[f32]]) -> Result<(), String> {
    let values = planes.iter().flat_map(|plane| plane.iter());
    let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
    write_file(file, |file| file.write_all(&bytes))
}

/// Reads planes of this number of values; `None` without the file, or if it has a part of a plane.
pub fn read_planes(file: &Path, pixels: usize) -> Option<Vec<Vec<f32>>> {
    let bytes = fs::read(file).ok()?;
    if pixels == 0 || bytes.len() % (4 * pixels) != 0 {
        return None;
    }
    let plane = |plane: &[u8]| {
        let values = plane.chunks_exact(4);
        values
            .map(|value| f32::from_le_bytes([value[0], value[1], value[2], value[3]]))
            .collect()
    };
    Some(bytes.chunks_exact(4 * pixels).map(plane).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 100;
    const HEIGHT: usize = 80;

    /// One value for a reflecting surface, another one for the matte ground below it and on its left.
    fn plane(reflecting: f32, other: f32) -> Vec<f32> {
        let rows = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
        rows.map(|(x, y)| if y < 60 && x >= 10 { reflecting } else { other })
            .collect()
    }

    /// The distance of a slanted plane, with a part that is nearer.
    fn surroundings() -> Surroundings {
        let distance = |x: usize| 1.0 / (0.1 + 0.002 * x as f32) * if x < 70 { 1.0 } else { 0.9 };
        Surroundings {
            without: plane(0.01, 0.3),
            in_white: plane(0.06, 0.3),
            distance: (0..WIDTH * HEIGHT).map(|index| distance(index % WIDTH)).collect(),
            objects: Objects {
                names: vec!["left".into(), "right".into()],
                seen: (0..WIDTH * HEIGHT)
                    .map(|index| u16::from(index % WIDTH >= 20))
                    .collect(),
            },
        }
    }

    /// The pixels that count: 4 rows and columns are at the margins, 6 columns around the step.
    const COUNTED: usize = (90 - 5 - 6) * (60 - 5);

    fn light() -> TrueLight {
        TrueLight::new(WIDTH as u32, surroundings(), [plane(0.031, 0.3), plane(0.029, 0.3)])
    }

    #[test]
    fn pixels_that_reflect_count_away_from_outlines() {
        let light = light();
        let counts = |x: usize, y: usize| light.counts(y * WIDTH + x);
        let row: Vec<usize> = (0..WIDTH).filter(|x| counts(*x, 30)).collect();
        let expected: Vec<usize> = (12..67).chain(73..97).collect();
        assert_eq!(row, expected);
        let column: Vec<usize> = (0..HEIGHT).filter(|y| counts(50, *y)).collect();
        assert_eq!(column, (3..58).collect::<Vec<_>>());
        assert_eq!(light.sums().pixels, COUNTED);
    }

    #[test]
    fn reflected_light_is_what_exceeds_the_frame_without_it() {
        let light = light();
        let sums = light.sums();
        // The left one of two blocks shows a named and an unnamed object.
        assert_eq!(sums.objects, [0, 1, 1]);
        assert_eq!(sums.halves[0].len(), 3);
        let total = |sums: &[f64]| sums.iter().sum::<f64>();
        assert!((total(&sums.halves[0]) / (0.021 * COUNTED as f64) - 1.0).abs() < 1e-5);
        assert!((total(&sums.halves[1]) / (0.019 * COUNTED as f64) - 1.0).abs() < 1e-5);
        assert_eq!(total(&light.shown(&light.without)), 0.0);
    }

    #[test]
    fn maps_have_a_sign() {
        let light = light();
        let map = |factor: f32| {
            let frame = light.without.iter().map(|without| without + factor * 0.02).collect();
            light.map(&[frame])[(50, 30)].0
        };
        let [bright, dark] = [map(1.05), map(0.5)];
        assert!(bright[0] == 255 && (120..136).contains(&bright[1]), "{bright:?}");
        assert_eq!(dark, [0, 0, 255]);
        assert_eq!(light.map(std::slice::from_ref(&light.without))[(0, 0)].0, [0; 3]);
    }

    #[test]
    fn files_hold_whole_images() {
        let folder = tempfile::tempdir().unwrap();
        let (file, light) = (folder.path().join("light.f32"), light());
        light.write(&file).unwrap();
        assert_eq!(TrueLight::read(&file, 100, 80), Some(light.clone()));
        assert_eq!(TrueLight::read(&file, 100, 79), None);
        write_planes(&file, &[&light.without]).unwrap();
        assert_eq!(TrueLight::read(&file, 100, 80), None);
    }

    #[test]
    fn broken_texels_have_no_light() {
        let texels = [[f32::NAN, 1.0, 1.0, 1.0], [1.0; 4], [f32::INFINITY; 4]];
        assert_eq!(luminance(&texels), [0.0, 1.0, 0.0]);
    }
}
