//! Measures, for each technique of `bevy_glint`, how much GPU time buys how much error, on which scene.
//!
//! `cargo xtask evaluate --quick --out results` runs it. One process plans, compares images and writes results. For each scene it starts
//! another one that renders, so that a driver crash costs one technique and not the run. All measurements are stored in files at once:
//! an interrupted run continues where it stopped, and scenes can be measured one after the other into one folder.
//!
//! From the top down; a file only imports files below it:
//!
//! | module | duty |
//! |---|---|
//! | `evaluation` | a whole run |
//! | `arguments` | the command line, and its jobs |
//! | `report` | rows, charts, summary, comparison of two runs |
//! | `process`, `worker` | the processes that render |
//! | `compare` | errors of images, on all cores |
//! | `message`, `progress`, `state` | communication between processes, and finished work |
//! | `machine`, `techniques` | the library: only `worker` also uses it |
//! | `job`, `protocol`, `files` | the measurements, their extent, and their files |
//! | `stats` | means, intervals, and the Pareto front |

mod arguments;
mod compare;
mod evaluation;
mod files;
mod job;
mod machine;
mod message;
mod process;
mod progress;
mod protocol;
mod report;
mod state;
mod stats;
mod techniques;
mod worker;

use arguments::{Arguments, MeasurementPlan};
use clap::Parser;
use evaluation::Evaluation;
use files::{read_json, write_json, write_text};
use job::Job;
use machine::Machine;
use message::Message;
use protocol::Protocol;
use report::{
    regressions::compare,
    rows::{self, Row},
    summary::conditions,
    tables::{ROWS, Results, Tables},
};
use std::{
    fs,
    io::{ErrorKind, Write},
    path::Path,
    process::ExitCode,
};

/// The exit status when a comparison shows a regression; 1 is failure, and 2 a wrong command line.
const REGRESSION: u8 = 3;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    if arguments.probe {
        return end(Machine::probe().map(|machine| Message::Machine(machine).send()));
    }
    if let Some(file) = &arguments.job {
        return end(work(file));
    }
    let outcome = if !arguments.mix.is_empty() {
        mix(&arguments)
    } else if arguments.rewrite {
        rewrite(&arguments)
    } else {
        evaluate(&arguments)
    };
    match outcome {
        Ok(code) => code,
        Err(reason) => {
            progress::say(format_args!("error: {reason}"));
            ExitCode::FAILURE
        }
    }
}

/// Ends a process whose output another one reads.
fn end(outcome: Result<(), String>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            Message::Failed(reason).send();
            ExitCode::FAILURE
        }
    }
}

/// Measures the job in a file.
fn work(file: &Path) -> Result<(), String> {
    let job = read_json::<Job>(file).ok_or_else(|| format!("{} holds no job", file.display()))?;
    worker::work(&job)
}

/// The part of `results.json` that its rows don't contain.
#[derive(serde::Deserialize)]
struct Measured {
    machine: Machine,
    protocol: Protocol,
}

/// Rewrites tables, summary and charts.
fn rewrite(arguments: &Arguments) -> Result<ExitCode, String> {
    let out = arguments.out.as_deref().ok_or("--out is missing")?;
    let file = out.join("results.json");
    let measured: Measured = read_json(&file).ok_or_else(|| format!("{} holds no results", file.display()))?;
    let tables = Tables::load(out)?;
    let results = Results {
        out,
        machine: &measured.machine,
        protocol: &measured.protocol,
        tables: &tables,
    };
    results.write()?;
    progress::say(out.join("summary.md").display());
    Ok(ExitCode::SUCCESS)
}

/// Prints the errors of mixes of two techniques.
fn mix(arguments: &Arguments) -> Result<ExitCode, String> {
    let [first, second] = arguments.mix.as_slice() else {
        return Err("--mix takes two techniques".to_owned());
    };
    let out = arguments.out.as_deref().ok_or("--out is missing")?;
    let runs = arguments
        .runs
        .filter(|runs| *runs >= 2)
        .ok_or("--mix takes at least 2 --runs")?;
    _ = writeln!(
        std::io::stdout(),
        "{}",
        compare::mix::table(out, [first, second], runs)?
    );
    Ok(ExitCode::SUCCESS)
}

fn evaluate(arguments: &Arguments) -> Result<ExitCode, String> {
    let old = arguments.compare.as_deref().map(rows::load).transpose()?;
    let machine = process::probe()?;
    let plan = arguments.plan(&machine)?;
    let before = prepare_folder(arguments, &plan, &machine)?;
    progress::say(conditions(&machine, &plan.protocol).trim_end());
    let all = Evaluation::new(&plan, &machine, before)?.run()?.rows;
    if !all.iter().any(Row::is_ok) {
        return Err(format!(
            "nothing could be measured; see {}",
            plan.out.join("summary.md").display()
        ));
    }
    let Some(old) = old else {
        return Ok(ExitCode::SUCCESS);
    };
    let comparison = compare(&old, &all);
    let text = comparison.to_markdown();
    write_text(&plan.out.join("comparison.md"), &text)?;
    _ = writeln!(std::io::stdout(), "\n{text}");
    Ok(if comparison.has_regressions() {
        ExitCode::from(REGRESSION)
    } else {
        ExitCode::SUCCESS
    })
}

/// Checks that the folder's results were measured with the same settings, by the same code, on this machine, and returns them.
fn prepare_folder(arguments: &Arguments, plan: &MeasurementPlan, machine: &Machine) -> Result<Tables, String> {
    let state = plan.out.join("state");
    let file = state.join("settings.json");
    let table = plan.out.join(ROWS);
    let settings = serde_json::json!({ "protocol": plan.protocol, "machine": machine });
    if arguments.fresh && file.exists() {
        // Only files of this tool, and only in its own folders.
        for folder in [&state, &plan.out.join("images")] {
            if let Err(error) = fs::remove_dir_all(folder)
                && error.kind() != ErrorKind::NotFound
            {
                return Err(format!("{} can't be removed: {error}", folder.display()));
            }
        }
    }
    match read_json::<serde_json::Value>(&file) {
        Some(before) if before != settings => Err(format!(
            "{} holds results of other settings, of another machine or of other sources; choose another --out, or begin anew with \
             --fresh",
            plan.out.display()
        )),
        Some(_) if table.exists() => Tables::load(&plan.out),
        Some(_) => Ok(Default::default()),
        None => write_json(&file, &settings).map(|()| Default::default()),
    }
}
