//! Hostile scenes, faults and long runs for as long as you like: `cargo xtask stress --minutes 30`.

use clap::Parser;
use glint_stress::{options::Options, report::print_line, runner, worker};
use std::process::ExitCode;

/// Attack the reflections with hostile scenes, faults of the device and long runs.
#[derive(Parser)]
#[command(name = "glint_stress")]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Work on a job of another process, in JSON.
    #[arg(long, hide = true)]
    job: Option<String>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let Some(job) = arguments.job else {
        let summary = match runner::run(&arguments.options, &mut |line| print_line(line)) {
            Ok(summary) => summary,
            Err(error) => {
                eprintln!("error: the campaign's folder can't be used: {error}");
                return ExitCode::FAILURE;
            }
        };
        print_line(&summary.to_string());
        return if summary.is_good() {
            ExitCode::SUCCESS
        } else {
            ExitCode::FAILURE
        };
    };
    match serde_json::from_str(&job) {
        Ok(job) => {
            worker::run(job);
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: the job can't be read: {error}");
            ExitCode::FAILURE
        }
    }
}
