//! Objects in impossible places, and from none to very many.

use super::Builder;
use bevy::{camera::visibility::RenderLayers, prelude::*};
use bevy_glint::NotReflected;

/// Materials of a crowd of objects.
const GROUPS: u32 = 4;

kinds! {
    /// Placements and numbers of objects. Most are a cube in an odd place.
    PlacementKind, fn place(builder: &mut Builder, spot: Transform, axis: usize) {
        ZeroScale => cube(builder, spot.with_scale(Vec3::ZERO)),
        FlatScale => cube(builder, scaled_along(axis, spot, 0.0)),
        // The inverse overflows.
        NearlyFlatScale => cube(builder, scaled_along(axis, spot, 1e-37)),
        TinyScale => cube(builder, spot.with_scale(Vec3::splat(1e-4))),
        HugeScale => cube(builder, spot.with_scale(Vec3::splat(1e6))),
        OverflowingScale => cube(builder, spot.with_scale(Vec3::splat(1e30))),
        MirroredScale => cube(builder, scaled_along(axis, spot, -1.0)),
        NanScale => cube(builder, scaled_along(axis, spot, f32::NAN)),
        InfiniteScale => cube(builder, scaled_along(axis, spot, f32::INFINITY)),
        NanTranslation => cube(builder, spot.with_translation(Vec3::NAN)),
        InfiniteTranslation => cube(builder, spot.with_translation(Vec3::new(f32::INFINITY, 0.0, -f32::INFINITY))),
        NanRotation => cube(builder, spot.with_rotation(Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0))),
        ZeroRotation => cube(builder, spot.with_rotation(Quat::from_xyzw(0.0, 0.0, 0.0, 0.0))),
        LongRotation => cube(builder, spot.with_rotation(Quat::from_xyzw(30.0, -4.0, 7.0, 11.0))),
        Sheared => sheared(builder, spot),
        FarAway => cube(builder, spot.with_translation(Vec3::new(1e6, -2e5, 1e6))),
        // Many objects in exactly one place.
        Stacked => (0..24).for_each(|_| cube(builder, spot)),
        DeepHierarchy => deep(builder, spot),
        Unseen => unseen(builder, spot),
        AroundTheCamera => around_the_camera(builder),
        Nothing => nothing(builder),
        Single => { nothing(builder); cube(builder, spot); },
        Thousand => crowd(builder, 10),
        HundredThousand => crowd(builder, 47),
    }
}

pub fn add(kind: PlacementKind, builder: &mut Builder) {
    let spot = builder.spot();
    let axis = builder.scene.random.below(3);
    place(kind, builder, spot, axis);
}

fn cube(builder: &mut Builder, place: Transform) {
    builder.cube(0.5, place);
}

fn scaled_along(axis: usize, mut place: Transform, scale: f32) -> Transform {
    place.scale[axis] = scale;
    place
}

fn around_the_camera(builder: &mut Builder) {
    let eye = builder.scene.camera.transform.translation;
    cube(builder, Transform::from_translation(eye).with_scale(Vec3::splat(8.0)));
}

/// By a parent's scale.
fn sheared(builder: &mut Builder, spot: Transform) {
    let parent = builder.add((spot.with_scale(Vec3::new(3.0, 0.1, -1.0)), Visibility::default()));
    let child = builder.cube(0.5, Transform::from_rotation(Quat::from_rotation_z(0.9)));
    builder.world().entity_mut(child).insert(ChildOf(parent));
}

/// A long chain of parents.
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

/// Hidden, in other layers, and excluded from reflections.
fn unseen(builder: &mut Builder, spot: Transform) {
    let [hidden, elsewhere, out] = [(); 3].map(|()| builder.cube(0.5, spot));
    let world = builder.world();
    world.entity_mut(hidden).insert(Visibility::Hidden);
    world.entity_mut(elsewhere).insert(RenderLayers::layer(7));
    world.entity_mut(out).insert(NotReflected);
}

/// Removes the ordinary objects, too.
fn nothing(builder: &mut Builder) {
    let root = builder.scene.root;
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
    builder.scene.objects.clear();
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
        let (root, mesh) = (builder.scene.root, Cuboid::from_length(length));
        builder.harness.spawn_objects(root, mesh, material, positions);
    }
}
