//! Measures what each technique costs and how far its picture is from the truth: `cargo xtask evaluate --out results`.

mod arguments;
mod evaluation;
mod output;

use arguments::Arguments;
use clap::Parser;
use evaluation::Evaluation;
use glint_evaluate::{
    compare::compare,
    jobs,
    machine::Machine,
    plan::Job,
    protocol::Protocol,
    report::Event,
    rows::{self, Row},
    run,
    state::{read_json, write_json, write_text},
};
use output::Results;
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
        return probe();
    }
    if let Some(file) = &arguments.job {
        return work(file);
    }
    let outcome = if arguments.rewrite {
        rewrite(&arguments)
    } else {
        evaluate(&arguments)
    };
    match outcome {
        Ok(code) => code,
        Err(reason) => {
            say(format_args!("error: {reason}"));
            ExitCode::FAILURE
        }
    }
}

/// A line on standard error; a reader that went away is no failure.
fn say(text: impl std::fmt::Display) {
    _ = writeln!(std::io::stderr(), "{text}");
}

/// Describes the machine to the process that asked.
fn probe() -> ExitCode {
    let told = Machine::probe().and_then(|machine| serde_json::to_string(&machine).map_err(|error| error.to_string()));
    match told {
        Ok(text) => {
            _ = writeln!(std::io::stdout(), "{text}");
            ExitCode::SUCCESS
        }
        Err(reason) => {
            Event::Failed(reason).tell();
            ExitCode::FAILURE
        }
    }
}

/// Measures a job for the process that started this one.
fn work(file: &Path) -> ExitCode {
    let job = read_json::<Job>(file).ok_or_else(|| format!("{} holds no job", file.display()));
    match job.and_then(|job| run::work(&job)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            Event::Failed(reason).tell();
            ExitCode::FAILURE
        }
    }
}

/// What `results.json` says of how its rows were measured.
#[derive(serde::Deserialize)]
struct Measured {
    machine: Machine,
    protocol: Protocol,
}

/// Writes tables, summary and charts anew.
fn rewrite(arguments: &Arguments) -> Result<ExitCode, String> {
    let out = arguments.out.as_deref().ok_or("--out is missing")?;
    let file = out.join("results.json");
    let measured: Measured = read_json(&file).ok_or_else(|| format!("{} holds no results", file.display()))?;
    let rows = rows::load(&out.join("results.csv"))?;
    let results = Results {
        out,
        machine: &measured.machine,
        protocol: &measured.protocol,
        rows: &rows,
    };
    results.write()?;
    results.print();
    Ok(ExitCode::SUCCESS)
}

fn evaluate(arguments: &Arguments) -> Result<ExitCode, String> {
    let old = arguments.compare.as_deref().map(rows::load).transpose()?;
    let machine: Machine = jobs::probe()?;
    let plan = arguments.plan(&machine)?;
    let before = prepare_folder(arguments, &plan, &machine)?;
    evaluation::announce(&plan, &machine);
    let all = Evaluation::new(&plan, &machine, before).run()?;
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

/// Makes sure that what lies in the folder of results was measured with the same settings, by the same code, on this machine; returns
/// its rows.
fn prepare_folder(arguments: &Arguments, plan: &arguments::Plan, machine: &Machine) -> Result<Vec<Row>, String> {
    let state = plan.out.join("state");
    let file = state.join("settings.json");
    let table = plan.out.join("results.csv");
    let settings = serde_json::json!({ "protocol": plan.protocol, "machine": machine });
    if arguments.fresh && file.exists() {
        // Only what this tool wrote, and only where it did.
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
        Some(_) if table.exists() => rows::load(&table),
        Some(_) => Ok(Vec::new()),
        None => write_json(&file, &settings).map(|()| Vec::new()),
    }
}
