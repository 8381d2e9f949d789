//! Images of 8 bits in sRGB, and their preparation for a metric.

use crate::files::write_file;
use bevy::color::Srgba;
use half::f16;
use image::{ImageFormat, RgbImage, RgbaImage, buffer::ConvertBuffer};
use std::{
    io::{Cursor, Error},
    path::Path,
    sync::LazyLock,
};

/// Linear value of each sRGB byte.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| Srgba::gamma_function(byte as f32 / 255.0)));

/// Linear value (0 to 1) of an sRGB byte.
fn linear(byte: u8) -> f32 {
    LINEAR[usize::from(byte)]
}

/// The sRGB byte of a linear value, clamped to 0 to 1; 0 for NaN.
fn encode(linear: f32) -> u8 {
    let value = Srgba::gamma_function_inverse(linear.clamp(0.0, 1.0));
    (value * 255.0).round() as u8
}

/// An image from RGBA bytes; alpha is dropped. `None` if there are too few.
pub fn from_rgba(width: u32, height: u32, rgba: Vec<u8>) -> Option<RgbImage> {
    RgbaImage::from_raw(width, height, rgba).map(|image| image.convert())
}

/// Reads a PNG.
pub fn load(path: &Path) -> Result<RgbImage, String> {
    let image = image::open(path).map_err(|error| format!("{} can't be read: {error}", path.display()))?;
    Ok(image.into_rgb8())
}

/// Writes a PNG; folders on the way are created.
pub fn save(image: &RgbImage, path: &Path) -> Result<(), String> {
    write_file(path, |file| {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).map_err(Error::other)?;
        file.write_all(bytes.get_ref())
    })
}

/// Linear values, three a pixel.
pub fn linear_values(image: &RgbImage) -> impl Iterator<Item = f32> + '_ {
    image.iter().map(|&byte| linear(byte))
}

/// Linear luminance (Rec. 709), one value a pixel.
pub fn luminance(image: &RgbImage) -> impl Iterator<Item = f32> + '_ {
    image
        .pixels()
        .map(|pixel| pixel.0.map(linear))
        .map(|[red, green, blue]| 0.212_639 * red + 0.715_169 * green + 0.072_192 * blue)
}

/// The reflection alone: the difference between an image and the same image without any environment reflection or traced reflection.
///
/// Both are tone-mapped, so this is the contribution to the display and not radiance. The tone curve compresses bright surfaces, so a
/// reflection can darken its surface: such a value is cut off at black. Only this function defines "the reflection alone".
pub fn reflection_alone(image: &RgbImage, without: &RgbImage) -> Result<RgbImage, String> {
    if image.dimensions() != without.dimensions() {
        return Err("an image and the one without reflections have different sizes".to_owned());
    }
    let mut alone = image.clone();
    for (byte, without) in alone.iter_mut().zip(without.iter()) {
        *byte = encode(linear(*byte) - linear(*without));
    }
    Ok(alone)
}

/// Flags of pixels, given as four half floats each, with an infinite or NaN red, green or blue.
pub fn not_finite(halves: &[u8]) -> Vec<bool> {
    let broken = |half: &[u8]| !f16::from_le_bytes([half[0], half[1]]).is_finite();
    let pixels = halves.chunks_exact(8);
    pixels.map(|pixel| pixel[..6].chunks_exact(2).any(broken)).collect()
}

/// An image with one grey for all pixels, for tests.
#[cfg(test)]
pub fn gray(width: u32, height: u32, value: u8) -> RgbImage {
    RgbImage::from_pixel(width, height, image::Rgb([value; 3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_survives_the_way_to_linear_and_back() {
        assert!((0..=255).all(|byte| encode(linear(byte)) == byte));
        assert_eq!((linear(0), linear(255)), (0.0, 1.0));
        assert_eq!((encode(-1.0), encode(2.0)), (0, 255));
        assert_eq!((encode(f32::NAN), encode(1e-9)), (0, 0));
    }

    #[test]
    fn the_reflection_alone_is_the_difference_of_light() {
        let gray = |value| gray(2, 1, value);
        let alone = reflection_alone(&gray(200), &gray(100)).unwrap();
        let expected = linear(200) - linear(100);
        assert!((linear(alone[(0, 0)].0[0]) - expected).abs() < 0.005);
        assert_eq!(reflection_alone(&gray(9), &gray(9)).unwrap(), gray(0));
        assert!(reflection_alone(&gray(0), &super::gray(1, 2, 0)).is_err());
    }

    #[test]
    fn half_floats_that_are_no_numbers_are_found() {
        // 1, infinity, NaN and the largest number; alpha doesn't count.
        let pixel = |red: u16, alpha: u16| [red, 0, 0, alpha].map(u16::to_le_bytes).concat();
        let halves = [
            pixel(0x3c00, 0x7c00),
            pixel(0x7c00, 0),
            pixel(0xfe01, 0),
            pixel(0x7bff, 0),
        ]
        .concat();
        assert_eq!(not_finite(&halves), [false, true, true, false]);
    }

    #[test]
    fn alpha_is_dropped() {
        assert!(from_rgba(1, 1, vec![1, 2, 3]).is_none());
        assert_eq!(from_rgba(1, 1, vec![1, 2, 3, 4]).unwrap().as_raw(), &[1, 2, 3]);
    }
}
