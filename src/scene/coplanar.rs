//! Surfaces in the same place: the order in which Bevy draws them, and depth biases. `coplanar.wesl` compares hits by them.

#[cfg(any(test, feature = "internals"))]
mod order;

#[cfg(any(test, feature = "internals"))]
pub use order::DrawnOrder;

use super::{
    gpu_types::{INSTANCE_DEPTH_BIAS, INSTANCE_DRAWN_SHIFT},
    see_through::stop_probability,
};
use bevy::{pbr::StandardMaterial, prelude::AlphaMode};
use std::collections::BTreeMap;

/// Units of a depth bias in a step of the half float that stores it.
const UNIT: f32 = 64.0;
/// The largest depth bias that is stored.
const MOST_BIAS: f32 = 65280.0 * UNIT;

/// The `INSTANCE_` bits by which rays order surfaces in the same place. `is_forward`: Bevy draws the material forward.
pub(super) fn order_bits(material: &StandardMaterial, is_forward: bool) -> u32 {
    (phase(material, is_forward) | half_of_bias(material)) << INSTANCE_DRAWN_SHIFT
}

/// The phase in which Bevy draws a material, counted from 0.
fn phase(material: &StandardMaterial, is_forward: bool) -> u32 {
    let is_masked = matches!(material.alpha_mode, AlphaMode::Mask(_));
    let forward = if is_forward { 2 } else { 0 };
    match stop_probability(material) {
        None => forward + u32::from(is_masked),
        // Bevy draws blended surfaces after glass.
        Some(_) if material.specular_transmission > 0.0 => 4,
        Some(_) => 5,
    }
}

/// The depth bias as a half float without its lowest three bits, in units of `UNIT`. Bevy drops fractions.
fn half_of_bias(material: &StandardMaterial) -> u32 {
    let bias = (material.depth_bias as i32 as f32).clamp(-MOST_BIAS, MOST_BIAS) / UNIT;
    if bias == 0.0 {
        return 0;
    }
    // Rounded to 7 bits of mantissa. The exponent's bias is 112 less than that of `f32`.
    let rounded = (bias.abs().to_bits() + (1 << 15)) >> 16 << 3;
    let sign = if bias < 0.0 { 0x8000 } else { 0 };
    sign | (rounded - (112 << 10))
}

/// The depth bias of an instance with these flags.
fn bias_of(flags: u32) -> f32 {
    let half = (flags >> INSTANCE_DRAWN_SHIFT) & INSTANCE_DEPTH_BIAS;
    if half == 0 {
        return 0.0;
    }
    let size = f32::from_bits(((half & 0x7fff) + (112 << 10)) << 13) * UNIT;
    if half & 0x8000 == 0 { size } else { -size }
}

/// The depth biases of the objects that rays can hit.
#[derive(Default)]
pub(super) struct DepthBiases {
    /// Bits of the bias by slot, if it isn't 0.
    by_slot: BTreeMap<u32, i32>,
    /// Number of objects by bias.
    counts: BTreeMap<i32, u32>,
}

impl DepthBiases {
    /// Records the object of a slot by its `INSTANCE_` flags; `None` if there is none.
    pub fn note(&mut self, slot: u32, flags: Option<u32>) {
        // Biases are integers.
        let bias = flags.map_or(0, |flags| bias_of(flags) as i32);
        let before = if bias == 0 {
            self.by_slot.remove(&slot)
        } else {
            self.by_slot.insert(slot, bias)
        };
        if before == Some(bias) {
            return;
        }
        if let Some(count) = before.and_then(|before| self.counts.get_mut(&before)) {
            *count -= 1;
        }
        self.counts.retain(|_, count| *count > 0);
        if bias != 0 {
            *self.counts.entry(bias).or_default() += 1;
        }
    }

    /// Returns whether any object has one.
    pub fn exist(&self) -> bool {
        !self.by_slot.is_empty()
    }

    /// The largest bias, and the difference to the smallest one. Most objects have none, which counts as 0.
    pub fn range(&self) -> [f32; 2] {
        let largest = self.counts.keys().next_back().map_or(0, |bias| *bias.max(&0)) as f32;
        let smallest = self.counts.keys().next().map_or(0, |bias| *bias.min(&0)) as f32;
        [largest, largest - smallest]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{color::Color, material::OpaqueRendererMethod};

    fn biased(depth_bias: f32) -> StandardMaterial {
        StandardMaterial {
            depth_bias,
            ..StandardMaterial::default()
        }
    }

    fn bits_of(material: &StandardMaterial) -> u32 {
        order_bits(material, material.opaque_render_method == OpaqueRendererMethod::Forward)
    }

    #[test]
    fn biases_are_stored_as_bevy_rounds_them() {
        for (bias, stored) in [
            (0.0, 0.0),
            (0.9, 0.0),
            (f32::NAN, 0.0),
            (1.0, 1.0),
            (-1.7, -1.0),
            (3.0, 3.0),
            (200.0, 200.0),
            (-255.0, -255.0),
            (f32::INFINITY, MOST_BIAS),
            (-1e9, -MOST_BIAS),
        ] {
            assert_eq!(bias_of(bits_of(&biased(bias))), stored, "{bias}");
        }
        for bias in [1000.0, 12_345.0, -300_000.0, 4e6_f32] {
            let stored = bias_of(bits_of(&biased(bias)));
            assert!((stored - bias).abs() <= bias.abs() / 256.0, "{bias} as {stored}");
        }
        // No other flag is touched.
        let bits = (7 | INSTANCE_DEPTH_BIAS) << INSTANCE_DRAWN_SHIFT;
        for bias in [-1e9, -1.0, 1.0, 77.0, 1e9] {
            assert_eq!(bits_of(&biased(bias)) & !bits, 0);
        }
    }

    #[test]
    fn later_phases_and_larger_biases_lie_over_others() {
        let glass = StandardMaterial {
            specular_transmission: 0.5,
            ..StandardMaterial::default()
        };
        let with = |alpha_mode, opaque_render_method| StandardMaterial {
            alpha_mode,
            opaque_render_method,
            base_color: Color::BLACK,
            ..StandardMaterial::default()
        };
        let (deferred, forward) = (OpaqueRendererMethod::Deferred, OpaqueRendererMethod::Forward);
        // From the lowest to the uppermost.
        let materials = [
            biased(-1e9),
            biased(-200.0),
            biased(-1.0),
            with(AlphaMode::Opaque, deferred),
            with(AlphaMode::Mask(0.5), deferred),
            with(AlphaMode::Opaque, forward),
            with(AlphaMode::Mask(0.5), forward),
            glass,
            with(AlphaMode::Blend, forward),
            biased(1.0),
            biased(2.0),
            biased(200.0),
            biased(1000.0),
        ];
        let flags = materials.each_ref().map(bits_of);
        let order = DrawnOrder {
            flags: &flags,
            largest_bias: 1000.0,
            bias_range: 1000.0 + MOST_BIAS,
        };
        for t in [0.01, 1.0, 300.0] {
            for size in [0.0, 5.0, 4096.0] {
                let distances: Vec<_> = (0..flags.len() as u32).map(|i| order.distance(t, i, size)).collect();
                assert!(distances.is_sorted_by(|a, b| a > b), "{distances:?}");
                assert!(
                    distances
                        .iter()
                        .all(|distance| *distance > t && *distance <= order.last(t, size))
                );
            }
        }
    }

    #[test]
    fn the_range_of_biases_follows_objects() {
        let bits = |bias| Some(bits_of(&biased(bias)));
        let mut biases = DepthBiases::default();
        biases.note(3, bits(0.0));
        assert!(!biases.exist() && biases.range() == [0.0; 2]);
        biases.note(3, bits(-5.0));
        biases.note(4, bits(-2.0));
        assert!(biases.exist() && biases.range() == [0.0, 5.0]);
        biases.note(5, bits(100.0));
        biases.note(6, bits(100.0));
        assert_eq!(biases.range(), [100.0, 105.0]);
        biases.note(5, None);
        biases.note(3, bits(1.0));
        assert_eq!(biases.range(), [100.0, 102.0]);
        biases.note(6, bits(7.0));
        assert_eq!(biases.range(), [7.0, 9.0]);
        for slot in 0..9 {
            biases.note(slot, None);
        }
        assert!(!biases.exist() && biases.range() == [0.0; 2]);
    }
}
