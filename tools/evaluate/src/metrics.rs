//! How far a picture is from another: FLIP, PSNR, bias, flicker.

use crate::picture::Picture;
use nv_flip::{FlipImageFloat, FlipImageRgb8};

/// Pixels per degree of the paper's display: 2,560 pixels over 0.5 m, seen from 0.62 m.
pub const PIXELS_PER_DEGREE: f32 = 55.4;

/// The PSNR of equal pictures, in decibels: no pair of different pictures of 8 bits comes near.
pub const PERFECT_PSNR: f64 = 199.0;

/// FLIP's error at each pixel, 0 to 1.
pub struct ErrorMap {
    /// The mean, which is the number that FLIP's authors recommend.
    pub mean: f64,
    errors: FlipImageFloat,
}

impl ErrorMap {
    /// The errors in FLIP's colours: black is none, yellow a large one.
    #[must_use]
    pub fn picture(&self) -> Picture {
        Picture {
            width: self.errors.width(),
            height: self.errors.height(),
            rgb: self.errors.apply_color_lut(&nv_flip::magma_lut()).to_vec(),
        }
    }
}

fn same_size(reference: &Picture, test: &Picture) -> Result<(), String> {
    if !reference.fits(test) {
        return Err(format!(
            "pictures of {}x{} and {}x{} can't be compared",
            reference.width, reference.height, test.width, test.height
        ));
    }
    if reference.rgb.is_empty() || reference.rgb.len() != reference.width as usize * reference.height as usize * 3 {
        return Err("a picture without pixels, or with too few, can't be compared".to_owned());
    }
    Ok(())
}

/// FLIP: the difference that a person sees when two pictures alternate (Andersson et al. 2020), at [`PIXELS_PER_DEGREE`].
///
/// # Errors
///
/// If the sizes differ.
pub fn flip(reference: &Picture, test: &Picture) -> Result<ErrorMap, String> {
    same_size(reference, test)?;
    let image = |picture: &Picture| FlipImageRgb8::with_data(picture.width, picture.height, &picture.rgb);
    let errors = nv_flip::flip(image(reference), image(test), PIXELS_PER_DEGREE);
    let values = errors.to_vec();
    let mean = values.iter().map(|&error| f64::from(error)).sum::<f64>() / values.len() as f64;
    Ok(ErrorMap { mean, errors })
}

/// Peak signal-to-noise ratio in decibels, of linear light; [`PERFECT_PSNR`] for equal pictures. White is the peak.
///
/// # Errors
///
/// If the sizes differ.
pub fn psnr(reference: &Picture, test: &Picture) -> Result<f64, String> {
    same_size(reference, test)?;
    let differences = reference.linear().zip(test.linear()).map(|(a, b)| f64::from(a - b));
    let mean_square = differences.map(|d| d * d).sum::<f64>() / reference.rgb.len() as f64;
    Ok(if mean_square > 0.0 {
        (-10.0 * mean_square.log10()).min(PERFECT_PSNR)
    } else {
        PERFECT_PSNR
    })
}

/// Mean signed error of linear luminance (white is 1): below 0 the test is too dark.
///
/// # Errors
///
/// If the sizes differ.
pub fn bias(reference: &Picture, test: &Picture) -> Result<f64, String> {
    same_size(reference, test)?;
    let differences = reference
        .luminance()
        .zip(test.luminance())
        .map(|(a, b)| f64::from(b - a));
    let count = reference.rgb.len() / 3;
    Ok(differences.sum::<f64>() / count as f64)
}

/// Mean linear luminance of a picture (white is 1); 0 without pixels.
#[must_use]
pub fn mean_luminance(picture: &Picture) -> f64 {
    let count = picture.rgb.len() / 3;
    picture.luminance().map(f64::from).sum::<f64>() / count.max(1) as f64
}

/// Mean change of the signed error from frame to frame, of linear luminance: what is left of noise when nothing moves.
///
/// The truth of a still view doesn't change, so it cancels out and isn't needed.
///
/// # Errors
///
/// If there are fewer than two frames or their sizes differ.
pub fn flicker(frames: &[Picture]) -> Result<f64, String> {
    let several = frames.split_first().filter(|(_, rest)| !rest.is_empty());
    let Some((first, rest)) = several else {
        return Err("flicker takes at least two frames".to_owned());
    };
    let mut before: Vec<f32> = first.luminance().collect();
    let mut sum = 0.0;
    for frame in rest {
        same_size(first, frame)?;
        let now: Vec<f32> = frame.luminance().collect();
        let changes = before.iter().zip(&now).map(|(a, b)| f64::from((b - a).abs()));
        sum += changes.sum::<f64>() / now.len() as f64;
        before = now;
    }
    Ok(sum / rest.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth picture with an edge, so that everything that can go wrong shows.
    fn picture(change: impl Fn(u32, u32, u8) -> u8) -> Picture {
        let (width, height) = (64, 48);
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| {
                let base = if x > 30 && y > 20 { 210 } else { 40 + x as u8 };
                [change(x, y, base), change(x, y, base / 2), change(x, y, 255 - base)]
            });
        Picture {
            width,
            height,
            rgb: rgb.collect(),
        }
    }

    fn shifted(picture: &Picture) -> Picture {
        let row = picture.width as usize * 3;
        let rows = picture.rgb.chunks_exact(row);
        Picture {
            rgb: rows
                .flat_map(|row| row[..3].iter().chain(&row[..row.len() - 3]))
                .copied()
                .collect(),
            ..*picture
        }
    }

    #[test]
    fn a_picture_equals_itself() {
        let picture = picture(|_, _, value| value);
        assert_eq!(flip(&picture, &picture).unwrap().mean, 0.0);
        assert_eq!(psnr(&picture, &picture), Ok(PERFECT_PSNR));
        assert_eq!(bias(&picture, &picture), Ok(0.0));
        assert_eq!(flicker(&[picture.clone(), picture.clone(), picture]), Ok(0.0));
    }

    #[test]
    fn more_damage_is_more_error() {
        let truth = picture(|_, _, value| value);
        let noisy = |amplitude: u32| {
            picture(move |x, y, value| {
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
        let moved = flip(&truth, &shifted(&truth)).unwrap().mean;
        let black = flip(&truth, &picture(|_, _, _| 0)).unwrap().mean;
        assert!(0.0 < moved && moved < black, "{moved} {black}");
    }

    #[test]
    fn bias_has_a_sign() {
        let truth = picture(|_, _, value| value);
        assert!(bias(&truth, &picture(|_, _, value| value.saturating_add(9))).unwrap() > 0.0);
        assert!(bias(&truth, &picture(|_, _, value| value.saturating_sub(9))).unwrap() < 0.0);
        // It is the difference of the means.
        let bright = picture(|_, _, value| value.saturating_add(9));
        let difference = mean_luminance(&bright) - mean_luminance(&truth);
        assert!((bias(&truth, &bright).unwrap() - difference).abs() < 1e-6);
    }

    #[test]
    fn flicker_counts_changes_and_not_errors() {
        let (a, b) = (
            picture(|_, _, value| value),
            picture(|_, _, value| value.saturating_add(30)),
        );
        let still = flicker(&[b.clone(), b.clone()]).unwrap();
        let restless = flicker(&[a.clone(), b.clone(), a.clone()]).unwrap();
        assert!(still == 0.0 && restless > 0.01);
        assert!(flicker(&[a]).is_err());
    }

    #[test]
    fn the_map_is_black_where_nothing_differs() {
        let truth = picture(|_, _, value| value);
        let map = flip(&truth, &truth).unwrap().picture();
        assert!(map.fits(&truth));
        assert!(map.rgb.iter().all(|&byte| byte < 8));
    }

    #[test]
    fn sizes_must_agree() {
        let small = Picture {
            width: 1,
            height: 1,
            rgb: vec![0; 3],
        };
        let large = picture(|_, _, value| value);
        assert!(flip(&small, &large).is_err() && psnr(&small, &large).is_err() && bias(&small, &large).is_err());
        let empty = Picture {
            width: 0,
            height: 0,
            rgb: vec![],
        };
        assert!(flip(&empty, &empty).is_err());
    }
}
