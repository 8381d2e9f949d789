//! Skinned and morphed meshes: a mirror shows them as they are drawn.

use crate::{
    pictures::{assert_flip, flip, picture_app, reflect, warm_up},
    stage::{SIZE, add, image, report, share_app, spawn_mesh, spawn_mirror, until},
};
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageSampler, ImageSamplerDescriptor},
    math::Affine3A,
    mesh::{
        Indices, PrimitiveTopology, VertexAttributeValues,
        morph::{MeshMorphWeights, MorphAttributes},
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    prelude::*,
    render::{RenderApp, render_resource::TextureFormat},
};
use bevy_glint::{
    NotReflected, ReflectedPose, ReflectedPoseBudget, ReflectionTechnique, ReflectionTracerChoice,
    internals::meshes::SceneMeshes,
};
use core::f32::consts::{FRAC_PI_2, TAU};
use glint_scenes::{HeadlessApp, SceneName};

/// Mean FLIP of two equal images: single pixels at edges differ by the rounding of vertices.
const SAME: f32 = 0.0005;
/// Minimum mean FLIP of images with different poses.
const OTHER: f32 = 0.02;

const SIDES: usize = 16;
const RINGS: usize = 20;
const LENGTH: f32 = 4.0;
/// The joint of the two bones of an arm, at half its length.
pub const ELBOW: Vec3 = Vec3::new(0.0, 0.5 * LENGTH, 0.0);

/// A tube along Y, and of each vertex how far up it is.
fn tube() -> (Vec<Vec3>, Vec<Vec3>, Vec<u32>) {
    let mut positions = Vec::new();
    let mut normals = Vec::new();
    let mut indices = Vec::new();
    for ring in 0..=RINGS {
        let y = LENGTH * ring as f32 / RINGS as f32;
        for side in 0..SIDES {
            let (sin, cos) = (TAU * side as f32 / SIDES as f32).sin_cos();
            positions.push(Vec3::new(0.5 * cos, y, 0.5 * sin));
            normals.push(Vec3::new(cos, 0.0, sin));
            if ring < RINGS {
                let [a, b] = [side, (side + 1) % SIDES].map(|side| (ring * SIDES + side) as u32);
                let [c, d] = [a, b].map(|vertex| vertex + SIDES as u32);
                indices.extend([a, c, b, b, c, d]);
            }
        }
    }
    (positions, normals, indices)
}

fn mesh_of(positions: &[Vec3], normals: &[Vec3], indices: &[u32]) -> Mesh {
    let list = |vectors: &[Vec3]| vectors.iter().map(|vector| vector.to_array()).collect::<Vec<_>>();
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, list(positions))
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, list(normals))
        .with_inserted_indices(Indices::U32(indices.to_vec()))
}

/// Share of the second bone in each vertex.
fn upper_share(position: &Vec3) -> f32 {
    ((position.y - ELBOW.y) / 1.0 + 0.5).clamp(0.0, 1.0)
}

/// A tube of two bones.
pub fn arm() -> Mesh {
    let (positions, normals, indices) = tube();
    let weights: Vec<[f32; 4]> = positions
        .iter()
        .map(|position| [1.0 - upper_share(position), upper_share(position), 0.0, 0.0])
        .collect();
    mesh_of(&positions, &normals, &indices)
        .with_inserted_attribute(
            Mesh::ATTRIBUTE_JOINT_INDEX,
            VertexAttributeValues::Uint16x4(vec![[0, 1, 0, 0]; positions.len()]),
        )
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights)
}

/// Thicker in the middle, and bent to the side.
fn targets() -> [Vec<MorphAttributes>; 2] {
    let (positions, normals, _) = tube();
    let along = |position: &Vec3| position.y / LENGTH;
    let thick = positions.iter().zip(&normals).map(|(position, normal)| {
        let y = along(position);
        MorphAttributes::new(*normal * (4.0 * y * (1.0 - y)), Vec3::Y * (2.0 * y - 1.0), Vec3::ZERO)
    });
    let bent = positions.iter().map(|position| {
        let y = along(position);
        MorphAttributes::new(Vec3::X * 3.0 * y * y, -Vec3::Y * y, Vec3::ZERO)
    });
    [thick.collect(), bent.collect()]
}

fn morphable(mesh: Mesh) -> Mesh {
    mesh.with_morph_targets(targets().concat())
}

/// The tube with morph targets and bones applied, as a plain mesh.
fn baked(weights: [f32; 2], bones: Option<[Affine3A; 2]>) -> Mesh {
    let (mut positions, mut normals, indices) = tube();
    for (target, weight) in targets().iter().zip(weights) {
        for (vertex, difference) in target.iter().enumerate() {
            positions[vertex] += weight * difference.position;
            normals[vertex] += weight * difference.normal;
        }
    }
    if let Some([lower, upper]) = bones {
        let (rest, ..) = tube();
        for ((position, normal), rest) in positions.iter_mut().zip(&mut normals).zip(&rest) {
            let share = upper_share(rest);
            let matrix = Mat4::from(lower) * (1.0 - share) + Mat4::from(upper) * share;
            *position = matrix.transform_point3(*position);
            *normal = Mat3::from_mat4(matrix).inverse().transpose() * *normal;
        }
    }
    for normal in &mut normals {
        *normal = normal.normalize();
    }
    mesh_of(&positions, &normals, &indices)
}

fn paint() -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness: 0.6,
        ..Color::srgb(0.9, 0.5, 0.1).into()
    }
}

/// The two joints of an arm. Its mesh is spawned far from them.
pub struct Arm {
    pub mesh: Entity,
    pub joints: [Entity; 2],
}

/// Behind the camera, where only the mirror shows it.
fn shoulder() -> Transform {
    Transform::from_xyz(0.5, -2.0, 6.5).with_rotation(Quat::from_rotation_y(0.7))
}

fn bend() -> Transform {
    Transform::from_translation(ELBOW).with_rotation(Quat::from_rotation_z(FRAC_PI_2))
}

fn inverse_bindposes() -> Vec<Mat4> {
    vec![Mat4::IDENTITY, Mat4::from_translation(-ELBOW)]
}

pub fn spawn_arm(app: &mut HeadlessApp, mesh: Mesh, material: StandardMaterial) -> Arm {
    let far = Transform::from_xyz(40.0, 3.0, -7.0).with_scale(Vec3::splat(0.3));
    let mesh = spawn_mesh(app, mesh, material, far);
    let world = app.world();
    let lower = world.spawn(shoulder()).id();
    let upper = world.spawn((bend(), ChildOf(lower))).id();
    let inverse_bindposes = world
        .resource_mut::<Assets<SkinnedMeshInverseBindposes>>()
        .add(SkinnedMeshInverseBindposes::from(inverse_bindposes()));
    let joints = [lower, upper];
    world.entity_mut(mesh).insert(SkinnedMesh {
        inverse_bindposes,
        joints: joints.to_vec(),
    });
    Arm { mesh, joints }
}

/// From bind pose to the world.
fn bones(upper: Transform) -> [Affine3A; 2] {
    let lower = shoulder().compute_affine();
    [
        lower,
        lower * upper.compute_affine() * Affine3A::from_translation(-ELBOW),
    ]
}

fn stage(app: &mut HeadlessApp) -> Entity {
    let camera = spawn_mirror(app, 0.0, SceneName::Demo);
    let sun = DirectionalLight {
        illuminance: 20_000.0,
        ..default()
    };
    app.world().spawn((
        sun,
        Transform::default().looking_to(Vec3::new(-0.5, -1.0, 1.0), Vec3::Y),
    ));
    reflect(app, camera, ReflectionTechnique::Reference);
    camera
}

/// The image once this number of objects is posed.
#[track_caller]
fn shown(app: &mut HeadlessApp, posed: usize) -> Vec<u8> {
    app.step(1);
    warm_up(app);
    for waited in 0..2000 {
        if report(app).posed_instances == posed {
            // The report is one frame old.
            app.step(2 * waited.min(1));
            return app.capture().unwrap();
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
        app.step(1);
    }
    panic!("{posed} objects should be posed: {:?}", report(app));
}

/// Compares the image once this number of objects is posed.
#[track_caller]
fn assert_shown(app: &mut HeadlessApp, posed: usize, name: &str, expected: &[u8]) {
    let actual = shown(app, posed);
    assert_flip(name, SIZE, expected, &actual, SAME);
}

/// The image of a mesh without a pose.
fn shown_baked(app: &mut HeadlessApp, mesh: Mesh, material: StandardMaterial, at: Transform) -> Vec<u8> {
    let entity = spawn_mesh(app, mesh, material, at);
    let picture = shown(app, 0);
    app.world().despawn(entity);
    picture
}

/// Words in use of the scene's meshes and trees.
fn used_bytes(app: &mut HeadlessApp) -> u64 {
    let meshes = app.app().sub_app(RenderApp).world().resource::<SceneMeshes>();
    meshes.geometry.used_bytes() + meshes.bvh.used_bytes()
}

#[test]
fn a_mirror_shows_poses() {
    share_app(&[
        a_bent_arm_looks_like_one_that_was_baked,
        morph_targets_look_like_a_mesh_that_was_baked,
        what_is_gone_leaves_nothing,
        a_pose_stays_where_buffers_grow,
        holes_stay_where_they_are_on_the_surface,
        bad_skeletons_leave_a_picture,
    ]);
}

fn a_bent_arm_looks_like_one_that_was_baked(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    stage(app);
    let [lower, _] = bones(bend());
    let expected = shown_baked(app, baked([0.0; 2], Some(bones(bend()))), paint(), Transform::IDENTITY);
    let straight = shown_baked(app, baked([0.0; 2], Some([lower; 2])), paint(), Transform::IDENTITY);
    let other = flip(SIZE, &expected, &straight).0;
    assert!(other > OTHER, "{tracer}: the bend changes the picture by {other} alone");

    let arm = spawn_arm(app, arm(), paint());
    assert_shown(app, 1, &format!("bent-arm-{tracer}"), &expected);
    // Bevy places it only by its joints.
    app.world().get_mut::<Transform>(arm.mesh).unwrap().translation = Vec3::new(-3.0, 9.0, 1.0);
    assert_shown(app, 1, &format!("bent-arm-elsewhere-{tracer}"), &expected);

    // It straightens, and bends again.
    *app.world().get_mut::<Transform>(arm.joints[1]).unwrap() = Transform::from_translation(ELBOW);
    assert_shown(app, 1, &format!("straight-arm-{tracer}"), &straight);
    *app.world().get_mut::<Transform>(arm.joints[1]).unwrap() = bend();
    assert_shown(app, 1, &format!("arm-bent-again-{tracer}"), &expected);

    // A rigid mesh has its bind pose at the first joint; without a skin it is far away.
    app.world().entity_mut(arm.mesh).insert(ReflectedPose::Rigid);
    assert_shown(app, 0, &format!("rigid-arm-{tracer}"), &straight);
    app.world().entity_mut(arm.mesh).remove::<ReflectedPose>();
    assert_shown(app, 1, &format!("posed-again-{tracer}"), &expected);
}

fn morph_targets_look_like_a_mesh_that_was_baked(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    const WEIGHTS: [f32; 2] = [0.7, -0.4];
    stage(app);
    let expected = shown_baked(app, baked(WEIGHTS, None), paint(), shoulder());
    let flat = shown_baked(app, baked([0.0; 2], None), paint(), shoulder());
    let other = flip(SIZE, &expected, &flat).0;
    assert!(
        other > OTHER,
        "{tracer}: the targets change the picture by {other} alone"
    );
    let (positions, normals, indices) = tube();
    let at = shoulder();
    let morphed = spawn_mesh(app, morphable(mesh_of(&positions, &normals, &indices)), paint(), at);
    let weights = |weights: [f32; 2]| MeshMorphWeights::Value {
        weights: weights.to_vec(),
    };
    app.world().entity_mut(morphed).insert(weights([0.0; 2]));
    // Its vertices don't move.
    assert_shown(app, 0, &format!("not-morphed-{tracer}"), &flat);
    app.world().entity_mut(morphed).insert(weights(WEIGHTS));
    assert_shown(app, 1, &format!("morphed-{tracer}"), &expected);
    app.world().despawn(morphed);

    let expected = shown_baked(app, baked(WEIGHTS, Some(bones(bend()))), paint(), Transform::IDENTITY);
    let arm = spawn_arm(app, morphable(arm()), paint());
    app.world().entity_mut(arm.mesh).insert(weights(WEIGHTS));
    assert_shown(app, 1, &format!("morphed-arm-{tracer}"), &expected);
}

fn what_is_gone_leaves_nothing(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    stage(app);
    // The mirror gets its own merged tree.
    app.step(60);
    let empty = shown(app, 0);
    let before = used_bytes(app);
    for round in 0..3 {
        let arms = [(); 3].map(|()| spawn_arm(app, arm(), paint()));
        shown(app, 3);
        assert!(used_bytes(app) > before);
        for arm in &arms {
            let world = app.world();
            match round {
                0 => world.entity_mut(arm.mesh).despawn(),
                1 => drop(world.entity_mut(arm.mesh).insert(NotReflected)),
                // The skeleton is removed before the mesh that it moves.
                _ => world.entity_mut(arm.joints[0]).despawn(),
            }
        }
        app.step(2);
        assert_eq!(report(app).posed_instances, if round == 2 { 3 } else { 0 });
        for arm in &arms {
            app.world().try_despawn(arm.mesh).ok();
        }
        let picture = shown(app, 0);
        assert_eq!(used_bytes(app), before, "{tracer}, round {round}");
        assert_flip(&format!("no-arms-{tracer}"), SIZE, &empty, &picture, SAME);
    }
}

/// An arm bends in the frame in which a crowd arrives with trees that don't fit into the buffers.
fn a_pose_stays_where_buffers_grow(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    // And beside the view, where Bevy doesn't draw it.
    const BEHIND_THE_MIRROR: Vec3 = Vec3::new(100.0, 0.0, -50.0);
    stage(app);
    let expected = shown_baked(app, baked([0.0; 2], Some(bones(bend()))), paint(), Transform::IDENTITY);
    let arm = spawn_arm(app, arm(), paint());
    *app.world().get_mut::<Transform>(arm.joints[1]).unwrap() = Transform::from_translation(ELBOW);
    let place = Transform::from_translation(BEHIND_THE_MIRROR);
    let first = spawn_mesh(app, Cuboid::from_length(0.1), paint(), place);
    shown(app, 1);
    let world = app.world();
    let mesh = world.get::<Mesh3d>(first).unwrap().clone();
    let material = world.get::<MeshMaterial3d<StandardMaterial>>(first).unwrap().clone();
    let crowd = (0..20_000u16).map(|i| {
        let place = BEHIND_THE_MIRROR + 0.2 * Vec3::new(f32::from(i % 200), f32::from(i / 200), 0.0);
        (mesh.clone(), material.clone(), Transform::from_translation(place))
    });
    let crowd: Vec<Entity> = world.spawn_batch(crowd.collect::<Vec<_>>()).collect();
    *world.get_mut::<Transform>(arm.joints[1]).unwrap() = bend();
    assert_shown(app, 1, &format!("arm-among-a-crowd-{tracer}"), &expected);
    for object in crowd {
        app.world().despawn(object);
    }
}

/// Paint with holes in stripes across the arm, and UV coordinates for it.
fn cut_out(app: &mut HeadlessApp) -> StandardMaterial {
    let texels = [[255; 4], [255, 255, 255, 0]].concat();
    let mut image = image(UVec2::new(1, 2), TextureFormat::Rgba8UnormSrgb, texels);
    image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
        address_mode_v: ImageAddressMode::Repeat,
        ..ImageSamplerDescriptor::nearest()
    });
    StandardMaterial {
        base_color_texture: Some(add(app, image)),
        alpha_mode: AlphaMode::Mask(0.5),
        cull_mode: None,
        double_sided: true,
        ..paint()
    }
}

fn with_uvs(mesh: Mesh) -> Mesh {
    let (positions, ..) = tube();
    let uvs: Vec<[f32; 2]> = positions.iter().map(|position| [0.5, 1.5 * position.y]).collect();
    mesh.with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs)
}

/// Waits for as long as micromaps take.
fn until_micromaps_rest(app: &mut HeadlessApp) {
    app.step(30);
    until(app, "micromaps are still built", |app| !report(app).micromaps_pending);
}

fn holes_stay_where_they_are_on_the_surface(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    stage(app);
    let material = cut_out(app);
    let bent = || with_uvs(baked([0.0; 2], Some(bones(bend()))));
    let expected = shown_baked(app, bent(), material.clone(), Transform::IDENTITY);
    let solid = shown_baked(app, bent(), paint(), Transform::IDENTITY);
    let other = flip(SIZE, &expected, &solid).0;
    assert!(
        other > OTHER / 4.0,
        "{tracer}: holes change the picture by {other} alone"
    );
    spawn_arm(app, with_uvs(arm()), material);
    assert_shown(app, 1, &format!("masked-arm-{tracer}"), &expected);
    // Opacity micromaps arrive later, and change nothing.
    until_micromaps_rest(app);
    assert_shown(app, 1, &format!("micromapped-arm-{tracer}"), &expected);
}

fn bad_skeletons_leave_a_picture(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    stage(app);
    let expected = shown_baked(app, baked([0.0; 2], Some(bones(bend()))), paint(), Transform::IDENTITY);
    let arm = spawn_arm(app, arm(), paint());
    shown(app, 1);
    // While a joint is missing, the last pose stays.
    let upper = app.world().get::<Transform>(arm.joints[1]).copied().unwrap();
    for bad in [f32::NAN, f32::INFINITY, 1e30] {
        app.world().get_mut::<Transform>(arm.joints[1]).unwrap().translation.x = bad;
        assert_shown(app, 1, &format!("lost-joint-{tracer}"), &expected);
    }
    *app.world().get_mut::<Transform>(arm.joints[1]).unwrap() = upper;
    app.step(2);
    app.world().despawn(arm.joints[1]);
    assert_shown(app, 1, &format!("despawned-joint-{tracer}"), &expected);
    // Without joints, and without inverse bind poses, it was never posed: its transform gives its place.
    let place = |app: &mut HeadlessApp, mesh: Entity| {
        *app.world().get_mut::<Transform>(mesh).unwrap() = shoulder();
    };
    let inverse_bindposes = app
        .world()
        .get::<SkinnedMesh>(arm.mesh)
        .unwrap()
        .inverse_bindposes
        .clone();
    for skin in [
        SkinnedMesh::default(),
        SkinnedMesh {
            joints: arm.joints.to_vec(),
            ..default()
        },
        // More joints than inverse bind poses.
        SkinnedMesh {
            inverse_bindposes,
            joints: vec![arm.joints[0]; 70_000],
        },
    ] {
        let mesh = spawn_mesh(app, crate::poses::arm(), paint(), Transform::IDENTITY);
        app.world().entity_mut(mesh).insert(skin);
        app.step(1);
        place(app, mesh);
        let actual = shown(app, 1);
        let changed = flip(SIZE, &expected, &actual).0;
        assert!(
            changed > OTHER / 4.0,
            "{tracer}: a straight arm is seen, too, and not {changed}"
        );
        app.world().despawn(mesh);
    }
}

#[test]
fn the_budget_goes_to_the_nearest() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let app = &mut app;
    stage(app);
    let arms = [6.0, 20.0, 40.0].map(|z| {
        let arm = spawn_arm(app, arm(), paint());
        app.world().get_mut::<Transform>(arm.joints[0]).unwrap().translation.z = z;
        arm
    });
    // The mirror gets its own merged tree.
    app.step(60);
    shown(app, 3);
    let budget = |app: &mut HeadlessApp, vertices_per_frame: u32| {
        app.world().insert_resource(ReflectedPoseBudget { vertices_per_frame });
    };
    let bend_all = |app: &mut HeadlessApp, angle: f32| {
        for arm in &arms {
            app.world().get_mut::<Transform>(arm.joints[1]).unwrap().rotation = Quat::from_rotation_z(angle);
        }
        app.step(1);
        // The status is one frame old.
        app.step(1);
        report(app)
    };
    // Trees of the top level are built if something was posed.
    let builds = |app: &mut HeadlessApp| report(app).tlas_builds;
    budget(app, 0);
    let before = builds(app);
    bend_all(app, 0.1);
    app.step(5);
    assert_eq!(builds(app), before, "nothing is posed");
    // One mesh in each frame, however many vertices it has, and all of them in the end.
    budget(app, 1);
    app.step(6);
    assert_eq!(builds(app), before + 3, "one after the other");
    budget(app, u32::MAX);
    let before = builds(app);
    bend_all(app, 0.2);
    app.step(5);
    assert_eq!(builds(app), before + 1, "all at once");
    app.step(30);
    assert_eq!(builds(app), before + 1, "nothing moves any more");
}
