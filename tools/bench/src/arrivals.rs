//! The longest frame while many triangles arrive, with and without the plugin.
//!
//! Pictures are tiny and show none of the meshes, so that frames take the time of the CPU alone, and the GPU is idle when one begins.
//! Bevy's own work on new meshes is in both.

use crate::{
    table::Csv,
    worlds::{SIZE, interval},
};
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::time::Instant;

/// Sectors and stacks of a sphere of 260,000 triangles.
const SPHERE: [u32; 2] = [400, 326];
/// Such meshes in turn: three and ten million triangles.
const CASES: [(&str, usize); 2] = [("3 M triangles arrive", 12), ("10 M triangles arrive", 39)];
/// Milliseconds.
const LIMIT: f64 = 8.0;
/// Frames without the plugin, which has nothing to build.
const FRAMES_WITHOUT: u32 = 120;
const FRAME_LIMIT: u32 = 5_000;

/// Frames of one arrival.
struct Arrival {
    /// Milliseconds of the longest one.
    longest: f64,
    /// Milliseconds of the plugin's systems in the frame in which they took longest.
    plugin: f64,
    frames: u32,
}

/// Measures and prints. `only` leaves out the cases whose names don't contain it.
///
/// # Errors
///
/// If nothing can be rendered, or the meshes don't arrive.
pub fn measure(tracer: ReflectionTracerChoice, rounds: u32, only: Option<&str>, csv: &mut Csv) -> Result<(), String> {
    let cases = CASES
        .iter()
        .filter(|(name, _)| only.is_none_or(|word| name.contains(word)));
    let mut heading = false;
    for (name, meshes) in cases {
        if !core::mem::replace(&mut heading, true) {
            println!("\nLongest frame of an arrival, mean of {rounds} rounds.\n");
            println!(
                "| case | without ms | with ms | 95 % interval | longer by | at most | plugin's systems | frames |"
            );
            println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
        }
        let (mut with, mut without) = (Vec::new(), Vec::new());
        // In turn, so that what else the machine does counts for both.
        for _ in 0..rounds {
            without.push(arrive(None, *meshes)?);
            with.push(arrive(Some(tracer), *meshes)?);
        }
        let longest =
            |arrivals: &[Arrival]| interval(&arrivals.iter().map(|arrival| arrival.longest).collect::<Vec<_>>());
        let ((off, _), (on, half)) = (longest(&without), longest(&with));
        let plugin = with.iter().fold(0.0, |most: f64, arrival| most.max(arrival.plugin));
        let frames = with.iter().map(|arrival| arrival.frames).max().unwrap_or_default();
        println!(
            "| {name} | {off:.1} | {on:.1} | {:.1} to {:.1} | {:.1} | {LIMIT:.1} | {plugin:.1} | {frames} |",
            on - half,
            on + half,
            on - off
        );
        for (what, value) in [
            ("without", off),
            ("with", on),
            ("with_half_interval", half),
            ("plugin", plugin),
        ] {
            csv.add(name, "cpu", &format!("arrivals_{what}"), value, "ms");
        }
    }
    Ok(())
}

/// Has meshes arrive in one frame while the camera moves.
fn arrive(tracer: Option<ReflectionTracerChoice>, count: usize) -> Result<Arrival, String> {
    let clock = SystemClock::default();
    let settings = HeadlessSettings {
        size: SIZE,
        ..default()
    };
    let mut app = HeadlessApp::new(settings, |app| {
        if let Some(tracer) = tracer {
            clock.add_plugin(app, RayTracedReflectionsPlugin { tracer, ..default() });
        }
    })
    .map_err(|error| error.to_string())?;
    let camera = app.spawn_camera(Transform::default());
    let material = app.world().resource_mut::<Assets<StandardMaterial>>().add(Color::WHITE);
    let ground = app.world().resource_mut::<Assets<Mesh>>().add(Plane3d::default());
    app.world().spawn((
        Mesh3d(ground),
        MeshMaterial3d(material.clone()),
        Transform::from_xyz(0.0, -1.0, 0.0),
    ));
    if tracer.is_some() {
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
    }
    app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
    app.step(4);
    let [sectors, stacks] = SPHERE;
    let sphere = Sphere::new(1.0).mesh().uv(sectors, stacks);
    for index in 0..count {
        let world = app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(sphere.clone());
        // Behind the camera.
        let place = Transform::from_xyz(3.0 * index as f32, 0.0, 10.0);
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material.clone()), place));
    }
    let mut arrival = Arrival {
        longest: 0.0,
        plugin: 0.0,
        frames: 0,
    };
    while arrival.frames < FRAME_LIMIT {
        if let Some(mut transform) = app.world().get_mut::<Transform>(camera) {
            transform.translation.x += 0.01;
        }
        clock.take();
        let begin = Instant::now();
        app.step(1);
        arrival.longest = arrival.longest.max(begin.elapsed().as_secs_f64() * 1e3);
        let plugin = clock.take().iter().map(|(_, milliseconds)| milliseconds).sum();
        arrival.plugin = arrival.plugin.max(plugin);
        arrival.frames += 1;
        app.wait_until_idle().map_err(|error| error.to_string())?;
        let has_arrived = match tracer {
            None => arrival.frames == FRAMES_WITHOUT,
            Some(_) => {
                let report = app.world().resource::<ReflectionStatus>().report();
                report.ready && report.meshes_pending == 0 && report.instances == count + 1 && !report.merges_pending
            }
        };
        if has_arrived {
            return Ok(arrival);
        }
    }
    Err(format!("the meshes have not arrived after {FRAME_LIMIT} frames"))
}
