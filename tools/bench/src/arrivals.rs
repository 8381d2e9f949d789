//! The longest frame while many triangles arrive, with and without the plugin.
//!
//! Images are tiny and show none of the meshes, and the GPU is idle when a frame begins. Both numbers include Bevy's own work on new
//! meshes. With a driver that renders on the CPU, the frame also includes the copies that a GPU would make in parallel, and the kernel's
//! work on its memory.

use crate::{
    table::{Csv, quantile},
    worlds::{SIZE, interval},
};
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::time::Instant;

/// Sectors and stacks of a sphere of 65,000 triangles.
const SPHERE: [u32; 2] = [256, 128];
/// Number of these meshes, and number of measurements.
const CASES: [(&str, usize, usize); 2] = [("3 M triangles arrive", 46, 4), ("10 M triangles arrive", 154, 4)];
/// Milliseconds.
const LIMIT: f64 = 8.0;
/// Frames from one mesh to the next.
const PACE: u32 = 2;
const FRAME_LIMIT: u32 = 20_000;
/// More bytes than an app needs.
const WARM_BYTES: usize = 3 << 30;
const PAGE: usize = 4096;
/// Frames after the last mesh, in which trees over objects are built.
const AFTERMATH: u32 = 60;

/// Frames of one arrival.
struct Arrival {
    /// Milliseconds of each.
    frames: Vec<f64>,
    /// Milliseconds of the plugin's systems in their longest frame.
    plugin: f64,
    /// Seconds until everything can be hit.
    seconds: f64,
    /// Meshes that the device has no room for.
    left_out: usize,
}

/// Measures and prints the cases with `only` in their names.
///
/// # Errors
///
/// If nothing can be rendered, or the meshes don't arrive.
pub fn measure(tracer: ReflectionTracerChoice, only: Option<&str>, csv: &mut Csv) -> Result<(), String> {
    let cases = CASES
        .iter()
        .filter(|case| only.is_none_or(|word| case.0.contains(word)));
    let mut heading = false;
    for (name, meshes, rounds) in cases {
        if !core::mem::replace(&mut heading, true) {
            println!(
                "\nLongest frame while meshes arrive (tracer: {tracer:?}), mean of several rounds with its 95 % interval.\n"
            );
            println!(
                "| case | without ms | interval | with ms | interval | longer by | at most | median longer by | plugin's systems | \
                 seconds | meshes without room |"
            );
            println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
        }
        let (mut with, mut without) = (Vec::new(), Vec::new());
        // By turns, so that both see the same load from the rest of the machine.
        for _ in 0..*rounds {
            without.push(arrive(None, *meshes)?);
            with.push(arrive(Some(tracer), *meshes)?);
        }
        print_row(name, &without, &with, csv);
    }
    Ok(())
}

fn print_row(name: &str, without: &[Arrival], with: &[Arrival], csv: &mut Csv) {
    let of = |arrivals: &[Arrival], share: f64| {
        let values = arrivals.iter().filter_map(|arrival| quantile(&arrival.frames, share));
        interval(&values.collect::<Vec<_>>())
    };
    let most = |of: fn(&Arrival) -> f64| with.iter().map(of).fold(0.0, f64::max);
    let ((off, off_half), (on, on_half)) = (of(without, 1.0), of(with, 1.0));
    let median = of(with, 0.5).0 - of(without, 0.5).0;
    let (plugin, seconds) = (most(|arrival| arrival.plugin), most(|arrival| arrival.seconds));
    let left_out = with.iter().map(|arrival| arrival.left_out).max().unwrap_or_default();
    println!(
        "| {name} | {off:.1} | {:.1} to {:.1} | {on:.1} | {:.1} to {:.1} | {:.1} | {LIMIT:.1} | {median:.1} | {plugin:.1} | {seconds:.1} | \
         {left_out} |",
        off - off_half,
        off + off_half,
        on - on_half,
        on + on_half,
        on - off,
    );
    for (measure, value, unit) in [
        ("without", off, "ms"),
        ("without_half_interval", off_half, "ms"),
        ("with", on, "ms"),
        ("with_half_interval", on_half, "ms"),
        ("median_longer_by", median, "ms"),
        ("plugin", plugin, "ms"),
        ("seconds", seconds, "s"),
        ("without_room", left_out as f64, "meshes"),
    ] {
        csv.add(name, "cpu", &format!("arrivals_{measure}"), value, unit);
    }
}

/// Touches memory. A virtual machine might get a page from its host only at its first use. That takes so long (up to 2 ms per megabyte was
/// seen) that the app with the larger growth would always have the longest frame.
fn warm_memory() {
    let mut memory = vec![0_u8; WARM_BYTES];
    for byte in memory.iter_mut().step_by(PAGE) {
        *byte = 1;
    }
    core::hint::black_box(&memory);
}

/// Has meshes arrive one after the other while the camera moves.
fn arrive(tracer: Option<ReflectionTracerChoice>, count: usize) -> Result<Arrival, String> {
    warm_memory();
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
    let [sectors, stacks] = SPHERE;
    let sphere = Sphere::new(1.0).mesh().uv(sectors, stacks);
    let spawn = |app: &mut HeadlessApp, index: usize| {
        let world = app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(sphere.clone());
        // Behind the camera.
        let place = Transform::from_xyz(3.0 * index as f32, 0.0, 10.0);
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material.clone()), place));
    };
    spawn(&mut app, count);
    if tracer.is_some() {
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
    }
    app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
    app.step(4);
    if let Some(status) = app.world().get_resource::<ReflectionStatus>() {
        let report = status.report();
        if report.tracer.is_none() {
            return Err(format!("rays can't be traced: {}", report.reasons.join(". ")));
        }
    }
    let mut arrival = Arrival {
        frames: Vec::new(),
        plugin: 0.0,
        seconds: 0.0,
        left_out: 0,
    };
    let (begin, mut spawned, mut after) = (Instant::now(), 0, 0);
    while after < AFTERMATH {
        let frame = arrival.frames.len() as u32;
        if frame > FRAME_LIMIT {
            let status = app.world().get_resource::<ReflectionStatus>();
            let report = status.map(ReflectionStatus::report);
            return Err(format!(
                "the meshes have not arrived after {FRAME_LIMIT} frames: {report:?}"
            ));
        }
        if spawned < count && frame.is_multiple_of(PACE) {
            spawn(&mut app, spawned);
            spawned += 1;
        }
        if let Some(mut transform) = app.world().get_mut::<Transform>(camera) {
            transform.translation.x += 0.01;
        }
        arrival.step(&mut app, &clock)?;
        let complete = match app.world().get_resource::<ReflectionStatus>() {
            None => true,
            Some(status) => {
                let report = status.report();
                arrival.left_out = report.meshes_without_room;
                report.ready && report.meshes_pending == 0 && report.instances + arrival.left_out == count + 1
            }
        };
        if spawned == count && complete {
            after += 1;
        } else {
            arrival.seconds = begin.elapsed().as_secs_f64();
        }
    }
    Ok(arrival)
}

impl Arrival {
    fn step(&mut self, app: &mut HeadlessApp, clock: &SystemClock) -> Result<(), String> {
        clock.take();
        let begin = Instant::now();
        app.step(1);
        self.frames.push(begin.elapsed().as_secs_f64() * 1e3);
        let plugin = clock.take().iter().map(|(_, milliseconds)| milliseconds).sum();
        self.plugin = self.plugin.max(plugin);
        app.wait_until_idle().map_err(|error| error.to_string())
    }
}
