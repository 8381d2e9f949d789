//! Objects in impossible places, and from none to very many.

use super::Builder;
use bevy::{camera::visibility::RenderLayers, prelude::*};
use bevy_glint::NotReflected;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Materials of a crowd of objects.
const GROUPS: u32 = 4;

/// Placements and numbers of objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum PlacementKind {
    /// A scale of 0.
    ZeroScale,
    /// A scale of 0 along one axis.
    FlatScale,
    /// A scale along one axis with an inverse that overflows.
    NearlyFlatScale,
    /// A scale of 1e-4.
    TinyScale,
    /// A scale of 1e6.
    HugeScale,
    /// A scale of 1e30.
    OverflowingScale,
    /// A negative scale along one axis.
    MirroredScale,
    /// A scale that is NaN along one axis.
    NanScale,
    /// An infinite scale along one axis.
    InfiniteScale,
    /// A position that is NaN.
    NanTranslation,
    /// An infinite position.
    InfiniteTranslation,
    /// A rotation that is NaN.
    NanRotation,
    /// A quaternion of zeros.
    ZeroRotation,
    /// A quaternion that is not normalised.
    LongRotation,
    /// Shear, by a parent's scale.
    Sheared,
    /// A position 1e6 metres away.
    FarAway,
    /// Many objects in exactly one place.
    Stacked,
    /// A long chain of parents.
    DeepHierarchy,
    /// Hidden objects, objects of other layers, objects excluded from reflections.
    Unseen,
    /// An object around the camera.
    AroundTheCamera,
    /// No object at all.
    Nothing,
    /// A single object.
    Single,
    /// A thousand objects.
    Thousand,
    /// A hundred thousand objects.
    HundredThousand,
}

/// Adds objects in such places.
pub fn add(kind: PlacementKind, builder: &mut Builder) {
    let spot = builder.spot();
    let axis = builder.random.below(3);
    let along = |value: f32| {
        let mut scale = Vec3::ONE;
        scale[axis] = value;
        scale
    };
    let placed = match kind {
        PlacementKind::ZeroScale => spot.with_scale(Vec3::ZERO),
        PlacementKind::FlatScale => spot.with_scale(along(0.0)),
        PlacementKind::NearlyFlatScale => spot.with_scale(along(1e-37)),
        PlacementKind::TinyScale => spot.with_scale(Vec3::splat(1e-4)),
        PlacementKind::HugeScale => spot.with_scale(Vec3::splat(1e6)),
        PlacementKind::OverflowingScale => spot.with_scale(Vec3::splat(1e30)),
        PlacementKind::MirroredScale => spot.with_scale(along(-1.0)),
        PlacementKind::NanScale => spot.with_scale(along(f32::NAN)),
        PlacementKind::InfiniteScale => spot.with_scale(along(f32::INFINITY)),
        PlacementKind::NanTranslation => spot.with_translation(Vec3::splat(f32::NAN)),
        PlacementKind::InfiniteTranslation => spot.with_translation(Vec3::new(f32::INFINITY, 0.0, -f32::INFINITY)),
        PlacementKind::NanRotation => spot.with_rotation(Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0)),
        PlacementKind::ZeroRotation => spot.with_rotation(Quat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        PlacementKind::LongRotation => spot.with_rotation(Quat::from_xyzw(30.0, -4.0, 7.0, 11.0)),
        PlacementKind::FarAway => spot.with_translation(Vec3::new(1e6, -2e5, 1e6)),
        PlacementKind::AroundTheCamera => {
            let eye = builder.camera.transform.translation;
            Transform::from_translation(eye).with_scale(Vec3::splat(8.0))
        }
        PlacementKind::Sheared => return sheared(builder, spot),
        PlacementKind::Stacked => return (0..24).for_each(|_| _ = builder.cube(0.5, spot)),
        PlacementKind::DeepHierarchy => return deep(builder, spot),
        PlacementKind::Unseen => return unseen(builder, spot),
        PlacementKind::Nothing => return nothing(builder),
        PlacementKind::Single => {
            nothing(builder);
            spot
        }
        PlacementKind::Thousand => return crowd(builder, 10),
        PlacementKind::HundredThousand => return crowd(builder, 47),
    };
    builder.cube(0.5, placed);
}

fn sheared(builder: &mut Builder, spot: Transform) {
    let parent = builder.add((spot.with_scale(Vec3::new(3.0, 0.1, -1.0)), Visibility::default()));
    let child = builder.cube(0.5, Transform::from_rotation(Quat::from_rotation_z(0.9)));
    builder.world().entity_mut(child).insert(ChildOf(parent));
}

fn deep(builder: &mut Builder, spot: Transform) {
    let mut parent = builder.add((spot, Visibility::default()));
    for _ in 0..64 {
        let step = Transform::from_xyz(0.01, 0.0, 0.0).with_scale(Vec3::splat(0.98));
        parent = builder
            .world()
            .spawn((step, Visibility::default(), ChildOf(parent)))
            .id();
    }
    let child = builder.cube(0.8, Transform::IDENTITY);
    builder.world().entity_mut(child).insert(ChildOf(parent));
}

fn unseen(builder: &mut Builder, spot: Transform) {
    let [hidden, elsewhere, out] = [(); 3].map(|()| builder.cube(0.5, spot));
    let world = builder.world();
    world.entity_mut(hidden).insert(Visibility::Hidden);
    world.entity_mut(elsewhere).insert(RenderLayers::layer(7));
    world.entity_mut(out).insert(NotReflected);
}

/// Removes the ordinary objects, too.
fn nothing(builder: &mut Builder) {
    let root = builder.root;
    let world = builder.world();
    let mut objects = world.query_filtered::<(Entity, &ChildOf), With<Mesh3d>>();
    let ours: Vec<Entity> = objects
        .iter(world)
        .filter(|(_, parent)| parent.parent() == root)
        .map(|(entity, _)| entity)
        .collect();
    for entity in ours {
        world.despawn(entity);
    }
    builder.objects.clear();
}

/// Adds a block of objects with this many along each side.
fn crowd(builder: &mut Builder, side: u32) {
    let corner = builder.spot().translation - 0.5;
    let length = 0.8 / side as f32;
    for group in 0..GROUPS {
        let material = builder.plain();
        let position = |index: u32| {
            let cell = UVec3::new(index % side, index / side % side, index / side / side);
            Transform::from_translation(corner + cell.as_vec3() / side as f32)
        };
        let positions = (group..side.pow(3)).step_by(GROUPS as usize).map(position);
        let (root, mesh) = (builder.root, Cuboid::from_length(length));
        builder.harness.spawn_objects(root, mesh, material, positions);
    }
}
