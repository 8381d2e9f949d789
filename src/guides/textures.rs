//! The textures of a view.

use crate::{targets::create_texture, view::GuideMemory};
use bevy::{
    ecs::component::Component,
    math::UVec2,
    render::{
        render_resource::{TextureFormat, TextureUsages, TextureView, TextureViewDescriptor},
        renderer::RenderDevice,
    },
};

/// Formats of the textures.
pub(super) const FORMATS: [TextureFormat; 3] = [
    TextureFormat::Rg16Float,
    TextureFormat::R16Float,
    TextureFormat::R8Unorm,
];

/// Textures about the reflections on a view's opaque surfaces, in the render world, on the view's entity: see
/// [`ReflectionGuides`](crate::ReflectionGuides).
///
/// [`ReflectionSystems::Passes`](crate::ReflectionSystems::Passes) fills them in each frame. Read them in `Core3d` after it. Pixel (0, 0) is
/// the first pixel of the camera's viewport. The textures can be larger than the view, which occupies their first [`size`](Self::size)
/// texels. They are 0 in frames in which nothing is traced, such as those of cameras that see nothing reflective.
#[derive(Component, Clone, Debug)]
pub struct ReflectionGuideTextures {
    /// `Rg16Float`: how far the reflected image moved on the screen since the last frame, as a fraction of the view, with the convention
    /// of Bevy's [motion vectors](bevy::core_pipeline::prepass::MotionVectorPrepass). It includes the motion of the camera and the
    /// curvature of the reflector, not the motion of what is reflected. Where nothing is reflected, on rough surfaces, and on reflectors that
    /// move by themselves, it is the motion of the surface.
    pub specular_motion: TextureView,
    /// `R16Float`: distance in metres from the surface to the reflected point, at most 60,000. The sky has 60,000, and pixels without a ray
    /// have 0.
    pub hit_distance: TextureView,
    /// `R8Unorm`: from 0, where the history of a pixel is valid at its motion vector, to 1, where a bright and sharp reflection doesn't
    /// follow its surface: its image moves differently, or it shows something that moves.
    pub reactive_mask: TextureView,
    /// Pixels of the view.
    pub size: UVec2,
    /// Pixels of the textures.
    capacity: UVec2,
}

impl ReflectionGuideTextures {
    /// The textures and their memory.
    pub(super) fn new(device: &RenderDevice, size: UVec2, capacity: UVec2) -> (Self, GuideMemory) {
        let mut memory = GuideMemory::default();
        let mut texture = |format, label| {
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
            let (texture, bytes) = create_texture(device, capacity, format, usage, label);
            memory.0.push((label, bytes));
            texture.create_view(&TextureViewDescriptor {
                label: Some(label),
                ..Default::default()
            })
        };
        let [motion, distance, mask] = FORMATS;
        let textures = Self {
            specular_motion: texture(motion, "glint_specular_motion"),
            hit_distance: texture(distance, "glint_hit_distance"),
            reactive_mask: texture(mask, "glint_reactive_mask"),
            size,
            capacity,
        };
        (textures, memory)
    }

    /// Pixels of the textures.
    pub(super) fn capacity(&self) -> UVec2 {
        self.capacity
    }
}
