//! The definitions that shaders which import the scene's modules are compiled with.

use super::SceneBindings;
use crate::{device::ReflectionTracer, scene::bvh::LARGEST_STACK};
use bevy::shader::ShaderDefVal;

impl SceneBindings {
    /// Returns the definitions that shaders which import the scene's modules must be compiled with for the scene as it is. Code
    /// that keeps pipelines has to follow [`Self::shader_defs_version`], or use [`Self::shader_defs_for`] any scene.
    #[cfg(feature = "internals")]
    pub fn shader_defs(&self) -> Vec<ShaderDefVal> {
        self.shader_defs_for(self.has_masked_geometry())
    }

    /// The same with or without masked geometry. Shaders for scenes with it are right for all scenes. With the BVH tracer, shaders
    /// for scenes without it treat masked and blended surfaces as opaque (apart from what merged trees already cut out) and cannot
    /// tell their triangles; they are slightly smaller and faster. With ray queries there is no difference.
    ///
    /// A change of the scene never waits for a compiler where both are compiled from the start.
    pub fn shader_defs_for(&self, masked_geometry: bool) -> Vec<ShaderDefVal> {
        let mut defs = self.tracer.shader_defs();
        defs.extend(self.texture_def.map(Into::into));
        if masked_geometry && self.tracer == ReflectionTracer::Bvh {
            defs.push("ALPHA_MASKED_GEOMETRY".into());
        }
        if self.deep {
            defs.push(ShaderDefVal::UInt("BVH_STACK_SIZE".into(), LARGEST_STACK));
        }
        defs
    }

    /// For any scene.
    pub(crate) fn shader_defs_for_any(&self) -> Vec<ShaderDefVal> {
        let mut defs = self.shader_defs_for(true);
        if self.tracer == ReflectionTracer::Bvh && !self.deep {
            defs.push(ShaderDefVal::UInt("BVH_STACK_SIZE".into(), LARGEST_STACK));
        }
        defs
    }

    /// Changes whenever [`Self::shader_defs`] does.
    #[cfg(feature = "internals")]
    pub fn shader_defs_version(&self) -> u32 {
        self.defs_version
    }

    /// Returns whether rays can hit something that needs the alpha test. Also `true` until the first object can be hit.
    pub fn has_masked_geometry(&self) -> bool {
        self.masked
    }

    /// Returns whether the scene's trees need a larger stack than shaders usually have. A larger stack slows rays down
    /// a little.
    pub(crate) fn has_deep_trees(&self) -> bool {
        self.deep
    }

    /// Notes whether shaders need the alpha test.
    pub(in crate::scene) fn set_masked(&mut self, masked: bool) {
        if self.masked != masked {
            self.masked = masked;
            self.defs_version = self.defs_version.wrapping_add(1);
        }
    }

    /// Notes whether shaders need a larger stack.
    pub(in crate::scene) fn set_deep(&mut self, deep: bool) {
        if self.deep != deep {
            self.deep = deep;
            self.defs_version = self.defs_version.wrapping_add(1);
        }
    }
}
