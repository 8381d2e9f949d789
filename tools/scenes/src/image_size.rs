//! Image sizes on command lines.

use bevy::math::UVec2;
use std::{fmt, str::FromStr};

/// Width and height in pixels, written as `1920x1080`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize(pub UVec2);

impl ImageSize {
    /// Largest width and height: the limit for textures of current GPUs.
    pub const MAX: u32 = 16_384;
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.0.x, self.0.y)
    }
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split_once(['x', 'X'])
            .and_then(|(width, height)| Some(UVec2::new(width.parse().ok()?, height.parse().ok()?)))
            .filter(|size| size.min_element() >= 1 && size.max_element() <= Self::MAX)
            .map(Self)
            .ok_or_else(|| format!("'{text}' is not a size such as 1280x720, each from 1 to {}", Self::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!("1280x720".parse(), Ok(ImageSize(UVec2::new(1280, 720))));
        assert_eq!("1X16384".parse(), Ok(ImageSize(UVec2::new(1, 16_384))));
        for wrong in [
            "",
            "1280",
            "1280x",
            "x720",
            "0x720",
            "-1x5",
            "16385x1",
            "12 x 7",
            "1x2x3",
            "99999999999x1",
        ] {
            assert!(wrong.parse::<ImageSize>().is_err(), "{wrong}");
        }
    }
}
