//! `cargo xtask demo`: a scene with ray-traced reflections, in a window or as a picture.

use std::env;
use std::ffi::OsString;
use std::fmt;
use std::path::{self, Path, PathBuf};
use std::str::FromStr;
use std::time::SystemTime;

use clap::ValueEnum;

use crate::cargo::Program;
use crate::driver::{self, Need};
use crate::failure::{Failure, Result};
use crate::{cargo, progress};

/// What `demo` accepts.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Render without a window and write a picture; this is what happens where there is no display.
    #[arg(long)]
    headless: bool,
    /// Name of a built-in scene.
    #[arg(long, value_name = "NAME", conflicts_with = "gltf")]
    scene: Option<String>,
    /// A glTF file (.gltf or .glb) to show instead of a built-in scene.
    #[arg(long, value_name = "FILE")]
    gltf: Option<PathBuf>,
    /// How reflections are made, such as `reference` or `converged` (default: medium; when headless: ultra, which is clean after few
    /// frames).
    #[arg(long, value_name = "NAME")]
    technique: Option<String>,
    /// How rays are spread over the picture.
    #[arg(long, value_name = "NAME")]
    backend: Option<String>,
    /// What follows the rays.
    #[arg(long, value_enum, value_name = "NAME")]
    tracer: Option<Tracer>,
    /// Size in pixels (default: 1280x720; when headless: 960x540, which a CPU can render, too).
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Number of frames to render before the picture is taken (default: 32; `converged` wants hundreds).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Open the settings panel.
    #[arg(long)]
    panel: bool,
    /// Where the picture goes (default when headless: demo.png).
    #[arg(long, value_name = "FILE.png")]
    out: Option<PathBuf>,
}

/// What a picture shows if nothing else is said; for files, too.
const PICTURE: &str = "ultra";
const PICTURE_SIZE: Size = Size {
    width: 960,
    height: 540,
};
const PICTURE_FRAMES: u32 = 32;

/// The tracers that can be asked for.
#[derive(Clone, Copy, ValueEnum)]
enum Tracer {
    /// Ray query where the GPU has it, else the BVH.
    Auto,
    /// The GPU's ray queries.
    RayQuery,
    /// The bounding volume hierarchy in compute shaders, on any GPU.
    Bvh,
}

/// A picture's size in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Size {
    width: u32,
    height: u32,
}

impl Size {
    /// The largest texture that every desktop adapter offers.
    const MAX: u32 = 8192;
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let side = |text: &str| text.parse().ok().filter(|side| (1..=Self::MAX).contains(side));
        text.split_once(['x', 'X'])
            .and_then(|(width, height)| {
                Some(Self {
                    width: side(width)?,
                    height: side(height)?,
                })
            })
            .ok_or_else(|| {
                format!(
                    "a size is WIDTHxHEIGHT in pixels, each from 1 to {}, such as 1280x720",
                    Self::MAX
                )
            })
    }
}

impl fmt::Display for Size {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}x{}", self.width, self.height)
    }
}

/// Builds the viewer and runs it.
pub fn run(options: &Options) -> Result {
    let plan = Plan::new(options, has_display())?;
    if plan.headless && !options.headless {
        progress::note("there is no display, so a picture is written instead");
    }
    let written_before = plan.picture.as_deref().and_then(modified);
    let driver = driver::prepare(Need::Vulkan)?;
    progress::step("build and run the viewer", || {
        let mut command = cargo::program(Program::Binary("glint_viewer"))?;
        command.args(&plan.arguments).envs(driver);
        cargo::run(&mut command, "the viewer")
    })?;
    match plan.picture {
        Some(picture) if modified(&picture) != written_before => progress::result(picture.display()),
        Some(picture) if plan.headless => {
            return Err(Failure::new(format!(
                "the viewer ended without writing {}",
                picture.display()
            )));
        }
        _ => {}
    }
    Ok(())
}

/// When a file was last written, if it exists.
fn modified(file: &Path) -> Option<SystemTime> {
    file.metadata().and_then(|metadata| metadata.modified()).ok()
}

/// What to run, once the options are known to make sense.
struct Plan {
    headless: bool,
    picture: Option<PathBuf>,
    arguments: Vec<OsString>,
}

impl Plan {
    fn new(options: &Options, has_display: bool) -> Result<Self> {
        let headless = options.headless || !has_display;
        let out = options
            .out
            .clone()
            .or_else(|| headless.then(|| PathBuf::from("demo.png")));
        let picture = out.as_deref().map(picture_path).transpose()?;
        let gltf = options.gltf.as_deref().map(gltf_path).transpose()?;

        let mut arguments: Vec<OsString> = Vec::new();
        let mut option = |name: &str, value: Option<OsString>| {
            if let Some(value) = value {
                arguments.push(name.into());
                arguments.push(value);
            }
        };
        let technique = options.technique.clone();
        let technique = technique.or_else(|| headless.then(|| PICTURE.to_owned()));
        let size = options.size.or(headless.then_some(PICTURE_SIZE));
        let frames = options.frames.or(headless.then_some(PICTURE_FRAMES));
        option("--gltf", gltf.map(Into::into));
        option("--scene", options.scene.clone().map(Into::into));
        option("--technique", technique.map(Into::into));
        option("--backend", options.backend.clone().map(Into::into));
        let tracer = options.tracer.and_then(|tracer| tracer.to_possible_value());
        option("--tracer", tracer.map(|tracer| tracer.get_name().into()));
        option("--size", size.map(|size| size.to_string().into()));
        option("--frames", frames.map(|frames| frames.to_string().into()));
        option("--out", picture.clone().map(Into::into));
        if options.panel {
            arguments.push("--panel".into());
        }
        if headless {
            arguments.push("--headless".into());
        }
        Ok(Self {
            headless,
            picture,
            arguments,
        })
    }
}

/// Whether a window can be opened.
///
/// On Linux that means X11: the viewer is built with it alone, and Wayland desktops serve it too.
fn has_display() -> bool {
    !cfg!(all(unix, not(target_os = "macos"))) || env::var_os("DISPLAY").is_some_and(|display| !display.is_empty())
}

/// Checks a glTF file and makes its path absolute, since the viewer runs in another directory.
fn gltf_path(file: &Path) -> Result<PathBuf> {
    let is_gltf = file
        .extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("gltf") || end.eq_ignore_ascii_case("glb"));
    if !is_gltf {
        return Err(Failure::new(format!(
            "{} is no glTF file: its name must end in .gltf or .glb",
            file.display()
        )));
    }
    if !file.is_file() {
        return Err(Failure::new(format!("there is no file {}", file.display())));
    }
    absolute(file)
}

/// Checks that a picture can be written there and makes its path absolute.
fn picture_path(file: &Path) -> Result<PathBuf> {
    if !file.extension().is_some_and(|end| end.eq_ignore_ascii_case("png")) {
        return Err(Failure::new(format!(
            "the picture {} must have a name that ends in .png",
            file.display()
        )));
    }
    let file = absolute(file)?;
    if file.is_dir() {
        return Err(Failure::new(format!("{} is a folder", file.display())));
    }
    match file.parent() {
        Some(folder) if !folder.is_dir() => Err(Failure::new(format!("there is no folder {}", folder.display()))),
        _ => Ok(file),
    }
}

fn absolute(file: &Path) -> Result<PathBuf> {
    path::absolute(file).map_err(|error| Failure::new(format!("{} can't be resolved: {error}", file.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(
            "1280x720".parse(),
            Ok(Size {
                width: 1280,
                height: 720
            })
        );
        assert_eq!("1X8192".parse(), Ok(Size { width: 1, height: 8192 }));
        for wrong in [
            "",
            "1280",
            "1280x",
            "x720",
            "0x720",
            "-1x5",
            "8193x1",
            "12 x 7",
            "1x2x3",
            "99999999999x1",
        ] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn options_reach_the_viewer() {
        let options = Options {
            scene: Some("spheres".into()),
            tracer: Some(Tracer::RayQuery),
            size: Some(Size { width: 64, height: 32 }),
            frames: Some(8),
            ..Options::default()
        };
        let plan = Plan::new(&options, true).unwrap();
        assert_eq!((plan.headless, plan.picture), (false, None));
        assert_eq!(
            plan.arguments,
            [
                "--scene",
                "spheres",
                "--tracer",
                "ray-query",
                "--size",
                "64x32",
                "--frames",
                "8"
            ]
            .map(OsString::from)
        );
    }

    #[test]
    fn without_a_display_a_picture_is_written() {
        let plan = Plan::new(&Options::default(), false).unwrap();
        let picture = path::absolute("demo.png").unwrap();
        assert!(plan.headless);
        let defaults = ["--technique", "ultra", "--size", "960x540", "--frames", "32", "--out"];
        let mut expected: Vec<OsString> = defaults.map(OsString::from).into();
        expected.extend([picture.clone().into_os_string(), "--headless".into()]);
        assert_eq!(plan.arguments, expected);
        assert_eq!(plan.picture, Some(picture));
    }

    #[test]
    fn what_is_said_of_a_picture_counts() {
        let options = Options {
            headless: true,
            technique: Some("converged".into()),
            size: Some(Size { width: 64, height: 32 }),
            frames: Some(8),
            ..Options::default()
        };
        let plan = Plan::new(&options, true).unwrap();
        let expected = ["--technique", "converged", "--size", "64x32", "--frames", "8", "--out"];
        assert_eq!(plan.arguments[..7], expected.map(OsString::from));
    }

    #[test]
    fn wrong_files_are_named() {
        let failure = |options: Options| Plan::new(&options, false).err().unwrap().to_string();
        let gltf = |file: &str| Options {
            gltf: Some(file.into()),
            ..Options::default()
        };
        let out = |file: &str| Options {
            out: Some(file.into()),
            ..Options::default()
        };
        assert_eq!(failure(gltf("missing.glb")), "there is no file missing.glb");
        assert!(failure(gltf("Cargo.toml")).contains("must end in .gltf or .glb"));
        assert!(failure(out("picture.jpg")).contains("ends in .png"));
        assert!(failure(out("no/such/folder/a.png")).starts_with("there is no folder"));
    }
}
