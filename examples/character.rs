//! A figure with bones walks in front of a mirror, which shows each step.
//!
//! No code here handles bones: the library follows the joints of every `SkinnedMesh`. The P key shows the figure in its bind pose in the
//! mirror, as `ReflectedPose::Rigid` does for crowds. The Space key stops and starts the clock.

use bevy::{
    asset::RenderAssetUsages,
    math::ops::{cos, sin},
    mesh::{
        Indices, PrimitiveTopology, VertexAttributeValues,
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    prelude::*,
};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectedPose};
use std::f32::consts::{PI, TAU};

/// The parent of each bone, and its start in bind pose. Bones point down, except for the hips, the spine and the head.
const BONES: [(usize, Vec3); 11] = [
    (0, Vec3::new(0.0, 0.8, 0.0)),    // Hips.
    (0, Vec3::new(0.0, 1.1, 0.0)),    // Spine.
    (1, Vec3::new(0.0, 1.5, 0.0)),    // Head.
    (1, Vec3::new(-0.27, 1.45, 0.0)), // Right upper arm.
    (3, Vec3::new(-0.27, 1.15, 0.0)), // Right forearm.
    (1, Vec3::new(0.27, 1.45, 0.0)),  // Left upper arm.
    (5, Vec3::new(0.27, 1.15, 0.0)),  // Left forearm.
    (0, Vec3::new(-0.12, 0.95, 0.0)), // Right thigh.
    (7, Vec3::new(-0.12, 0.5, 0.0)),  // Right shin.
    (0, Vec3::new(0.12, 0.95, 0.0)),  // Left thigh.
    (9, Vec3::new(0.12, 0.5, 0.0)),   // Left shin.
];
/// Two bones, the start of the first one, the length in metres along Y, and the radius: the second bone takes over halfway.
const LIMBS: [([u16; 2], f32, f32); 6] = [
    ([0, 1], 0.75, 0.2),     // Trunk.
    ([2, 2], 0.34, 0.12),    // Head.
    ([3, 4], -0.62, 0.07),   // Right arm.
    ([5, 6], -0.62, 0.07),   // Left arm.
    ([7, 8], -0.93, 0.095),  // Right leg.
    ([9, 10], -0.93, 0.095), // Left leg.
];

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (setup_room, setup_figure, show_keys))
        .add_systems(Update, (read_keys, walk));
}

fn read_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    mut time: ResMut<Time<Virtual>>,
    mut figures: Query<&mut ReflectedPose>,
) {
    if keyboard.just_pressed(KeyCode::Space) {
        time.toggle();
    }
    if keyboard.just_pressed(KeyCode::KeyP) {
        for mut pose in &mut figures {
            *pose = match *pose {
                ReflectedPose::Rigid => ReflectedPose::Posed,
                _ => ReflectedPose::Rigid,
            };
        }
    }
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "P: pose in the mirror, Space: stop or start the clock".to_owned();
}

/// Index in [`BONES`].
#[derive(Component)]
struct Bone(usize);

/// The figure walks in circles.
fn walk(time: Res<Time>, mut bones: Query<(&Bone, &mut Transform)>) {
    let (step, heading) = (5.0 * time.elapsed_secs() + 0.5, 0.4 * time.elapsed_secs());
    for (bone, mut transform) in &mut bones {
        let leg = if bone.0 >= 9 { step + PI } else { step };
        transform.rotation = match bone.0 {
            0 => {
                transform.translation = Vec3::new(cos(heading), 0.78 + 0.03 * cos(2.0 * step), sin(heading));
                Quat::from_rotation_y(-heading)
            }
            1 => Quat::from_euler(EulerRot::YXZ, 0.15 * sin(step), 0.05, 0.0), // Spine.
            3 => Quat::from_rotation_x(-0.6 * sin(step)),                      // Right upper arm.
            5 => Quat::from_rotation_x(0.6 * sin(step)),                       // Left upper arm.
            4 | 6 => Quat::from_rotation_x(-0.7),                              // Forearms.
            7 | 9 => Quat::from_rotation_x(0.6 * sin(leg)),                    // Thighs.
            8 | 10 => Quat::from_rotation_x(0.6 - 0.5 * cos(leg + 0.6)),       // Shins.
            _ => Quat::IDENTITY,
        };
    }
}

/// One mesh of all limbs, which are round at both ends, with two bones in each vertex.
fn figure() -> Mesh {
    /// Around a limb, and along it.
    const SIDES: u32 = 24;
    let (mut positions, mut joints, mut weights, mut indices) = (vec![], vec![], vec![], vec![]);
    for (bones, length, radius) in LIMBS {
        let begin = BONES[usize::from(bones[0])].1;
        for ring in 0..=SIDES {
            let along = ring as f32 / SIDES as f32;
            let width = radius * (1.0 - (2.0 * along - 1.0).abs().powi(5)).sqrt();
            let share = ((along - 0.5) * 6.0 + 0.5).clamp(0.0, 1.0);
            for side in 0..SIDES {
                let angle = TAU * side as f32 / SIDES as f32;
                let first = positions.len() as u32;
                positions.push((begin + Vec3::new(width * cos(angle), length * along, width * sin(angle))).to_array());
                joints.push([bones[0], bones[1], 0, 0]);
                weights.push([1.0 - share, share, 0.0, 0.0]);
                if ring < SIDES {
                    let next = first + 1 - SIDES * u32::from(side + 1 == SIDES);
                    let [a, b] = if length > 0.0 { [first, next] } else { [next, first] };
                    indices.extend([a, a + SIDES, b, b, a + SIDES, b + SIDES]);
                }
            }
        }
    }
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, VertexAttributeValues::Uint16x4(joints))
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights)
        .with_inserted_indices(Indices::U32(indices))
        .with_computed_smooth_normals()
}

fn setup_figure(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut bindposes: ResMut<Assets<SkinnedMeshInverseBindposes>>,
) {
    let mut joints: Vec<Entity> = Vec::new();
    for (index, (parent, begin)) in BONES.into_iter().enumerate() {
        let offset = if index == 0 { begin } else { begin - BONES[parent].1 };
        let joint = commands.spawn((Bone(index), Transform::from_translation(offset))).id();
        if let Some(parent) = joints.get(parent) {
            commands.entity(*parent).add_child(joint);
        }
        joints.push(joint);
    }
    let to_bones = BONES.map(|(_, begin)| Mat4::from_translation(-begin));
    commands.spawn((
        Mesh3d(meshes.add(figure())),
        MeshMaterial3d(materials.add(StandardMaterial {
            perceptual_roughness: 0.4,
            ..Color::srgb(0.9, 0.35, 0.12).into()
        })),
        SkinnedMesh {
            inverse_bindposes: bindposes.add(to_bones.to_vec()),
            joints,
        },
        // The default, named here so that the P key can change it.
        ReflectedPose::Posed,
    ));
}

fn setup_room(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let cube = meshes.add(Cuboid::default());
    for (size, center, color, metallic, perceptual_roughness) in [
        ([12.0, 0.2, 12.0], [0.0, -0.1, 0.0], [0.3, 0.3, 0.33], 0.0, 0.8),
        ([12.0, 5.0, 0.2], [0.0, 2.5, -2.6], [0.35, 0.4, 0.5], 0.0, 0.9),
        ([12.0, 5.0, 0.2], [0.0, 2.5, 6.0], [0.5, 0.42, 0.35], 0.0, 0.9),
        ([5.0, 2.6, 0.05], [0.0, 1.45, -2.4], [0.95, 0.95, 0.95], 1.0, 0.0),
    ] {
        commands.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: Color::srgb_from_array(color),
                metallic,
                perceptual_roughness,
                ..default()
            })),
            Transform::from_translation(center.into()).with_scale(size.into()),
        ));
    }
    commands.spawn((
        PointLight {
            intensity: 600_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(-1.0, 3.5, 1.0),
    ));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(-2.0, 1.6, 3.8).looking_at(Vec3::new(0.4, 0.9, -1.0), Vec3::Y),
        RayTracedReflections::default(),
    ));
}
