//! Order in which meshes become visible: changed ones, then by distance, then by age.

use crate::{
    scene::instances::SceneInstances,
    settings::{RayTracedReflections, ReflectionUploadBudget},
};
use bevy::{
    asset::AssetId,
    camera::Camera,
    ecs::{prelude::*, system::SystemParam},
    math::Vec3A,
    mesh::Mesh,
    transform::components::GlobalTransform,
};

/// Maximum number of objects of a mesh whose distance is computed. A higher number finds the nearest of many more often, and takes longer.
const MOST_LOOKED_AT: usize = 16;
/// Limit on bytes of copies that haven't been uploaded, since builds take longer than copies.
const MOST_COPIED_BYTES: u64 = 64 << 20;

/// The priority of a waiting mesh; lower ones come first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Rank {
    /// Bits of the squared distance to the nearest camera, which sort like the distance.
    distance: u32,
    /// Grows with each mesh.
    order: u64,
}

impl Rank {
    /// A rank after all meshes that are near.
    pub fn far(order: u64) -> Self {
        Self {
            distance: u32::MAX,
            order,
        }
    }

    /// The rank of a mesh by its objects.
    pub fn of(id: AssetId<Mesh>, order: u64, instances: &SceneInstances, viewers: &[Vec3A]) -> Self {
        let slots = instances.slots_of_mesh(id).take(MOST_LOOKED_AT);
        let places = slots.filter_map(|slot| Some(instances.get(slot)?.world_from_object.translation));
        let distances = places.flat_map(|place| viewers.iter().map(move |viewer| place.distance_squared(*viewer)));
        let distance = distances.map(f32::to_bits).min();
        Self {
            distance: distance.unwrap_or(u32::MAX),
            order,
        }
    }
}

/// Reflecting cameras, and how fast meshes may be uploaded.
#[derive(SystemParam)]
pub struct ArrivalWorld<'w, 's> {
    cameras: Query<'w, 's, (&'static Camera, &'static GlobalTransform), With<RayTracedReflections>>,
    budget: Option<Res<'w, ReflectionUploadBudget>>,
}

impl ArrivalWorld<'_, '_> {
    /// Positions of active cameras with reflections.
    pub(super) fn viewers(&self) -> Vec<Vec3A> {
        let active = self.cameras.iter().filter(|(camera, _)| camera.is_active);
        active.map(|(_, place)| place.translation_vec3a()).collect()
    }

    /// Bytes per frame.
    pub(super) fn bytes(&self) -> u64 {
        self.budget.as_deref().copied().unwrap_or_default().bytes()
    }
}

/// Number of bytes that can still be copied in a frame.
pub(super) struct CopyBudget(u64);

impl CopyBudget {
    /// The budget of a frame of this number of bytes, while `waiting` bytes that were copied before aren't uploaded.
    pub fn new(bytes: u64, waiting: u64) -> Self {
        Self(bytes.min(MOST_COPIED_BYTES.max(bytes).saturating_sub(waiting)))
    }

    /// Takes this number of bytes. Returns false if nothing is left. The last copy can exceed the budget.
    pub fn take(&mut self, bytes: u64) -> bool {
        let is_left = self.0 > 0;
        self.0 = self.0.saturating_sub(bytes);
        is_left
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::instances::InstanceSource;
    use bevy::math::{Affine3A, Vec3};

    #[test]
    fn a_frame_copies_one_mesh_and_others_while_bytes_are_left() {
        let mut budget = CopyBudget(10);
        assert_eq!([6, 6, 1].map(|bytes| budget.take(bytes)), [true, true, false]);
        const BYTES: u64 = 2 << 20;
        assert!(CopyBudget::new(BYTES, 0).take(u64::MAX));
        assert_eq!(CopyBudget::new(BYTES, MOST_COPIED_BYTES - 1).0, 1, "builds lag behind");
        assert!(!CopyBudget::new(BYTES, MOST_COPIED_BYTES + 1).take(1));
        assert_eq!(CopyBudget::new(BYTES, 1).0, BYTES);
        assert_eq!(
            CopyBudget::new(u64::MAX, MOST_COPIED_BYTES).0,
            u64::MAX - MOST_COPIED_BYTES
        );
        assert_eq!(ReflectionUploadBudget { bytes_per_frame: 0 }.bytes(), 64 << 10);
    }

    #[test]
    fn the_nearest_object_ranks_a_mesh() {
        let mut world = World::new();
        let mut instances = SceneInstances::default();
        let mesh = AssetId::default();
        for x in [50.0, -8.0, 20.0] {
            instances.set(InstanceSource {
                mesh,
                world_from_object: Affine3A::from_translation(Vec3::X * x),
                ..InstanceSource::plain(world.spawn_empty().id())
            });
        }
        let rank = |viewers: &[Vec3A]| Rank::of(mesh, 7, &instances, viewers);
        let near = Rank {
            distance: 9_f32.to_bits(),
            order: 7,
        };
        assert_eq!(rank(&[Vec3A::X * 100.0, Vec3A::X * 23.0]), near);
        assert_eq!(rank(&[]), Rank::far(7));
        assert!(rank(&[Vec3A::ZERO]) > near && rank(&[Vec3A::ZERO]) < Rank::far(0));
        assert!(rank(&[Vec3A::NAN]) > rank(&[Vec3A::ZERO]));
    }
}
