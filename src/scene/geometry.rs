//! Packing of Bevy meshes into the words that `geometry.wesl` reads.
//!
//! A packed mesh is an array of `u32`. All offsets are in words from its first word, which is at a multiple of [`BASE_ALIGNMENT`]
//! in the geometry buffer:
//!
//! | words | content |
//! |---|---|
//! | 0 | number of vertices |
//! | 1 | number of triangles |
//! | 2 | number of morph targets |
//! | 3 to 9 | offsets of positions, indices, normals, tangents, UV set 0, UV set 1, colours; 0 = the mesh has none |
//! | 10, 11 | offsets of joints, morph targets; 0 = the mesh has none. Posed copies have the offset of their motions in word 10 |
//!
//! - Positions: three `f32` per vertex. The offset is a multiple of three words, so that hardware acceleration structures can be
//!   built directly from the geometry buffer with a stride of 12 bytes.
//! - Indices: three per triangle, each below the number of vertices.
//! - Normals: octahedral coordinates as two snorm16.
//! - Tangents: octahedral coordinates, x as snorm16 in the low half, y as unorm15 of `y * 0.5 + 0.5` in bits 16 to 30; bit 31 is
//!   set if the bitangent's sign is negative.
//! - UV sets: two `f32` per vertex.
//! - Colours: linear red, green and blue as `f16`, 8 bits of zeros, then alpha as unorm8: two words per vertex.
//! - Joints: four indices of 16 bits, then four `f32` weights per vertex.
//! - Morph targets: one after the other, for each vertex the differences of the position as three `f32`, and of the normal and the
//!   tangent if the mesh has them.
//! - Motions: how far each vertex of a posed copy moved between its last two poses, in object space, packed as in `motion.rs`.
//!
//! A mesh without triangles is followed by zeros up to [`MIN_WORDS`], so that a stray read stays inside it.

mod attributes;
mod decode;
mod packed;
mod pose;
#[cfg(test)]
mod shader_tests;
#[cfg(test)]
mod tests;

pub use packed::{
    BASE_ALIGNMENT, Bounds, Deformation, GeometryError, HEADER_WORDS, MAX_COORDINATE, MIN_WORDS, MeshDefects,
    MeshOffsets, PackedMesh,
};

use attributes::Attributes;
use bevy::{
    math::Vec3,
    mesh::{Indices, Mesh, MeshAttributeCompressionFlags, PrimitiveTopology, VertexAttributeValues},
};
use pose::Pose;

/// Packed meshes are smaller than this many words.
const WORD_LIMIT: u64 = 1 << 31;

/// Packs any triangle mesh in linear time. No mesh makes it panic.
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
    let pose = Pose::new(mesh, position_values.len())?;
    let indices = mesh.try_indices_option()?;

    // Checked before anything is allocated.
    let index_count = indices.map_or(count, Indices::len) as u64;
    let vertex_words = (3 + attributes.words_per_vertex() + pose.words_per_vertex()) * count as u64;
    let word_limit = u64::from(HEADER_WORDS) + vertex_words + 3 * most_triangles(topology, index_count);
    if word_limit >= WORD_LIMIT {
        return Err(GeometryError::TooLarge(word_limit));
    }

    let mut packed = PackedMesh {
        vertex_count: count as u32,
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
        // No triangle uses a non-finite vertex, but builders of acceleration structures might read it.
        position.unwrap_or_default().to_array().map(f32::to_bits)
    }));
    packed.pack_triangles(topology, indices, &positions);
    if count > 0 {
        attributes.pack(&mut packed);
        pose.pack(&mut packed);
    }
    write_header(&mut packed);
    Ok(packed)
}

/// Maximum number of triangles for this number of indices. The triangles of a strip are nearly as many as its indices.
fn most_triangles(topology: PrimitiveTopology, index_count: u64) -> u64 {
    if topology.is_strip() {
        index_count.saturating_sub(2)
    } else {
        index_count / 3
    }
}

/// Writes counts and offsets to the start of a mesh whose other words are complete.
fn write_header(packed: &mut PackedMesh) {
    let targets = packed
        .deformation
        .as_ref()
        .map_or(0, |deformation| deformation.targets.len());
    let counts = [packed.vertex_count, packed.triangle_count, targets as u32];
    let header = packed.offsets.header(counts);
    packed.words[..header.len()].copy_from_slice(&header);
    if packed.words.len() < MIN_WORDS as usize {
        packed.words.resize(MIN_WORDS as usize, 0);
    }
}

/// Returns `None` for positions that can't be traced.
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

/// Splits a list or strip into triangles. Strips alternate their winding and restart after the `restart` index.
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
