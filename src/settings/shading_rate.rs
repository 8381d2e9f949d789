//! The shading rates and their codes. `rate/codes.wesl` has the same for shaders.

use super::words::words;
use bevy::{
    math::UVec2,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Bits of [`ShadingRate::code`] in a texel of the rate image.
pub const RATE_CODE_MASK: u32 = 0xf;
/// Bit of a texel of the rate image: the tile contains reflective pixels. Nothing else of a frame is written in other tiles.
#[cfg(feature = "internals")]
pub const RATE_ACTIVE: u32 = 0x100;

/// Size of the blocks of trace pixels that share one ray: width times height.
///
/// With [`ReflectionTechnique::Variable`](crate::ReflectionTechnique::Variable), a trace pixel is a quad of 2x2 pixels, so 2x2
/// means one ray for 4x4 pixels of the view.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum ShadingRate {
    /// One ray for each trace pixel.
    #[default]
    R1x1,
    /// One ray for 2 trace pixels side by side.
    R2x1,
    /// One ray for 2 trace pixels, one above the other.
    R1x2,
    /// One ray for 4 trace pixels.
    R2x2,
    /// One ray for 4 trace pixels side by side. Not available in hardware.
    R4x1,
    /// One ray for 4 trace pixels, one above the other. Not available in hardware.
    R1x4,
    /// One ray for 8 trace pixels, wide.
    R4x2,
    /// One ray for 8 trace pixels, tall.
    R2x4,
    /// One ray for 16 trace pixels.
    R4x4,
}

words!(ShadingRate {
    R1x1 = "1x1",
    R2x1 = "2x1",
    R1x2 = "1x2",
    R2x2 = "2x2",
    R4x1 = "4x1",
    R1x4 = "1x4",
    R4x2 = "4x2",
    R2x4 = "2x4",
    R4x4 = "4x4",
});

impl ShadingRate {
    /// Width and height of a block in trace pixels.
    #[must_use]
    pub const fn size(self) -> UVec2 {
        match self {
            Self::R1x1 => UVec2::new(1, 1),
            Self::R2x1 => UVec2::new(2, 1),
            Self::R1x2 => UVec2::new(1, 2),
            Self::R2x2 => UVec2::new(2, 2),
            Self::R4x1 => UVec2::new(4, 1),
            Self::R1x4 => UVec2::new(1, 4),
            Self::R4x2 => UVec2::new(4, 2),
            Self::R2x4 => UVec2::new(2, 4),
            Self::R4x4 => UVec2::new(4, 4),
        }
    }

    /// Number of the rate in rate images: log2(width) * 4 + log2(height), as in Vulkan's shading-rate attachments.
    #[must_use]
    pub const fn code(self) -> u32 {
        let size = self.size();
        (size.x.trailing_zeros() << 2) | size.y.trailing_zeros()
    }

    /// The rate of a texel of a rate image. Bits other than the lowest four are ignored; invalid codes count as [`R1x1`](Self::R1x1).
    #[must_use]
    pub fn from_code(texel: u32) -> Self {
        Self::ALL
            .into_iter()
            .find(|rate| rate.code() == texel & RATE_CODE_MASK)
            .unwrap_or_default()
    }

    /// Rays per trace pixel: 1 to 1/16.
    #[must_use]
    pub const fn rays_per_trace_pixel(self) -> f32 {
        let size = self.size();
        1.0 / (size.x * size.y) as f32
    }

    /// Step of [`ShadingRateHeuristic::Combined`](super::ShadingRateHeuristic::Combined): 1x1, 2x1, 2x2, 4x2, 4x4.
    pub(super) fn level(self) -> u32 {
        match self {
            Self::R1x1 => 0,
            Self::R2x1 | Self::R1x2 | Self::R4x1 | Self::R1x4 => 1,
            Self::R2x2 => 2,
            Self::R4x2 | Self::R2x4 => 3,
            Self::R4x4 => 4,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_shader() {
        let source = include_str!("../rate/codes.wesl");
        let constant = |name: &str| {
            let line = source.lines().find(|line| line.starts_with(&format!("const {name}:")));
            let value = line.and_then(|line| line.split('=').nth(1)).unwrap().trim();
            let digits = value.trim_end_matches("u;");
            digits
                .strip_prefix("0x")
                .map_or_else(|| digits.parse(), |hex| u32::from_str_radix(hex, 16))
                .unwrap()
        };
        for rate in ShadingRate::ALL {
            let name = format!("RATE_{rate}").to_uppercase();
            assert_eq!(constant(&name), rate.code(), "{name}");
        }
        assert_eq!(constant("RATE_CODE_MASK"), RATE_CODE_MASK);
        assert_eq!(constant("RATE_ACTIVE"), RATE_ACTIVE);
    }

    #[test]
    fn rates_survive_their_codes() {
        for rate in ShadingRate::ALL {
            assert_eq!(ShadingRate::from_code(rate.code() | RATE_ACTIVE), rate);
            let size = rate.size();
            assert_eq!(rate.name(), format!("{}x{}", size.x, size.y));
            assert_eq!(rate.rays_per_trace_pixel() * (size.x * size.y) as f32, 1.0);
        }
        for code in [3, 7, 11, 12, 15, u32::MAX] {
            assert_eq!(ShadingRate::from_code(code), ShadingRate::R1x1, "{code}");
        }
    }
}
