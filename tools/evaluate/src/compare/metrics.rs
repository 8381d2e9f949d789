//! Differences of images: FLIP, PSNR, bias, flicker.

use super::image::{linear_values, luminance};
use image::RgbImage;
use nv_flip::{FlipImageFloat, FlipImageRgb8};

/// Pixels per degree of the paper's display: 2,560 pixels over 0.5 m, seen from 0.62 m.
const PIXELS_PER_DEGREE: f32 = 55.4;

/// The PSNR of equal images, in decibels. No two different images of 8 bits reach it.
pub const PERFECT_PSNR: f64 = 199.0;

/// FLIP's error at each pixel, 0 to 1.
pub struct ErrorMap {
    /// The mean, which FLIP's authors recommend.
    pub mean: f64,
    errors: FlipImageFloat,
}

impl ErrorMap {
    /// The errors, row by row.
    pub fn values(&self) -> Vec<f32> {
        self.errors.to_vec()
    }

    /// The errors in FLIP's colours: black is no error, yellow a large one.
    pub fn image(&self) -> Option<RgbImage> {
        let colors = self.errors.apply_color_lut(&nv_flip::magma_lut()).to_vec();
        RgbImage::from_raw(self.errors.width(), self.errors.height(), colors)
    }
}

fn same_size(reference: &RgbImage, test: &RgbImage) -> Result<(), String> {
    let ((width, height), (other_width, other_height)) = (reference.dimensions(), test.dimensions());
    if (width, height) != (other_width, other_height) || reference.is_empty() {
        return Err(format!(
            "images of {width}x{height} and {other_width}x{other_height} can't be compared"
        ));
    }
    Ok(())
}

/// FLIP: the difference that a person sees when two images alternate (Andersson et al. 2020), at the paper's [`PIXELS_PER_DEGREE`].
pub fn flip(reference: &RgbImage, test: &RgbImage) -> Result<ErrorMap, String> {
    same_size(reference, test)?;
    let image = |image: &RgbImage| FlipImageRgb8::with_data(image.width(), image.height(), image.as_raw());
    let errors = nv_flip::flip(image(reference), image(test), PIXELS_PER_DEGREE);
    let values = errors.to_vec();
    let mean = values.iter().map(|&error| f64::from(error)).sum::<f64>() / values.len() as f64;
    Ok(ErrorMap { mean, errors })
}

/// Peak signal-to-noise ratio in decibels, of linear light; [`PERFECT_PSNR`] for equal images. White is the peak.
pub fn psnr(reference: &RgbImage, test: &RgbImage) -> Result<f64, String> {
    same_size(reference, test)?;
    let pairs = linear_values(reference).zip(linear_values(test));
    let squares = pairs.map(|(a, b)| f64::from(a - b)).map(|d| d * d);
    let mean_square = squares.sum::<f64>() / reference.len() as f64;
    Ok(if mean_square > 0.0 {
        (-10.0 * mean_square.log10()).min(PERFECT_PSNR)
    } else {
        PERFECT_PSNR
    })
}

/// Mean signed error of linear luminance (white is 1): below 0 the test is too dark.
pub fn bias(reference: &RgbImage, test: &RgbImage) -> Result<f64, String> {
    same_size(reference, test)?;
    let pairs = luminance(reference).zip(luminance(test));
    let sum: f64 = pairs.map(|(a, b)| f64::from(b - a)).sum();
    Ok(sum / reference.pixels().len() as f64)
}

/// Mean linear luminance of an image (white is 1); 0 without pixels.
pub fn mean_luminance(image: &RgbImage) -> f64 {
    let sum: f64 = luminance(image).map(f64::from).sum();
    sum / image.pixels().len().max(1) as f64
}

/// Mean change of the signed error from frame to frame, of linear luminance: the noise that remains in a static view.
///
/// The ground truth of a still view doesn't change, so it cancels out and isn't needed.
pub fn flicker(frames: &[RgbImage]) -> Result<f64, String> {
    if frames.len() < 2 {
        return Err("flicker takes at least two frames".to_owned());
    }
    let mut sum = 0.0;
    for pair in frames.windows(2) {
        same_size(&pair[0], &pair[1])?;
        let values = luminance(&pair[0]).zip(luminance(&pair[1]));
        let changes = values.map(|(a, b)| f64::from((b - a).abs()));
        sum += changes.sum::<f64>() / pair[0].pixels().len() as f64;
    }
    Ok(sum / (frames.len() - 1) as f64)
}

#[cfg(test)]
mod tests {
    use super::{super::image::gray, *};

    /// A smooth image with an edge, so that every kind of error is visible.
    fn image(change: impl Fn(u32, u32, u8) -> u8) -> RgbImage {
        RgbImage::from_fn(64, 48, |x, y| {
            let base = if x > 30 && y > 20 { 210 } else { 40 + x as u8 };
            image::Rgb([change(x, y, base), change(x, y, base / 2), change(x, y, 255 - base)])
        })
    }

    #[test]
    fn an_image_equals_itself() {
        let image = image(|_, _, value| value);
        assert_eq!(flip(&image, &image).unwrap().mean, 0.0);
        assert_eq!(psnr(&image, &image), Ok(PERFECT_PSNR));
        assert_eq!(bias(&image, &image), Ok(0.0));
        assert_eq!(flicker(&[image.clone(), image.clone(), image]), Ok(0.0));
    }

    #[test]
    fn more_damage_is_more_error() {
        let truth = image(|_, _, value| value);
        let noisy = |amplitude: u32| {
            image(move |x, y, value| {
                let noise = (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503).rotate_left(7)) >> 16;
                value.saturating_add((noise % (amplitude + 1)) as u8)
            })
        };
        let errors: Vec<f64> = [0, 10, 40, 90]
            .into_iter()
            .map(|amplitude| flip(&truth, &noisy(amplitude)).unwrap().mean)
            .collect();
        assert!(errors.windows(2).all(|pair| pair[0] < pair[1]), "{errors:?}");
        let ratios: Vec<f64> = [10, 40, 90]
            .into_iter()
            .map(|amplitude| psnr(&truth, &noisy(amplitude)).unwrap())
            .collect();
        assert!(ratios.windows(2).all(|pair| pair[0] > pair[1]), "{ratios:?}");
        let shifted = RgbImage::from_fn(64, 48, |x, y| truth[(x.saturating_sub(1), y)]);
        let moved = flip(&truth, &shifted).unwrap().mean;
        let black = flip(&truth, &image(|_, _, _| 0)).unwrap().mean;
        assert!(0.0 < moved && moved < black, "{moved} {black}");
    }

    #[test]
    fn bias_has_a_sign() {
        let truth = image(|_, _, value| value);
        assert!(bias(&truth, &image(|_, _, value| value.saturating_add(9))).unwrap() > 0.0);
        assert!(bias(&truth, &image(|_, _, value| value.saturating_sub(9))).unwrap() < 0.0);
        // It is the difference of the means.
        let bright = image(|_, _, value| value.saturating_add(9));
        let difference = mean_luminance(&bright) - mean_luminance(&truth);
        assert!((bias(&truth, &bright).unwrap() - difference).abs() < 1e-6);
    }

    #[test]
    fn flicker_counts_changes_and_not_errors() {
        let (a, b) = (
            image(|_, _, value| value),
            image(|_, _, value| value.saturating_add(30)),
        );
        let still = flicker(&[b.clone(), b.clone()]).unwrap();
        let restless = flicker(&[a.clone(), b.clone(), a.clone()]).unwrap();
        assert!(still == 0.0 && restless > 0.01);
        assert!(flicker(&[a]).is_err());
    }

    #[test]
    fn the_map_is_black_where_nothing_differs() {
        let truth = image(|_, _, value| value);
        let map = flip(&truth, &truth).unwrap().image().unwrap();
        assert_eq!(map.dimensions(), truth.dimensions());
        assert!(map.iter().all(|&byte| byte < 8));
    }

    #[test]
    fn sizes_must_agree() {
        let (small, large) = (gray(1, 1, 0), image(|_, _, value| value));
        assert!(flip(&small, &large).is_err() && psnr(&small, &large).is_err() && bias(&small, &large).is_err());
        let empty = RgbImage::new(0, 0);
        assert!(flip(&empty, &empty).is_err());
    }
}
