//! What the rasterizer's shading rate can do; known on platforms without it too, where no device has any.

use bevy::math::UVec2;

/// What a device does with shading-rate attachments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShadingRates {
    /// Pixels that a texel of the attachment covers at least, in each direction.
    pub min_texel: UVec2,
    /// Pixels that a texel of the attachment covers at most, in each direction.
    pub max_texel: UVec2,
    /// Pixels of the largest fragment, in each direction.
    pub max_fragment: UVec2,
    /// Rates can be combined by minimum, maximum and product; this crate needs none of them.
    pub non_trivial_combiners: bool,
    /// One bit for each supported rate, at the position of its code (see [`supports`](Self::supports)).
    pub codes: u16,
}

impl ShadingRates {
    /// Whether fragments of a size exist, named by its code: `log2(width) << 2 | log2(height)`. Where the attachment holds
    /// another code, the hardware takes a smaller size, and all fragments of a block trace the block's ray.
    #[must_use]
    pub fn supports(&self, code: u32) -> bool {
        code < u16::BITS && (self.codes >> code) & 1 != 0
    }
}
