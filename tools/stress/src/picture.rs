//! What a camera drew, as linear colours.

use bevy::math::UVec2;

/// Linear radiance, exposed; rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height in pixels.
    pub size: UVec2,
    /// Red, green, blue, alpha.
    pub texels: Vec<[f32; 4]>,
}

impl Picture {
    /// Decodes texels of four half floats; `None` if they are not as many as the size says.
    #[must_use]
    pub fn from_halves(size: UVec2, bytes: &[u8]) -> Option<Self> {
        let texels: Vec<_> = bytes
            .chunks_exact(8)
            .map(|texel| [0, 2, 4, 6].map(|i| half(u16::from_le_bytes([texel[i], texel[i + 1]]))))
            .collect();
        (texels.len() as u64 == u64::from(size.x) * u64::from(size.y)).then_some(Self { size, texels })
    }

    /// Indices of texels with a channel that is NaN or infinite.
    #[must_use]
    pub fn non_finite(&self) -> Vec<usize> {
        let wrong = |texel: &[f32; 4]| texel.iter().any(|channel| !channel.is_finite());
        let texels = self.texels.iter().enumerate();
        texels
            .filter(|(_, texel)| wrong(texel))
            .map(|(index, _)| index)
            .collect()
    }

    /// Luminance of each pixel.
    pub fn luminances(&self) -> impl Iterator<Item = f32> + '_ {
        self.texels.iter().map(luminance)
    }

    /// Mean luminance of all pixels.
    #[must_use]
    pub fn mean(&self) -> f64 {
        let sum: f64 = self.luminances().map(f64::from).sum();
        sum / self.texels.len().max(1) as f64
    }

    /// Mean difference of the channels of two pictures of one size; infinite if their sizes differ.
    #[must_use]
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
#[must_use]
pub fn luminance(texel: &[f32; 4]) -> f32 {
    0.2126 * texel[0] + 0.7152 * texel[1] + 0.0722 * texel[2]
}

/// Value of a half float.
#[must_use]
pub fn half(bits: u16) -> f32 {
    let sign = if bits & 0x8000 != 0 { -1.0 } else { 1.0 };
    let (exponent, fraction) = ((bits >> 10) & 0x1f, f32::from(bits & 0x3ff));
    sign * match exponent {
        0 => fraction / 16_777_216.0,
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction / 1024.0) * f32::powi(2.0, i32::from(exponent) - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_decoded() {
        assert_eq!(half(0x3c00), 1.0);
        assert_eq!(half(0xc000), -2.0);
        assert_eq!(half(0x7bff), 65504.0);
        assert_eq!(half(0x0001), 1.0 / 16_777_216.0);
        assert_eq!(half(0x7c00), f32::INFINITY);
        assert!(half(0x7e00).is_nan());
    }

    #[test]
    fn wrong_texels_are_found() {
        let bytes = |halves: [u16; 8]| halves.map(u16::to_le_bytes).concat();
        let size = UVec2::new(2, 1);
        let picture = Picture::from_halves(size, &bytes([0, 0, 0, 0, 0, 0x7e00, 0, 0])).unwrap();
        assert_eq!(picture.non_finite(), [1]);
        let gray = Picture::from_halves(size, &bytes([0x3c00; 8])).unwrap();
        assert!((gray.mean() - 1.0).abs() < 1e-6);
        assert_eq!(gray.difference(&gray), 0.0);
        assert!(Picture::from_halves(UVec2::splat(3), &bytes([0; 8])).is_none());
    }
}
