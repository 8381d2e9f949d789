//! Objects at rest are merged into trees in world space: nothing of that may be seen.

#[path = "common/pictures.rs"]
mod pictures;

use bevy::{math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionStatus, StatusReport, Technique, TracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName};
use pictures::{app, assert_flip, flip, spawn, warm_up};

const SIZE: UVec2 = UVec2::new(96, 64);
/// Frames that merging may take.
const PATIENCE: u32 = 20_000;

fn report(app: &mut HeadlessApp) -> StatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

/// Waits until nothing is left to be merged.
fn rest(app: &mut HeadlessApp) -> StatusReport {
    app.step(3);
    for _ in 0..PATIENCE {
        let report = report(app);
        if !report.merges_pending {
            return report;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
        app.step(1);
    }
    panic!("merging goes on: {:?}", report(app));
}

#[test]
fn merging_is_not_seen() {
    let Some(mut app) = app(SIZE, Output::Picture, TracerChoice::Bvh) else {
        return;
    };
    let camera = spawn(&mut app, SceneName::MirrorRoom, Technique::Reference);
    let first = app.capture().unwrap();
    let merged = rest(&mut app);
    assert!(
        merged.instances > 1 && merged.merged_instances == merged.instances,
        "{merged:?}"
    );
    assert!(merged.merge_builds >= 1 && merged.merged_triangles > 0, "{merged:?}");
    assert_flip("merged", SIZE, &first, &app.capture().unwrap(), 0.002);

    // A still scene stays as it is.
    app.step(20);
    assert_eq!(report(&mut app), merged);

    let world = app.world();
    let mut objects = world.query_filtered::<Entity, With<Mesh3d>>();
    let subject = objects.iter(world).next().unwrap();
    world.get_mut::<Transform>(subject).unwrap().translation.x += 0.5;
    app.step(3);
    assert_eq!(report(&mut app).merged_instances, 0, "the moved object is seen at once");
    let moved = app.capture().unwrap();
    let again = rest(&mut app);
    assert_eq!(again.merged_instances, again.instances);
    assert_flip("merged-again", SIZE, &moved, &app.capture().unwrap(), 0.002);

    app.world().entity_mut(subject).despawn();
    app.step(3);
    let gone = report(&mut app);
    assert_eq!((gone.merged_instances, gone.instances), (0, merged.instances - 1));
    let less = app.capture().unwrap();
    rest(&mut app);
    assert_flip("merged-less", SIZE, &less, &app.capture().unwrap(), 0.002);

    app.world().entity_mut(camera).remove::<RayTracedReflections>();
    app.step(3);
    let idle = report(&mut app);
    assert_eq!((idle.merged_instances, idle.merged_triangles), (0, 0));
}

/// Alpha-masked objects share trees with all others.
#[test]
fn masked_objects_are_merged() {
    let Some(mut app) = app(SIZE, Output::Picture, TracerChoice::Bvh) else {
        return;
    };
    spawn(&mut app, SceneName::MirrorRoom, Technique::Reference);
    let solid = rest(&mut app);
    let opaque = app.capture().unwrap();

    let world = app.world();
    let mut objects = world.query::<(Entity, &MeshMaterial3d<StandardMaterial>)>();
    let objects: Vec<_> = objects
        .iter(world)
        .map(|(entity, material)| (entity, material.id()))
        .collect();
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    // All but the mirror are unlit.
    let is_subject = |id: AssetId<StandardMaterial>| materials.get(id).is_some_and(|material| material.unlit);
    let masked: Vec<_> = objects.into_iter().filter(|(_, id)| is_subject(*id)).take(2).collect();
    assert_eq!(masked.len(), 2);
    for (_, id) in &masked {
        materials.get_mut(*id).unwrap().alpha_mode = AlphaMode::Mask(0.5);
    }
    warm_up(&mut app);
    let single = app.capture().unwrap();
    assert_flip("masked", SIZE, &opaque, &single, 0.002);
    let merged = rest(&mut app);
    assert_eq!(merged.merged_instances, merged.instances);
    assert!(merged.merge_builds > solid.merge_builds, "{merged:?}");
    assert_flip("masked-merged", SIZE, &single, &app.capture().unwrap(), 0.002);

    // What the alpha test cuts out is not seen, merged or not.
    let mut materials = app.world().resource_mut::<Assets<StandardMaterial>>();
    for (_, id) in &masked {
        materials.get_mut(*id).unwrap().base_color.set_alpha(0.0);
    }
    warm_up(&mut app);
    assert_eq!(report(&mut app).merged_instances, merged.instances);
    let cut_out = app.capture().unwrap();
    assert!(flip(SIZE, &opaque, &cut_out).0 > 0.01);
    for (entity, _) in &masked {
        app.world().entity_mut(*entity).despawn();
    }
    warm_up(&mut app);
    assert_flip("masked-out", SIZE, &app.capture().unwrap(), &cut_out, 0.002);
}
