//! Worlds that change: unchanged objects cost nothing.

use crate::{
    common::if_renders,
    pictures::{BOTH, apps_of_both, assert_flip, differing_pixels, reflect, warm_up},
    stage::{add, metal, report, spawn_camera, spawn_mesh, unlit},
};
use bevy::{math::UVec2, prelude::*};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTechnique, ReflectionTracer,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName, SystemClock};

/// Milliseconds of the plugin per frame in a world with this number of objects, one of them moving. It is the lower quartile of all
/// frames, so that other load on the machine counts little.
fn cost(tracer: ReflectionTracerChoice, instances: usize) -> Option<f64> {
    let clock = SystemClock::default();
    let settings = HeadlessSettings {
        size: UVec2::splat(16),
        ..default()
    };
    let mut app = if_renders(HeadlessApp::new(settings, |app| {
        clock.add_plugin(app, RayTracedReflectionsPlugin { tracer, ..default() });
    }))?;
    app.spawn_camera((RayTracedReflections::default(), Transform::default()));
    let world = app.world();
    // Few triangles: all of them are merged before anything is measured.
    let mesh = world.resource_mut::<Assets<Mesh>>().add(Tetrahedron::default());
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(Color::WHITE);
    let entities: Vec<Entity> = (0..instances)
        .map(|index| {
            // Behind the camera.
            let place = Vec3::new((index % 256) as f32, (index / 256) as f32, 10.0);
            let object = (Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()));
            world.spawn((object, Transform::from_translation(place))).id()
        })
        .collect();
    let mover = entities[instances / 2];
    app.warm_up(20_000).expect("the world can be loaded");
    let mut quiet = 0;
    let mut frames = 0;
    let mut times = Vec::new();
    while times.len() < 60 {
        if let Some(mut transform) = app.world().get_mut::<Transform>(mover) {
            transform.translation.z += 0.01;
        }
        clock.take();
        app.step(1);
        let time: f64 = clock.take().iter().map(|(_, milliseconds)| milliseconds).sum();
        app.wait_until_idle().expect("the device is there");
        let report = report(&mut app);
        let ready = report.ready && report.instances == instances && !report.merges_pending;
        quiet = if ready { quiet + 1 } else { 0 };
        if quiet > 40 {
            times.push(time);
        }
        frames += 1;
        assert!(frames < 20_000, "the world doesn't come to rest: {report:?}");
    }
    times.sort_by(f64::total_cmp);
    Some(times[times.len() / 4])
}

#[test]
fn one_mover_costs_as_much_in_a_large_world_as_in_a_small_one() {
    for tracer in BOTH {
        let (Some(small), Some(large)) = (cost(tracer, 2_000), cost(tracer, 40_000)) else {
            return;
        };
        println!("{tracer:?}: {small} ms among 2,000 objects, {large} ms among 40,000");
        assert!(
            large < 1.5 * small + 0.15,
            "{tracer:?}: {small} ms among 2,000 objects, {large} ms among 40,000"
        );
    }
}

const SIZE: UVec2 = UVec2::new(128, 96);

/// Entities of a scene.
struct Tiles {
    camera: Entity,
    ball: Entity,
    board: Entity,
    /// Some of the tiles.
    group: Vec<Entity>,
}

/// A mirror before a wall, a ball, and a lit board. The wall has enough tiles that moving objects get their own structure with ray queries.
fn spawn_tiles(app: &mut HeadlessApp) -> Tiles {
    let floor = Transform::from_translation(Vec3::new(0.0, -0.05, 0.0));
    spawn_mesh(app, Cuboid::new(12.0, 0.1, 12.0), metal(0.0), floor);
    let mesh = add(app, Mesh::from(Cuboid::from_length(0.2)));
    let paints = [[40, 60, 90], [90, 80, 40]].map(|color| add(app, unlit(color)));
    let world = app.world();
    let mut group = Vec::new();
    for index in 0..1_200 {
        let (column, row) = (index % 48, index / 48);
        let place = Vec3::new(0.25 * (column as f32 - 24.0), 0.25 * row as f32 + 0.15, -6.0);
        let material = MeshMaterial3d(paints[(column + row) % 2].clone());
        let tile = world.spawn((Mesh3d(mesh.clone()), material, Transform::from_translation(place)));
        if (27..37).contains(&column) && row < 8 {
            group.push(tile.id());
        }
    }
    let at = Transform::from_xyz(-2.0, 1.5, -2.0);
    let ball = spawn_mesh(app, Sphere::new(0.8), unlit([220, 30, 30]), at);
    // Shadows fall on it, past objects that are in the way or no longer are.
    let board = StandardMaterial {
        perceptual_roughness: 1.0,
        ..default()
    };
    let at = Transform::from_xyz(-2.0, 1.5, -4.5);
    let board = spawn_mesh(app, Rectangle::new(5.0, 3.0), board, at);
    let lamp = PointLight {
        intensity: 400_000.0,
        shadow_maps_enabled: true,
        ..default()
    };
    app.world().spawn((lamp, Transform::from_xyz(-1.0, 2.0, 2.0)));
    let view = Transform::from_xyz(0.0, 2.5, 5.0).looking_at(Vec3::new(0.0, 0.5, -2.0), Vec3::Y);
    Tiles {
        camera: spawn_camera(app, view, SceneName::Demo),
        ball,
        board,
        group,
    }
}

/// Images of all movements of the ball, and of others like it, one after the other.
fn pictures_of_movements(app: &mut HeadlessApp) -> Vec<(&'static str, Vec<u8>)> {
    let scene = spawn_tiles(app);
    let ball = scene.ball;
    reflect(app, scene.camera, ReflectionTechnique::Reference);
    let capture = |app: &mut HeadlessApp| app.capture().unwrap_or_else(|error| panic!("{error}"));
    let mut pictures = vec![("standing", capture(app))];
    for step in 1..=4 {
        let mut transform = app.world().get_mut::<Transform>(ball).unwrap();
        transform.translation.x = -2.0 + step as f32;
        app.step(1);
    }
    pictures.push(("moving", capture(app)));
    let at = Transform::from_xyz(-2.0, 1.0, -2.0);
    let second = spawn_mesh(app, Sphere::new(0.5), unlit([30, 220, 30]), at);
    warm_up(app);
    pictures.push(("one that came", capture(app)));
    app.world().despawn(ball);
    app.step(2);
    pictures.push(("one that went", capture(app)));
    app.world().despawn(second);
    app.step(2);
    pictures.push(("none", capture(app)));
    // The last of the table is removed, and an object that rays never see replaces it.
    app.world().despawn(scene.board);
    app.step(2);
    for _ in 0..3 {
        let added = StandardMaterial {
            alpha_mode: AlphaMode::Add,
            ..default()
        };
        spawn_mesh(app, Sphere::new(0.5), added, Transform::from_xyz(0.0, 0.0, 20.0));
    }
    app.step(4);
    pictures.push(("the board that went", capture(app)));
    // Some of the first objects are removed, and another object takes the place of one in the table.
    for tile in scene.group {
        app.world().despawn(tile);
    }
    app.step(2);
    pictures.push(("tiles that went", capture(app)));
    let third = Transform::from_xyz(1.5, 1.0, -2.0);
    spawn_mesh(app, Sphere::new(0.5), unlit([30, 30, 220]), third);
    warm_up(app);
    pictures.push(("another in their place", capture(app)));
    pictures
}

/// Reflections show moving objects among many others, and objects that join and leave them, in any structure.
#[test]
fn what_moves_among_many_objects_is_seen() {
    let mut pictures = Vec::new();
    for (choice, mut app) in apps_of_both(SIZE, Output::Picture) {
        let found = pictures_of_movements(&mut app);
        let report = app.world().resource::<ReflectionStatus>().report();
        let traced = match choice {
            ReflectionTracerChoice::RayQuery => ReflectionTracer::RayQuery,
            _ => ReflectionTracer::Bvh,
        };
        assert_eq!(report.tracer, Some(traced));
        pictures.push(found);
    }
    for found in &pictures {
        for pair in found.windows(2) {
            let apart = differing_pixels(&pair[0].1, &pair[1].1, 40);
            println!("{} and {}: {apart} pixels differ", pair[0].0, pair[1].0);
            assert!(apart > 150, "{} and {}: {apart} pixels", pair[0].0, pair[1].0);
        }
    }
    if let [ray_query, bvh] = pictures.as_slice() {
        for ((name, expected), (_, actual)) in bvh.iter().zip(ray_query) {
            assert_flip(
                &format!("movement-{}", name.replace(' ', "-")),
                SIZE,
                expected,
                actual,
                0.002,
            );
        }
    }
}
