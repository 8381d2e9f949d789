//! `cargo xtask evaluate`: for each technique, how much GPU time buys how much error, on which scene.

use std::ffi::OsString;
use std::path::{self, Path, PathBuf};

use clap::ValueEnum;

use crate::driver::{self, Need};
use crate::failure::{Failure, Result};
use crate::{cargo, progress};

/// What `evaluate` accepts.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Measure little: under 2 minutes on a GPU, under 10 on a CPU.
    #[arg(long)]
    quick: bool,
    /// Built-in scenes, separated by commas (default: atrium,temple,street).
    #[arg(long, value_name = "NAMES")]
    scene: Option<String>,
    /// A glTF file (.gltf or .glb), in place of or beside built-in scenes; may be given several times.
    #[arg(long, value_name = "FILE")]
    gltf: Vec<PathBuf>,
    /// Size in pixels, such as 1920x1080.
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// Number of timed frames per technique.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Views along the camera's path whose pictures are compared.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    views: Option<u32>,
    /// Samples per pixel of the ground truth.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    samples: Option<u32>,
    /// How rays are spread over the picture.
    #[arg(long, value_enum, value_name = "NAME")]
    backend: Option<Backend>,
    /// What follows the rays.
    #[arg(long, value_enum, value_name = "NAME")]
    tracer: Option<Tracer>,
    /// Techniques and presets, separated by commas, such as reference,quarter,vrs-roughness,low.
    #[arg(long, value_name = "NAMES")]
    techniques: Option<String>,
    /// The folder of results; a run that was interrupted goes on where it stopped.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// An older results.csv: shows what changed beyond noise, and fails if anything got slower or worse.
    #[arg(long, value_name = "FILE.csv")]
    compare: Option<PathBuf>,
    /// Forget what was measured before in the folder of results.
    #[arg(long)]
    fresh: bool,
}

/// The back ends that can be asked for.
#[derive(Clone, Copy, ValueEnum)]
enum Backend {
    /// All that this machine has.
    Auto,
    /// Lists of rays.
    Compute,
    /// The rasterizer's shading rate.
    Hardware,
    /// The same as auto.
    All,
}

/// The tracers that can be asked for.
#[derive(Clone, Copy, ValueEnum)]
enum Tracer {
    /// Ray query where the GPU has it, else the BVH.
    Auto,
    /// The GPU's ray queries.
    RayQuery,
    /// The bounding volume hierarchy in compute shaders, on any GPU.
    Bvh,
    /// All that this machine has.
    All,
}

/// Builds the tool and runs it.
pub fn run(options: &Options) -> Result {
    let arguments = arguments(options)?;
    let need = match options.tracer {
        Some(Tracer::RayQuery | Tracer::All) => Need::RayQuery,
        Some(Tracer::Auto | Tracer::Bvh) | None => Need::Vulkan,
    };
    let driver = driver::prepare(need)?;
    progress::step("build and run the evaluation", || {
        let mut command = cargo::release("run")?;
        command
            .args(["--package", "glint_evaluate"])
            .args(cargo::FEATURES)
            .arg("--")
            .args(&arguments)
            .envs(driver);
        cargo::run(&mut command, "the evaluation")
    })
}

/// The tool's own arguments, once it is clear that they make sense: a build takes long.
fn arguments(options: &Options) -> Result<Vec<OsString>> {
    let mut arguments: Vec<OsString> = Vec::new();
    if options.quick {
        arguments.push("--quick".into());
    }
    if options.fresh {
        arguments.push("--fresh".into());
    }
    let mut option = |name: &str, value: Option<OsString>| {
        if let Some(value) = value {
            arguments.push(name.into());
            arguments.push(value);
        }
    };
    option("--scene", options.scene.clone().map(Into::into));
    for file in &options.gltf {
        option("--gltf", Some(existing(file)?.into()));
    }
    option("--size", options.size.clone().map(Into::into));
    let number = |number: Option<u32>| number.map(|number| number.to_string().into());
    option("--frames", number(options.frames));
    option("--views", number(options.views));
    option("--samples", number(options.samples));
    option("--backend", options.backend.and_then(word));
    option("--tracer", options.tracer.and_then(word));
    option("--techniques", options.techniques.clone().map(Into::into));
    let compare = options.compare.as_deref().map(existing).transpose()?;
    option("--compare", compare.map(Into::into));
    if options.out.is_file() {
        return Err(Failure::new(format!(
            "{} is a file; results need a folder",
            options.out.display()
        )));
    }
    option("--out", Some(absolute(&options.out)?.into()));
    Ok(arguments)
}

/// The word of a value on the command line.
fn word<T: ValueEnum>(value: T) -> Option<OsString> {
    value.to_possible_value().map(|value| value.get_name().into())
}

/// The absolute path of a file that exists, since the tool runs in another directory.
fn existing(file: &Path) -> Result<PathBuf> {
    if file.is_file() {
        absolute(file)
    } else {
        Err(Failure::new(format!("there is no file {}", file.display())))
    }
}

fn absolute(file: &Path) -> Result<PathBuf> {
    path::absolute(file).map_err(|error| Failure::new(format!("{} can't be resolved: {error}", file.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_reach_the_tool() {
        let options = Options {
            quick: true,
            scene: Some("atrium,street".into()),
            frames: Some(50),
            tracer: Some(Tracer::RayQuery),
            backend: Some(Backend::All),
            out: "results".into(),
            ..Options::default()
        };
        let out = path::absolute("results").unwrap().into_os_string();
        let mut expected: Vec<OsString> = [
            "--quick",
            "--scene",
            "atrium,street",
            "--frames",
            "50",
            "--backend",
            "all",
            "--tracer",
            "ray-query",
            "--out",
        ]
        .map(OsString::from)
        .into();
        expected.push(out);
        assert_eq!(arguments(&options).unwrap(), expected);
    }

    #[test]
    fn wrong_files_are_named() {
        let failure = |options: Options| arguments(&options).err().unwrap().to_string();
        let missing = Options {
            compare: Some("no/such.csv".into()),
            ..Options::default()
        };
        assert_eq!(failure(missing), "there is no file no/such.csv");
        let missing = Options {
            gltf: vec!["no/such.glb".into()],
            ..Options::default()
        };
        assert_eq!(failure(missing), "there is no file no/such.glb");
        let file = Options {
            out: concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml").into(),
            ..Options::default()
        };
        assert!(failure(file).contains("results need a folder"));
    }
}
