//! The difference between two images.

use anyhow::{Context, Result, ensure};
use nv_flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImageRgb8, FlipPool};
use std::path::Path;

/// Mean FLIP, from 0 to 1.
pub fn mean(expected: &Path, actual: &Path) -> Result<f32> {
    let [expected, actual] = [expected, actual].map(|path| {
        let image = image::open(path).with_context(|| path.display().to_string())?;
        let image = image.into_rgb8();
        anyhow::Ok(FlipImageRgb8::with_data(image.width(), image.height(), &image))
    });
    let (expected, actual) = (expected?, actual?);
    let size = |image: &FlipImageRgb8| [image.width(), image.height()];
    ensure!(size(&expected) == size(&actual), "the images have different sizes");
    let map = nv_flip::flip(expected, actual, DEFAULT_PIXELS_PER_DEGREE);
    Ok(FlipPool::from_image(&map).mean())
}
