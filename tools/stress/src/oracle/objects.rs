//! The objects that rays should hit, from the entities, meshes and materials of the app.

use super::exact::{Object, Objects};
use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    light::NotShadowCaster,
    math::DVec3,
    mesh::{PrimitiveTopology, VertexAttributeValues, morph::MeshMorphWeights, skinning::SkinnedMesh},
    prelude::*,
};
use bevy_glint::{NotReflected, ReflectedMaterial3d, ReflectedMesh3d};

/// Objects beyond these coordinates, or as finely scaled, are lost in single precision.
const MOST: f32 = 1e12;
/// The same for objects that a matrix distorts by so much.
const MOST_DISTORTED: f64 = 1e5;

/// Entities with a mesh that reflections may show.
type Candidates<'a> = (
    Entity,
    &'a Mesh3d,
    &'a MeshMaterial3d<StandardMaterial>,
    &'a GlobalTransform,
    &'a InheritedVisibility,
    Has<NotShadowCaster>,
);

/// Components that put an object where its mesh and its transform don't tell.
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
            objects.unknown.push(entity);
            continue;
        };
        // They add to what lies behind them, or multiply it: rays don't see them.
        if matches!(material.alpha_mode, AlphaMode::Add | AlphaMode::Multiply) {
            continue;
        }
        let place = transform.affine();
        if !place.is_finite() {
            continue;
        }
        let is_far = place.translation.abs().max_element() > MOST;
        let object = triangles(mesh).filter(|_| !is_far).and_then(|triangles| {
            let object = Object::new(entity, &place, triangles)?;
            let reach = MOST * f32::EPSILON * f32::EPSILON;
            let is_tiny = place.matrix3.determinant().abs() < reach.powi(3);
            (object.condition() < MOST_DISTORTED && !is_tiny && object.reach() < MOST.into()).then_some(object)
        });
        match object {
            Some(mut object) => {
                object.see_through = material.alpha_mode != AlphaMode::Opaque || material.specular_transmission != 0.0;
                (object.culled, object.casts_shadow) = (material.cull_mode, !no_shadow);
                objects.known.push(object);
            }
            None => objects.unknown.push(entity),
        }
    }
    objects
}

/// Triangles of a mesh whose corners exist and are finite. `None` where the vertices can't be read, or are not those of a list.
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
