//! Bottom-level structures: variants of a mesh, and the inputs of their builds.

use crate::{
    device::try_allocate,
    scene::{
        gpu_types::{INSTANCE_ALPHA_MASKED, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED},
        meshes::{SceneMesh, SceneMeshes},
    },
};
use bevy::{
    asset::AssetId,
    log::warn_once,
    mesh::Mesh,
    render::{
        render_resource::{
            AccelerationStructureFlags, AccelerationStructureGeometryFlags, AccelerationStructureUpdateMode, Blas,
            BlasBuildEntry, BlasGeometries, BlasGeometrySizeDescriptors, BlasTriangleGeometry,
            BlasTriangleGeometrySizeDescriptor, Buffer, BufferDescriptor, BufferUsages, CreateBlasDescriptor,
            IndexFormat, VertexFormat,
        },
        renderer::{RenderDevice, RenderQueue},
    },
};

/// Faces of a mesh that are part of a BLAS. Closest-hit rays always cull back faces in hardware. wgpu can't disable culling per
/// instance, so a surface that is visible from behind needs triangles with reversed winding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Winding {
    /// Triangles with the mesh's winding.
    AsIs,
    /// All triangles flipped: (a, c, b).
    Flipped,
    /// All triangles twice: first with the mesh's winding, then flipped.
    Both,
}

/// The variants of a mesh's BLAS.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlasKey {
    pub(super) mesh: AssetId<Mesh>,
    winding: Winding,
    opaque: bool,
}

impl BlasKey {
    /// The variant that an instance with these flags needs.
    pub fn new(mesh: AssetId<Mesh>, flags: u32) -> Self {
        let mirrored = flags & INSTANCE_MIRRORED != 0;
        let winding = if flags & INSTANCE_CULL_BACK != 0 {
            if mirrored { Winding::Flipped } else { Winding::AsIs }
        } else if flags & INSTANCE_CULL_FRONT != 0 {
            if mirrored { Winding::AsIs } else { Winding::Flipped }
        } else {
            Winding::Both
        };
        Self {
            mesh,
            winding,
            opaque: flags & INSTANCE_ALPHA_MASKED == 0,
        }
    }
}

/// The reason why a BLAS can't be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The mesh has more triangles than the device allows.
    TooLarge,
    NoMemory,
}

/// A BLAS with the inputs of its build.
pub(super) struct PendingBlas {
    pub key: BlasKey,
    pub version: u64,
    pub blas: Blas,
    pub size: BlasTriangleGeometrySizeDescriptor,
    /// Indices with changed winding; `None` to use the mesh's own.
    indices: Option<Buffer>,
    pub first_vertex: u32,
    first_index: u32,
}

impl PendingBlas {
    pub fn new(
        key: BlasKey,
        mesh: &SceneMesh,
        flags: AccelerationStructureFlags,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Result<Self, Refusal> {
        let indices = rewound(&mesh.indices, key.winding);
        let index_count = indices.as_ref().map_or(mesh.indices.len(), Vec::len) as u32;
        let limit = device.limits().max_blas_primitive_count;
        let triangles = index_count / 3;
        // The limit counts triangles, but wgpu also checks the number of vertices against it.
        if triangles.max(mesh.vertex_count) > limit {
            warn_once!(
                "a mesh of {triangles} triangles is missing from reflections: the device's limit is {limit}; split \
                 the mesh, or keep it out with `NotReflected`"
            );
            return Err(Refusal::TooLarge);
        }
        let size = BlasTriangleGeometrySizeDescriptor {
            vertex_format: VertexFormat::Float32x3,
            vertex_count: mesh.vertex_count,
            index_format: Some(IndexFormat::Uint32),
            index_count: Some(index_count),
            flags: if key.opaque {
                AccelerationStructureGeometryFlags::OPAQUE
            } else {
                AccelerationStructureGeometryFlags::empty()
            },
        };
        let created = try_allocate(device, || {
            let blas = device.wgpu_device().create_blas(
                &CreateBlasDescriptor {
                    label: Some("glint_blas"),
                    flags,
                    update_mode: AccelerationStructureUpdateMode::Build,
                },
                BlasGeometrySizeDescriptors::Triangles {
                    descriptors: vec![size.clone()],
                },
            );
            let buffer = indices.as_ref().map(|indices| {
                device.create_buffer(&BufferDescriptor {
                    label: Some("glint_blas_indices"),
                    size: 4 * indices.len() as u64,
                    usage: BufferUsages::BLAS_INPUT | BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            });
            (blas, buffer)
        });
        // wgpu might also lack the memory to stage the write.
        let written = created.filter(|(_, buffer)| {
            let (Some(buffer), Some(indices)) = (buffer, &indices) else {
                return true;
            };
            try_allocate(device, || queue.write_buffer(buffer, 0, bytemuck::cast_slice(indices))).is_some()
        });
        let Some((blas, buffer)) = written else {
            warn_once!(
                "a mesh of {triangles} triangles is missing from reflections, since the device has no memory for its \
                 acceleration structure; use fewer or smaller meshes, or keep some out with `NotReflected`"
            );
            return Err(Refusal::NoMemory);
        };
        let base = mesh.geometry.base();
        Ok(Self {
            key,
            version: mesh.version,
            blas,
            size,
            first_vertex: (base + mesh.offsets.positions) / 3,
            first_index: if buffer.is_some() {
                0
            } else {
                base + mesh.offsets.indices
            },
            indices: buffer,
        })
    }

    pub fn entry<'a>(&'a self, meshes: &'a SceneMeshes) -> BlasBuildEntry<'a> {
        BlasBuildEntry {
            blas: &self.blas,
            geometry: BlasGeometries::TriangleGeometries(vec![BlasTriangleGeometry {
                size: &self.size,
                vertex_buffer: meshes.geometry.buffer(),
                first_vertex: self.first_vertex,
                vertex_stride: 12,
                index_buffer: Some(self.indices.as_ref().unwrap_or(meshes.geometry.buffer())),
                first_index: Some(self.first_index),
                transform_buffer: None,
                transform_buffer_offset: None,
            }]),
        }
    }
}

/// Indices with changed winding, or `None` if the mesh's own will do.
fn rewound(indices: &[u32], winding: Winding) -> Option<Vec<u32>> {
    let flipped = indices
        .chunks_exact(3)
        .flat_map(|triangle| [triangle[0], triangle[2], triangle[1]]);
    match winding {
        Winding::AsIs => None,
        Winding::Flipped => Some(flipped.collect()),
        Winding::Both => Some(indices.iter().copied().chain(flipped).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn winding_follows_culling_and_mirroring() {
        let winding = |flags| BlasKey::new(AssetId::default(), flags).winding;
        assert_eq!(winding(INSTANCE_CULL_BACK), Winding::AsIs);
        assert_eq!(winding(INSTANCE_CULL_BACK | INSTANCE_MIRRORED), Winding::Flipped);
        assert_eq!(winding(INSTANCE_CULL_FRONT), Winding::Flipped);
        assert_eq!(winding(INSTANCE_CULL_FRONT | INSTANCE_MIRRORED), Winding::AsIs);
        assert_eq!(winding(INSTANCE_MIRRORED), Winding::Both);
        assert_eq!(rewound(&[0, 1, 2], Winding::Both), Some(vec![0, 1, 2, 0, 2, 1]));
    }
}
