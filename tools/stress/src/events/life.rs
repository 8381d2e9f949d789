//! Assets, levels and crowds that come, change and go.

use crate::{
    generators::{EventKind, HostileScene, plain_image},
    harness::Harness,
};
use bevy::{
    asset::RenderAssetUsages,
    ecs::entity_disabling::Disabled,
    mesh::{
        VertexAttributeValues,
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    prelude::*,
    render::render_resource::TextureFormat,
};

/// Objects of a level. Each has its own mesh, material and image.
const OBJECTS_OF_A_LEVEL: u32 = 12;
/// Characters of a crowd.
const CROWD: usize = 6;
/// Number of frames for which a crowd moves, and then doesn't, by turns.
const STRIDE: u32 = 3;

/// Applies an event to each object before a frame.
pub(super) fn change_assets(kind: EventKind, harness: &mut Harness, scene: &mut HostileScene, frame: u32) {
    for (index, &entity) in scene.objects.iter().enumerate() {
        let size = scene.random.range(0.1, 0.7);
        let world = harness.world();
        let Ok(object) = world.get_entity(entity) else {
            continue;
        };
        let mesh = object.get::<Mesh3d>().map(|mesh| mesh.id());
        let material = object
            .get()
            .map(|MeshMaterial3d::<StandardMaterial>(material)| material.id());
        let odd = (frame as usize + index) % 2 == 1;
        match kind {
            EventKind::ReplaceMeshes => replace_mesh(world, mesh, size, RenderAssetUsages::default()),
            EventKind::ChangeUsage => {
                let usage = if odd {
                    RenderAssetUsages::RENDER_WORLD
                } else {
                    RenderAssetUsages::default()
                };
                replace_mesh(world, mesh, size, usage);
            }
            EventKind::ReloadImages => {
                let edge = 1 << (frame % 4);
                let image = scene.images.get(index).cloned();
                reload_image(world, image, edge, &mut scene.images, material);
            }
            EventKind::FailedImage => {
                let missing = world
                    .resource::<AssetServer>()
                    .load(format!("no/such/image-{index}.png"));
                set_texture(world, material, odd.then_some(missing));
            }
            _ if odd => drop(world.entity_mut(entity).insert(Disabled)),
            _ => drop(world.entity_mut(entity).remove::<Disabled>()),
        }
    }
}

/// Removes a mesh and inserts another under its id.
fn replace_mesh(world: &mut World, id: Option<AssetId<Mesh>>, size: f32, usage: RenderAssetUsages) {
    let Some(id) = id else { return };
    let mut mesh = Mesh::from(Cuboid::from_length(size));
    mesh.asset_usage = usage;
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    meshes.remove(id);
    // Fails if the id is no longer in use.
    _ = meshes.insert(id, mesh);
}

/// Gives an object an image of another size, with its old id if it had one.
fn reload_image(
    world: &mut World,
    image: Option<Handle<Image>>,
    edge: u32,
    all: &mut Vec<Handle<Image>>,
    material: Option<AssetId<StandardMaterial>>,
) {
    let mut images = world.resource_mut::<Assets<Image>>();
    match image {
        Some(image) => _ = images.insert(&image, square_image(edge)),
        None => {
            let image = images.add(square_image(edge));
            all.push(image.clone());
            set_texture(world, material, Some(image));
        }
    }
}

fn square_image(edge: u32) -> Image {
    plain_image(UVec2::splat(edge), &[200, 90, 30, 128], TextureFormat::Rgba8UnormSrgb)
}

fn set_texture(world: &mut World, material: Option<AssetId<StandardMaterial>>, image: Option<Handle<Image>>) {
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    if let Some(mut material) = material.and_then(|material| materials.get_mut(material)) {
        material.base_color_texture = image;
        material.alpha_mode = AlphaMode::Mask(0.4);
    }
}

/// Loads a level in one frame, and unloads it in the next one.
pub(super) fn load_level(harness: &mut Harness, scene: &mut HostileScene) {
    if !scene.level.is_empty() || harness.world().get_entity(scene.root).is_err() {
        return harness.despawn(scene.level.drain(..));
    }
    for index in 0..OBJECTS_OF_A_LEVEL {
        let image = harness
            .world()
            .resource_mut::<Assets<Image>>()
            .add(square_image(1 + index));
        let material = StandardMaterial {
            base_color_texture: Some(image),
            alpha_mode: AlphaMode::Mask(0.5),
            ..default()
        };
        let place = Transform::from_xyz(scene.random.range(-1.4, 1.4), 0.2 * index as f32, 4.5);
        let ball = Sphere::new(0.1 + 0.01 * index as f32).mesh().uv(8 + index, 6);
        scene
            .level
            .extend(harness.spawn_objects(scene.root, ball, material, [place]));
    }
}

/// Spawns a crowd of characters at first, which bends for some frames and doesn't move for others.
pub(super) fn move_crowd(harness: &mut Harness, scene: &mut HostileScene, frame: u32) {
    if harness.world().get_entity(scene.root).is_err() {
        return;
    }
    if scene.joints.is_empty() {
        for index in 0..CROWD {
            let joint = spawn_character(harness, scene.root, index);
            scene.joints.push(joint);
        }
    }
    let moves = (frame / STRIDE).is_multiple_of(2);
    for joint in scene.joints.iter().filter(|_| moves) {
        if let Some(mut transform) = harness.world().get_mut::<Transform>(*joint) {
            transform.rotate_z(0.2);
        }
    }
}

/// Spawns a box with its upper half bound to a joint, and returns the joint.
fn spawn_character(harness: &mut Harness, root: Entity, index: usize) -> Entity {
    let mut mesh = Mesh::from(Cuboid::new(0.2, 0.8, 0.2));
    let upper = match mesh.attribute(Mesh::ATTRIBUTE_POSITION) {
        Some(VertexAttributeValues::Float32x3(positions)) => {
            positions.iter().map(|position| u16::from(position[1] > 0.0)).collect()
        }
        _ => Vec::new(),
    };
    let joints = upper.iter().map(|upper| [*upper, 0, 0, 0]).collect();
    mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, VertexAttributeValues::Uint16x4(joints));
    mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, vec![[1.0, 0.0, 0.0, 0.0]; upper.len()]);
    let place = Transform::from_xyz(0.5 * index as f32 - 1.2, 0.5, 4.4);
    let object = harness.spawn_objects(root, mesh, StandardMaterial::default(), [place])[0];
    let world = harness.world();
    let lower = world.spawn((place, ChildOf(root))).id();
    let upper = world.spawn((Transform::default(), ChildOf(lower))).id();
    let inverse_bindposes = world
        .resource_mut::<Assets<SkinnedMeshInverseBindposes>>()
        .add(SkinnedMeshInverseBindposes::from(vec![Mat4::IDENTITY; 2]));
    world.entity_mut(object).insert(SkinnedMesh {
        inverse_bindposes,
        joints: vec![lower, upper],
    });
    upper
}
