//! Capabilities of the rasterizer's shading rate. The types also exist on platforms without it.

#[cfg(feature = "hardware-vrs")]
use bevy::math::UVec2;
use bevy::reflect::{Reflect, std_traits::ReflectDefault};

/// Availability of [`ReflectionBackend::HardwareVrs`](crate::ReflectionBackend::HardwareVrs): whether the rasterizer's shading
/// rate can distribute rays.
#[derive(Reflect, Clone, Debug, Default, PartialEq, Eq)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum HardwareVrsSupport {
    /// Not requested: the app lacks `HardwareVrsPlugin`, or was built without the crate feature `hardware-vrs`.
    #[default]
    NotAsked,
    /// Not supported by the device or its driver; the reason, as the end of a sentence.
    Missing(String),
    /// The device has no such rates; for tests, the pass runs with an invocation for each trace pixel.
    FullRate,
    /// Cameras can use it.
    Available,
}

/// Capabilities of a device for shading-rate attachments.
#[cfg(feature = "hardware-vrs")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShadingRates {
    /// Minimum number of pixels that a texel of the attachment covers, in each direction.
    pub min_texel: UVec2,
    /// Maximum number of pixels that a texel of the attachment covers, in each direction.
    pub max_texel: UVec2,
    /// Size of the largest fragment in pixels, in each direction.
    pub max_fragment: UVec2,
    /// Rates can be combined by minimum, maximum and product; this crate needs none of them.
    pub non_trivial_combiners: bool,
    /// One bit for each supported rate, at the position of its code (see [`supports`](Self::supports)).
    pub codes: u16,
}

#[cfg(feature = "hardware-vrs")]
impl ShadingRates {
    /// Returns whether the device supports a fragment size, given by its code: `log2(width) << 2 | log2(height)`. For an unsupported code
    /// in the attachment, the hardware uses a smaller size, and all fragments of a block trace the block's ray.
    #[must_use]
    pub fn supports(&self, code: u32) -> bool {
        code < u16::BITS && (self.codes >> code) & 1 != 0
    }
}
