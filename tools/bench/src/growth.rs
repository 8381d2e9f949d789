//! Growth of times: of each pass with the resolution, of rays with the triangles, and the cost of things that cover few pixels.

use crate::{
    arguments::{Plan, TimedTechnique},
    measure::Bench,
    subject::{SmallThing, Subject},
    table::{Csv, Table, mebibytes, number},
};
use bevy::math::UVec2;
use bevy_glint::ReflectionTracerChoice;

/// Sizes, in parts of the plan's: it is 1920x1080 on a GPU.
const SIZES: [UVec2; 5] = [
    UVec2::new(960, 540),
    UVec2::new(1280, 720),
    UVec2::new(1920, 1080),
    UVec2::new(2560, 1440),
    UVec2::new(3840, 2160),
];
const TRIANGLES: [u32; 5] = [66_000, 250_000, 1_000_000, 4_000_000, 10_000_000];
const PASSES: [&str; 5] = ["rate", "trace", "denoise", "composite", "total"];

/// Passes of the front layer.
const LAYER_PASSES: [&str; 6] = [
    "layer_find",
    "layer_rate",
    "layer_trace",
    "layer_denoise",
    "layer_composite",
    "layer_total",
];

type Case = fn(&Plan, ReflectionTracerChoice, &mut Csv) -> Result<Table, String>;

/// Measures and prints the cases among `sizes`, `small things` and `triangles` with a word in their names.
///
/// # Errors
///
/// If rays can't be traced, or a scene doesn't become ready.
pub fn measure(plan: &Plan, only: Option<&str>, csv: &mut Csv) -> Result<(), String> {
    let cases: [(&str, Case); 3] = [
        ("sizes", sizes),
        ("small things", small_things),
        ("triangles", triangles),
    ];
    for &tracer in &plan.tracers {
        println!("\n# {tracer:?}");
        for (name, case) in cases {
            if only.is_none_or(|word| name.contains(word)) {
                case(plan, tracer, csv)?.print();
            }
        }
    }
    Ok(())
}

/// Renders a subject with a technique.
fn time(bench: &mut Bench, technique: &TimedTechnique, frames: u32) -> Result<(), String> {
    bench.set_technique(technique);
    bench.wait_for_scene()?;
    bench.measure(frames)
}

/// Columns of all passes, between others.
fn columns(before: &str, after: &str) -> String {
    format!("{before} | {}{after}", PASSES.join(" | "))
}

/// A row of all passes behind some cells.
fn row<const N: usize>(bench: &Bench, cells: [String; N]) -> Vec<String> {
    let times = PASSES.iter().map(|pass| number(bench.pass(pass), 4));
    cells.into_iter().chain(times).collect()
}

/// Adds the time of a pass to the CSV, if it was measured.
fn add(csv: &mut Csv, bench: &Bench, [subject, variant]: [&str; 2], technique: &TimedTechnique, pass: &str) {
    if let Some(value) = bench.pass(pass) {
        csv.add(subject, variant, &format!("{technique}_{pass}"), value, "ms");
    }
}

fn sizes(plan: &Plan, tracer: ReflectionTracerChoice, csv: &mut Csv) -> Result<Table, String> {
    let mut table = Table::new(
        "Passes by size of the picture (median ms of the GPU), and memory of the camera",
        &columns("size | technique", " | ns per pixel | MB | B/pixel"),
    );
    for subject in plan.subjects.iter().take(1) {
        for size in SIZES {
            let size = size * plan.size / SIZES[2];
            let plan = Plan { size, ..plan.clone() };
            let mut bench = Bench::new(subject, tracer, &plan)?;
            for technique in &plan.techniques {
                time(&mut bench, technique, plan.frames)?;
                let pixels = f64::from(size.x * size.y);
                let bytes = bench.view_bytes();
                let word = format!("{}x{}", size.x, size.y);
                let mut cells = row(&bench, [word.clone(), technique.to_string()]);
                let total = bench.pass("total");
                cells.push(number(total.map(|total| total * 1e6 / pixels), 3));
                cells.push(number(Some(bytes as f64 * 1e-6), 1));
                cells.push(number(Some(bytes as f64 / pixels), 1));
                table.row(cells);
                for pass in PASSES {
                    add(csv, &bench, [&subject.to_string(), &word], technique, pass);
                }
            }
        }
    }
    Ok(table)
}

fn triangles(plan: &Plan, tracer: ReflectionTracerChoice, csv: &mut Csv) -> Result<Table, String> {
    let mut table = Table::new(
        "Passes by triangles of the scene, which is the same picture (median ms of the GPU), and memory of the scene",
        &columns("triangles | technique", " | MiB"),
    );
    for count in TRIANGLES {
        let subject = Subject::Spheres(count);
        let mut bench = Bench::new(&subject, tracer, plan)?;
        for technique in &plan.techniques {
            time(&mut bench, technique, plan.frames)?;
            let report = bench.report();
            let mut cells = row(&bench, [report.triangles.to_string(), technique.to_string()]);
            cells.push(number(Some(mebibytes(report.scene_bytes)), 1));
            table.row(cells);
            add(csv, &bench, [&subject.to_string(), "-"], technique, "trace");
        }
    }
    Ok(table)
}

fn small_things(plan: &Plan, tracer: ReflectionTracerChoice, csv: &mut Csv) -> Result<Table, String> {
    let mut table = Table::new(
        "Small things. With a cut-off of 0.6, nothing else reflects; the helmet is alone with both (median ms of the GPU)",
        &columns(
            "thing | technique | roughness cut-off",
            " | layer: find | rate | trace | denoise | composite | total",
        ),
    );
    for thing in SmallThing::ALL {
        let mut bench = Bench::new(&Subject::Small(thing), tracer, plan)?;
        for technique in &plan.techniques {
            for cutoff in [0.6, 1.0] {
                let mut technique = technique.clone();
                technique.reflections.roughness_cutoff = cutoff;
                time(&mut bench, &technique, plan.frames)?;
                let words = [thing.to_string(), technique.to_string(), number(Some(cutoff.into()), 1)];
                let mut cells = row(&bench, words);
                cells.extend(LAYER_PASSES.map(|pass| number(bench.pass(pass), 4)));
                table.row(cells);
                let variant = format!("cut-off {cutoff}");
                for pass in ["total", "layer_find", "layer_total"] {
                    add(csv, &bench, [&thing.to_string(), &variant], &technique, pass);
                }
            }
        }
    }
    Ok(table)
}
