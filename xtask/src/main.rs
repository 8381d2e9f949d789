//! The commands of this workspace, run as `cargo xtask <command>`.
//!
//! They need nothing but cargo and a C/C++ compiler: the Vulkan driver is looked for, and installed where that is possible.

mod bench;
mod cargo;
mod ci;
mod demo;
mod driver;
mod environment;
mod evaluate;
mod failure;
mod file_sizes;
mod new_user;
mod progress;
mod stress;
mod test;
mod version;
mod window;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::failure::Result;

/// The commands of this workspace.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Show ray-traced reflections: the demo scene, or any glTF file.
    Demo(demo::Options),
    /// Run every test, on the CPU Vulkan driver if there is no GPU.
    Test(test::Options),
    /// Measure rays per second and build times.
    Bench(bench::Options),
    /// Measure for each technique what it costs and how far its picture is from the truth.
    Evaluate(evaluate::Options),
    /// Attack the reflections with hostile scenes, faults and long runs.
    Stress(stress::Options),
    /// Follow the README in a new crate, as a new user would.
    NewUser,
    /// Click and drag the settings panel in a window on a virtual display.
    Window(window::Options),
    /// Everything that must hold before a change is merged: format, lints, feature sets, docs, tests.
    Ci,
}

fn main() -> ExitCode {
    let result: Result = match Cli::parse().command {
        Command::Demo(options) => demo::run(&options),
        Command::Test(options) => test::run(&options),
        Command::Bench(options) => bench::run(&options),
        Command::Evaluate(options) => evaluate::run(&options),
        Command::Stress(options) => stress::run(&options),
        Command::NewUser => new_user::run(),
        Command::Window(options) => window::run(&options),
        Command::Ci => ci::run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            progress::say(format_args!("error: {failure}"));
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }
}
