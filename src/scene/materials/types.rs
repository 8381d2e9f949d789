//! Material types that rays know: the numbers by which shaders of an app tell them apart, and which of them show no environment.

use crate::scene::gpu_types::{MATERIAL_TYPE_BITS, MATERIAL_TYPE_SHIFT};
use bevy::{ecs::resource::Resource, pbr::StandardMaterial, platform::collections::HashSet};
use core::any::TypeId;

/// Types of materials that rays know.
#[derive(Resource, Default)]
pub struct MaterialTypes {
    /// Types besides `StandardMaterial`, in the order of their plugins.
    numbered: Vec<TypeId>,
    /// Types with a plugin that declares their shader to add no specular light of the environment.
    without_environment: HashSet<TypeId>,
}

impl MaterialTypes {
    /// Gives the next number to a type of materials. Belongs in its plugin.
    pub fn add(&mut self, id: TypeId) {
        if id != TypeId::of::<StandardMaterial>() && !self.numbered.contains(&id) {
            self.numbered.push(id);
        }
    }

    /// Notes that the shader of a type shows no environment. Of several plugins, one that says so is enough.
    pub fn deny_environment(&mut self, id: TypeId) {
        self.without_environment.insert(id);
    }

    /// Returns whether the shader of a type shows the environment, as far as its plugin knows.
    pub fn shows_environment(&self, id: TypeId) -> bool {
        !self.without_environment.contains(&id)
    }

    /// The `MATERIAL_TYPE_` bits of a type. Types for which bits lack share the last number.
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
