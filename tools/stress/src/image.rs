//! Rendered images as linear colours.

use bevy::math::UVec2;

/// Linear radiance, exposed; rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearImage {
    pub size: UVec2,
    /// Red, green, blue, alpha.
    pub texels: Vec<[f32; 4]>,
}

impl LinearImage {
    /// Indices of texels with a channel that is NaN or infinite.
    pub fn non_finite(&self) -> Vec<usize> {
        let is_wrong = |texel: &[f32; 4]| texel.iter().any(|channel| !channel.is_finite());
        (0..self.texels.len())
            .filter(|index| is_wrong(&self.texels[*index]))
            .collect()
    }

    /// Fails with a pixel that is NaN or infinite.
    pub fn check_finite(&self) -> Result<(), String> {
        let wrong = self.non_finite().first().copied();
        wrong.map_or(Ok(()), |index| Err(format!("pixel {index} is not finite")))
    }

    /// Mean luminance of all pixels.
    pub fn mean(&self) -> f64 {
        let sum: f64 = self.texels.iter().map(|texel| f64::from(luminance(texel))).sum();
        sum / self.texels.len().max(1) as f64
    }

    /// Mean difference between the channels of two images; infinite if their sizes differ.
    pub fn difference(&self, other: &Self) -> f64 {
        if self.size != other.size {
            return f64::INFINITY;
        }
        let pairs = self.texels.iter().flatten().zip(other.texels.iter().flatten());
        let sum: f64 = pairs.map(|(a, b)| f64::from((a - b).abs())).sum();
        sum / (4 * self.texels.len().max(1)) as f64
    }
}

/// Rec. 709 luminance of a linear colour.
pub fn luminance(texel: &[f32; 4]) -> f32 {
    0.2126 * texel[0] + 0.7152 * texel[1] + 0.0722 * texel[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_compared() {
        let image = |value: f32| LinearImage {
            size: UVec2::new(2, 1),
            texels: vec![[1.0; 4], [1.0, value, 1.0, 1.0]],
        };
        assert_eq!(image(f32::NAN).non_finite(), [1]);
        assert!((image(1.0).mean() - 1.0).abs() < 1e-6);
        assert_eq!(image(1.0).difference(&image(1.0)), 0.0);
        assert_eq!(image(1.0).difference(&image(5.0)), 0.5);
        let other = LinearImage {
            size: UVec2::ONE,
            texels: vec![[1.0; 4]],
        };
        assert_eq!(image(1.0).difference(&other), f64::INFINITY);
    }
}
