//! The commands of this workspace, run as `cargo xtask <command>`.
//!
//! They need only cargo and a C/C++ compiler: the Vulkan driver is searched for, and installed if possible.

mod batches;
mod cargo;
mod cases;
mod ci;
mod driver;
mod environment;
mod file_sizes;
mod isa;
mod known;
mod new_user;
mod package;
mod progress;
mod publish;
mod test;
mod tools;
mod translations;
mod validate;
mod web;
mod words;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The commands of this workspace.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Show ray-traced reflections: a built-in scene (`--scene street`) or any glTF file (`--gltf FILE`), in a window or as an image
    /// (`--headless --size 1920x1080 --out shot.png`).
    Demo(tools::Options),
    /// Run every test, on the CPU Vulkan driver if there is no GPU.
    Test(test::Options),
    /// Measure rays per second and build times.
    Bench(tools::Options),
    /// Measure the cost of each technique, and the error of its image: `evaluate --quick --scene atrium --out DIR`.
    Evaluate(tools::EvaluateOptions),
    /// Attack the reflections with hostile scenes, faults and long runs: `stress --minutes 30`. `--lives N` and `--mirrors N` run generators
    /// of cameras' lives and of scenes in a mirror.
    Stress(tools::StressOptions),
    /// Render with each technique under Vulkan's validation layers, with synchronisation validation.
    Validate,
    /// Compile every shader variant for AMD's GPUs, without one, and compare the figures with `tests/shaders/isa.txt`.
    Isa(isa::Options),
    /// Have Tint read the WGSL of browsers, and Slang compile the HLSL of DirectX back to SPIR-V, which is run beside the original.
    Translations(translations::Options),
    /// Build the demo as a page for browsers with WebGPU: `web --serve`, `web --check`.
    Web(web::Options),
    /// Follow the README in a new crate, as a new user would; `--measure` reports the plugin's compile time and size.
    NewUser(new_user::Options),
    /// Make the package of the library and check it with cargo; nothing is uploaded.
    Package(package::Options),
    /// Count habits of speech in comments: `words --list may src/denoise`.
    Words(words::Options),
    /// Run everything that a change must pass before it is merged: format, lints, feature sets, docs, tests.
    Ci,
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Demo(options) => tools::demo(options),
        Command::Test(options) => test::run(&options),
        Command::Bench(options) => tools::bench(&options),
        Command::Evaluate(options) => tools::evaluate(options),
        Command::Stress(options) => tools::stress(&options),
        Command::Validate => validate::run(),
        Command::Isa(options) => isa::run(&options),
        Command::Translations(options) => translations::run(&options),
        Command::Web(options) => web::run(&options),
        Command::NewUser(options) => new_user::run(&options),
        Command::Package(options) => package::run(&options),
        Command::Words(options) => words::run(&options),
        Command::Ci => ci::run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            progress::say(format_args!("error: {error:#}"));
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

    #[test]
    fn options_reach_the_programs() {
        let parse = |line: &str| Cli::try_parse_from(line.split(' ')).map(|cli| cli.command);
        for line in [
            "xtask demo --scene street --size 64x32",
            "xtask demo -- --scene street --size 64x32",
        ] {
            let Ok(Command::Demo(options)) = parse(line) else {
                panic!("{line}")
            };
            assert_eq!(options.arguments, ["--scene", "street", "--size", "64x32"]);
        }
        let Ok(Command::Evaluate(options)) = parse("xtask evaluate --out a --quick --fresh") else {
            panic!()
        };
        assert_eq!(
            (options.out, options.program.arguments),
            (Some("a".into()), vec!["--quick".into(), "--fresh".into()])
        );
        let Ok(Command::Evaluate(options)) = parse("xtask evaluate --quick --out a") else {
            panic!()
        };
        assert_eq!((options.out, options.program.arguments.len()), (None, 3));
        assert!(matches!(parse("xtask evaluate --out a --readme"), Ok(Command::Evaluate(options)) if options.readme));
        assert!(parse("xtask evaluate --readme").is_err());
        assert!(parse("xtask stress --lives 5 --mirrors 2").is_ok());
        assert!(parse("xtask stress --lives 5 --minutes 3").is_err());
    }
}
