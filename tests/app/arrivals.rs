//! Levels that arrive: rays soon hit everything that fits, and the status reports the rest.

use crate::{
    common::app_of,
    pictures::{apps, reflect},
    stage::{BEFORE_THE_MIRROR, SIZE, metal, report, spawn_camera, spawn_mesh, unlit, wall},
};
use bevy::{
    prelude::*,
    render::settings::{WgpuLimits, WgpuSettings},
};
use bevy_glint::{ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName};
use std::time::{Duration, Instant};

/// An app with a mirror, and with this number of spheres of 16,000 triangles that have just arrived.
fn level(spheres: usize, bytes: u64) -> Option<HeadlessApp> {
    let limits = WgpuLimits {
        max_storage_buffer_binding_size: bytes,
        ..WgpuLimits::unlimited()
    };
    let settings = HeadlessSettings {
        size: SIZE / 4,
        device: WgpuSettings {
            constrained_limits: Some(limits),
            ..default()
        },
        ..default()
    };
    let mut app = app_of(settings, ReflectionTracerChoice::Bvh, |_| {}, |_| {})?;
    spawn_mesh(&mut app, wall(), metal(0.0), Transform::IDENTITY);
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    reflect(&mut app, camera, ReflectionTechnique::Reference);
    for index in 0..spheres {
        let place = Transform::from_xyz(index as f32, 0.0, 6.0);
        spawn_mesh(&mut app, Sphere::new(0.4).mesh().uv(128, 64), unlit([255; 3]), place);
    }
    Some(app)
}

/// A million triangles, through several buffers that grow in parts, one larger than the other.
#[test]
fn a_level_arrives_in_seconds() {
    const SPHERES: usize = 62;
    let Some(mut app) = level(SPHERES, u64::MAX) else {
        return;
    };
    let begin = Instant::now();
    loop {
        app.step(1);
        let report = report(&mut app);
        if report.instances == SPHERES + 1 {
            assert_eq!((report.meshes_pending, report.meshes_without_room), (0, 0));
            assert!(report.triangles > 999_000, "{report:?}");
            return;
        }
        // A separate thread takes two seconds for it.
        assert!(begin.elapsed() < Duration::from_secs(60), "{report:?}");
    }
}

/// Apps can detect that a level is loaded although not all of it fits. The rest arrives once other objects are gone.
#[test]
fn meshes_that_find_no_room_are_told() {
    const SPHERES: usize = 12;
    const LEFT: usize = 4;
    // A sphere uses 0.9 MB.
    let Some(mut app) = level(SPHERES, 6 << 20) else { return };
    for _ in 0..2_000 {
        app.step(1);
        let report = report(&mut app);
        if report.meshes_without_room > 0 && report.meshes_pending == 0 {
            assert_eq!(report.instances + report.meshes_without_room, SPHERES + 1, "{report:?}");
            assert!(report.instances > 3, "{report:?}");
            break;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let world = app.world();
    let mut objects = world.query_filtered::<(Entity, &Transform), With<Mesh3d>>();
    let spheres = objects.iter(world).filter(|(_, place)| place.translation.z == 6.0);
    let gone: Vec<_> = spheres.take(SPHERES - LEFT).map(|(entity, _)| entity).collect();
    for entity in gone {
        world.despawn(entity);
    }
    for _ in 0..2_000 {
        app.step(1);
        let report = report(&mut app);
        if report.meshes_without_room == 0 && report.instances == LEFT + 1 {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("{:?}", report(&mut app));
}

/// A mesh too large for the budget of a frame is copied in the frame after a change, however often it changes.
#[test]
fn a_large_mesh_that_changes_in_every_frame_is_seen() {
    let Some(mut app) = level(0, u64::MAX) else { return };
    let mesh = Sphere::new(0.4).mesh().uv(400, 300);
    let size = mesh.get_vertex_buffer_size();
    assert!(size > 2 << 20, "{size} bytes");
    spawn_mesh(&mut app, mesh, unlit([255; 3]), Transform::from_xyz(0.0, 0.0, 6.0));
    let meshes = app.world().resource::<Assets<Mesh>>();
    let (id, _) = meshes
        .iter()
        .find(|(_, mesh)| mesh.count_vertices() > 10_000)
        .expect("it was spawned");
    for _ in 0..2_000 {
        app.step(1);
        if report(&mut app).instances == 2 {
            return;
        }
        let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
        meshes.get_mut(id).expect("it stays").enable_raytracing = true;
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("{:?}", report(&mut app));
}

/// An object that gets a mesh that takes a while to build is shown with its last mesh until then.
#[test]
fn an_object_never_vanishes_for_another_mesh() {
    for (_, mut app) in apps(SIZE / 4, Output::Picture) {
        spawn_mesh(&mut app, wall(), metal(0.0), Transform::IDENTITY);
        let at = Transform::from_xyz(0.0, 0.0, 6.0);
        let ball = spawn_mesh(&mut app, Sphere::new(0.4).mesh().uv(32, 16), unlit([255; 3]), at);
        let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        reflect(&mut app, camera, ReflectionTechnique::Reference);
        let before = report(&mut app);
        let fine = Sphere::new(0.4).mesh().uv(256, 128);
        let mesh = app.world().resource_mut::<Assets<Mesh>>().add(fine);
        app.world().entity_mut(ball).insert(Mesh3d(mesh));
        let mut frames = 0;
        loop {
            app.step(1);
            frames += 1;
            let now = report(&mut app);
            assert_eq!(now.instances, 2, "frame {frames}");
            if now.meshes_pending == 0 && now.triangles > before.triangles + 50_000 && now.meshes == 2 {
                break;
            }
            assert!(frames < 10_000, "{now:?}");
        }
        println!("the new mesh has come after {frames} frames, and the last one has gone");
    }
}
