//! Numbers by which shaders of an app tell material types apart.

use crate::scene::gpu_types::{MATERIAL_TYPE_BITS, MATERIAL_TYPE_SHIFT};
use bevy::{ecs::resource::Resource, pbr::StandardMaterial};
use core::any::TypeId;

/// Types of materials that rays know besides `StandardMaterial`, in the order of their plugins.
#[derive(Resource, Default)]
pub struct MaterialTypes(Vec<TypeId>);

impl MaterialTypes {
    /// Gives the next number to a type of materials. Belongs in its plugin.
    pub fn add(&mut self, id: TypeId) {
        if id != TypeId::of::<StandardMaterial>() && !self.0.contains(&id) {
            self.0.push(id);
        }
    }

    /// The `MATERIAL_TYPE_` bits of a type. Types for which bits lack share the last number.
    pub fn flags(&self, id: TypeId) -> u32 {
        let place = self.0.iter().position(|added| *added == id);
        place.map_or(0, |place| (place as u32 + 1).min(MATERIAL_TYPE_BITS)) << MATERIAL_TYPE_SHIFT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_count_in_their_order() {
        let mut types = MaterialTypes::default();
        let [a, b, c] = [TypeId::of::<u8>(), TypeId::of::<u16>(), TypeId::of::<u32>()];
        for id in [b, TypeId::of::<StandardMaterial>(), a, b] {
            types.add(id);
        }
        let numbers = [TypeId::of::<StandardMaterial>(), c, b, a].map(|id| types.flags(id) >> MATERIAL_TYPE_SHIFT);
        assert_eq!(numbers, [0, 0, 1, 2]);
    }
}
