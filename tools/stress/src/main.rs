//! Attacks every stage of `bevy_glint`: `cargo xtask stress --minutes 30`.
//!
//! From the top down; a module imports only modules below it.
//!
//! | module | content |
//! |---|---|
//! | `runner`, `summary` | divides the time among sections, survives crashes and hangs of worker processes, sums up |
//! | `campaign` | keeps what many thousands of scenes have shown, and which ingredients have met |
//! | `process` | has a worker process do a job, and collects its messages |
//! | `worker`, `report` | executes the job of a worker process and reports |
//! | `protocol`, `options`, `selection` | jobs, messages, options, and parts of a run, as data |
//! | `viewer` | broken files in the viewer |
//! | `faults` | devices that lack something or are lost, shaders that don't compile |
//! | `bounds` | runtime checks in shaders must not change a frame |
//! | `fuzzer` | renders scenarios, attributes failures to the library or to Bevy, simplifies scenarios that fail |
//! | `energy`, `furnace`, `stability`, `long_run` | properties of known scenes: light, flicker, time |
//! | `oracle` | rays through a scene against brute force |
//! | `budget` | time and memory that a scene may take |
//! | `invariants`, `path_equivalence` | properties of every scene |
//! | `events` | applies events between frames |
//! | `scenario` | a hostile scene as data: a seed and a list of generators |
//! | `generators`, `glb` | generators of meshes, lights, files, views, settings and events |
//! | `static_scene` | known scenes in which nothing moves, and averages of their frames |
//! | `fixture`, `wait` | an app to inject faults into; waiting for work in the background |
//! | `harness` | an app without a window that survives the loss of its device |
//! | `statistics`, `image`, `log_capture`, `heartbeat`, `tally`, `verdict`, `word` | small tools |
//!
//! Everything random follows from a seed. Each failure is printed with the options that repeat it.

/// Declares an enum of things that can be named on the command line, and a function with a value or an effect for each.
macro_rules! kinds {
    ($(#[$doc:meta])* $name:ident, $public:vis fn $function:ident($($argument:ident: $type:ty),*) $(-> $result:ty)? {
        $($(#[$attribute:meta])* $kind:ident => $effect:expr,)+
    }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize)]
        pub enum $name { $($(#[$attribute])* $kind),+ }

        $public fn $function(kind: $name, $($argument: $type),*) $(-> $result)? {
            match kind { $($name::$kind => $effect,)+ }
        }
    };
}

mod bounds;
mod budget;
mod campaign;
mod energy;
mod events;
mod faults;
mod fixture;
mod furnace;
mod fuzzer;
mod generators;
mod glb;
mod harness;
mod heartbeat;
mod image;
mod invariants;
mod log_capture;
mod long_run;
mod options;
mod oracle;
mod path_equivalence;
mod process;
mod protocol;
mod report;
mod runner;
mod scenario;
mod selection;
mod stability;
mod static_scene;
mod statistics;
mod summary;
mod tally;
mod verdict;
mod viewer;
mod wait;
mod word;
mod worker;

#[cfg(test)]
mod tests;

use clap::Parser;
use options::Options;
use report::print_line;
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
