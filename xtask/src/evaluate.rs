//! `cargo xtask evaluate`: for each technique, how much GPU time buys how much error, on which scene.

use std::ffi::OsString;
use std::fs;
use std::path::{self, Path, PathBuf};

use clap::ValueEnum;

use crate::cargo::Program;
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
    /// Measure nothing: put what the folder of results holds into README.md and docs/evaluation.
    #[arg(long)]
    readme: bool,
}

/// The folder for results that the README shows; the tool writes links to it.
const FOLDER: &str = "docs/evaluation";
/// Where the tool's part of the README begins.
const BEGIN: &str = "<!-- evaluation:begin -->";
/// Where it ends.
const END: &str = "<!-- evaluation:end -->";

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
    if options.readme {
        return progress::step("put results into the README", || {
            publish(&options.out, &cargo::workspace_root())
        });
    }
    let arguments = arguments(options)?;
    let need = match options.tracer {
        Some(Tracer::Bvh) => Need::Vulkan,
        // Bevy Solari has a row, too.
        Some(Tracer::Auto | Tracer::RayQuery | Tracer::All) | None => Need::RayQuery,
    };
    let driver = driver::prepare(need)?;
    progress::step("build and run the evaluation", || {
        let mut command = cargo::program(Program::Binary("glint_evaluate"))?;
        command.args(&arguments).envs(driver);
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

/// Copies the summary, the table and the charts of a folder of results into the repository, and its tables into the README.
fn publish(out: &Path, root: &Path) -> Result {
    let fail = |file: &Path, error: std::io::Error| Failure::new(format!("{}: {error}", file.display()));
    let read = |file: PathBuf| fs::read_to_string(&file).map_err(|error| fail(&file, error));
    let fragment = read(out.join("readme.md"))?;
    let readme = root.join("README.md");
    let text = splice(&read(readme.clone())?, &fragment)?;
    let mut files: Vec<PathBuf> = ["summary.md", "results.csv"].map(PathBuf::from).into();
    let charts = out.join("charts");
    for entry in fs::read_dir(&charts).map_err(|error| fail(&charts, error))?.flatten() {
        let name = PathBuf::from(entry.file_name());
        if name.extension().is_some_and(|end| end == "svg") {
            files.push(Path::new("charts").join(name));
        }
    }
    files.sort();
    let folder = root.join(FOLDER);
    let target = folder.join("charts");
    fs::create_dir_all(&target).map_err(|error| fail(&target, error))?;
    for file in files {
        let to = folder.join(&file);
        fs::copy(out.join(&file), &to).map_err(|error| fail(&to, error))?;
        progress::note(format_args!("{}", to.display()));
    }
    fs::write(&readme, text).map_err(|error| fail(&readme, error))?;
    progress::note(format_args!("{}", readme.display()));
    Ok(())
}

/// The README with a text between its markers.
fn splice(readme: &str, text: &str) -> Result<String> {
    let parts = readme.split_once(BEGIN).and_then(|(before, rest)| {
        let (_, after) = rest.split_once(END)?;
        Some((before, after))
    });
    let Some((before, after)) = parts else {
        return Err(Failure::new(format!(
            "README.md has no line `{BEGIN}` with a line `{END}` below it: add both where the tables should be"
        )));
    };
    Ok(format!("{before}{BEGIN}\n\n{}\n\n{END}{after}", text.trim()))
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
    fn results_take_the_place_of_older_ones() {
        let readme = format!("# Title\n\n{BEGIN}\nold\n{END}\n\nThe end.\n");
        let new = splice(&readme, "new\n").unwrap();
        assert_eq!(new, format!("# Title\n\n{BEGIN}\n\nnew\n\n{END}\n\nThe end.\n"));
        assert_eq!(splice(&new, "new").unwrap(), new);
        for wrong in ["", "no markers", &format!("{END} {BEGIN}")] {
            assert!(splice(wrong, "new").unwrap_err().to_string().contains(BEGIN));
        }
    }

    #[test]
    fn results_are_put_into_the_repository() {
        let folder = std::env::temp_dir().join(format!("xtask-{}-publish", std::process::id()));
        let (out, root) = (folder.join("out"), folder.join("root"));
        fs::create_dir_all(out.join("charts")).unwrap();
        fs::create_dir_all(&root).unwrap();
        for (file, text) in [
            ("out/readme.md", "| a | b |"),
            ("out/summary.md", "summary"),
            ("out/results.csv", "scene,technique"),
            ("out/charts/atrium.picture.svg", "<svg/>"),
            ("out/charts/atrium.picture.png", "png"),
            (
                "root/README.md",
                "before <!-- evaluation:begin --><!-- evaluation:end --> after",
            ),
        ] {
            fs::write(folder.join(file), text).unwrap();
        }
        publish(&out, &root).unwrap();
        let readme = fs::read_to_string(root.join("README.md")).unwrap();
        assert!(readme.starts_with("before ") && readme.contains("\n\n| a | b |\n\n") && readme.ends_with(" after"));
        for file in ["summary.md", "results.csv", "charts/atrium.picture.svg"] {
            assert!(root.join(FOLDER).join(file).exists(), "{file}");
        }
        assert!(!root.join(FOLDER).join("charts/atrium.picture.png").exists());
        assert!(publish(&root, &root).is_err(), "there are no results");
        fs::remove_dir_all(folder).unwrap();
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
