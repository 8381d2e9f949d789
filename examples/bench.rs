//! Rays per second of both tracers, times of the passes, and times and sizes of acceleration structures.
//!
//! `cargo run --release --example bench -- --scene atrium --csv bench.csv`
//!
//! Rays are timed alone: one kernel writes them into a buffer, tile by tile, and the timed kernel only reads, traces and stores
//! what they hit. All times on the GPU come from its own clock.

#[path = "bench/build.rs"]
mod build;
mod common;
#[path = "bench/kernels.rs"]
mod kernels;
#[path = "bench/measure.rs"]
mod measure;
#[path = "bench/table.rs"]
mod table;

use argh::FromArgs;
use bevy::{
    prelude::*,
    render::renderer::{RenderAdapterInfo, RenderDevice},
};
use bevy_glint::{Backend, Tracer};
use common::{Size, TracerWord};
use glint_scenes::{HeadlessApp, HeadlessSettings, SceneName};
use measure::{Bench, Tables, render_world};
use std::{path::PathBuf, process::ExitCode, str::FromStr};
use table::{Csv, Table};

const TECHNIQUES: &str = "reference,quarter,quarter-inline,vrs-roughness,vrs-grazing,vrs-combined,vrs-roughness@hardware,\
    vrs-grazing@hardware,paper,low,medium,high,ultra,idle";
/// Mesa's CPU driver crashes on ray queries in fragment shaders.
const CPU_TECHNIQUES: &str = "reference,quarter,vrs-roughness,vrs-grazing,vrs-combined,paper,idle";

/// Measure rays per second and build times.
#[derive(FromArgs)]
struct Arguments {
    /// demo, atrium, `atrium_small`, temple, street, `mirror_room`, furnace or `emissive_floor`; may be given several times
    /// (default: demo, `atrium_small` and atrium)
    #[argh(option)]
    scene: Vec<SceneName>,
    /// auto, ray-query, bvh or all (default: all that the adapter has)
    #[argh(option, default = "Tracers::All")]
    tracer: Tracers,
    /// width and height in pixels (default: 1920x1080; 480x270 on a CPU)
    #[argh(option)]
    size: Option<Size>,
    /// frames to measure (default: 60; 5 on a CPU)
    #[argh(option)]
    frames: Option<u32>,
    /// techniques whose passes are timed, separated by commas; `@hardware` behind one chooses that back end, and `idle` is a
    /// camera with nothing to reflect on (default: all but the slow quarter-inline on a CPU)
    #[argh(option)]
    techniques: Option<String>,
    /// fineness of curved parts, 0.25 to 8
    #[argh(option, default = "1.0")]
    detail: f32,
    /// triangles of the generated mesh whose BVH is built
    #[argh(option, default = "1_000_000")]
    triangles: u32,
    /// leave out the rays
    #[argh(switch)]
    skip_rays: bool,
    /// leave out building on the CPU
    #[argh(switch)]
    skip_build: bool,
    /// write all values as CSV
    #[argh(option)]
    csv: Option<PathBuf>,
}

#[derive(Clone, Copy)]
enum Tracers {
    One(TracerWord),
    All,
}

impl FromStr for Tracers {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "all" => Ok(Self::All),
            _ => word
                .parse::<TracerWord>()
                .map(Self::One)
                .map_err(|error| format!("{error}, all")),
        }
    }
}

impl Tracers {
    fn list(self) -> Vec<TracerWord> {
        match self {
            Self::One(word) => vec![word],
            Self::All => vec![TracerWord::RayQuery, TracerWord::Bvh],
        }
    }
}

fn main() -> ExitCode {
    common::report(run(&argh::from_env()))
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let mut csv = Csv::default();
    let mut adapter = "CPU".to_owned();
    let mut size_word = "-".to_owned();
    if !arguments.skip_rays {
        let machine = Machine::probe()?;
        let fallback = if machine.is_cpu {
            UVec2::new(480, 270)
        } else {
            UVec2::new(1920, 1080)
        };
        let size = arguments.size.map_or(fallback, |size| size.0);
        let needed = kernels::largest_buffer(size);
        if needed > machine.buffer_limit {
            return Err(format!(
                "{}x{} needs a buffer of {needed} bytes, and {} allows {}; pass a smaller --size",
                size.x, size.y, machine.name, machine.buffer_limit
            ));
        }
        let frames = arguments.frames.unwrap_or(if machine.is_cpu { 5 } else { 60 }).max(1);
        size_word = format!("{}x{}", size.x, size.y);
        println!("{}, {size_word}, {frames} frames", machine.name);
        if machine.is_cpu {
            println!("This adapter is a CPU: its times can't be compared with those of GPUs.");
        }
        adapter = machine.name;
        let all = if machine.is_cpu { CPU_TECHNIQUES } else { TECHNIQUES };
        let techniques = arguments.techniques.as_deref().unwrap_or(all);
        rays(arguments, techniques, size, frames, &mut csv)?;
    }
    if !arguments.skip_build {
        build::run(arguments.triangles, &mut csv)?;
    }
    match &arguments.csv {
        Some(path) => csv.save(path, &adapter, &size_word),
        None => Ok(()),
    }
}

/// What must be known before sizes are chosen.
struct Machine {
    name: String,
    is_cpu: bool,
    /// Bytes of the largest buffer that can be bound.
    buffer_limit: u64,
}

impl Machine {
    fn probe() -> Result<Self, String> {
        // The one logger of the process: it goes on to serve the apps that follow.
        let settings = HeadlessSettings {
            size: UVec2::ONE,
            log: true,
            ..default()
        };
        let mut app = HeadlessApp::new(settings, |_| {}).map_err(|error| error.to_string())?;
        let world = render_world(&mut app)?;
        let (Some(info), Some(device)) = (
            world.get_resource::<RenderAdapterInfo>(),
            world.get_resource::<RenderDevice>(),
        ) else {
            return Err("no graphics device was found".to_owned());
        };
        let limits = device.limits();
        Ok(Self {
            name: format!(
                "{} ({:?}, {} {})",
                info.name, info.backend, info.driver, info.driver_info
            ),
            is_cpu: info.device_type == wgpu::DeviceType::Cpu,
            buffer_limit: limits.max_buffer_size.min(limits.max_storage_buffer_binding_size),
        })
    }
}

fn rays(arguments: &Arguments, techniques: &str, size: UVec2, frames: u32, csv: &mut Csv) -> Result<(), String> {
    let scenes = match arguments.scene.as_slice() {
        [] => vec![SceneName::Demo, SceneName::AtriumSmall, SceneName::Atrium],
        chosen => chosen.to_vec(),
    };
    let techniques: Vec<&str> = techniques.split(',').map(str::trim).collect();
    let is_hardware = |word: &&str| measure::technique_and_backend(word).1 == Backend::Hardware;
    let backend = if techniques.iter().any(is_hardware) {
        Backend::Hardware
    } else {
        Backend::Compute
    };
    let mut tables = Tables {
        scenes: Table::new(
            "Scenes (build times of the CPU, of meshes summed over threads; memory without what a driver keeps for ray queries)",
            &[
                "scene",
                "tracer",
                "mesh triangles",
                "placed triangles",
                "instances",
                "meshes ms",
                "top level ms",
                "MiB",
            ],
        ),
        kernels: Table::new(
            "Closest hits alone: one ray per pixel from the camera; specular reflections at half resolution, and the same \
             without alpha tests",
            &[
                "scene",
                "tracer",
                "kernel",
                "rays",
                "hits",
                "median ms",
                "p95 ms",
                "Mrays/s",
            ],
        ),
        passes: Table::new(
            "Passes (median ms of the GPU; the total without timers between them) and rays of a frame, roughness cut-off 1",
            &[
                "scene",
                "tracer",
                "technique",
                "rate",
                "trace",
                "reconstruct",
                "temporal",
                "blur",
                "composite",
                "total",
                "rays",
                "mirror rays",
                "hits",
            ],
        ),
        memory: Table::new(
            "Memory of a camera (B, and B per pixel of the view)",
            &["technique", "part", "B", "B/pixel"],
        ),
    };
    let mut memory_known = false;
    for scene in scenes {
        for word in arguments.tracer.list() {
            let mut bench = Bench::new(scene, word, backend, size, arguments.detail)?;
            let report = bench.report();
            let tracer = match report.tracer {
                Some(Tracer::RayQuery) => "ray-query",
                Some(Tracer::Bvh) => "bvh",
                None => return Err(format!("rays can't be traced: {}", report.reasons.join(". "))),
            };
            if word == TracerWord::RayQuery && report.tracer != Some(Tracer::RayQuery) {
                println!("{scene}: {}.", report.reasons.join(". "));
                continue;
            }
            for (index, technique) in techniques.iter().enumerate() {
                bench.set_technique(technique)?;
                let report = bench.wait_for_scene()?;
                bench.measure(frames)?;
                if index == 0 {
                    bench.describe(scene, tracer, &report, &mut tables.scenes, csv);
                    bench.kernels(scene, tracer, &mut tables.kernels, csv);
                }
                bench.passes(scene, tracer, technique, &mut tables.passes, csv);
                if !memory_known {
                    bench.memory(scene, technique, &mut tables.memory, csv);
                }
            }
            memory_known = true;
        }
    }
    for table in [&tables.scenes, &tables.kernels, &tables.passes, &tables.memory] {
        table.print();
    }
    Ok(())
}
