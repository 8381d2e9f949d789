//! Levels that are loaded and unloaded: space is freed, and used again.

use crate::{
    pictures::{PATIENCE, app_of_device, apps, device_without, picture_app, red_pixels, reflect, warm_up},
    stage::{RED, SIZE, add, frame, report, spawn_mesh, spawn_mirror, texel, unlit, until},
};
use bevy::{
    prelude::*,
    render::{RenderApp, settings::WgpuFeatures},
};
use bevy_glint::{
    ReflectionTechnique, ReflectionTextureMode,
    internals::{
        instances::SceneInstances, materials::MaterialTable, meshes::SceneMeshes, refuse_memory, textures::TextureTable,
    },
};
use glint_scenes::{HeadlessApp, Output, SceneName, is_alone};
use std::time::{Duration, Instant};

/// Objects of a level. Each has its own mesh, material and image.
const OBJECTS: usize = 40;
const ROUNDS: usize = 50;

fn spawn_textured(app: &mut HeadlessApp, mesh: impl Into<Mesh>, color: [u8; 3], at: Transform) -> Entity {
    let material = StandardMaterial {
        base_color_texture: Some(add(app, texel(color))),
        alpha_mode: AlphaMode::Mask(0.5),
        ..unlit([255; 3])
    };
    spawn_mesh(app, mesh, material, at)
}

fn spawn_level(app: &mut HeadlessApp) -> Vec<Entity> {
    (0..OBJECTS)
        .map(|index| {
            let mesh = Sphere::new(0.1 + 0.001 * index as f32).mesh().uv(16, 12);
            let place = Transform::from_xyz((index % 10) as f32 - 4.5, (index / 10) as f32 - 4.0, 9.0);
            spawn_textured(app, mesh, [index as u8, 128, 0], place)
        })
        .collect()
}

/// Renders until all objects can be hit, and no work is left.
#[track_caller]
fn until_there_are(app: &mut HeadlessApp, objects: usize) {
    app.step(1);
    until(app, &format!("not {objects} objects"), |app| {
        let report = report(app);
        let is_busy = report.meshes_pending > 0 || report.merges_pending || report.micromaps_pending;
        report.instances == objects && !is_busy
    });
}

/// Renders until all objects can be hit.
fn until_loaded(app: &mut HeadlessApp) {
    app.step(1);
    until(app, "the level is not there", |app| {
        let report = report(app);
        report.instances == OBJECTS + 1 && report.meshes_pending == 0
    });
    // Their textures follow.
    app.step(2);
}

/// Renders until buffers have at most this number of bytes, or for many frames. They become smaller in parts, frame by frame.
fn shrink(app: &mut HeadlessApp, most: u64) {
    for _ in 0..PATIENCE {
        if inventory(app).1[2] <= most {
            break;
        }
        app.step(1);
    }
}

/// Spawns a mirror and a camera that reflects before it, and waits until rays can hit the mirror.
fn load_mirror(app: &mut HeadlessApp) {
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    reflect(app, camera, ReflectionTechnique::Reference);
    until_there_are(app, 1);
}

/// Lengths of tables, bytes in use, and bytes of buffers.
fn inventory(app: &mut HeadlessApp) -> ([usize; 4], [u64; 3]) {
    let report = report(app);
    let world = app.app().sub_app(RenderApp).world();
    let meshes = world.resource::<SceneMeshes>();
    (
        [
            world.resource::<SceneInstances>().slots().len(),
            world.resource::<MaterialTable>().materials().len(),
            world.resource::<TextureTable>().texture_count() as usize,
            report.meshes_pending,
        ],
        [
            meshes.geometry.used_bytes(),
            meshes.bvh.used_bytes(),
            report.scene_bytes,
        ],
    )
}

#[test]
fn levels_that_go_give_everything_back() {
    for (tracer, mut app) in apps(SIZE / 4, Output::Picture) {
        let app = &mut app;
        load_mirror(app);
        let before = inventory(app);
        let mut loaded = None;
        for round in 0..ROUNDS {
            let level = spawn_level(app);
            // Merging waits for a second: levels change before and after it.
            if round == 0 {
                until_there_are(app, OBJECTS + 1);
            } else {
                until_loaded(app);
            }
            let inventory = inventory(app);
            let first = *loaded.get_or_insert(inventory);
            assert_eq!(inventory.0, first.0, "{tracer:?}: round {round}");
            for entity in level {
                app.world().despawn(entity);
            }
            app.step(2);
        }
        until_there_are(app, 1);
        assert!(loaded.is_some_and(|loaded| loaded.1[0] > 2 * before.1[0]));
        let [geometry, bvh, bytes] = before.1;
        shrink(app, 2 * bytes);
        // Trees that were in the way are merged again.
        until_there_are(app, 1);
        let after = inventory(app);
        assert_eq!(
            (after.0, after.1[..2].to_vec()),
            (before.0, vec![geometry, bvh]),
            "{tracer:?}: tables, bytes in use"
        );
        // Buffers have more room than they need.
        assert!(
            after.1[2] <= 2 * bytes,
            "{tracer:?}: {} bytes of buffers, {bytes} before",
            after.1[2]
        );
    }
}

/// Most objects of a crowd are removed, and the last one added stays. No table stays as long as it was for the crowd.
#[test]
fn the_last_of_many_objects_keeps_no_table_long() {
    const CROWD: usize = 10_000;
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        load_mirror(app);
        let ([before, ..], [.., bytes]) = inventory(app);
        let mesh = add(app, Mesh::from(Cuboid::from_length(0.1)));
        let material = add(app, unlit([0, 255, 0]));
        let far = (0..CROWD).map(|i| Transform::from_xyz((i % 100) as f32 - 50.0, (i / 100) as f32 - 50.0, 90.0));
        let crowd = far.map(|place| (Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), place));
        let crowd: Vec<_> = crowd.collect();
        let crowd: Vec<Entity> = app.world().spawn_batch(crowd).collect();
        app.step(3);
        let survivor = Transform::from_xyz(0.0, 0.0, 6.0);
        spawn_mesh(app, Cuboid::from_length(1.5), unlit(RED), survivor);
        warm_up(app);
        let [long, ..] = inventory(app).0;
        assert_eq!(long, before + CROWD + 1, "{tracer:?}");
        let red = red_pixels(&app.capture().unwrap());
        assert!(red > 100, "{tracer:?}: {red} pixels show the last one");
        for entity in crowd {
            app.world().despawn(entity);
        }
        warm_up(app);
        let ([after, ..], _) = inventory(app);
        assert!(after < 64, "{tracer:?}: {after} slots for two objects");
        let after = red_pixels(&app.capture().unwrap());
        assert_eq!(after, red, "{tracer:?}: pixels that show the last one");
        let large = inventory(app).1[2];
        shrink(app, 2 * bytes);
        let small = inventory(app).1[2];
        println!("{tracer:?}: {bytes} bytes of buffers, {large} when the crowd has gone, then {small}");
        assert!(
            small <= 2 * bytes,
            "{tracer:?}: {small} bytes of buffers, {bytes} before"
        );
        let later = red_pixels(&app.capture().unwrap());
        assert_eq!(later, red, "{tracer:?}: pixels that show the last one");
    }
}

/// Trees that are merged while a level uses the start of the buffer lie behind that level. They must not keep the buffer large once the
/// level is gone.
#[test]
#[ignore = "long: waits for merged trees"]
fn a_tree_merged_behind_a_level_lets_the_buffer_shrink() {
    // The other tracer doesn't merge.
    let Some(mut app) = picture_app(SIZE / 4) else { return };
    let app = &mut app;
    load_mirror(app);
    let world = app.world();
    let object = world.query_filtered::<Entity, With<Mesh3d>>().single(world).unwrap();
    let (_, [geometry, bvh, bytes]) = inventory(app);
    let mut level = spawn_level(app);
    until_loaded(app);
    // The object leaves its merged tree, and becomes static again. The level doesn't, and takes the space of that tree.
    app.world().get_mut::<Transform>(object).unwrap().translation.x += 0.01;
    for merged in [0, 1] {
        for _ in 0..PATIENCE {
            for entity in &level {
                app.world().get_mut::<Transform>(*entity).unwrap().translation.x += 1e-4;
            }
            app.step(1);
            if report(app).merged_instances == merged {
                break;
            }
        }
        assert_eq!(report(app).merged_instances, merged);
        if merged == 0 {
            let place = Transform::from_xyz(0.0, 0.0, 9.0);
            level.push(spawn_textured(app, Rectangle::new(0.1, 0.1), [0; 3], place));
        }
    }
    for entity in level {
        app.world().despawn(entity);
    }
    until_there_are(app, 1);
    let large = inventory(app).1[2];
    assert!(large > 2 * bytes, "{large} bytes of buffers, {bytes} before");
    shrink(app, 2 * bytes);
    until_there_are(app, 1);
    let (_, after) = inventory(app);
    assert_eq!(after[..2], [geometry, bvh], "bytes in use");
    assert!(after[2] <= 2 * bytes, "{} bytes of buffers, {bytes} before", after[2]);
}

/// The next level is loaded before the last one is removed, so it lies behind it. It must not keep the buffers large either.
#[test]
#[ignore = "long: waits for merged trees"]
fn a_level_that_was_loaded_behind_another_lets_the_buffers_shrink() {
    const LATE: usize = 3;
    for (tracer, mut app) in apps(SIZE / 4, Output::Picture) {
        let app = &mut app;
        load_mirror(app);
        let bytes = inventory(app).1[2];
        let most = bytes / 2 * 3;
        let level = spawn_level(app);
        until_loaded(app);
        for x in 0..LATE {
            let place = Transform::from_xyz(x as f32, 0.0, 9.0);
            spawn_textured(app, Sphere::new(0.1).mesh().uv(16, 12), [0; 3], place);
        }
        until_there_are(app, 1 + OBJECTS + LATE);
        for entity in level {
            app.world().despawn(entity);
        }
        until_there_are(app, 1 + LATE);
        let large = inventory(app).1[2];
        shrink(app, most - 1);
        until_there_are(app, 1 + LATE);
        let after = inventory(app).1[2];
        println!("{tracer:?}: {bytes} bytes of buffers, {large} with two levels, {after} with the second");
        assert!(large > most && after < most, "{tracer:?}: {after}");
    }
}

/// An app on a device that has textures in layers only.
fn app_with_layers() -> Option<HeadlessApp> {
    app_of_device(SIZE, device_without(WgpuFeatures::TEXTURE_BINDING_ARRAY))
}

/// Layers without memory show plain colours, and are requested again.
#[test]
fn textures_without_memory_get_some_later() {
    if !is_alone("levels::textures_without_memory_get_some_later") {
        return;
    }
    let Some(mut app) = app_with_layers() else { return };
    let app = &mut app;
    let device = app.device().unwrap().clone();
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    reflect(app, camera, ReflectionTechnique::Reference);
    refuse_memory(&device, true);
    for index in 0..20 {
        let far = Transform::from_xyz(index as f32, 0.0, 90.0);
        spawn_textured(app, Rectangle::new(0.1, 0.1), [0, 255, 0], far);
    }
    // The first layers exist from the start: the others take them.
    (0..4).for_each(|_| frame(app));
    spawn_textured(app, Cuboid::from_length(3.0), RED, Transform::from_xyz(0.0, 0.0, 6.0));
    (0..20).for_each(|_| frame(app));
    let red = |app: &HeadlessApp| red_pixels(&app.capture().unwrap());
    assert_eq!(red(app), 0, "there is no memory for its texture");
    refuse_memory(&device, false);
    let start = Instant::now();
    while red(app) <= 100 {
        frame(app);
        // It is requested again after five seconds.
        assert!(start.elapsed() < Duration::from_secs(60), "the texture never came");
    }
}

/// A texture without space gets some once another texture is removed.
#[test]
fn a_texture_without_a_place_gets_one_later() {
    // Copies in layers; every device supports at least this number of them.
    const PLACES: usize = 256;
    let Some(mut app) = app_with_layers() else { return };
    let app = &mut app;
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    reflect(app, camera, ReflectionTechnique::Reference);
    assert_eq!(
        report(app).textures,
        Some(ReflectionTextureMode::Layers { layers: PLACES as u32 })
    );
    let far = Transform::from_xyz(0.0, 0.0, 90.0);
    let level: Vec<_> = (0..PLACES)
        .map(|_| spawn_textured(app, Rectangle::new(0.1, 0.1), [0, 255, 0], far))
        .collect();
    warm_up(app);
    let late = Transform::from_xyz(0.0, 0.0, 6.0);
    spawn_textured(app, Cuboid::from_length(3.0), RED, late);
    warm_up(app);
    assert_eq!(
        red_pixels(&app.capture().unwrap()),
        0,
        "there is no place for its texture"
    );
    app.world().despawn(level[7]);
    (0..4).for_each(|_| frame(app));
    let red = red_pixels(&app.capture().unwrap());
    assert!(red > 100, "{red} pixels of the mirror show the texture");
}
