//! Meshes with source data that only exists in the render world, and only until they are prepared.

use crate::scene::{
    geometry::{GeometryError, PackedMesh, pack_mesh},
    tree_builds,
};
use bevy::{asset::AssetId, ecs::prelude::*, log::warn, mesh::Mesh, platform::collections::HashMap};
use std::sync::Arc;

/// The part of a mesh that is kept, since its data can't be read twice: the packed mesh. Merged trees and masks use it, too.
enum KeptMesh {
    Packing(tree_builds::Build<Result<PackedMesh, GeometryError>>),
    Packed(Arc<PackedMesh>),
    /// Ray tracing is disabled for it (`Mesh::enable_raytracing`), or it isn't made of triangles.
    Unseen,
}

/// Result of a look-up.
pub(super) enum Found {
    Packed(Arc<PackedMesh>),
    Unseen,
    /// To be retried in the next frame.
    Later,
    Nowhere,
}

/// Meshes that only exist in the render world.
#[derive(Resource, Default)]
pub struct RenderWorldMeshes(HashMap<AssetId<Mesh>, KeptMesh>);

impl RenderWorldMeshes {
    /// Packs and keeps a mesh.
    pub(super) fn keep(&mut self, id: AssetId<Mesh>, mesh: &Mesh) {
        let topology = mesh.primitive_topology();
        let kept = if !mesh.enable_raytracing {
            KeptMesh::Unseen
        } else if !topology.is_triangles() {
            // Bevy extracts it again with each change.
            if !matches!(self.0.get(&id), Some(KeptMesh::Unseen)) {
                tell_of(id, &GeometryError::NotTriangles(topology));
            }
            KeptMesh::Unseen
        } else {
            let mesh = mesh.clone();
            KeptMesh::Packing(tree_builds::spawn(async move {
                let mut packed = pack_mesh(&mesh)?;
                packed.words.shrink_to_fit();
                Ok(packed)
            }))
        };
        self.0.insert(id, kept);
    }

    /// Forgets a mesh.
    pub fn remove(&mut self, id: AssetId<Mesh>) {
        self.0.remove(&id);
    }

    /// Looks up a mesh. Warns once if rays can't hit it.
    pub(super) fn find(&mut self, id: AssetId<Mesh>) -> Found {
        let Some(kept) = self.0.get_mut(&id) else {
            return Found::Nowhere;
        };
        if let KeptMesh::Packing(task) = kept {
            if !task.is_finished() {
                return Found::Later;
            }
            match task.take() {
                None => *kept = KeptMesh::Unseen,
                Some(Ok(packed)) => *kept = KeptMesh::Packed(Arc::new(packed)),
                Some(Err(error)) => {
                    tell_of(id, &error);
                    *kept = KeptMesh::Unseen;
                }
            }
        }
        match kept {
            KeptMesh::Packed(packed) => Found::Packed(packed.clone()),
            _ => Found::Unseen,
        }
    }
}

fn tell_of(id: AssetId<Mesh>, error: &GeometryError) {
    warn!("mesh {id} is missing from reflections: {error}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::asset::RenderAssetUsages;
    use bevy::{asset::uuid::Uuid, prelude::*};

    const ID: AssetId<Mesh> = AssetId::Uuid {
        uuid: Uuid::from_u128(1),
    };

    fn wait(kept: &mut RenderWorldMeshes) -> Found {
        loop {
            match kept.find(ID) {
                Found::Later => std::thread::yield_now(),
                found => return found,
            }
        }
    }

    #[test]
    fn what_rays_need_is_kept_and_the_source_is_not() {
        let mut mesh = Sphere::new(1.0).mesh().uv(64, 32);
        mesh.generate_tangents().unwrap();
        let all = mesh.get_vertex_buffer_size() + mesh.get_index_buffer_bytes().unwrap().len();
        let mut kept = RenderWorldMeshes::default();
        kept.keep(ID, &mesh);
        let Found::Packed(packed) = wait(&mut kept) else {
            panic!("it can be hit");
        };
        let bytes = 4 * packed.words.capacity();
        assert!(bytes < all * 3 / 4, "{bytes} of {all} bytes are kept");
        assert_eq!(*packed, pack_mesh(&mesh).unwrap());
        // The source is dropped, so only the kept one and this one are left.
        assert_eq!(Arc::strong_count(&packed), 2);
        kept.remove(ID);
        assert_eq!(Arc::strong_count(&packed), 1);
        assert!(matches!(kept.find(ID), Found::Nowhere));
    }

    #[test]
    fn what_rays_do_not_see_is_not_kept() {
        let mut kept = RenderWorldMeshes::default();
        let mut unseen = Mesh::from(Cuboid::default());
        unseen.enable_raytracing = false;
        let mut points = Mesh::new(
            bevy::mesh::PrimitiveTopology::PointList,
            RenderAssetUsages::RENDER_WORLD,
        );
        points.insert_attribute(Mesh::ATTRIBUTE_POSITION, vec![[0.0; 3]]);
        for mesh in [unseen, points] {
            kept.keep(ID, &mesh);
            assert!(matches!(wait(&mut kept), Found::Unseen));
            assert!(matches!(kept.0.get(&ID), Some(KeptMesh::Unseen)));
        }
    }
}
