//! A packed mesh, and the errors of packing.

use bevy::{
    math::Vec3,
    mesh::{MeshAccessError, PrimitiveTopology},
};
use std::fmt;
use thiserror::Error;

/// A packed mesh starts at a multiple of this many words, as required by vertices of 3 words and the 16-byte alignment of GPU buffers.
pub const BASE_ALIGNMENT: u32 = 12;
/// Words of the header.
pub const HEADER_WORDS: u32 = 12;
/// The smallest packed mesh, in words.
pub const MIN_WORDS: u32 = 24;
/// Vertices beyond this coordinate in object space count as not finite: products of three edges would overflow.
pub const MAX_COORDINATE: f32 = 1e12;
/// The reason why rays can't hit a mesh.
#[derive(Debug, Error)]
pub enum GeometryError {
    /// Points and lines have no surface.
    #[error(
        "the mesh is a {0:?} and rays only hit triangles; rebuild it as TriangleList or TriangleStrip to see it in reflections"
    )]
    NotTriangles(PrimitiveTopology),
    /// There are no vertices.
    #[error("the mesh has no vertex positions; insert Mesh::ATTRIBUTE_POSITION")]
    MissingPositions,
    /// Bevy removed the vertices from this copy of the mesh.
    #[error(
        "the vertices of the mesh were moved to the render world; add RenderAssetUsages::MAIN_WORLD to Mesh::asset_usage or \
         pack the mesh while it is being extracted"
    )]
    Extracted,
    /// Compressed positions are relative to an unknown box.
    #[error(
        "the positions of the mesh are compressed but Mesh::final_aabb is empty, as happens when a compressed mesh is extracted \
         without RenderAssetUsages::MAIN_WORLD; add that usage or set final_aabb again"
    )]
    MissingAabb,
    /// Offsets inside the geometry buffer would not fit.
    #[error("the mesh takes {0} words and must stay below 2147483648; split it into several meshes")]
    TooLarge(u64),
}

impl From<MeshAccessError> for GeometryError {
    fn from(error: MeshAccessError) -> Self {
        match error {
            MeshAccessError::ExtractedToRenderWorld => Self::Extracted,
            MeshAccessError::NotFound => Self::MissingPositions,
        }
    }
}

/// An axis-aligned box in object space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bounds {
    /// Minimum coordinates.
    pub min: Vec3,
    /// Maximum coordinates.
    pub max: Vec3,
}

/// Offsets of the arrays of a packed mesh, in words from its first word. 0 = the mesh has no such array.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshOffsets {
    /// Three words per vertex; always present.
    pub positions: u32,
    /// Three words per triangle; always present.
    pub indices: u32,
    /// One word per vertex.
    pub normals: u32,
    /// One word per vertex.
    pub tangents: u32,
    /// Two words per vertex.
    pub uv0: u32,
    /// Two words per vertex.
    pub uv1: u32,
    /// Two words per vertex.
    pub colors: u32,
    /// Six words per vertex.
    pub joints: u32,
    /// Three to nine words per vertex, target by target.
    pub morphs: u32,
}

impl MeshOffsets {
    /// The words before the arrays: counts of vertices, triangles and morph targets, and these offsets.
    pub fn header(self, [vertices, triangles, targets]: [u32; 3]) -> [u32; HEADER_WORDS as usize] {
        let Self {
            positions,
            indices,
            normals,
            tangents,
            uv0,
            uv1,
            colors,
            joints,
            morphs,
        } = self;
        [
            vertices, triangles, targets, positions, indices, normals, tangents, uv0, uv1, colors, joints, morphs,
        ]
    }
}

/// Parts of a mesh that had to be left out or replaced. [`fmt::Display`] formats them for a warning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshDefects {
    /// Triangles left out because an index is out of range.
    pub out_of_range_triangles: u32,
    /// Triangles left out because a position is not finite or beyond [`MAX_COORDINATE`].
    pub non_finite_triangles: u32,
    /// Normals, tangents, UVs and colours that are not finite or have no direction, replaced by neutral ones.
    pub replaced_values: u32,
    /// The attribute arrays differ in length; the shortest counts.
    pub uneven_attributes: bool,
}

impl MeshDefects {
    /// Returns whether there are no defects.
    #[cfg(any(test, feature = "internals"))]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for MeshDefects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        if self.out_of_range_triangles > 0 {
            parts.push(format!(
                "{} triangles with indices beyond the vertices left out",
                self.out_of_range_triangles
            ));
        }
        if self.non_finite_triangles > 0 {
            parts.push(format!(
                "{} triangles with positions that are not finite left out",
                self.non_finite_triangles
            ));
        }
        if self.replaced_values > 0 {
            parts.push(format!(
                "{} invalid normals, tangents, UVs or colours replaced",
                self.replaced_values
            ));
        }
        if self.uneven_attributes {
            parts.push("attributes of different lengths cut to the shortest".to_owned());
        }
        f.write_str(&parts.join(", "))
    }
}

/// Data to compute the bounds of a posed mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Deformation {
    /// The box around all triangles in bind pose.
    pub bounds: Bounds,
    /// Joints that move vertices, and the box around those vertices in bind pose. Empty without a skin.
    pub joints: Vec<(u32, Bounds)>,
    /// By morph target, the box around the displacements of its vertices at a weight of 1.
    pub targets: Vec<Bounds>,
}

/// A mesh in the layout of this module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PackedMesh {
    /// Words to store in the geometry buffer.
    pub words: Vec<u32>,
    /// Number of vertices, including unused ones.
    pub vertex_count: u32,
    /// Number of triangles. If it is 0, nothing can be hit, and no acceleration structure is built.
    pub triangle_count: u32,
    /// Offsets of the arrays.
    pub offsets: MeshOffsets,
    /// Box around all triangles; zero if there are none.
    pub bounds: Bounds,
    /// Set if the mesh has a skin or morph targets. The packed vertices are in bind pose, without morph targets.
    pub deformation: Option<Deformation>,
    /// Differences from the source.
    pub defects: MeshDefects,
}

impl PackedMesh {
    /// Positions in object space, all finite.
    pub fn positions(&self) -> &[[f32; 3]] {
        self.array(self.offsets.positions, self.vertex_count)
    }

    /// Vertices of each triangle in winding order.
    pub fn triangles(&self) -> &[[u32; 3]] {
        self.array(self.offsets.indices, self.triangle_count)
    }

    /// Three indices per triangle.
    pub fn indices(&self) -> &[u32] {
        self.triangles().as_flattened()
    }

    /// UV coordinates of the vertices; empty if the mesh doesn't have this set (0 or 1).
    pub fn uvs(&self, set: usize) -> &[[f32; 2]] {
        let offset = [self.offsets.uv0, self.offsets.uv1][set.min(1)];
        bytemuck::cast_slice(self.optional(offset, 2 * self.vertex_count))
    }

    /// Packed colours of the vertices, alpha in the highest byte; empty if the mesh has none.
    pub fn colors(&self) -> &[[u32; 2]] {
        bytemuck::cast_slice(self.optional(self.offsets.colors, 2 * self.vertex_count))
    }

    fn optional(&self, offset: u32, words: u32) -> &[u32] {
        let start = offset as usize;
        let range = start..start.saturating_add(words as usize);
        self.words.get(range).filter(|_| offset != 0).unwrap_or_default()
    }

    fn array<T: bytemuck::Pod>(&self, offset: u32, count: u32) -> &[[T; 3]] {
        let start = offset as usize;
        let words = self.words.get(start..start.saturating_add(3 * count as usize));
        words
            .and_then(|words| bytemuck::try_cast_slice(words).ok())
            .unwrap_or(&[])
    }
}
