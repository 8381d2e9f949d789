//! Skinned and morphed meshes as reflections show them.

use bevy::{
    ecs::{component::Component, prelude::*},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// How reflections show a skinned or morphed mesh. On any other entity it has no effect.
///
/// Without this component a mesh is [`Posed`](Self::Posed).
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectedPose {
    /// In the pose that the camera sees. The GPU poses the mesh again in each frame in which its pose has changed, within
    /// [`ReflectedPoseBudget`]. The entity takes memory of its own: 12 to 20 bytes for each vertex, and the tree or the acceleration
    /// structure of its mesh once more.
    #[default]
    Posed,
    /// In its bind pose and without morph targets, moved by the first joint. Costs no more than a mesh without a skin: for crowds and
    /// distant characters.
    Rigid,
}

/// How many vertices of skinned and morphed meshes are posed for reflections in one frame, at most.
///
/// If more of them have changed, the meshes that are nearest to a camera with reflections come first. Others keep their last pose
/// and still follow their first joint; the longer they wait, the sooner it is their turn. At least one mesh is posed however many
/// vertices it has, unless the budget is 0, which keeps all poses as they are.
///
/// More costs time on the GPU, which grows with the number of posed vertices and triangles, and less makes distant characters move
/// in steps.
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
