//! Material types that rays support: their numbers for an app's shaders, and the types whose shaders ignore the environment.

use crate::scene::gpu_types::{MATERIAL_TYPE_BITS, MATERIAL_TYPE_SHIFT};
use bevy::{ecs::resource::Resource, pbr::StandardMaterial, platform::collections::HashSet};
use core::any::TypeId;

/// Types of materials that rays support.
#[derive(Resource, Default)]
pub struct MaterialTypes {
    /// Types besides `StandardMaterial`, in the order of their plugins.
    numbered: Vec<TypeId>,
    /// Types that a plugin declared to add no specular light of the environment.
    without_environment: HashSet<TypeId>,
}

impl MaterialTypes {
    /// Assigns the next number to a type of materials. Called by its plugin.
    pub fn add(&mut self, id: TypeId) {
        if id != TypeId::of::<StandardMaterial>() && !self.numbered.contains(&id) {
            self.numbered.push(id);
        }
    }

    /// Records that the shader of a type ignores the environment. If several plugins add the type, one declaration is enough.
    pub fn deny_environment(&mut self, id: TypeId) {
        self.without_environment.insert(id);
    }

    /// Returns whether the shader of a type adds the environment's light, according to its plugin.
    pub fn shows_environment(&self, id: TypeId) -> bool {
        !self.without_environment.contains(&id)
    }

    /// The `MATERIAL_TYPE_` bits of a type. Types beyond the range of the bits share the last number.
    pub fn flags(&self, id: TypeId) -> u32 {
        let place = self.numbered.iter().position(|added| *added == id);
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

    #[test]
    fn one_word_against_the_environment_is_enough() {
        let mut types = MaterialTypes::default();
        let [a, b] = [TypeId::of::<u8>(), TypeId::of::<u16>()];
        types.deny_environment(a);
        types.add(a);
        types.add(b);
        assert_eq!([a, b].map(|id| types.shows_environment(id)), [false, true]);
    }
}
