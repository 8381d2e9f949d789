//! Packs the vertex attributes for shading, besides the position.

use super::{
    decode,
    packed::{GeometryError, PackedMesh},
};
use bevy::{
    math::{Vec2, Vec3},
    mesh::{
        Mesh, MeshAttributeCompressionFlags, MeshVertexAttribute, MeshVertexBufferLayouts, VertexAttributeValues,
        octahedral_encode_signed,
    },
};

/// The optional attributes of a mesh.
pub(super) struct Attributes<'a> {
    normals: Option<&'a VertexAttributeValues>,
    tangents: Option<&'a VertexAttributeValues>,
    uvs: [Option<&'a VertexAttributeValues>; 2],
    /// Least UV and extent of each set, to undo compression.
    uv_ranges: [(Vec2, Vec2); 2],
    colors: Option<&'a VertexAttributeValues>,
    /// Which attributes are in Bevy's compressed form.
    pub compression: MeshAttributeCompressionFlags,
}

impl<'a> Attributes<'a> {
    /// Fails if the mesh's data is in the render world.
    pub fn new(mesh: &'a Mesh) -> Result<Self, GeometryError> {
        let get = |attribute: MeshVertexAttribute| mesh.try_attribute_option(attribute);
        let (normals, tangents) = (get(Mesh::ATTRIBUTE_NORMAL)?, get(Mesh::ATTRIBUTE_TANGENT)?);
        let uvs = [get(Mesh::ATTRIBUTE_UV_0)?, get(Mesh::ATTRIBUTE_UV_1)?];
        let colors = get(Mesh::ATTRIBUTE_COLOR)?;
        // Only the layout exposes these flags. It panics on extracted meshes, which failed above.
        let mut layouts = MeshVertexBufferLayouts::default();
        let compression = mesh
            .get_mesh_vertex_buffer_layout(&mut layouts)
            .0
            .get_attribute_compression();
        let uv_ranges = mesh.final_uv_ranges.map(|range| {
            // As in Bevy, an unknown range is the unit square.
            range.map_or((Vec2::ZERO, Vec2::ONE), |range| (range.min, range.max - range.min))
        });
        Ok(Self {
            normals,
            tangents,
            uvs,
            uv_ranges,
            colors,
            compression,
        })
    }

    /// Words that [`Self::pack`] adds for each vertex.
    pub fn words_per_vertex(&self) -> u64 {
        let single = [self.normals, self.tangents].iter().flatten().count();
        let double = self.uvs.iter().chain([&self.colors]).flatten().count();
        (single + 2 * double) as u64
    }

    /// Appends the attributes to a mesh with packed positions and triangles.
    pub fn pack(&self, packed: &mut PackedMesh) {
        let normals = self.normals.map(|values| self.pack_normals(packed, values));
        if let Some(values) = self.tangents {
            self.pack_tangents(packed, values, normals.as_deref());
        }
        let uv_flags = [
            MeshAttributeCompressionFlags::COMPRESS_UV0,
            MeshAttributeCompressionFlags::COMPRESS_UV1,
        ];
        for (set, flag) in uv_flags.into_iter().enumerate() {
            let Some(values) = self.uvs[set] else { continue };
            *[&mut packed.offsets.uv0, &mut packed.offsets.uv1][set] = packed.words.len() as u32;
            let compressed = self.compression.contains(flag) && matches!(values, VertexAttributeValues::Unorm16x2(_));
            let (min, extent) = if compressed {
                self.uv_ranges[set]
            } else {
                (Vec2::ZERO, Vec2::ONE)
            };
            decode::for_each_value(values, packed.vertex_count as usize, |[x, y, ..]| {
                let uv = min + extent * Vec2::new(x, y);
                let valid = uv.is_finite();
                packed.defects.replaced_values += u32::from(!valid);
                packed
                    .words
                    .extend((if valid { uv } else { Vec2::ZERO }).to_array().map(f32::to_bits));
            });
        }
        if let Some(values) = self.colors {
            packed.offsets.colors = packed.words.len() as u32;
            decode::for_each_value(values, packed.vertex_count as usize, |color| {
                let valid = color.iter().all(|channel| channel.is_finite());
                packed.defects.replaced_values += u32::from(!valid);
                packed.words.extend(encode_color(if valid { color } else { [1.0; 4] }));
            });
        }
    }

    /// Returns the normals for [`Self::pack_tangents`].
    fn pack_normals(&self, packed: &mut PackedMesh, values: &VertexAttributeValues) -> Vec<Vec3> {
        let compressed = self.is_octahedral(values, MeshAttributeCompressionFlags::COMPRESS_NORMAL);
        let count = packed.vertex_count as usize;
        let mut normals = Vec::with_capacity(count);
        decode::for_each_value(values, count, |value| normals.push(decode::normal(value, compressed)));
        let missing = normals.iter().filter(|normal| normal.is_none()).count();
        packed.defects.replaced_values += missing as u32;
        let computed = if missing > 0 { face_normals(packed) } else { Vec::new() };
        let normals: Vec<Vec3> = normals
            .into_iter()
            .enumerate()
            .map(|(vertex, normal)| normal.or_else(|| computed.get(vertex).copied()).unwrap_or(Vec3::Z))
            .collect();
        packed.offsets.normals = packed.words.len() as u32;
        packed.words.extend(normals.iter().map(|normal| encode_normal(*normal)));
        normals
    }

    fn pack_tangents(&self, packed: &mut PackedMesh, values: &VertexAttributeValues, normals: Option<&[Vec3]>) {
        let compressed = self.is_octahedral(values, MeshAttributeCompressionFlags::COMPRESS_TANGENT);
        packed.offsets.tangents = packed.words.len() as u32;
        let mut vertex = 0;
        decode::for_each_value(values, packed.vertex_count as usize, |value| {
            let (tangent, flipped) = decode::tangent(value, compressed);
            packed.defects.replaced_values += u32::from(tangent.is_none());
            // Any direction that spans a plane with the normal will do.
            let tangent = tangent.unwrap_or_else(|| {
                let normal = normals.and_then(|normals| normals.get(vertex));
                normal.map_or(Vec3::X, |normal| normal.any_orthonormal_vector())
            });
            packed.words.push(encode_tangent(tangent, flipped));
            vertex += 1;
        });
    }

    fn is_octahedral(&self, values: &VertexAttributeValues, flag: MeshAttributeCompressionFlags) -> bool {
        self.compression.contains(flag) && matches!(values, VertexAttributeValues::Snorm16x2(_))
    }
}

/// For each vertex, the area-weighted mean of its triangles' normals, or +Z if there is none.
fn face_normals(packed: &PackedMesh) -> Vec<Vec3> {
    let positions = packed.positions();
    let mut sums = vec![Vec3::ZERO; positions.len()];
    // Scaled to unit size, so that the products neither overflow nor underflow.
    let size = (packed.bounds.max - packed.bounds.min).max_element();
    let scale = if size > 0.0 { 1.0 / size } else { 1.0 };
    let scale = if scale.is_finite() { scale } else { 1.0 };
    for triangle in packed.triangles() {
        let corner = |vertex: u32| positions.get(vertex as usize).copied().unwrap_or_default();
        let [a, b, c] = triangle.map(|vertex| Vec3::from(corner(vertex)));
        let normal = ((b - a) * scale).cross((c - a) * scale);
        for vertex in triangle {
            if let Some(sum) = sums.get_mut(*vertex as usize) {
                *sum += normal;
            }
        }
    }
    sums.into_iter()
        .map(|sum| decode::direction(sum).unwrap_or(Vec3::Z))
        .collect()
}

fn snorm16(value: f32) -> u32 {
    u32::from(((value.clamp(-1.0, 1.0) * 32767.0).round() as i16) as u16)
}

/// Encodes a unit vector.
pub(super) fn encode_normal(normal: Vec3) -> u32 {
    let octahedral = octahedral_encode_signed(normal);
    snorm16(octahedral.x) | (snorm16(octahedral.y) << 16)
}

/// Encodes a unit vector; `flipped` = the bitangent's sign is negative.
pub(super) fn encode_tangent(tangent: Vec3, flipped: bool) -> u32 {
    let octahedral = octahedral_encode_signed(tangent);
    let y = ((octahedral.y * 0.5 + 0.5).clamp(0.0, 1.0) * 32767.0).round() as u32;
    snorm16(octahedral.x) | (y << 16) | (u32::from(flipped) << 31)
}

/// Half floats, since Bevy multiplies by colours above 1, and dark colours need more than 8 bits.
fn encode_color([red, green, blue, alpha]: [f32; 4]) -> [u32; 2] {
    let alpha = (alpha.clamp(0.0, 1.0) * 255.0).round() as u32;
    [half(red) | (half(green) << 16), half(blue) | (alpha << 24)]
}

/// Bits of the nearest non-negative half float.
fn half(value: f32) -> u32 {
    const LARGEST: f32 = 65504.0;
    // 2^-112 changes the exponent's bias from 127 to 15; the smallest numbers become denormal, as in half floats.
    let bits = (value.clamp(0.0, LARGEST) * f32::from_bits(15 << 23)).to_bits();
    (bits + 0xfff + ((bits >> 13) & 1)) >> 13
}
