//! The objects that rays should hit, from the entities, meshes and materials of the app.

use super::exact::{Object, Objects};
use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    light::NotShadowCaster,
    math::{Affine3A, DVec3},
    mesh::{PrimitiveTopology, VertexAttributeValues, morph::MeshMorphWeights, skinning::SkinnedMesh},
    prelude::*,
};
use bevy_glint::{NotReflected, ReflectedMaterial3d, ReflectedMesh3d};

/// Objects beyond these coordinates are lost in single precision.
const MOST: f32 = 1e12;
/// Maximum shrinking by a matrix, as the largest entry of its inverse. Rays don't see smaller objects.
const MOST_SHRUNK: f64 = 1e12;
/// Maximum distortion by a matrix.
const MOST_DISTORTED: f64 = 1e5;

/// Entities with a mesh that reflections can show.
type Candidates<'a> = (
    Entity,
    &'a Mesh3d,
    &'a MeshMaterial3d<StandardMaterial>,
    &'a GlobalTransform,
    &'a InheritedVisibility,
    Has<NotShadowCaster>,
);

/// Components that move an object away from the place of its mesh and its transform.
type IsElsewhere = Or<(
    With<RenderLayers>,
    With<VisibilityRange>,
    With<SkinnedMesh>,
    With<MeshMorphWeights>,
    With<ReflectedMesh3d>,
    With<ReflectedMaterial3d>,
)>;

/// Collects all objects of the app.
pub fn collect(world: &mut World) -> Objects {
    let mut elsewhere = world.query_filtered::<Entity, (With<Mesh3d>, IsElsewhere)>();
    let mut objects = Objects {
        unknown: elsewhere.iter(world).collect(),
        ..default()
    };
    let mut query = world.query_filtered::<Candidates, Without<NotReflected>>();
    let (meshes, materials) = (
        world.resource::<Assets<Mesh>>(),
        world.resource::<Assets<StandardMaterial>>(),
    );
    for (entity, mesh, material, transform, visibility, no_shadow) in query.iter(world) {
        if !visibility.get() || objects.unknown.contains(&entity) {
            continue;
        }
        let (Some(material), Some(mesh)) = (materials.get(material), meshes.get(mesh)) else {
            objects.unknown.insert(entity);
            continue;
        };
        // They add to the surfaces behind them, or multiply them: rays don't see them.
        if matches!(material.alpha_mode, AlphaMode::Add | AlphaMode::Multiply) {
            continue;
        }
        let place = transform.affine();
        if !place.is_finite() {
            continue;
        }
        match triangles(mesh).and_then(|triangles| object(entity, &place, triangles)) {
            Some(mut object) => {
                object.see_through = material.alpha_mode != AlphaMode::Opaque || material.specular_transmission != 0.0;
                (object.culled, object.casts_shadow) = (material.cull_mode, !no_shadow);
                objects.known.push(object);
            }
            None => {
                objects.unknown.insert(entity);
            }
        }
    }
    objects
}

/// The object at its place. `None` if single precision loses it.
fn object(entity: Entity, place: &Affine3A, triangles: Vec<[DVec3; 3]>) -> Option<Object> {
    let is_invertible = place.matrix3.determinant().is_normal() && place.translation.abs().max_element() <= MOST;
    let object = Object::new(entity, place, triangles).filter(|_| is_invertible)?;
    let is_kept = object.shrinking() <= MOST_SHRUNK && object.condition() < MOST_DISTORTED;
    (is_kept && object.reach() < MOST.into()).then_some(object)
}

/// Triangles of a mesh with existing and finite corners. `None` if the vertices can't be read, or don't form a list.
fn triangles(mesh: &Mesh) -> Option<Vec<[DVec3; 3]>> {
    if mesh.primitive_topology() != PrimitiveTopology::TriangleList {
        return None;
    }
    // Without vertices in the main world.
    let attributes = mesh.try_attributes().ok()?;
    let count = attributes.map(|(_, values)| values.len()).min().unwrap_or(0);
    let Ok(Some(VertexAttributeValues::Float32x3(positions))) = mesh.try_attribute_option(Mesh::ATTRIBUTE_POSITION)
    else {
        return None;
    };
    let corner = |index: usize| {
        let position = Vec3::from(*positions.get(index).filter(|_| index < count)?);
        (position.abs().max_element() <= MOST && position.is_finite()).then(|| position.as_dvec3())
    };
    let indices: Vec<usize> = match mesh.try_indices_option().ok()? {
        Some(indices) => indices.iter().collect(),
        None => (0..count).collect(),
    };
    let (whole, _) = indices.as_chunks::<3>();
    Some(
        whole
            .iter()
            .filter_map(|[a, b, c]| Some([corner(*a)?, corner(*b)?, corner(*c)?]))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_objects_are_known() {
        let is_known = |scale: Vec3| {
            let place = Transform::from_xyz(1.0, -2.0, 3.0).with_scale(scale).compute_affine();
            object(Entity::PLACEHOLDER, &place, vec![[DVec3::X, DVec3::Y, DVec3::Z]]).is_some()
        };
        for scale in [1.0, 1e-2, 1e-4, 1e-10, 1e10] {
            assert!(is_known(Vec3::splat(scale)), "{scale}");
        }
        for scale in [0.0, 1e-13, 1e13, f32::NAN] {
            assert!(!is_known(Vec3::splat(scale)), "{scale}");
        }
        assert!(is_known(Vec3::new(1e-3, 1.0, 10.0)) && !is_known(Vec3::new(1e-6, 1.0, 1.0)));
    }
}
