//! The part of a mesh that stays in main memory while rays can hit it.

use super::CHUNK_TRIANGLES;
use crate::scene::{
    bvh::MaskSource,
    geometry::{MeshOffsets, PackedMesh},
};
use bevy::math::Affine2;
use std::sync::Arc;

/// Mesh data that merged trees and masks copy: 12 bytes for each vertex and 12 for each triangle, 8 more for each vertex with UV
/// coordinates, and 8 with colours. Micromaps take 16 for each triangle.
pub struct MeshTriangles(Arc<PackedMesh>);

impl MeshTriangles {
    /// A reduced copy.
    pub(super) fn copied(packed: &PackedMesh) -> Self {
        let mut copy = PackedMesh {
            vertex_count: packed.vertex_count,
            triangle_count: packed.triangle_count,
            // Arrays start after this word, since an offset of 0 means that an array is missing.
            words: vec![0],
            ..PackedMesh::default()
        };
        let words = &mut copy.words;
        let mut add = |array: &[u32]| {
            let begin = words.len() as u32;
            words.extend_from_slice(array);
            if array.is_empty() { 0 } else { begin }
        };
        let positions = packed.positions().as_flattened();
        copy.offsets = MeshOffsets {
            positions: add(if is_mergeable(packed) {
                bytemuck::cast_slice(positions)
            } else {
                &[]
            }),
            indices: add(packed.indices()),
            uv0: add(bytemuck::cast_slice(packed.uvs(0))),
            uv1: add(bytemuck::cast_slice(packed.uvs(1))),
            colors: add(packed.colors().as_flattened()),
            ..MeshOffsets::default()
        };
        copy.words.shrink_to_fit();
        Self(Arc::new(copy))
    }

    /// A mesh that stays in memory anyway.
    pub(super) fn shared(packed: Arc<PackedMesh>) -> Self {
        Self(packed)
    }

    /// Object space; empty if the mesh is too large to be merged.
    pub fn positions(&self) -> &[[f32; 3]] {
        if is_mergeable(&self.0) { self.0.positions() } else { &[] }
    }

    /// Three per triangle.
    pub fn indices(&self) -> &[u32] {
        self.0.indices()
    }

    /// Returns the data to build masks from. The second set of UV coordinates is used only if the mesh has one.
    pub(in crate::scene) fn mask_source(&self, second_uvs: bool, uv_transform: Affine2) -> MaskSource<'_> {
        let is_second = second_uvs && !self.0.uvs(1).is_empty();
        MaskSource {
            indices: self.indices(),
            uvs: self.0.uvs(usize::from(is_second)),
            uv_transform,
            colors: self.0.colors(),
        }
    }
}

fn is_mergeable(packed: &PackedMesh) -> bool {
    u64::from(packed.triangle_count) <= CHUNK_TRIANGLES
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::geometry::pack_mesh;
    use bevy::prelude::*;

    #[test]
    fn a_copy_has_what_is_needed_and_no_more() {
        let mut mesh = Sphere::new(1.0).mesh().uv(32, 16);
        mesh.generate_tangents().unwrap();
        mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, vec![[0.5; 4]; mesh.count_vertices()]);
        let packed = Arc::new(pack_mesh(&mesh).unwrap());
        let [copied, shared] = [MeshTriangles::copied(&packed), MeshTriangles::shared(packed.clone())];
        for second_uvs in [false, true] {
            let [a, b] = [&copied, &shared].map(|triangles| triangles.mask_source(second_uvs, Affine2::IDENTITY));
            assert_eq!((a.indices, a.uvs, a.colors), (b.indices, b.uvs, b.colors));
            assert!(!a.uvs.is_empty() && !a.colors.is_empty());
        }
        assert_eq!(copied.positions(), shared.positions());
        let (vertices, triangles) = (packed.vertex_count as usize, packed.triangle_count as usize);
        assert_eq!(copied.0.words.capacity(), 1 + (3 + 2 + 2) * vertices + 3 * triangles);
        assert!(Arc::ptr_eq(&shared.0, &packed));
    }
}
