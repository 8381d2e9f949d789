//! The command line, and the measurements that it requests on a machine.

use crate::{kernels, machine::Machine, subject::Subject};
use bevy::math::UVec2;
use bevy_glint::{
    RayTracedReflections, ReflectionBackend, ReflectionTracerChoice, ShadingRateHeuristic, named_settings,
};
use clap::{Parser, value_parser};
use glint_scenes::{CameraPlace, ImageSize, SceneName};
use std::{fmt, path::PathBuf, str::FromStr};

const TECHNIQUES: &str = "reference,quarter,quarter-inline,vrs-roughness,vrs-grazing,vrs-combined,vrs-adaptive,vrs-roughness@hardware,\
    vrs-grazing@hardware,paper,low,medium,high,ultra,idle";
/// Mesa's CPU driver crashes on ray queries in fragment shaders.
const CPU_TECHNIQUES: &str = "reference,quarter,vrs-roughness,vrs-grazing,vrs-combined,paper,idle";
const GROWTH_TECHNIQUES: &str = "vrs-combined,quarter";
const BUDGET_TECHNIQUES: &str = "vrs-combined";
/// Frames of the way under a budget.
const WAY_FRAMES: u32 = 1200;
const DEFAULT_SCENES: [SceneName; 3] = [SceneName::Demo, SceneName::AtriumSmall, SceneName::Atrium];
const GPU_SIZE: UVec2 = UVec2::new(1920, 1080);
const CPU_SIZE: UVec2 = UVec2::new(480, 270);
const GPU_FRAMES: u32 = 60;
const CPU_FRAMES: u32 = 5;

fn scene_help() -> String {
    let names = SceneName::ALL.map(SceneName::as_str).join(", ");
    let default = DEFAULT_SCENES.map(SceneName::as_str).join(", ");
    format!("{names}; may be given several times (default: {default})")
}

/// Measure rays per second, times of passes, and builds of acceleration structures.
#[derive(Parser)]
#[command(name = "glint_bench")]
pub struct Arguments {
    #[arg(long, value_name = "NAME", help = scene_help())]
    scene: Vec<SceneName>,
    /// A glTF file (.gltf or .glb), in place of or beside built-in scenes; can be given several times
    #[arg(long, value_name = "FILE")]
    gltf: Vec<PathBuf>,
    /// Position of the camera in the files and its target, in metres (default: their first camera, or one that sees everything)
    #[arg(long, value_name = "X,Y,Z,TX,TY,TZ", allow_hyphen_values = true, requires = "gltf")]
    camera: Option<CameraPlace>,
    /// auto, ray-query, bvh or all
    #[arg(long, value_name = "NAME", default_value = "all")]
    tracer: Tracers,
    /// Width and height in pixels (default: 1920x1080; 480x270 on a CPU)
    #[arg(long, value_name = "WxH")]
    size: Option<ImageSize>,
    /// Frames to measure (default: 60; 5 on a CPU)
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Techniques with passes to time, separated by commas; `@hardware` after one selects that back end, and `idle` is a camera that sees
    /// nothing reflective (default: all but the slow ones on a CPU)
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    techniques: Vec<TimedTechnique>,
    /// Fineness of curved parts, 0.25 to 8
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    detail: f32,
    /// Triangles of the generated mesh for BVH builds
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    pub triangles: u32,
    /// Measure the techniques again with the WESL files of this folder instead of the crate's modules of the same path below src; can be
    /// given several times
    #[arg(long, value_name = "DIR")]
    shaders: Vec<PathBuf>,
    /// Leave out the rays and the passes: measure only builds on the CPU
    #[arg(long, conflicts_with_all = ["skip_build", "worlds", "crowds", "growth", "budget"])]
    pub skip_rays: bool,
    /// Leave out building on the CPU
    #[arg(long)]
    pub skip_build: bool,
    /// Measure only the CPU time of worlds that are large or change, and the longest frame while meshes arrive: tables in Markdown
    #[arg(long, group = "cases")]
    pub worlds: bool,
    /// Rounds of `--worlds`, for the intervals; arrivals have fewer
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = value_parser!(u32).range(2..))]
    pub rounds: u32,
    /// Measure only characters and a field that are posed in each frame, particles, decals, and many lamps against few: tables in Markdown
    #[arg(long, group = "cases")]
    pub crowds: bool,
    /// Characters of `--crowds`, of 20 thousand triangles each
    #[arg(long, value_name = "N", default_value_t = 50, requires = "crowds")]
    pub characters: usize,
    /// Measure only the growth of times with the resolution (of the first scene) and with triangles, and the cost of small things:
    /// tables
    #[arg(long, group = "cases")]
    pub growth: bool,
    /// Measure only how well a budget keeps to its time along the camera's path through the scenes, over this number of frames, and after
    /// a new target: tables
    #[arg(long, conflicts_with_all = ["worlds", "crowds", "growth"])]
    pub budget: bool,
    /// Folder in which `--budget` writes a chart for each scene and technique
    #[arg(long, value_name = "DIR", requires = "budget")]
    pub out: Option<PathBuf>,
    /// Measure only the cases of `--worlds`, `--crowds` or `--growth` with this in their names
    #[arg(long, value_name = "WORD", requires = "cases")]
    pub only: Option<String>,
    /// Write all values as CSV
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
}

/// Rays and passes to measure.
#[derive(Clone)]
pub struct Plan {
    /// Scenes.
    pub subjects: Vec<Subject>,
    /// Tracers, each in its own app.
    pub tracers: Vec<ReflectionTracerChoice>,
    /// Techniques with passes to time.
    pub techniques: Vec<TimedTechnique>,
    /// Size of the view.
    pub size: UVec2,
    /// Frames to measure.
    pub frames: u32,
    /// Fineness of curved parts.
    pub detail: f32,
    /// Folders of shader modules that replace the crate's own.
    pub shaders: Vec<PathBuf>,
}

impl Arguments {
    /// Tracers to measure, each in its own app.
    pub fn tracers(&self) -> Vec<ReflectionTracerChoice> {
        self.tracer.list()
    }

    /// Returns the reason why there are no measurements.
    pub fn why_nothing(&self) -> String {
        match &self.only {
            Some(word) => format!("nothing was measured: no case has a name that contains `{word}`"),
            None => "nothing was measured: no tracer of these runs on this machine; pass --tracer bvh".to_owned(),
        }
    }

    /// The tracer for arrivals, which take long: the one that an app gets.
    pub fn arrival_tracer(&self) -> ReflectionTracerChoice {
        match self.tracer {
            Tracers::One(tracer) => tracer,
            Tracers::All => ReflectionTracerChoice::Auto,
        }
    }

    /// Fills the gaps with defaults that suit the machine.
    pub fn plan(&self, machine: &Machine) -> Plan {
        let (size, frames, mut techniques) = if machine.is_cpu {
            (CPU_SIZE, CPU_FRAMES, CPU_TECHNIQUES)
        } else {
            (GPU_SIZE, if self.budget { WAY_FRAMES } else { GPU_FRAMES }, TECHNIQUES)
        };
        if self.growth {
            techniques = GROWTH_TECHNIQUES;
        } else if self.budget {
            techniques = BUDGET_TECHNIQUES;
        }
        let default_techniques = || techniques.split(',').filter_map(|word| word.parse().ok()).collect();
        let scenes = match self.scene.as_slice() {
            [] if self.gltf.is_empty() => &DEFAULT_SCENES,
            chosen => chosen,
        };
        let files = self.gltf.iter().map(|path| Subject::File {
            // Bevy resolves relative paths in the asset folder.
            path: std::path::absolute(path).unwrap_or_else(|_| path.clone()),
            camera: self.camera,
        });
        Plan {
            subjects: scenes.iter().copied().map(Subject::BuiltIn).chain(files).collect(),
            tracers: self.tracers(),
            techniques: match self.techniques.as_slice() {
                [] => default_techniques(),
                chosen => chosen.to_vec(),
            },
            size: self.size.map_or(size, |size| size.0),
            frames: self.frames.unwrap_or(frames),
            detail: self.detail,
            shaders: self.shaders.clone(),
        }
    }
}

impl Plan {
    /// Checks that the rays fit into the adapter's memory.
    ///
    /// # Errors
    ///
    /// If they don't fit.
    pub fn check(&self, machine: &Machine) -> Result<(), String> {
        let needed = kernels::largest_buffer(self.size);
        if needed > machine.buffer_limit {
            return Err(format!(
                "{}x{} needs a buffer of {needed} bytes, and {} allows {}; pass a smaller --size",
                self.size.x, self.size.y, machine.name, machine.buffer_limit
            ));
        }
        Ok(())
    }

    /// Back end that the device is opened for.
    pub fn backend(&self) -> ReflectionBackend {
        let is_hardware = |technique: &TimedTechnique| technique.reflections.backend == ReflectionBackend::HardwareVrs;
        if self.techniques.iter().any(is_hardware) {
            ReflectionBackend::HardwareVrs
        } else {
            ReflectionBackend::Compute
        }
    }
}

#[derive(Clone, Copy)]
enum Tracers {
    One(ReflectionTracerChoice),
    All,
}

impl FromStr for Tracers {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "all" => Ok(Self::All),
            _ => word
                .parse::<ReflectionTracerChoice>()
                .map(Self::One)
                .map_err(|error| format!("{error}, all")),
        }
    }
}

impl Tracers {
    fn list(self) -> Vec<ReflectionTracerChoice> {
        match self {
            Self::One(tracer) => vec![tracer],
            Self::All => vec![ReflectionTracerChoice::RayQuery, ReflectionTracerChoice::Bvh],
        }
    }
}

/// Settings of a camera, from a word such as `vrs-roughness@hardware`. They have no roughness cut-off: rays are compared.
#[derive(Clone, Debug)]
pub struct TimedTechnique {
    word: String,
    /// Components of the camera.
    pub reflections: RayTracedReflections,
    /// Components of the camera.
    pub heuristic: ShadingRateHeuristic,
    /// The camera sees nothing reflective: all pixels are cut off.
    pub is_idle: bool,
}

impl TimedTechnique {
    /// The word for the preset `medium` on a camera that sees nothing reflective.
    const IDLE: &str = "idle";
}

impl fmt::Display for TimedTechnique {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.word)
    }
}

impl FromStr for TimedTechnique {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        let word = word.trim();
        let (name, backend) = match word.strip_suffix("@hardware") {
            Some(name) => (name, ReflectionBackend::HardwareVrs),
            None => (word, ReflectionBackend::Compute),
        };
        let is_idle = name == Self::IDLE;
        let name = if is_idle { "medium" } else { name };
        let (mut reflections, heuristic) = named_settings(name).map_err(|error| format!("{error}, {}", Self::IDLE))?;
        reflections.backend = backend;
        reflections.roughness_cutoff = if is_idle { 0.0 } else { 1.0 };
        reflections.roughness_fade = 0.0;
        Ok(Self {
            word: word.to_owned(),
            reflections,
            heuristic,
            is_idle,
        })
    }
}
