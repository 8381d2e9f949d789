//! See-through materials, and the objects with such materials.

use super::gpu_types::{MATERIAL_FADES, MATERIAL_SEE_THROUGH, OPAQUE_DEPTH};
use bevy::{
    color::{ColorToComponents, LinearRgba},
    ecs::entity::{Entity, EntityHashMap},
    math::Vec3,
    pbr::StandardMaterial,
    prelude::AlphaMode,
};
use std::collections::{BTreeMap, BTreeSet};

/// Minimum probability that a ray stops at refracting glass. Rays that are followed through layers need to find the glass, and stop at
/// surfaces with more than `LEAST_SHARE` of `transparency.wesl`. Stochastic rays lose this fraction of the light behind it.
const LEAST_STOPPED: f32 = 1.0 / 512.0;
/// The same for glass that emits light, which is brighter by the inverse where rays stop. A lower value adds noise in rough reflections, and
/// a higher one takes light from what is behind.
const LEAST_STOPPED_BY_LIGHT: f32 = 1.0 / 64.0;

/// The probability that a ray stops at an alpha of 1; `None` for materials without stochastic transparency.
pub(super) fn stop_probability(material: &StandardMaterial) -> Option<f32> {
    let least = if emits(material) {
        LEAST_STOPPED_BY_LIGHT
    } else if refracts(material) {
        LEAST_STOPPED
    } else {
        0.0
    };
    let stopped = (1.0 - transmission(material)).max(least);
    match material.alpha_mode {
        AlphaMode::Mask(_) | AlphaMode::AlphaToCoverage => None,
        AlphaMode::Opaque => (stopped < 1.0).then_some(stopped),
        _ => Some(stopped),
    }
}

fn emits(material: &StandardMaterial) -> bool {
    material.emissive.to_vec3() != Vec3::ZERO
}

fn transmission(material: &StandardMaterial) -> f32 {
    let transmission = material.specular_transmission;
    if transmission.is_finite() {
        transmission.clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// Returns whether the material changes the path of the light that passes through it.
pub(super) fn refracts(material: &StandardMaterial) -> bool {
    transmission(material) > 0.0
        && !matches!(material.alpha_mode, AlphaMode::Mask(_) | AlphaMode::AlphaToCoverage)
        && (material.thickness > 0.0 && material.thickness.is_finite())
        && (material.ior > 1.0 && material.ior.is_finite())
}

/// Index of refraction; 0 if light isn't refracted.
pub(super) fn index_of_refraction(material: &StandardMaterial) -> f32 {
    if refracts(material) { material.ior } else { 0.0 }
}

/// Optical depth of the material's volume, for red, green and blue: Beer's law with the material's attenuation.
pub(super) fn optical_depth(material: &StandardMaterial) -> [u32; 2] {
    let color = LinearRgba::from(material.attenuation_color);
    let lengths = material.thickness / material.attenuation_distance;
    if !(lengths > 0.0 && lengths.is_finite()) || transmission(material) == 0.0 {
        return [0; 2];
    }
    let [red, green, blue] = [color.red, color.green, color.blue].map(|part| {
        let depth = -part.ln() * lengths;
        // A colour that isn't a number absorbs nothing.
        let depth = if depth > 0.0 { depth.min(OPAQUE_DEPTH) } else { 0.0 };
        (depth / OPAQUE_DEPTH * f32::from(u16::MAX)).round() as u32
    });
    [red | (green << 16), blue]
}

/// The `MATERIAL_` flags of reflective surfaces that are drawn over the opaque image. Rays find no other see-through surfaces.
pub(super) fn see_through_flags(material: &StandardMaterial) -> u32 {
    let is_transmissive = transmission(material) > 0.0;
    match material.alpha_mode {
        _ if material.unlit => 0,
        AlphaMode::Blend => MATERIAL_SEE_THROUGH | MATERIAL_FADES,
        AlphaMode::Premultiplied => MATERIAL_SEE_THROUGH,
        AlphaMode::Opaque if is_transmissive => MATERIAL_SEE_THROUGH,
        _ => 0,
    }
}

/// Returns whether shaders need code for tinted glass: the material colours the light that passes through it, or emits light.
fn is_tinted(material: &StandardMaterial) -> bool {
    let color = LinearRgba::from(material.base_color);
    let is_white =
        material.base_color_texture.is_none() && [color.red, color.green, color.blue].iter().all(|&part| part >= 1.0);
    let is_clear = is_white && optical_depth(material) == [0; 2] && !emits(material);
    stop_probability(material).is_some_and(|stopped| stopped < 1.0) && !is_clear
}

/// The objects with such surfaces that rays can hit.
#[derive(Default)]
pub(crate) struct SeeThroughObjects {
    by_slot: BTreeMap<u32, Entity>,
    /// Slots by object. While an object moves to another slot, it can be in both for a moment; this is the later one.
    by_entity: EntityHashMap<u32>,
    /// Slots of objects that let a part of the rays through.
    partial: BTreeSet<u32>,
    /// Slots of objects that tint the light that passes through them.
    tinted: BTreeSet<u32>,
    /// Slots of objects that refract it.
    refracting: BTreeSet<u32>,
}

impl SeeThroughObjects {
    /// Records the object of a slot; `material` is `None` if it can't be hit.
    pub(super) fn note(&mut self, slot: u32, entity: Option<Entity>, material: Option<&StandardMaterial>) {
        let lets_through = |material| stop_probability(material).is_some();
        for (slots, holds) in [
            (&mut self.tinted, material.is_some_and(is_tinted)),
            (&mut self.partial, material.is_some_and(lets_through)),
            (&mut self.refracting, material.is_some_and(refracts)),
        ] {
            if holds {
                slots.insert(slot);
            } else {
                slots.remove(&slot);
            }
        }
        let is_see_through = material.is_some_and(|material| see_through_flags(material) != 0);
        let entity = entity.filter(|_| is_see_through);
        let last = match entity {
            Some(entity) => self.by_slot.insert(slot, entity),
            None => self.by_slot.remove(&slot),
        };
        if let Some(last) = last.filter(|last| self.by_entity.get(last) == Some(&slot)) {
            self.by_entity.remove(&last);
        }
        self.by_entity.extend(entity.map(|entity| (entity, slot)));
    }

    /// Returns whether any of them tints the light that passes through it.
    pub(crate) fn has_tints(&self) -> bool {
        !self.tinted.is_empty()
    }

    /// Returns whether any object lets a part of the rays through.
    pub(crate) fn has_partial(&self) -> bool {
        !self.partial.is_empty()
    }

    /// Returns whether any object refracts the light that passes through it.
    pub(crate) fn has_refraction(&self) -> bool {
        !self.refracting.is_empty()
    }

    /// Number of these objects.
    pub(crate) fn count(&self) -> usize {
        self.by_slot.len()
    }

    /// Returns whether an entity of the main world is one of them.
    pub(crate) fn contains(&self, entity: Entity) -> bool {
        self.by_entity.contains_key(&entity)
    }

    /// Entities of the objects in the main world.
    pub(crate) fn entities(&self) -> impl Iterator<Item = Entity> + '_ {
        self.by_slot.values().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::color::Color;

    fn material(alpha_mode: AlphaMode, specular_transmission: f32, unlit: bool) -> StandardMaterial {
        StandardMaterial {
            alpha_mode,
            specular_transmission,
            unlit,
            ..Default::default()
        }
    }

    #[test]
    fn surfaces_over_the_opaque_picture_are_told_from_others() {
        let flags = |alpha_mode, transmission, unlit| see_through_flags(&material(alpha_mode, transmission, unlit));
        assert_eq!(
            flags(AlphaMode::Blend, 0.0, false),
            MATERIAL_SEE_THROUGH | MATERIAL_FADES
        );
        assert_eq!(flags(AlphaMode::Premultiplied, 0.0, false), MATERIAL_SEE_THROUGH);
        assert_eq!(flags(AlphaMode::Opaque, 0.5, false), MATERIAL_SEE_THROUGH);
        for (alpha_mode, transmission, unlit) in [
            (AlphaMode::Opaque, 0.0, false),
            (AlphaMode::Opaque, f32::NAN, false),
            (AlphaMode::Mask(0.5), 0.0, false),
            (AlphaMode::AlphaToCoverage, 0.0, false),
            (AlphaMode::Add, 0.0, false),
            (AlphaMode::Blend, 0.0, true),
        ] {
            assert_eq!(flags(alpha_mode, transmission, unlit), 0, "{alpha_mode:?}");
        }
    }

    #[test]
    fn thick_glass_refracts_and_absorbs() {
        let glass = |thickness, ior, attenuation_distance| StandardMaterial {
            thickness,
            ior,
            attenuation_distance,
            attenuation_color: Color::linear_rgb(0.5, 1.0, 0.0),
            ..material(AlphaMode::Opaque, 1.0, false)
        };
        let thick = glass(0.2, 1.5, 0.4);
        assert_eq!(index_of_refraction(&thick), 1.5);
        assert!(stop_probability(&thick).is_some_and(|stopped| stopped > 0.0 && stopped < 0.01));
        let [red_green, blue] = optical_depth(&thick);
        let depth = |bits: u32| bits as f32 / f32::from(u16::MAX) * OPAQUE_DEPTH;
        assert!((depth(red_green & 0xffff) - 0.5 * 2.0_f32.ln()).abs() < 1e-3);
        assert_eq!((red_green >> 16, depth(blue)), (0, OPAQUE_DEPTH));
        for (thin, absorbs) in [
            (glass(0.0, 1.5, 0.4), false),
            (glass(0.2, 1.0, 0.4), true),
            (glass(f32::NAN, 1.5, 0.4), false),
            (glass(0.2, f32::INFINITY, 0.0), false),
            (glass(-1.0, 1.5, 1.0), false),
        ] {
            assert_eq!(index_of_refraction(&thin), 0.0, "{thin:?}");
            assert_eq!(stop_probability(&thin), Some(0.0), "{thin:?}");
            assert_eq!(optical_depth(&thin) != [0; 2], absorbs, "{thin:?}");
        }
        let stone = StandardMaterial {
            specular_transmission: 0.0,
            ..thick.clone()
        };
        assert_eq!((index_of_refraction(&stone), optical_depth(&stone)), (0.0, [0; 2]));
        let mut objects = SeeThroughObjects::default();
        objects.note(3, Some(Entity::from_bits(7)), Some(&thick));
        assert!(objects.has_refraction() && objects.has_tints());
        objects.note(3, Some(Entity::from_bits(7)), Some(&stone));
        assert!(!objects.has_refraction() && !objects.has_tints());
    }

    #[test]
    fn objects_leave_with_their_slot_or_their_material() {
        let entity = Entity::from_bits(7);
        let glass = material(AlphaMode::Blend, 0.0, false);
        let stone = StandardMaterial::default();
        let mut objects = SeeThroughObjects::default();
        objects.note(3, Some(entity), Some(&glass));
        assert!(objects.entities().eq([entity]));
        objects.note(3, Some(entity), Some(&stone));
        assert_eq!(objects.entities().count(), 0);
        objects.note(3, Some(entity), Some(&glass));
        // It moves to another slot, which is recorded first.
        objects.note(1, Some(entity), Some(&glass));
        objects.note(3, None, None);
        assert!(objects.entities().eq([entity]) && objects.contains(entity));
        objects.note(1, None, None);
        assert!(objects.count() == 0 && !objects.contains(entity));
    }

    #[test]
    fn glass_of_a_colour_has_tints() {
        let mut objects = SeeThroughObjects::default();
        let colored = |base_color: Color, alpha_mode, transmission| StandardMaterial {
            base_color,
            ..material(alpha_mode, transmission, false)
        };
        for (material, has_tints) in [
            (colored(Color::srgb(0.2, 0.9, 0.2), AlphaMode::Opaque, 0.5), true),
            (colored(Color::WHITE, AlphaMode::Opaque, 1.0), false),
            (colored(Color::srgb(0.2, 0.9, 0.2), AlphaMode::Blend, 0.0), false),
            (colored(Color::BLACK, AlphaMode::Opaque, 0.0), false),
        ] {
            objects.note(3, Some(Entity::from_bits(7)), Some(&material));
            assert_eq!(objects.has_tints(), has_tints, "{material:?}");
        }
        let glowing = StandardMaterial {
            emissive: LinearRgba::rgb(0.0, 0.1, 0.0),
            ..colored(Color::WHITE, AlphaMode::Opaque, 1.0)
        };
        objects.note(3, Some(Entity::from_bits(7)), Some(&glowing));
        assert!(objects.has_tints());
        let textured = StandardMaterial {
            base_color_texture: Some(Default::default()),
            ..colored(Color::WHITE, AlphaMode::Opaque, 1.0)
        };
        objects.note(3, Some(Entity::from_bits(7)), Some(&textured));
        assert!(objects.has_tints());
        objects.note(3, None, None);
        objects.note(4, None, Some(&colored(Color::BLACK, AlphaMode::Opaque, 1.0)));
        objects.note(4, None, None);
        assert!(!objects.has_tints());
    }
}
