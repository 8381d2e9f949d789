//! Packing of Bevy meshes into the words that `geometry.wesl` reads.
//!
//! A packed mesh is an array of `u32`. All offsets are in words from its first word, which stands at a multiple of
//! [`BASE_ALIGNMENT`] in the geometry buffer:
//!
//! | words | content |
//! |---|---|
//! | 0 | number of vertices |
//! | 1 | number of triangles |
//! | 2 | 0 |
//! | 3 to 9 | offsets of positions, indices, normals, tangents, UV set 0, UV set 1, colours; 0 = the mesh has none |
//! | 10, 11 | 0 |
//!
//! - Positions: three `f32` per vertex. The offset is a multiple of three words, so that hardware acceleration structures can
//!   be built straight from the geometry buffer with a stride of 12 bytes.
//! - Indices: three per triangle, each below the number of vertices.
//! - Normals: octahedral coordinates as two snorm16.
//! - Tangents: octahedral coordinates, x as snorm16 in the low half, y as unorm15 of `y * 0.5 + 0.5` in bits 16 to 30; bit 31
//!   is set where the bitangent's sign is negative.
//! - UV sets: two `f32` per vertex.
//! - Colours: linear RGBA as four unorm8. Brighter colours are clamped to 1.
//!
//! A mesh without triangles is followed by zeros up to [`MIN_WORDS`], so that a stray read stays inside it.

mod attributes;
mod decode;
#[cfg(test)]
mod shader_tests;
#[cfg(test)]
mod tests;

use attributes::Attributes;
use bevy::{
    math::Vec3,
    mesh::{Indices, Mesh, MeshAccessError, MeshAttributeCompressionFlags, PrimitiveTopology, VertexAttributeValues},
};
use std::fmt;
use thiserror::Error;

/// A packed mesh starts at a multiple of this many words: vertices of 3 words and the 16-byte alignment of GPU buffers meet.
pub const BASE_ALIGNMENT: u32 = 12;
/// Words of the header.
pub const HEADER_WORDS: u32 = 12;
/// The smallest packed mesh, in words.
pub const MIN_WORDS: u32 = 24;
/// Vertices farther out than this, in object space, count as not finite: products of three edges would overflow.
pub const MAX_COORDINATE: f32 = 1e12;
/// Packed meshes are smaller than this many words.
const WORD_LIMIT: u64 = 1 << 31;

/// Why a mesh cannot be hit by rays.
#[derive(Debug, Error)]
pub enum GeometryError {
    /// Points and lines have no surface.
    #[error(
        "the mesh is a {0:?} and rays only hit triangles; rebuild it as TriangleList or TriangleStrip to see it in reflections"
    )]
    NotTriangles(PrimitiveTopology),
    /// There is nothing to place in space.
    #[error("the mesh has no vertex positions; insert Mesh::ATTRIBUTE_POSITION")]
    MissingPositions,
    /// Bevy took the vertices out of this copy of the mesh.
    #[error(
        "the vertices of the mesh were moved to the render world; add RenderAssetUsages::MAIN_WORLD to Mesh::asset_usage or \
         pack the mesh while it is being extracted"
    )]
    Extracted,
    /// Compressed positions are relative to a box that is not known.
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
    /// Least coordinates.
    pub min: Vec3,
    /// Greatest coordinates.
    pub max: Vec3,
}

/// Where the arrays of a packed mesh start, in words from its first word. 0 = the mesh has none.
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
    /// One word per vertex.
    pub colors: u32,
}

/// What had to be left out or replaced. [`fmt::Display`] words it for a warning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshDefects {
    /// Triangles left out because an index names no vertex.
    pub out_of_range_triangles: u32,
    /// Triangles left out because a position is not finite or beyond [`MAX_COORDINATE`].
    pub non_finite_triangles: u32,
    /// Normals, tangents, UVs and colours that are not finite or have no direction, replaced by neutral ones.
    pub replaced_values: u32,
    /// The attribute arrays differ in length; the shortest counts.
    pub uneven_attributes: bool,
}

impl MeshDefects {
    /// Nothing to tell.
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

/// A mesh in the layout of this module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PackedMesh {
    /// What belongs in the geometry buffer.
    pub words: Vec<u32>,
    /// Vertices, used by triangles or not.
    pub vertex_count: u32,
    /// Triangles; 0 = nothing to hit, and no acceleration structure to build.
    pub triangle_count: u32,
    /// Where the arrays start.
    pub offsets: MeshOffsets,
    /// Box around all triangles; zero if there are none.
    pub bounds: Bounds,
    /// The mesh has joint weights. Its vertices here are in bind pose.
    pub has_skin: bool,
    /// The mesh has morph targets. Its vertices here are without them.
    pub has_morphs: bool,
    /// What differs from the source.
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

    /// UV coordinates of the vertices; empty where the mesh doesn't have this set (0 or 1).
    pub fn uvs(&self, set: usize) -> &[[f32; 2]] {
        let offset = [self.offsets.uv0, self.offsets.uv1][set.min(1)];
        bytemuck::cast_slice(self.optional(offset, 2 * self.vertex_count))
    }

    /// Packed colours of the vertices, red in the lowest byte; empty where the mesh has none.
    pub fn colors(&self) -> &[u32] {
        self.optional(self.offsets.colors, self.vertex_count)
    }

    fn optional(&self, offset: u32, words: u32) -> &[u32] {
        let start = offset as usize;
        let range = start..start.saturating_add(words as usize);
        self.words.get(range).filter(|_| offset != 0).unwrap_or_default()
    }

    /// Size in the geometry buffer.
    pub fn byte_len(&self) -> u64 {
        self.words.len() as u64 * 4
    }

    fn array<T: bytemuck::Pod>(&self, offset: u32, count: u32) -> &[[T; 3]] {
        let start = offset as usize;
        let words = self.words.get(start..start.saturating_add(3 * count as usize));
        words
            .and_then(|words| bytemuck::try_cast_slice(words).ok())
            .unwrap_or(&[])
    }
}

/// Packs any triangle mesh. The work is linear in its size; nothing in a mesh makes it panic.
pub fn pack_mesh(mesh: &Mesh) -> Result<PackedMesh, GeometryError> {
    let topology = mesh.primitive_topology();
    if !topology.is_triangles() {
        return Err(GeometryError::NotTriangles(topology));
    }
    let (shortest, longest) = mesh
        .try_attributes()?
        .fold((usize::MAX, 0), |(shortest, longest), (_, values)| {
            (shortest.min(values.len()), longest.max(values.len()))
        });
    let position_values = mesh
        .try_attribute_option(Mesh::ATTRIBUTE_POSITION)?
        .ok_or(GeometryError::MissingPositions)?;
    let count = shortest.min(position_values.len());
    let attributes = Attributes::new(mesh)?;
    let indices = mesh.try_indices_option()?;

    // Checked before anything is allocated. The triangles of a strip are nearly as many as its indices.
    let index_count = indices.map_or(count, Indices::len) as u64;
    let triangle_limit = if topology.is_strip() {
        index_count.saturating_sub(2)
    } else {
        index_count / 3
    };
    let word_limit = u64::from(HEADER_WORDS) + (3 + attributes.words_per_vertex()) * count as u64 + 3 * triangle_limit;
    if word_limit >= WORD_LIMIT {
        return Err(GeometryError::TooLarge(word_limit));
    }

    let mut packed = PackedMesh {
        vertex_count: count as u32,
        has_skin: mesh.try_contains_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT)?,
        has_morphs: mesh.try_has_morph_targets().unwrap_or(false),
        defects: MeshDefects {
            uneven_attributes: shortest != longest,
            ..Default::default()
        },
        ..Default::default()
    };
    let positions = load_positions(mesh, position_values, count, attributes.compression)?;
    packed.words = vec![0; HEADER_WORDS as usize];
    packed
        .words
        .reserve_exact(word_limit.max(u64::from(MIN_WORDS)) as usize - HEADER_WORDS as usize);
    packed.offsets.positions = packed.words.len() as u32;
    packed.words.extend(positions.iter().flat_map(|position| {
        // Nothing refers to a vertex that is not finite, but builders of acceleration structures may read it.
        position.unwrap_or_default().to_array().map(f32::to_bits)
    }));
    packed.pack_triangles(topology, indices, &positions);
    if count > 0 {
        attributes.pack(&mut packed);
    }

    let MeshOffsets {
        positions,
        indices,
        normals,
        tangents,
        uv0,
        uv1,
        colors,
    } = packed.offsets;
    let header = [
        packed.vertex_count,
        packed.triangle_count,
        0,
        positions,
        indices,
        normals,
        tangents,
        uv0,
        uv1,
        colors,
        0,
        0,
    ];
    packed.words[..header.len()].copy_from_slice(&header);
    if packed.words.len() < MIN_WORDS as usize {
        packed.words.resize(MIN_WORDS as usize, 0);
    }
    Ok(packed)
}

/// `None` for positions that cannot be traced.
fn load_positions(
    mesh: &Mesh,
    values: &VertexAttributeValues,
    count: usize,
    compression: MeshAttributeCompressionFlags,
) -> Result<Vec<Option<Vec3>>, GeometryError> {
    let compressed = compression.contains(MeshAttributeCompressionFlags::COMPRESS_POSITION)
        && matches!(values, VertexAttributeValues::Snorm16x4(_));
    let (center, half_extents) = match (compressed, mesh.final_aabb) {
        (false, _) => (Vec3::ZERO, Vec3::ONE),
        (true, Some(aabb)) => (
            Vec3::from((aabb.min + aabb.max) * 0.5),
            Vec3::from((aabb.max - aabb.min) * 0.5),
        ),
        (true, None) => return Err(GeometryError::MissingAabb),
    };
    let mut positions = Vec::with_capacity(count);
    decode::for_each_value(values, count, |[x, y, z, _]| {
        let position = center + half_extents * Vec3::new(x, y, z);
        positions.push((position.abs().max_element() <= MAX_COORDINATE && position.is_finite()).then_some(position));
    });
    Ok(positions)
}

impl PackedMesh {
    fn pack_triangles(&mut self, topology: PrimitiveTopology, indices: Option<&Indices>, positions: &[Option<Vec3>]) {
        self.offsets.indices = self.words.len() as u32;
        let mut bounds: Option<Bounds> = None;
        let mut add = |triangle: [u32; 3]| {
            let corners = triangle.map(|vertex| positions.get(vertex as usize));
            let [Some(a), Some(b), Some(c)] = corners else {
                self.defects.out_of_range_triangles += 1;
                return;
            };
            let (Some(a), Some(b), Some(c)) = (*a, *b, *c) else {
                self.defects.non_finite_triangles += 1;
                return;
            };
            let (min, max) = (a.min(b).min(c), a.max(b).max(c));
            let all = bounds.get_or_insert(Bounds { min, max });
            *all = Bounds {
                min: all.min.min(min),
                max: all.max.max(max),
            };
            self.words.extend(triangle);
            self.triangle_count += 1;
        };
        match indices {
            Some(Indices::U16(indices)) => {
                for_each_triangle(topology, indices.iter().map(|i| u32::from(*i)), Some(0xffff), &mut add);
            }
            Some(Indices::U32(indices)) => {
                for_each_triangle(topology, indices.iter().copied(), Some(u32::MAX), &mut add);
            }
            None => for_each_triangle(topology, 0..positions.len() as u32, None, &mut add),
        }
        self.bounds = bounds.unwrap_or_default();
    }
}

/// Splits a list or strip into triangles. Strips alternate their winding and start anew after the `restart` index.
fn for_each_triangle(
    topology: PrimitiveTopology,
    indices: impl Iterator<Item = u32>,
    restart: Option<u32>,
    add: &mut impl FnMut([u32; 3]),
) {
    let strip = topology.is_strip();
    let mut corners = [0; 2];
    let mut seen = 0_usize;
    for index in indices {
        if strip && Some(index) == restart {
            seen = 0;
            continue;
        }
        let [a, b] = corners;
        match (strip, seen) {
            (_, 0) => corners[0] = index,
            (_, 1) => corners[1] = index,
            (true, _) => {
                add(if seen.is_multiple_of(2) {
                    [a, b, index]
                } else {
                    [b, a, index]
                });
                corners = [b, index];
            }
            (false, _) => add([a, b, index]),
        }
        seen = if !strip && seen == 2 { 0 } else { seen + 1 };
    }
}
