//! Textures about reflections for other render plugins.

use bevy::{ecs::prelude::*, reflect::prelude::*};

/// Makes a camera's reflections describe themselves in textures that other render plugins read: upscalers, denoisers and temporal
/// antialiasing.
///
/// Insert it on a camera with [`RayTracedReflections`](crate::RayTracedReflections). While the camera's opaque surfaces show traced
/// reflections, its view in the render world has [`ReflectionGuideTextures`](crate::ReflectionGuideTextures). They take 7 bytes per pixel,
/// and one more pass fills them. Cameras without this component pay nothing. The technique
/// [`Converged`](crate::ReflectionTechnique::Converged) has no guides, and neither do glass, water and cameras without a
/// [`MotionVectorPrepass`](bevy::core_pipeline::prepass::MotionVectorPrepass).
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct ReflectionGuides;
