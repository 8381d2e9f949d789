//! Data for a draw at a variable rate.

use super::BindGroupContents;
use crate::targets::Sizes;
use bevy::{
    asset::Handle,
    ecs::entity::Entity,
    render::render_resource::{BindGroupLayoutDescriptor, TextureView},
    shader::{Shader, ShaderDefVal},
};

/// Shaders, definitions and layouts of the pipeline; the same for all views.
pub(crate) struct PipelineRequest {
    /// A module with the entry points `vertex` (a triangle over the targets) and `fragment` (radiance and ray sample).
    pub shader: Handle<Shader>,
    pub defs: Vec<ShaderDefVal>,
    /// Layouts of the bind groups, as for wgpu's pipelines.
    pub layouts: Vec<BindGroupLayoutDescriptor>,
    /// A module with the entry points `pack`, which writes the bytes of a shading-rate attachment, and `touch`, which does nothing.
    pub attachment_shader: Handle<Shader>,
}

/// A bind group of the pass.
pub(crate) struct DrawGroup<'a> {
    pub contents: &'a BindGroupContents,
    /// Dynamic offsets, in the order of their bindings.
    pub offsets: &'a [u32],
}

/// The pass of one view.
pub(crate) struct VrsDraw<'a> {
    pub view: Entity,
    pub sizes: Sizes,
    /// The rate image of this frame.
    pub rate: &'a TextureView,
    pub ray_radiance: &'a TextureView,
    pub ray_sample: &'a TextureView,
    pub groups: [DrawGroup<'a>; 3],
}
