//! Pictures of 8 bits, and what happens to them on the way to a metric.

use std::{fs, path::Path, sync::LazyLock};

/// A picture: sRGB, three bytes a pixel, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green and blue of each pixel.
    pub rgb: Vec<u8>,
}

/// Linear value of each sRGB byte.
static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let value = byte as f64 / 255.0;
        let linear = if value <= 0.040_45 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});

/// Linear value (0 to 1) of an sRGB byte.
#[must_use]
pub fn linear(byte: u8) -> f32 {
    LINEAR[usize::from(byte)]
}

/// Steps of [`FIRST_BYTES`].
const STEPS: usize = 4096;

/// The least linear value of each sRGB byte above 0: halfway between bytes, as they are displayed.
static LIMITS: LazyLock<[f32; 255]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let value = (byte as f64 + 0.5) / 255.0;
        let linear = if value <= 0.040_45 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});

/// The byte at the start of each step of linear values: from there it is a few limits to any value of the step.
static FIRST_BYTES: LazyLock<[u8; STEPS + 1]> = LazyLock::new(|| {
    std::array::from_fn(|step| {
        let value = step as f32 / STEPS as f32;
        LIMITS.partition_point(|limit| *limit <= value) as u8
    })
});

/// The sRGB byte of a linear value, clamped to 0 to 1; 0 for what is no number.
#[must_use]
pub fn encode(linear: f32) -> u8 {
    // Millions of values a picture: a table instead of powers.
    let value = linear.clamp(0.0, 1.0);
    let mut byte = FIRST_BYTES[(value * STEPS as f32) as usize];
    while byte < u8::MAX && LIMITS[usize::from(byte)] <= value {
        byte += 1;
    }
    byte
}

impl Picture {
    /// A picture from RGBA bytes; alpha is dropped. `None` if there are too many or too few.
    #[must_use]
    pub fn from_rgba(width: u32, height: u32, rgba: &[u8]) -> Option<Self> {
        if rgba.len() != width as usize * height as usize * 4 {
            return None;
        }
        let mut rgb = Vec::with_capacity(rgba.len() / 4 * 3);
        for pixel in rgba.chunks_exact(4) {
            rgb.extend_from_slice(&pixel[..3]);
        }
        Some(Self { width, height, rgb })
    }

    /// Reads a PNG.
    ///
    /// # Errors
    ///
    /// If the file can't be read or isn't a PNG; the sentence names it.
    pub fn load(path: &Path) -> Result<Self, String> {
        let picture = image::open(path).map_err(|error| format!("{} can't be read: {error}", path.display()))?;
        let picture = picture.into_rgb8();
        Ok(Self {
            width: picture.width(),
            height: picture.height(),
            rgb: picture.into_raw(),
        })
    }

    /// Writes a PNG; folders on the way are created. The file appears whole or not at all.
    ///
    /// # Errors
    ///
    /// If the file can't be written; the sentence names it.
    pub fn save(&self, path: &Path) -> Result<(), String> {
        let fail = |error: String| format!("{} can't be written: {error}", path.display());
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| fail(error.to_string()))?;
        }
        let part = path.with_extension("part");
        image::save_buffer_with_format(
            &part,
            &self.rgb,
            self.width,
            self.height,
            image::ExtendedColorType::Rgb8,
            image::ImageFormat::Png,
        )
        .map_err(|error| fail(error.to_string()))?;
        fs::rename(&part, path).map_err(|error| fail(error.to_string()))
    }

    /// Linear values, three a pixel.
    pub fn linear(&self) -> impl Iterator<Item = f32> + '_ {
        self.rgb.iter().map(|&byte| linear(byte))
    }

    /// Linear luminance (Rec. 709), one value a pixel.
    pub fn luminance(&self) -> impl Iterator<Item = f32> + '_ {
        self.rgb
            .chunks_exact(3)
            .map(|pixel| 0.212_639 * linear(pixel[0]) + 0.715_169 * linear(pixel[1]) + 0.072_192 * linear(pixel[2]))
    }

    /// Whether both have the same size.
    #[must_use]
    pub fn fits(&self, other: &Self) -> bool {
        (self.width, self.height, self.rgb.len()) == (other.width, other.height, other.rgb.len())
    }
}

/// The reflection alone: what a picture has over the same picture without any environment reflection or traced reflection.
///
/// Both are tone-mapped, so this is the contribution to the display and not radiance; a reflection that darkens (its surface's
/// tone curve compresses) is cut off at black. This is the one place that decides what "the reflection alone" is.
///
/// # Errors
///
/// If the sizes differ.
pub fn reflection_alone(picture: &Picture, without: &Picture) -> Result<Picture, String> {
    if !picture.fits(without) {
        return Err("a picture and the one without reflections have different sizes".to_owned());
    }
    let rgb = picture
        .linear()
        .zip(without.linear())
        .map(|(with, without)| encode(with - without));
    Ok(Picture {
        rgb: rgb.collect(),
        ..*picture
    })
}

/// Half floats (four a pixel, little endian) of which red, green or blue is infinite or no number: one flag a pixel.
#[must_use]
pub fn not_finite(halves: &[u8]) -> Vec<bool> {
    let broken = |half: &[u8]| u16::from_le_bytes([half[0], half[1]]) & 0x7c00 == 0x7c00;
    let pixels = halves.chunks_exact(8);
    pixels.map(|pixel| pixel[..6].chunks_exact(2).any(broken)).collect()
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
    fn values_become_the_nearest_byte() {
        for i in 0..=100_000 {
            let value = i as f32 / 100_000.0;
            let exact = if value <= 0.003_130_8 {
                f64::from(value) * 12.92
            } else {
                1.055 * f64::from(value).powf(1.0 / 2.4) - 0.055
            };
            let distance = (exact * 255.0 - f64::from(encode(value))).abs();
            assert!(distance < 0.501, "{value}: {distance}");
        }
    }

    #[test]
    fn the_reflection_alone_is_the_difference_of_light() {
        let picture = |value: u8| Picture {
            width: 2,
            height: 1,
            rgb: vec![value; 6],
        };
        let alone = reflection_alone(&picture(200), &picture(100)).unwrap();
        let expected = linear(200) - linear(100);
        assert!((linear(alone.rgb[0]) - expected).abs() < 0.005);
        assert_eq!(reflection_alone(&picture(9), &picture(9)).unwrap(), picture(0));
        let wide = Picture {
            width: 1,
            height: 2,
            rgb: vec![0; 6],
        };
        assert!(reflection_alone(&picture(0), &wide).is_err());
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
    fn rgba_must_have_the_right_size() {
        assert!(Picture::from_rgba(1, 1, &[1, 2, 3]).is_none());
        assert_eq!(Picture::from_rgba(1, 1, &[1, 2, 3, 4]).unwrap().rgb, [1, 2, 3]);
    }
}
