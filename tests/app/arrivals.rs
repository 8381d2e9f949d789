//! Levels that arrive: rays soon hit everything that fits, and the status reports the rest.

use crate::{
    pictures::{app_of_device, apps, limited, reflect},
    stage::{SIZE, report, spawn_mesh, spawn_mirror, unlit, until},
};
use bevy::{prelude::*, render::settings::WgpuLimits};
use bevy_glint::ReflectionTechnique;
use glint_scenes::{HeadlessApp, Output, SceneName};
use std::time::{Duration, Instant};

/// An app with a mirror, and with this number of spheres of 16,000 triangles that have just arrived.
fn level(spheres: usize, bytes: u64) -> Option<HeadlessApp> {
    let limits = WgpuLimits {
        max_storage_buffer_binding_size: bytes,
        ..WgpuLimits::unlimited()
    };
    let mut app = app_of_device(SIZE / 4, limited(limits))?;
    let camera = spawn_mirror(&mut app, 0.0, SceneName::MirrorRoom);
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
    app.step(1);
    until(&mut app, "the level isn't told to be complete", |app| {
        let report = report(app);
        report.meshes_without_room > 0 && report.meshes_pending == 0
    });
    let told = report(&mut app);
    assert_eq!(told.instances + told.meshes_without_room, SPHERES + 1, "{told:?}");
    assert!(told.instances > 3, "{told:?}");
    let world = app.world();
    let mut objects = world.query_filtered::<(Entity, &Transform), With<Mesh3d>>();
    let spheres = objects.iter(world).filter(|(_, place)| place.translation.z == 6.0);
    let gone: Vec<_> = spheres.take(SPHERES - LEFT).map(|(entity, _)| entity).collect();
    for entity in gone {
        world.despawn(entity);
    }
    app.step(1);
    until(&mut app, "no room for the rest", |app| {
        let report = report(app);
        report.meshes_without_room == 0 && report.instances == LEFT + 1
    });
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
    app.step(1);
    until(&mut app, "it is never copied", |app| {
        let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
        meshes.get_mut(id).expect("it stays").enable_raytracing = true;
        report(app).instances == 2
    });
}

/// An object that gets a mesh that takes a while to build is shown with its last mesh until then.
#[test]
fn an_object_never_vanishes_for_another_mesh() {
    for (_, mut app) in apps(SIZE / 4, Output::Picture) {
        let camera = spawn_mirror(&mut app, 0.0, SceneName::MirrorRoom);
        let at = Transform::from_xyz(0.0, 0.0, 6.0);
        let ball = spawn_mesh(&mut app, Sphere::new(0.4).mesh().uv(32, 16), unlit([255; 3]), at);
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
