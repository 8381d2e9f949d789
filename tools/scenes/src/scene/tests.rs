//! The scenes without a renderer: complete, valid and the same every time.

use crate::{
    CameraPath, SceneName, SceneOptions, SceneStatistics, UnknownScene, animation::Motion, camera, environment,
    set_time, spawn_with, write_test_assets,
};
use bevy::{
    mesh::{Indices, VertexAttributeValues},
    prelude::*,
};

const SMALL: SceneOptions = SceneOptions {
    detail: 1.0,
    texture_size: 16,
};

fn spawned(name: SceneName, options: &SceneOptions) -> (World, SceneStatistics) {
    let mut world = World::new();
    let root = spawn_with(name, &mut world, options);
    let statistics = *world.entity(root).get::<SceneStatistics>().unwrap();
    (world, statistics)
}

#[test]
fn names_round_trip() {
    for name in SceneName::ALL {
        assert_eq!(name.to_string().parse(), Ok(name));
    }
    assert_eq!("Emissive-Floor".parse(), Ok(SceneName::EmissiveFloor));
    assert_eq!("atrium-small".parse(), Ok(SceneName::AtriumSmall));
    assert_eq!("street-moving".parse(), Ok(SceneName::StreetMoving));
    let error: Result<SceneName, UnknownScene> = "sponza".parse();
    assert!(error.unwrap_err().to_string().contains("atrium"));
}

fn positions_and_normals(mesh: &Mesh) -> [Vec<Vec3>; 2] {
    [Mesh::ATTRIBUTE_POSITION, Mesh::ATTRIBUTE_NORMAL].map(|attribute| match mesh.attribute(attribute) {
        Some(VertexAttributeValues::Float32x3(values)) => values.iter().map(|value| Vec3::from(*value)).collect(),
        _ => panic!("no {}", attribute.name),
    })
}

fn indices(mesh: &Mesh) -> &[u32] {
    match mesh.indices() {
        Some(Indices::U32(indices)) => indices,
        _ => panic!("no indices of 32 bits"),
    }
}

#[test]
fn every_mesh_is_complete() {
    for name in SceneName::ALL {
        let (world, _) = spawned(name, &SMALL);
        for (_, mesh) in world.resource::<Assets<Mesh>>().iter() {
            let vertices = mesh.count_vertices();
            let [positions, normals] = positions_and_normals(mesh);
            for values in [&positions, &normals] {
                assert!(
                    values.len() == vertices && values.iter().all(|v| v.is_finite()),
                    "{name}"
                );
            }
            let (Some(VertexAttributeValues::Float32x4(tangents)), Some(VertexAttributeValues::Float32x2(uvs))) = (
                mesh.attribute(Mesh::ATTRIBUTE_TANGENT),
                mesh.attribute(Mesh::ATTRIBUTE_UV_0),
            ) else {
                panic!("{name}")
            };
            assert!(uvs.len() == vertices && uvs.iter().flatten().all(|v| v.is_finite()));
            assert_eq!(tangents.len(), vertices);
            for (normal, &[x, y, z, w]) in normals.iter().zip(tangents) {
                let tangent = Vec3::new(x, y, z);
                assert!(
                    (normal.length() - 1.0).abs() < 1e-3 && (tangent.length() - 1.0).abs() < 1e-3,
                    "{name}"
                );
                assert!(normal.dot(tangent).abs() < 1e-3 && w.abs() == 1.0, "{name}");
            }
            let indices = indices(mesh);
            assert!(
                !indices.is_empty() && indices.iter().all(|&i| (i as usize) < vertices),
                "{name}"
            );
        }
    }
}

#[test]
fn faces_agree_with_normals() {
    for name in SceneName::ALL {
        let (world, _) = spawned(name, &SMALL);
        let (mut wrong, mut all) = (0, 0);
        for (_, mesh) in world.resource::<Assets<Mesh>>().iter() {
            let [positions, normals] = positions_and_normals(mesh);
            for triangle in indices(mesh).chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|i| positions[triangle[i] as usize]);
                let shading: Vec3 = triangle.iter().map(|&i| normals[i as usize]).sum();
                wrong += usize::from((b - a).cross(c - a).dot(shading) <= 0.0);
                all += 1;
            }
        }
        assert!(
            wrong * 200 < all,
            "{name}: {wrong} of {all} triangles face away from their normals"
        );
    }
}

#[test]
fn scenes_have_the_triangles_that_they_promise() {
    for (name, triangles) in [
        (SceneName::AtriumSmall, 66_000..100_000),
        (SceneName::Atrium, 250_000..300_000),
        (SceneName::Temple, 500_000..700_000),
        (SceneName::Street, 2_000_000..3_500_000),
    ] {
        let (_, statistics) = spawned(name, &SMALL);
        assert!(triangles.contains(&statistics.triangles), "{name}: {statistics:?}");
        let (_, same) = spawned(name, &SMALL);
        assert_eq!(statistics, same, "{name}");
    }
}

#[test]
fn detail_makes_the_atrium_finer() {
    let (_, plain) = spawned(SceneName::AtriumSmall, &SMALL);
    assert!((100..400).contains(&plain.instances), "{plain:?}");
    let (_, fine) = spawned(SceneName::AtriumSmall, &SceneOptions { detail: 2.25, ..SMALL });
    assert!((230_000..300_000).contains(&fine.triangles), "{fine:?}");
    let coarse = SceneOptions { detail: 0.25, ..SMALL };
    let (_, coarse) = spawned(SceneName::Atrium, &coarse);
    assert!((10_000..150_000).contains(&coarse.triangles), "{coarse:?}");
}

/// Tests draw it coarse: a CPU takes longer for its triangles than for rays.
#[test]
fn detail_makes_the_demo_coarser() {
    let (_, plain) = spawned(SceneName::Demo, &SMALL);
    let coarse = SceneOptions { detail: 0.25, ..SMALL };
    let (_, coarse) = spawned(SceneName::Demo, &coarse);
    assert_eq!(plain.instances, coarse.instances);
    assert!(plain.triangles > 2 * coarse.triangles, "{plain:?} {coarse:?}");
}

#[test]
fn the_path_is_smooth_and_inside() {
    let path = CameraPath::of(SceneName::Atrium);
    for i in 0..=400 {
        let pose = |i: i32| path.pose(path.seconds * i as f32 / 400.0);
        let (here, next) = (pose(i), pose(i + 1));
        assert!(
            here.translation.x.abs() < 10.0 && here.translation.z.abs() < 4.2 && here.translation.y > 1.2,
            "{i}"
        );
        assert!(
            here.translation.distance(next.translation) < 0.2 && here.rotation.angle_between(next.rotation) < 0.1,
            "{i}"
        );
    }
}

#[test]
fn every_scene_has_a_path() {
    for name in SceneName::ALL {
        let path = CameraPath::of(name);
        let (start, projection) = camera(name);
        assert!(path.seconds > 0.0 && path.points.len() > 2, "{name}");
        assert_eq!(projection.far, path.far);
        // It begins at the camera's place, and doesn't move before the start and after the end.
        for seconds in [0.0, -1.0, f32::NAN, f32::NEG_INFINITY] {
            assert_eq!(path.pose(seconds), start, "{name}: {seconds}");
        }
        assert_eq!(path.pose(f32::INFINITY), path.pose(path.seconds), "{name}");
        // No jumps: each hundredth of the path is short.
        let poses: Vec<Transform> = (0..=100).map(|i| path.pose(path.seconds * i as f32 / 100.0)).collect();
        let steps = poses.windows(2);
        let lengths: Vec<f32> = steps
            .map(|pair| pair[0].translation.distance(pair[1].translation))
            .collect();
        let whole: f32 = lengths.iter().sum();
        assert!(whole > 1.0, "{name}");
        assert!(
            lengths.iter().all(|&length| length < 0.1 * whole),
            "{name}: {lengths:?}"
        );
        assert!(poses.iter().all(|pose| pose.is_finite()), "{name}");
        for pair in poses.windows(2) {
            let angle = pair[0].rotation.angle_between(pair[1].rotation);
            assert!(angle < 0.5, "{name}: {angle}");
        }
    }
}

#[test]
fn cameras_and_skies_exist() {
    for name in SceneName::ALL {
        let mut world = World::new();
        world.init_resource::<Assets<Image>>();
        let (transform, projection) = camera(name);
        assert!(transform.is_finite() && projection.fov > 0.1);
        let first = environment(name, &mut world);
        assert_eq!(first.light.is_some(), first.skybox.is_some());
        let count = world.resource::<Assets<Image>>().len();
        let _ = environment(name, &mut world);
        assert_eq!(world.resource::<Assets<Image>>().len(), count, "a sky is baked once");
    }
}

const MOVING: [(SceneName, SceneName); 3] = [
    (SceneName::Atrium, SceneName::AtriumMoving),
    (SceneName::Temple, SceneName::TempleMoving),
    (SceneName::Street, SceneName::StreetMoving),
];

/// Places of all moving objects of a scene; limbs and lamps on cords are at their owners' places.
fn movers(world: &mut World) -> Vec<Vec3> {
    let mut query = world.query::<(Entity, &Motion, &Transform, Option<&ChildOf>)>();
    let all: Vec<(Entity, Vec3, Option<Entity>)> = query
        .iter(world)
        .map(|(entity, _, transform, parent)| (entity, transform.translation, parent.map(ChildOf::parent)))
        .collect();
    let moves = |of: &Option<Entity>| all.iter().any(|(entity, ..)| Some(*entity) == *of);
    all.iter()
        .filter(|(.., parent)| !moves(parent))
        .map(|(_, at, _)| *at)
        .collect()
}

#[test]
fn views_show_what_moves_and_nothing_runs_into_the_camera() {
    const STEPS: usize = 200;
    let coarse = SceneOptions { detail: 0.25, ..SMALL };
    let mut wrong = Vec::new();
    for (still, name) in MOVING {
        let (mut world, with) = spawned(name, &coarse);
        let (_, without) = spawned(still, &coarse);
        assert!(with.instances > without.instances + 10, "{name}: {with:?}");
        let path = CameraPath::of(name);
        let up = (0.5 * path.vertical_degrees).to_radians().tan();
        for step in 0..=STEPS {
            let seconds = path.seconds * step as f32 / STEPS as f32;
            let pose = path.pose(seconds);
            set_time(&mut world, seconds);
            let places = movers(&mut world);
            // The objects are lower than a camera that looks down on them.
            let above = Vec3::Y * (pose.translation.y - 2.0).max(0.0);
            let nearest = places
                .iter()
                .map(|at| at.with_y(0.0).distance(pose.translation.with_y(0.0) + above))
                .fold(f32::INFINITY, f32::min);
            if nearest < 0.7 {
                wrong.push(format!("{name}: {nearest} m from the camera after {seconds} s"));
            }
            let is_seen = |at: &&Vec3| {
                let point = pose.rotation.inverse() * (**at + Vec3::Y - pose.translation);
                point.z > -30.0 && point.y.abs() < up * -point.z && point.x.abs() < up * 16.0 / 9.0 * -point.z
            };
            if places.iter().filter(is_seen).count() == 0 {
                wrong.push(format!("{name}: nothing moves in view after {seconds} s"));
            }
        }
        let at = |world: &mut World, seconds| {
            set_time(world, seconds);
            movers(world)
        };
        let (first, later) = (at(&mut world, 3.0), at(&mut world, 11.0));
        assert_ne!(first, later, "{name}");
        assert_eq!(at(&mut world, 3.0), first, "{name}: a pure function of time");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn two_views_show_all_shapes_and_normals_that_face_away() {
    let (mut world, _) = spawned(SceneName::Shapes, &SMALL);
    let mut query = world.query::<(&Mesh3d, &MeshMaterial3d<StandardMaterial>, &Transform)>();
    let (meshes, materials) = (
        world.resource::<Assets<Mesh>>(),
        world.resource::<Assets<StandardMaterial>>(),
    );
    let path = CameraPath::of(SceneName::Shapes);
    let views = [0.25, 0.75].map(|share| path.pose(share * path.seconds));
    let up = (0.5 * path.vertical_degrees).to_radians().tan();
    let (mut roughness, mut seen, mut away) = (Vec::new(), [0; 2], [0; 2]);
    for (mesh, material, transform) in query.iter(&world) {
        let material = materials.get(&material.0).unwrap();
        if material.unlit {
            continue;
        }
        roughness.push(material.perceptual_roughness);
        let mesh = meshes.get(&mesh.0).unwrap();
        let [positions, normals] = positions_and_normals(mesh);
        let vertices: Vec<(Vec3, Vec3)> = positions.into_iter().zip(normals).collect();
        let is_seen = |view: &Transform| {
            vertices.iter().all(|(position, _)| {
                let point = view.rotation.inverse() * (transform.transform_point(*position) - view.translation);
                point.y.abs() < up * -point.z && point.x.abs() < up * 16.0 / 9.0 * -point.z
            })
        };
        assert!(
            views.iter().any(is_seen),
            "a shape at {} is cut off",
            transform.translation
        );
        for (index, view) in views.iter().enumerate() {
            seen[index] += usize::from(is_seen(view));
            for triangle in indices(mesh).chunks_exact(3) {
                let corners = [0, 1, 2].map(|i| vertices[triangle[i] as usize]);
                let [a, b, c] = corners.map(|(position, _)| transform.transform_point(position));
                let faces = |normal: Vec3| normal.dot(view.translation - a) > 0.0;
                let normals = corners.map(|(_, normal)| transform.rotation * normal);
                away[index] += usize::from(faces((b - a).cross(c - a)) && !normals.into_iter().any(faces));
            }
        }
    }
    roughness.sort_by(f32::total_cmp);
    assert_eq!(roughness.len(), 15);
    assert!(roughness[0] == 0.1 && roughness[14] == 1.0, "{roughness:?}");
    assert!(seen.iter().all(|count| *count >= 7), "{seen:?}");
    assert!(away.iter().all(|count| *count >= 20), "{away:?}");
}

#[test]
fn held_out_scenes_are_varied() {
    let mut roughness = Vec::new();
    for name in SceneName::HELD_OUT {
        assert!(SceneName::ALL.contains(&name));
        let (world, statistics) = spawned(name, &SMALL);
        let (_, same) = spawned(name, &SMALL);
        assert_eq!(statistics, same, "{name}");
        assert!(
            (1_000..200_000).contains(&statistics.triangles),
            "{name}: {statistics:?}"
        );
        let materials = world.resource::<Assets<StandardMaterial>>().iter();
        // A texture has its own roughness.
        let plain = materials.filter(|(_, material)| !material.unlit && material.metallic_roughness_texture.is_none());
        roughness.extend(plain.map(|(_, material)| material.perceptual_roughness));
        let path = CameraPath::of(name);
        let [first, second] = [0.25, 0.75].map(|share| path.pose(share * path.seconds));
        assert!(first.translation.distance(second.translation) > 1.0, "{name}");
    }
    roughness.sort_by(f32::total_cmp);
    assert_eq!(roughness[0], 0.0);
    assert!(roughness.contains(&0.9), "{roughness:?}");
    assert!(
        roughness.windows(2).all(|pair| pair[1] - pair[0] <= 0.2),
        "{roughness:?}"
    );
}

#[test]
fn gltf_files_are_written() {
    let folder = std::env::temp_dir().join(format!("glint_scenes_{}", std::process::id()));
    let paths = write_test_assets(&folder).unwrap();
    for path in &paths {
        assert!(std::fs::read_to_string(path).unwrap().contains("\"version\": \"2.0\""));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
