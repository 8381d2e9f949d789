//! Joints, morph weights, and objects with vertices that the app's shader moves, of the main world.

use super::vertex_shader::{Inputs, Motion, VertexShader};
use crate::{
    scene::{acceleration::rows, instances::SceneInstances, meshes::SceneMeshes},
    settings::{RayTracedReflections, ReflectedMesh3d, ReflectedPose, ReflectedPoseBudget, ReflectedVertices},
};
use bevy::{
    asset::Assets,
    camera::Camera,
    ecs::{entity::EntityHashSet, prelude::*, system::SystemParam},
    log::warn_once,
    math::{Affine3A, Mat4, Vec3},
    mesh::{
        Mesh3d,
        morph::{MeshMorphWeights, MorphWeights},
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    transform::components::GlobalTransform,
};
use core::ops::Range;

/// Matrix entries beyond this count as not finite: products of three of them still fit an `f32`.
const MAX_ENTRY: f32 = 1e12;

/// Rows of a 3x4 matrix.
pub type Rows = [[f32; 4]; 3];

/// The pose of one object.
pub struct PoseSource {
    /// The object in [`SceneInstances`].
    pub slot: u32,
    /// Its entity.
    pub entity: Entity,
    /// Range in [`ExtractedPoses::matrices`]: from bind pose to the object's own space, by joint. Empty without a skin.
    pub matrices: Range<usize>,
    /// Range in [`ExtractedPoses::weights`], by morph target. Empty without morph targets.
    pub weights: Range<usize>,
    /// For the app's shader.
    pub(super) motion: Option<Motion>,
    /// The pose is unknown in this frame, so the last one stays.
    pub is_unknown: bool,
    /// World space.
    pub position: Vec3,
}

/// Poses of all posed objects in this frame.
#[derive(Resource, Default)]
pub struct ExtractedPoses {
    /// The objects.
    pub sources: Vec<PoseSource>,
    /// Matrices of all of them.
    pub matrices: Vec<Rows>,
    /// Weights of all of them.
    pub weights: Vec<f32>,
    /// What the app's shader depends on; `None` without one.
    pub(super) inputs: Option<Inputs>,
    /// World-space positions of active cameras with reflections; empty if there are no poses.
    pub cameras: Vec<Vec3>,
    /// [`ReflectedPoseBudget::vertices_per_frame`].
    pub vertices_per_frame: u32,
    /// Entities placed by their joints.
    placed: EntityHashSet,
}

/// Components of an entity with a pose.
type PoseQuery = (
    Entity,
    &'static Mesh3d,
    Option<&'static SkinnedMesh>,
    Option<&'static MeshMorphWeights>,
    Option<&'static ReflectedPose>,
    Option<&'static ReflectedVertices>,
    &'static GlobalTransform,
);
/// Entities with a pose; other archetypes are skipped. A stand-in has none.
type WithPose = (
    Without<ReflectedMesh3d>,
    Or<(With<SkinnedMesh>, With<MeshMorphWeights>)>,
);

/// Entities that the app's shader moves without a pose. Stand-ins for posed meshes are among them.
type WithoutPose = Or<(With<ReflectedMesh3d>, (Without<SkinnedMesh>, Without<MeshMorphWeights>))>;
/// Their components.
type MovedQuery = (
    Entity,
    &'static ReflectedVertices,
    Option<&'static ReflectedPose>,
    &'static GlobalTransform,
);

/// Parts of the main world that poses depend on.
#[derive(SystemParam)]
pub struct PoseWorld<'w, 's> {
    posed: Query<'w, 's, PoseQuery, WithPose>,
    moved: Query<'w, 's, MovedQuery, WithoutPose>,
    joints: Query<'w, 's, &'static GlobalTransform>,
    weights: Query<'w, 's, &'static MorphWeights>,
    bindposes: Option<Res<'w, Assets<SkinnedMeshInverseBindposes>>>,
    cameras: Query<'w, 's, (&'static Camera, &'static GlobalTransform), With<RayTracedReflections>>,
    budget: Option<Res<'w, ReflectedPoseBudget>>,
}

/// Places skinned objects at their joints, and extracts poses. Runs after all objects have been extracted.
pub fn extract_poses(
    world: &PoseWorld,
    active: bool,
    shader: Option<&VertexShader>,
    meshes: &mut SceneMeshes,
    instances: &mut SceneInstances,
    poses: &mut ExtractedPoses,
) {
    let ExtractedPoses {
        sources,
        matrices,
        weights,
        inputs,
        cameras,
        vertices_per_frame,
        placed,
    } = poses;
    let placed_before = core::mem::take(placed);
    sources.clear();
    matrices.clear();
    weights.clear();
    cameras.clear();
    if !active {
        return;
    }
    inputs.clone_from(&shader.and_then(VertexShader::inputs).cloned());
    let is_wanted = shader.is_some_and(VertexShader::is_wanted);
    for (entity, mesh, skin, morph, pose, vertices, transform) in &world.posed {
        let Some((slot, source)) = instances.find(entity) else {
            continue;
        };
        let last_place = source.world_from_object;
        let is_rigid = pose == Some(&ReflectedPose::Rigid);
        let (first_matrix, first_weight) = (matrices.len(), weights.len());
        let mut is_unknown = false;
        let mut place = transform.affine();
        // Bevy draws a mesh without joints as if the entity had no skin.
        let has_joints = || meshes.get(mesh.id()).is_none_or(|mesh| mesh.offsets.joints != 0);
        if let Some(skin) = skin.filter(|_| has_joints()) {
            match world.pose(skin, is_rigid, matrices) {
                Some(root) => {
                    place = root;
                    placed.insert(entity);
                }
                None => {
                    is_unknown = true;
                    if placed_before.contains(&entity) {
                        place = last_place;
                        placed.insert(entity);
                    }
                    matrices.truncate(first_matrix);
                    warn_once!(
                        "the skinned mesh {entity} is reflected without its pose: its inverse bind poses are missing, or one of its \
                         joints is, or has a transform that isn't finite"
                    );
                }
            }
        }
        instances.place(slot, place);
        if is_rigid {
            continue;
        }
        if let Some(morph) = morph {
            weights.extend(world.morph_weights(morph));
        }
        let motion = vertices
            .filter(|_| is_wanted)
            .and_then(|vertices| Motion::new(place, vertices));
        if motion.is_some() {
            meshes.make_posable(mesh.id());
        }
        sources.push(PoseSource {
            slot,
            entity,
            matrices: first_matrix..matrices.len(),
            weights: first_weight..weights.len(),
            motion,
            is_unknown,
            position: place.translation.into(),
        });
    }
    if is_wanted {
        sources.extend(world.moved(meshes, instances));
    }
    if !sources.is_empty() {
        let active = world.cameras.iter().filter(|(camera, _)| camera.is_active);
        cameras.extend(active.map(|(_, transform)| transform.translation()));
        *vertices_per_frame = world.budget.as_deref().copied().unwrap_or_default().vertices_per_frame;
    }
}

impl PoseWorld<'_, '_> {
    /// Objects that the app's shader moves without a pose. Requests meshes that can be posed.
    fn moved(&self, meshes: &mut SceneMeshes, instances: &SceneInstances) -> impl Iterator<Item = PoseSource> {
        self.moved.iter().filter_map(|(entity, vertices, pose, transform)| {
            let (slot, object) = instances.find(entity)?;
            if pose == Some(&ReflectedPose::Rigid) {
                return None;
            }
            meshes.make_posable(object.mesh);
            let place = transform.affine();
            Some(PoseSource {
                slot,
                entity,
                matrices: 0..0,
                weights: 0..0,
                motion: Motion::new(place, vertices),
                is_unknown: false,
                position: place.translation.into(),
            })
        })
    }

    /// Appends the matrices of a skin, unless it is rigid, and returns their target space: that of the first joint. Returns `None` if
    /// they are unknown; some might have been appended already.
    fn pose(&self, skin: &SkinnedMesh, is_rigid: bool, matrices: &mut Vec<Rows>) -> Option<Affine3A> {
        let bindposes = self.bindposes.as_ref()?.get(&skin.inverse_bindposes)?;
        let matrix = |joint: Entity, bindpose: &Mat4| {
            let matrix = self.joints.get(joint).ok()?.affine() * Affine3A::from_mat4(*bindpose);
            is_sound(&matrix).then_some(matrix)
        };
        let root = matrix(*skin.joints.first()?, bindposes.first()?)?;
        if is_rigid {
            return Some(root);
        }
        let (place, place_from_world) = place_of(root);
        for (index, joint) in skin.joints.iter().enumerate() {
            let matrix = place_from_world * matrix(*joint, bindposes.get(index)?)?;
            matrices.push(bytemuck::cast(rows(&is_sound(&matrix).then_some(matrix)?)));
        }
        Some(place)
    }

    fn morph_weights<'a>(&'a self, morph: &'a MeshMorphWeights) -> impl Iterator<Item = f32> {
        let weights = match morph {
            MeshMorphWeights::Value { weights } => weights,
            MeshMorphWeights::Reference(entity) => self.weights.get(*entity).map_or(&[][..], MorphWeights::weights),
        };
        let is_sound = |weight: f32| weight.abs() <= MAX_ENTRY;
        weights
            .iter()
            .map(move |weight| if is_sound(*weight) { *weight } else { 0.0 })
    }
}

fn is_sound(matrix: &Affine3A) -> bool {
    let columns = [matrix.matrix3.x_axis, matrix.matrix3.y_axis, matrix.matrix3.z_axis];
    let mut columns = columns.into_iter().chain([matrix.translation]);
    columns.all(|column| column.is_finite() && column.abs().max_element() <= MAX_ENTRY)
}

/// The space in which an object is posed, and its inverse. It is the space of the first joint, so that a figure that moves as a whole
/// keeps its pose. If the joint's matrix is singular, the space is only translated to it.
fn place_of(root: Affine3A) -> (Affine3A, Affine3A) {
    let inverse: Affine3A = root.inverse();
    if root.matrix3.determinant() != 0.0 && is_sound(&inverse) {
        (root, inverse)
    } else {
        let translation = Vec3::from(root.translation);
        (
            Affine3A::from_translation(translation),
            Affine3A::from_translation(-translation),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_root_leaves_its_place() {
        let root = Affine3A::from_scale_rotation_translation(Vec3::new(1.0, 0.0, 1.0), Default::default(), Vec3::X);
        let (place, inverse) = place_of(root);
        assert_eq!(place, Affine3A::from_translation(Vec3::X));
        assert_eq!(place * inverse, Affine3A::IDENTITY);
        let root = Affine3A::from_scale(Vec3::splat(2.0));
        assert_eq!(place_of(root).0, root);
    }

    #[test]
    fn matrices_beyond_all_bounds_are_refused() {
        assert!(is_sound(&Affine3A::IDENTITY));
        for bad in [f32::NAN, f32::INFINITY, -1e13] {
            assert!(!is_sound(&Affine3A::from_scale(Vec3::new(1.0, bad, 1.0))));
            assert!(!is_sound(&Affine3A::from_translation(Vec3::new(1.0, 1.0, bad))));
        }
    }
}
