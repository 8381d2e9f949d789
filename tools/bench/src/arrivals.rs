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
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionStatusReport, ReflectionTracerChoice,
    ReflectionUploadBudget,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::{
    thread,
    time::{Duration, Instant},
};

/// Sectors and stacks of a sphere of 65,000 triangles.
const SPHERE: [u32; 2] = [256, 128];
/// Number of these meshes, and number of measurements.
const CASES: [(&str, usize, usize); 2] = [("3 M triangles arrive", 46, 4), ("10 M triangles arrive", LEVEL, 4)];
/// The name of the table by budget.
const LEVELS: &str = "levels that arrive at once";
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

/// Meshes of a level that arrives at once: 10 million triangles.
const LEVEL: usize = 154;
/// Its budgets, in MiB per frame. The first one is the default.
const BUDGETS: [u64; 3] = [2, 16, 64];
/// Shortest frame.
const FRAME: Duration = Duration::from_micros(16_667);

/// Frames of one arrival.
#[derive(Default)]
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
    for (index, (name, meshes, rounds)) in cases.enumerate() {
        if index == 0 {
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
    if only.is_none_or(|word| LEVELS.contains(word)) {
        measure_levels(tracer, csv)?;
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

/// An app in which meshes arrive.
struct Stage {
    app: HeadlessApp,
    clock: SystemClock,
    camera: Entity,
    material: Handle<StandardMaterial>,
    sphere: Mesh,
    spawned: usize,
}

impl Stage {
    /// Opens an app with one mesh that is there already.
    fn open(tracer: Option<ReflectionTracerChoice>) -> Result<Self, String> {
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
        let [sectors, stacks] = SPHERE;
        let mut stage = Self {
            camera,
            material: app.world().resource_mut::<Assets<StandardMaterial>>().add(Color::WHITE),
            sphere: Sphere::new(1.0).mesh().uv(sectors, stacks),
            app,
            clock,
            spawned: 0,
        };
        stage.spawn();
        if tracer.is_some() {
            let world = stage.app.world();
            world.entity_mut(camera).insert(RayTracedReflections::default());
        }
        stage.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        stage.app.step(4);
        match stage.report() {
            Some(report) if report.tracer.is_none() => {
                Err(format!("rays can't be traced: {}", report.reasons.join(". ")))
            }
            _ => Ok(stage),
        }
    }

    /// The next object, behind the camera and farther away.
    fn spawn(&mut self) {
        let world = self.app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(self.sphere.clone());
        let place = Transform::from_xyz(3.0 * self.spawned as f32, 0.0, 10.0);
        world.spawn((Mesh3d(mesh), MeshMaterial3d(self.material.clone()), place));
        self.spawned += 1;
    }

    fn report(&mut self) -> Option<ReflectionStatusReport> {
        self.app
            .world()
            .get_resource::<ReflectionStatus>()
            .map(ReflectionStatus::report)
    }

    /// Renders a frame. Returns whether all objects can be hit that find room.
    fn step(&mut self, arrival: &mut Arrival) -> Result<bool, String> {
        if arrival.frames.len() as u32 > FRAME_LIMIT {
            return Err(format!(
                "the meshes have not arrived after {FRAME_LIMIT} frames: {:?}",
                self.report()
            ));
        }
        if let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera) {
            transform.translation.x += 0.01;
        }
        self.clock.take();
        let begin = Instant::now();
        self.app.step(1);
        arrival.frames.push(begin.elapsed().as_secs_f64() * 1e3);
        let plugin = self.clock.take().iter().map(|(_, milliseconds)| milliseconds).sum();
        arrival.plugin = arrival.plugin.max(plugin);
        self.app.wait_until_idle().map_err(|error| error.to_string())?;
        Ok(self.report().is_none_or(|report| {
            arrival.left_out = report.meshes_without_room;
            report.ready && report.meshes_pending == 0 && report.instances + arrival.left_out == self.spawned
        }))
    }
}

/// Has meshes arrive one after the other while the camera moves.
fn arrive(tracer: Option<ReflectionTracerChoice>, count: usize) -> Result<Arrival, String> {
    let mut stage = Stage::open(tracer)?;
    let mut arrival = Arrival::default();
    let (begin, mut after) = (Instant::now(), 0);
    while after < AFTERMATH {
        if stage.spawned <= count && (arrival.frames.len() as u32).is_multiple_of(PACE) {
            stage.spawn();
        }
        if stage.step(&mut arrival)? && stage.spawned > count {
            after += 1;
        } else {
            arrival.seconds = begin.elapsed().as_secs_f64();
        }
    }
    Ok(arrival)
}

/// Has all meshes arrive in one frame of an app with 60 frames per second.
fn arrive_at_once(tracer: ReflectionTracerChoice, bytes_per_frame: u64) -> Result<Arrival, String> {
    let mut stage = Stage::open(Some(tracer))?;
    let budget = ReflectionUploadBudget { bytes_per_frame };
    stage.app.world().insert_resource(budget);
    for _ in 0..LEVEL {
        stage.spawn();
    }
    let mut arrival = Arrival::default();
    let begin = Instant::now();
    while !stage.step(&mut arrival)? {
        let next = begin + FRAME * arrival.frames.len() as u32;
        thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    arrival.seconds = begin.elapsed().as_secs_f64();
    Ok(arrival)
}

/// Measures and prints how long a level takes, by the budget for uploads.
fn measure_levels(tracer: ReflectionTracerChoice, csv: &mut Csv) -> Result<(), String> {
    println!("\nA level of 10 M triangles that arrives in one frame (tracer: {tracer:?}), by the bytes per frame.\n");
    println!("| MiB per frame | seconds | frames | longest frame after the first ms | median frame ms |");
    println!("| ---: | ---: | ---: | ---: | ---: |");
    for mebibytes in BUDGETS {
        let arrival = arrive_at_once(tracer, mebibytes << 20)?;
        // In the first one, Bevy copies all meshes.
        let later = &arrival.frames[1..];
        let of = |share| quantile(later, share).unwrap_or_default();
        let (longest, median) = (of(1.0), of(0.5));
        let (seconds, frames) = (arrival.seconds, arrival.frames.len());
        println!("| {mebibytes} | {seconds:.2} | {frames} | {longest:.1} | {median:.1} |");
        let name = format!("a level with {mebibytes} MiB per frame");
        for (measure, value, unit) in [
            ("seconds", seconds, "s"),
            ("frames", frames as f64, "frames"),
            ("longest", longest, "ms"),
            ("median", median, "ms"),
        ] {
            csv.add(&name, "cpu", &format!("level_{measure}"), value, unit);
        }
    }
    Ok(())
}
