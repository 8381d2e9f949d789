//! Materials that light passes through, and the objects that have them.

use super::gpu_types::{MATERIAL_FADES, MATERIAL_SEE_THROUGH};
use bevy::{color::LinearRgba, ecs::entity::Entity, pbr::StandardMaterial, prelude::AlphaMode};
use std::collections::{BTreeMap, BTreeSet};

/// The probability with which a ray stops where alpha is 1; `None` for materials that let no ray through by chance.
pub(super) fn stop_probability(material: &StandardMaterial) -> Option<f32> {
    let stopped = 1.0 - transmission(material);
    match material.alpha_mode {
        AlphaMode::Mask(_) => None,
        AlphaMode::Opaque => (stopped < 1.0).then_some(stopped),
        _ => Some(stopped),
    }
}

fn transmission(material: &StandardMaterial) -> f32 {
    let transmission = material.specular_transmission;
    if transmission.is_finite() {
        transmission.clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// The `MATERIAL_` flags of surfaces that are drawn over the opaque picture and reflect. Rays meet no others of that kind, and
/// materials with alpha to coverage are drawn with the opaque ones.
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

/// Light that passes has another colour afterwards.
fn is_tinted(material: &StandardMaterial) -> bool {
    let color = LinearRgba::from(material.base_color);
    let is_white =
        material.base_color_texture.is_none() && [color.red, color.green, color.blue].iter().all(|&part| part >= 1.0);
    stop_probability(material).is_some_and(|stopped| stopped < 1.0) && !is_white
}

/// The objects with such surfaces that rays can hit.
#[derive(Default)]
pub(crate) struct SeeThroughObjects {
    by_slot: BTreeMap<u32, Entity>,
    /// Slots of objects that let a part of the rays through.
    partial: BTreeSet<u32>,
    /// Slots of objects that tint the light which they let through.
    tinted: BTreeSet<u32>,
}

impl SeeThroughObjects {
    /// Notes which object a slot holds; `material` is `None` where it can't be hit.
    pub(super) fn note(&mut self, slot: u32, entity: Option<Entity>, material: Option<&StandardMaterial>) {
        if material.is_some_and(is_tinted) {
            self.tinted.insert(slot);
        } else {
            self.tinted.remove(&slot);
        }
        if material.is_some_and(|material| stop_probability(material).is_some()) {
            self.partial.insert(slot);
        } else {
            self.partial.remove(&slot);
        }
        let is_see_through = material.is_some_and(|material| see_through_flags(material) != 0);
        match entity.filter(|_| is_see_through) {
            Some(entity) => {
                self.by_slot.insert(slot, entity);
            }
            None => {
                self.by_slot.remove(&slot);
            }
        }
    }

    /// Returns whether any of them tints the light that it lets through.
    pub(crate) fn has_tints(&self) -> bool {
        !self.tinted.is_empty()
    }

    /// Returns whether any object lets a part of the rays through.
    pub(crate) fn has_partial(&self) -> bool {
        !self.partial.is_empty()
    }

    /// Their entities in the main world.
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
        objects.note(3, None, None);
        assert_eq!(objects.entities().count(), 0);
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
