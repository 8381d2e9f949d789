//! Indices of samplers in the shaders' array.

use crate::device::MAX_SAMPLERS;
use bevy::image::ImageSampler;

/// Index of a sampler in the array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Already in the array.
    Known(u32),
    /// To be stored at this index: behind the last one, or in place of an unused one.
    New(u32),
    /// The array is full.
    Full,
}

/// Finds the index of a sampler. Images whose sampler doesn't fit share the first one.
pub(super) fn place_of<S>(
    samplers: &[(ImageSampler, S)],
    wanted: &ImageSampler,
    in_use: impl Fn(u32) -> bool,
) -> Place {
    let known = (0..).zip(samplers).skip(1).find(|(_, (known, _))| known == wanted);
    if let Some((index, _)) = known {
        return Place::Known(index);
    }
    if samplers.len() < MAX_SAMPLERS as usize {
        return Place::New(samplers.len() as u32);
    }
    (1..MAX_SAMPLERS)
        .find(|index| !in_use(*index))
        .map_or(Place::Full, Place::New)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::image::ImageSamplerDescriptor;

    fn sampler(kind: u32) -> ImageSampler {
        ImageSampler::Descriptor(ImageSamplerDescriptor {
            lod_max_clamp: kind as f32,
            ..ImageSamplerDescriptor::linear()
        })
    }

    #[test]
    fn kinds_of_samplers_are_shared_and_places_are_used_again() {
        let mut table = vec![(sampler(1), ())];
        assert_eq!(
            place_of(&table, &sampler(1), |_| true),
            Place::New(1),
            "the first is nobody's"
        );
        for kind in 1..MAX_SAMPLERS {
            assert_eq!(place_of(&table, &sampler(kind), |_| true), Place::New(kind));
            table.push((sampler(kind), ()));
        }
        assert_eq!(place_of(&table, &sampler(7), |_| false), Place::Known(7));
        assert_eq!(place_of(&table, &sampler(99), |_| true), Place::Full);
        assert_eq!(place_of(&table, &sampler(99), |index| index != 9), Place::New(9));
    }
}
