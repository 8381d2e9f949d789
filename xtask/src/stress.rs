//! `cargo xtask stress`: hostile scenes, faults of the device and long runs, for as long as one likes.

use std::ffi::OsString;

use clap::ValueEnum;

use crate::cargo::Program;
use crate::driver::{self, Need};
use crate::failure::Result;
use crate::{cargo, progress};

/// What `stress` accepts.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Minutes to run (default: 10).
    #[arg(long, value_name = "N")]
    minutes: Option<String>,
    /// Seed of the first scene (default: 1).
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// What follows the rays (default: both, where the GPU has ray queries).
    #[arg(long, value_enum, value_name = "NAME")]
    tracer: Option<Tracer>,
    /// A section (faults, energy, stability, long-run, bounds, viewer or scenes), a fault such as device-lost, or an ingredient that
    /// all scenes have, such as mesh-needles.
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Size of all pictures, such as 48x32.
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// Number of scenes, or of files for the viewer.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Frames of each scene, or of the long run.
    #[arg(long, value_name = "N")]
    frames: Option<u32>,
    /// Places of the ingredients to keep of the first scene, separated by commas, or `none`.
    #[arg(long, value_name = "PLACES")]
    keep: Option<String>,
    /// Compile all shaders with runtime checks.
    #[arg(long)]
    checked: bool,
}

/// The tracers that can be asked for.
#[derive(Clone, Copy, ValueEnum)]
enum Tracer {
    /// Both, where the GPU has ray queries.
    Auto,
    /// The GPU's ray queries.
    RayQuery,
    /// The bounding volume hierarchy in compute shaders, on any GPU.
    Bvh,
}

/// Builds the tool and runs it.
pub fn run(options: &Options) -> Result {
    let need = match options.tracer {
        Some(Tracer::Bvh) => Need::Vulkan,
        Some(Tracer::Auto | Tracer::RayQuery) | None => Need::RayQuery,
    };
    let driver = driver::prepare(need)?;
    if needs_viewer(options) {
        progress::step("build the viewer", || {
            cargo::program(Program::Binary("glint_viewer")).map(drop)
        })?;
    }
    progress::step("build and run the stress suite", || {
        let mut command = cargo::program(Program::Binary("glint_stress"))?;
        command.args(arguments(options)).envs(driver);
        cargo::run(&mut command, "the stress suite")
    })
}

/// Whether the run has a section in which files are shown.
fn needs_viewer(options: &Options) -> bool {
    match &options.only {
        Some(only) => only == "viewer",
        None => options.count.is_none() && options.keep.is_none(),
    }
}

/// The tool's own arguments.
fn arguments(options: &Options) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = Vec::new();
    let mut option = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            arguments.push(name.into());
            arguments.push(value.into());
        }
    };
    option("--minutes", options.minutes.clone());
    option("--seed", options.seed.map(|seed| seed.to_string()));
    let tracer = options.tracer.and_then(|tracer| tracer.to_possible_value());
    option("--tracer", tracer.map(|tracer| tracer.get_name().to_owned()));
    option("--only", options.only.clone());
    option("--size", options.size.clone());
    option("--count", options.count.map(|count| count.to_string()));
    option("--frames", options.frames.map(|frames| frames.to_string()));
    option("--keep", options.keep.clone());
    if options.checked {
        arguments.push("--checked".into());
    }
    arguments
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_reach_the_tool() {
        let options = Options {
            minutes: Some("30".into()),
            seed: Some(7),
            tracer: Some(Tracer::RayQuery),
            keep: Some("0,3".into()),
            size: Some("8x8".into()),
            checked: true,
            ..Options::default()
        };
        let expected = [
            "--minutes",
            "30",
            "--seed",
            "7",
            "--tracer",
            "ray-query",
            "--size",
            "8x8",
            "--keep",
            "0,3",
            "--checked",
        ];
        assert_eq!(arguments(&options), expected.map(OsString::from));
        assert!(arguments(&Options::default()).is_empty());
    }

    #[test]
    fn the_viewer_is_built_where_it_is_needed() {
        let only = |only: &str| Options {
            only: Some(only.into()),
            ..Options::default()
        };
        assert!(needs_viewer(&Options::default()) && needs_viewer(&only("viewer")));
        assert!(!needs_viewer(&only("faults")));
        let one_scene = Options {
            count: Some(1),
            ..Options::default()
        };
        assert!(!needs_viewer(&one_scene));
    }
}
