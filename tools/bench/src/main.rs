//! Rays per second of both tracers, times of the passes, and times and sizes of acceleration structures.
//!
//! `cargo xtask bench -- --scene atrium --csv bench.csv`
//! `cargo xtask bench --worlds`
//! `cargo xtask bench --crowds`
//! `cargo xtask bench --growth`
//! `cargo xtask bench --budget --out DIR`
//!
//! Rays are timed alone: one kernel writes them into a buffer, tile by tile, and the timed kernel only reads and traces them
//! and stores their hits. All GPU times come from the GPU's own clock.

mod arguments;
mod arrivals;
mod budget;
mod budget_chart;
mod bvh_builds;
mod crowds;
mod growth;
mod kernels;
mod machine;
mod measure;
mod scenes;
mod subject;
mod table;
mod worlds;

use arguments::Arguments;
use bevy::math::UVec2;
use clap::Parser;
use machine::Machine;
use std::process::ExitCode;
use table::Csv;

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("error: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let mut csv = Csv::default();
    let (adapter, size) = measure(arguments, &mut csv)?;
    if csv.is_empty() {
        return Err(arguments.why_nothing());
    }
    match &arguments.csv {
        Some(path) => csv.save(path, &adapter, &size),
        None => Ok(()),
    }
}

/// Runs the requested measurements. Returns the name of the adapter and the size of the view.
fn measure(arguments: &Arguments, csv: &mut Csv) -> Result<(String, String), String> {
    let only = arguments.only.as_deref();
    let mut adapter = "CPU".to_owned();
    let mut size_word = "-".to_owned();
    if arguments.worlds {
        worlds::measure(&arguments.tracers(), arguments.rounds, only, csv)?;
        arrivals::measure(arguments.arrival_tracer(), only, csv)?;
        return Ok((adapter, size_word));
    }
    if arguments.crowds {
        let plan = arguments.plan(&Machine::probe()?);
        let UVec2 { x, y } = plan.size;
        crowds::measure(&plan, arguments.characters, only, csv)?;
        return Ok((adapter, format!("{x}x{y}")));
    }
    if !arguments.skip_rays {
        let machine = Machine::probe()?;
        let plan = arguments.plan(&machine);
        plan.check(&machine)?;
        size_word = format!("{}x{}", plan.size.x, plan.size.y);
        println!("{}, {size_word}, {} frames", machine.name, plan.frames);
        if machine.is_cpu {
            println!("This adapter is a CPU: its times can't be compared with those of GPUs.");
        }
        adapter = machine.name;
        if arguments.growth {
            growth::measure(&plan, only, csv)?;
        } else if arguments.budget {
            budget::measure(&plan, arguments.out.as_deref(), csv)?;
        } else {
            scenes::measure(&plan, csv)?;
        }
    }
    if !arguments.skip_build && !arguments.growth && !arguments.budget {
        bvh_builds::measure(arguments.triangles, csv)?;
    }
    Ok((adapter, size_word))
}
