//! The command line.

use crate::{method::Method, source::Source};
use bevy::math::UVec2;
use bevy_glint::{ReflectionBackend, ReflectionDebugView, ReflectionTracerChoice, ScreenTraces};
use clap::{Parser, value_parser};
use glint_scenes::{ImageSize, SceneName, SceneOptions};
use std::{path::PathBuf, str::FromStr};

/// Preset of a window.
const WINDOW_PRESET: &str = "medium";
/// Preset of an image: clean after few frames, so that a CPU can render it too.
const IMAGE_PRESET: &str = "ultra";
const WINDOW_SIZE: UVec2 = UVec2::new(1280, 720);
const IMAGE_SIZE: UVec2 = UVec2::new(960, 540);

/// Ending of the names of images.
pub const IMAGE_ENDING: &str = "png";
/// Ending of the names of films.
#[cfg(feature = "film")]
pub const FILM_ENDING: &str = "webp";

fn scene_help() -> String {
    format!("A built-in scene: {}", SceneName::ALL.map(SceneName::as_str).join(", "))
}

/// Show a built-in scene or a glTF file with ray-traced reflections.
#[derive(Parser, Clone, Debug)]
#[command(name = "glint_viewer")]
pub struct Arguments {
    /// A .gltf or .glb file to show instead of a built-in scene
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Same as FILE
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    gltf: Option<PathBuf>,
    #[arg(long, value_name = "NAME", default_value_t = SceneName::Demo, conflicts_with_all = ["file", "gltf"], help = scene_help())]
    scene: SceneName,
    /// Fineness of curved parts of a built-in scene, 0.25 to 8
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    detail: f32,
    /// Position of the camera on the path of a built-in scene, 0 to 1
    #[arg(long, value_name = "T", default_value_t = 0.0)]
    pub path: f32,
    /// off, screen-space, reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, vrs-adaptive, converged,
    /// paper, low, medium, high or ultra (default: medium in a window, ultra for an image). A name that ends in `-half`, such as
    /// medium-half, denoises at half the resolution, and one that ends in `-no-follow` doesn't follow changes of the light
    #[arg(long, value_name = "NAME")]
    technique: Option<Method>,
    /// auto, compute or hardware
    #[arg(long, value_name = "NAME", default_value = "auto")]
    pub backend: ReflectionBackend,
    /// auto, ray-query or bvh
    #[arg(long, value_name = "NAME", default_value = "auto")]
    pub tracer: ReflectionTracerChoice,
    /// off, reuse or march: hits take their light from the last frame if they were visible there
    #[arg(long, value_name = "NAME", default_value = "off")]
    pub screen_traces: ScreenTraces,
    /// A debug view, such as shading-rates or rays-per-pixel, in place of the image
    #[arg(long, value_name = "NAME", default_value = "off")]
    pub view: ReflectionDebugView,
    /// Open the settings panel
    #[arg(long)]
    pub panel: bool,
    /// Width and height in pixels (default: 1280x720 in a window, 960x540 for an image)
    #[arg(long, value_name = "WxH")]
    size: Option<ImageSize>,
    /// Render without a window and write an image
    #[arg(long)]
    pub headless: bool,
    /// Stop the clock, so that nothing moves in an image
    #[arg(long, requires = "headless")]
    pub still: bool,
    /// Render a built-in scene as a browser does: with only the features and limits of WebGPU, and without anisotropic filtering, which
    /// drivers implement differently
    #[arg(long, requires = "headless")]
    pub browser: bool,
    /// Frames to render before the image is taken; converged needs hundreds
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Render the image by four methods, in two rows: the environment map alone, screen-space reflections, --technique, and the
    /// ground truth
    #[arg(long, requires = "headless")]
    pub compare: bool,
    /// Frames to render for the ground truth of --compare
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = value_parser!(u32).range(1..))]
    pub truth_frames: u32,
    /// File of the camera path that the key F9 records in a window, for `cargo xtask evaluate --path`
    #[arg(
        long,
        value_name = "FILE",
        default_value = "camera-path.txt",
        conflicts_with = "headless"
    )]
    pub record: PathBuf,
    /// Render a film of this many frames along the camera's path, as FILE.webp: without traced reflections at the left, and by
    /// --technique at the right, both of --size
    #[cfg(feature = "film")]
    #[arg(long, value_name = "N", requires = "headless", conflicts_with_all = ["compare", "still"], value_parser = value_parser!(u32).range(1..))]
    pub film: Option<u32>,
    /// The file of the image (default: named after the scene)
    #[arg(long, value_name = "FILE.png")]
    out: Option<PathBuf>,
}

impl Arguments {
    /// Reflections of the camera.
    pub fn method(&self) -> Result<Method, String> {
        let preset = if self.headless { IMAGE_PRESET } else { WINDOW_PRESET };
        let mut method = self.technique.clone().map_or_else(|| Method::from_str(preset), Ok)?;
        if let Method::Traced { settings, .. } = &mut method {
            settings.0.screen_traces = self.screen_traces;
        }
        Ok(method)
    }

    /// Size of the window or image.
    pub fn size(&self) -> UVec2 {
        let default = if self.headless { IMAGE_SIZE } else { WINDOW_SIZE };
        self.size.map_or(default, |size| size.0)
    }

    /// Scene or file.
    ///
    /// # Errors
    ///
    /// If the file can't be opened, or its name isn't a glTF file's.
    pub fn source(&self) -> Result<Source, String> {
        match self.file.as_ref().or(self.gltf.as_ref()) {
            Some(file) => Source::file(file),
            None => Ok(Source::BuiltIn(
                self.scene,
                SceneOptions {
                    detail: self.detail,
                    ..Default::default()
                },
            )),
        }
    }

    /// Path of the image or film. Its name must have this ending.
    ///
    /// # Errors
    ///
    /// If no file can be written there.
    pub fn out(&self, source: &Source, ending: &str) -> Result<PathBuf, String> {
        let default = || PathBuf::from(source.file_stem()).with_extension(ending);
        let out = self.out.clone().unwrap_or_else(default);
        if !out.extension().is_some_and(|end| end.eq_ignore_ascii_case(ending)) {
            return Err(format!(
                "the name of the file '{}' must end in .{ending}",
                out.display()
            ));
        }
        if out.is_dir() {
            return Err(format!("'{}' is a folder", out.display()));
        }
        Ok(out)
    }
}
