//! An object's lightmap, for extraction.

use bevy::{asset::AssetId, image::Image, pbr::Lightmap};

/// The lightmap of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightmapSource {
    /// Its texture.
    pub image: AssetId<Image>,
    /// Corners of the object's rectangle in it: 16 bits each, u, then v in the upper half.
    pub rect: [u32; 2],
}

impl From<&Lightmap> for LightmapSource {
    fn from(lightmap: &Lightmap) -> Self {
        // Like Bevy, with numbers clamped to the valid range.
        let bits = |part: f32| u32::from((part * 65535.0).round() as u16);
        let corner = |u, v| bits(u) | (bits(v) << 16);
        let rect = lightmap.uv_rect;
        Self {
            image: lightmap.image.id(),
            rect: [corner(rect.min.x, rect.min.y), corner(rect.max.x, rect.max.y)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Rect;

    #[test]
    fn parts_are_packed_as_shaders_unpack_them() {
        let rect = |x0, y0, x1, y1| {
            let lightmap = Lightmap {
                uv_rect: Rect {
                    min: (x0, y0).into(),
                    max: (x1, y1).into(),
                },
                ..Default::default()
            };
            LightmapSource::from(&lightmap).rect
        };
        assert_eq!(rect(0.0, 0.0, 1.0, 1.0), [0, 0xffff_ffff]);
        assert_eq!(rect(0.5, 0.25, 1.0, 0.75), [0x4000_8000, 0xbfff_ffff]);
        assert_eq!(rect(-1.0, f32::NAN, 2.0, 0.0), [0, 0xffff], "beyond the ends");
    }
}
