//! Features of the scene, and the shader definitions that modules of the scene need.

use super::SceneBindings;
use crate::{
    device::ReflectionTracer,
    scene::{bvh::LARGEST_STACK, environment::MANY_TEXTURES, features::Features},
};
use bevy::shader::ShaderDefVal;

/// Creates the definitions of shaders that import the scene's modules.
#[derive(Clone, Copy)]
pub(crate) struct SceneDefinitions {
    tracer: ReflectionTracer,
    textures: Option<&'static str>,
}

impl SceneDefinitions {
    /// The definitions for these features.
    pub fn of(self, features: Features) -> Vec<ShaderDefVal> {
        let mut definitions = self.tracer.shader_defs();
        definitions.extend(self.textures.map(Into::into));
        if features.contains(Features::MASKED) && self.tracer == ReflectionTracer::Bvh {
            definitions.push("ALPHA_MASKED_GEOMETRY".into());
        }
        if features.contains(Features::DEEP_TREES) && self.tracer == ReflectionTracer::Bvh {
            definitions.push(ShaderDefVal::UInt("BVH_STACK_SIZE".into(), LARGEST_STACK));
        }
        definitions.extend(features.definitions().map(Into::into));
        definitions
    }
}

impl SceneBindings {
    /// Features of the scene that shaders are compiled for.
    pub(crate) fn features(&self) -> Features {
        let of_tables = [
            (!self.lightmaps.is_empty(), Features::LIGHTMAPS),
            (!self.light_textures.is_empty(), Features::LIGHT_TEXTURES),
            (!self.light_probes.is_empty(), Features::LIGHT_PROBES),
            (self.see_through.has_tints(), Features::TINTS),
            (self.see_through.has_partial(), Features::LAYERS),
            (self.see_through.has_refraction(), Features::REFRACTION),
            (
                self.see_through.has_partial() || self.depth_biases.exist(),
                Features::COPLANAR,
            ),
            (self.has_forward_surfaces(), Features::FORWARD_SURFACES),
            (self.uniform_data.light_leaf_count > 0, Features::LIGHT_SAMPLING),
            (
                self.has_many_lights() || self.features.contains(Features::FOG_VOLUMES) || self.particles.is_lit(),
                Features::MANY_LIGHTS,
            ),
            (self.particles.exists(), Features::PARTICLES),
            (self.particles.is_lit(), Features::LIT_PARTICLES),
        ];
        let present = of_tables
            .into_iter()
            .filter_map(|(is_there, feature)| is_there.then_some(feature));
        present.fold(self.features, Features::union)
    }

    /// Features that the device's binding limits allow.
    pub(crate) fn possible_features(&self) -> Features {
        let mut features = Features::all();
        features.set(Features::LIGHT_PROBES, self.light_probes.textures().is_some());
        features.set(Features::HAZE, self.can_have_haze);
        features.set(Features::FOG_DENSITY, MANY_TEXTURES);
        features
    }

    /// Definitions of shaders that import the scene's modules.
    pub(crate) fn definitions(&self) -> SceneDefinitions {
        SceneDefinitions {
            tracer: self.tracer,
            textures: self.texture_def,
        }
    }

    /// Returns the definitions that shaders which import the scene's modules must be compiled with for the current scene. Code
    /// that caches pipelines has to check [`Self::shader_defs_version`], or use [`Self::shader_defs_for`] any scene.
    #[cfg(feature = "internals")]
    pub fn shader_defs(&self) -> Vec<ShaderDefVal> {
        self.shader_defs_for(self.has_masked_geometry())
    }

    /// Returns the definitions for scenes with or without masked geometry. Shaders for scenes with it work for all scenes. With the BVH
    /// tracer, shaders for scenes without it treat masked and blended surfaces as opaque, except for the parts that merged trees already
    /// cut out, and can't identify their triangles. They are slightly smaller and faster. With ray queries there is no difference.
    #[cfg(feature = "internals")]
    pub fn shader_defs_for(&self, masked_geometry: bool) -> Vec<ShaderDefVal> {
        let mut features = self.features & Features::DEEP_TREES;
        features.set(Features::MASKED, masked_geometry);
        self.definitions().of(features)
    }

    /// Changes whenever [`Self::shader_defs`] does.
    #[cfg(feature = "internals")]
    pub fn shader_defs_version(&self) -> u32 {
        self.defs_version
    }

    /// Returns whether rays can hit an object that needs the alpha test. Also `true` until the first object can be hit.
    #[cfg(feature = "internals")]
    pub fn has_masked_geometry(&self) -> bool {
        self.features.contains(Features::MASKED)
    }

    /// Notes whether trees over the scene need the alpha test or a larger stack.
    pub(in crate::scene) fn set_tree_features(&mut self, is_masked: bool, is_deep: bool) {
        let before = self.features;
        self.features.set(Features::MASKED, is_masked);
        self.features.set(Features::DEEP_TREES, is_deep);
        self.defs_version = self.defs_version.wrapping_add(u32::from(self.features != before));
    }
}
