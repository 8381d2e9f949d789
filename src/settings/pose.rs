//! Settings for meshes with vertices that move in reflections.

use bevy::{
    ecs::{component::Component, prelude::*},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// How reflections show a skinned or morphed mesh, or one with [`ReflectedVertices`](crate::ReflectedVertices). It has no effect on other
/// entities.
///
/// Without this component a mesh is [`Posed`](Self::Posed).
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectedPose {
    /// In the pose of the frame. The GPU poses the mesh again in each frame in which its pose has changed, within
    /// [`ReflectedPoseBudget`]. The entity takes additional memory: 12 to 20 bytes for each vertex, and another copy of its mesh's
    /// tree or acceleration structure.
    #[default]
    Posed,
    /// In its bind pose and without morph targets, moved by the first joint; vertices stay where the mesh has them. Costs no more than a
    /// mesh that can't be posed: for crowds and distant characters.
    Rigid,
}

/// Maximum number of vertices that are posed for reflections in one frame: of skinned and morphed meshes, and of those with
/// [`ReflectedVertices`](crate::ReflectedVertices).
///
/// If more vertices have changed, the meshes nearest to a camera with reflections come first. Others keep their last pose and still
/// follow their transform or first joint; the longer they wait, the higher their priority. At least one mesh is posed, regardless of its number of
/// vertices, unless the budget is 0, which freezes all poses.
///
/// A higher number costs GPU time, in proportion to the posed vertices and triangles; a lower one makes distant characters move in steps.
#[derive(Resource, Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectedPoseBudget {
    /// Vertices per frame, 1,000,000 by default.
    pub vertices_per_frame: u32,
}

impl Default for ReflectedPoseBudget {
    fn default() -> Self {
        Self {
            vertices_per_frame: 1_000_000,
        }
    }
}
