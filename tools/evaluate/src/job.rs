//! The units of measurement (techniques, scenes, and jobs for worker processes), and the paths of their results.

use crate::protocol::{Protocol, SHARED_FRAMES};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    path::{Path, PathBuf},
};
use strum::IntoStaticStr;

/// Frames until the pipelines and the scene are ready, for estimates only.
const LOAD_FRAMES: u64 = 40;

/// The techniques in the order of tables. `solari` is measured apart from the others.
pub const TECHNIQUES: [&str; 16] = [
    "off",
    "ssr",
    "reference",
    "quarter",
    "quarter-inline",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-combined",
    "vrs-adaptive",
    "vrs-adaptive-half",
    "paper",
    "low",
    "medium",
    "high",
    "ultra",
    "solari",
];

/// Techniques that a quick run leaves out.
const THOROUGH_TECHNIQUES: [&str; 5] = ["quarter-inline", "vrs-adaptive-half", "low", "high", "ultra"];

/// The techniques of a thorough run, or of a quick one.
pub fn techniques(quick: bool) -> Vec<&'static str> {
    let is_in = |name: &&str| !(quick && THOROUGH_TECHNIQUES.contains(name));
    TECHNIQUES.into_iter().filter(is_in).collect()
}

/// The built-in scenes that are measured unless others are named.
pub const SCENES: [&str; 3] = ["atrium", "temple", "street"];

/// The techniques that are measured in held-out scenes unless others are named.
pub const HELD_OUT_TECHNIQUES: [&str; 5] = ["reference", "quarter", "vrs-roughness", "vrs-combined", "vrs-adaptive"];
/// Views of each of these scenes, unless there is another number.
pub const HELD_OUT_VIEWS: u32 = 2;

/// A technique with a back end.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Variant {
    /// One of [`TECHNIQUES`].
    pub technique: String,
    /// Rays are spread by the rasterizer's shading rate instead of by lists.
    pub hardware: bool,
}

impl Variant {
    /// A technique with the usual back end.
    pub fn new(technique: &str) -> Self {
        Self {
            technique: technique.to_owned(),
            hardware: false,
        }
    }

    /// A word for file names.
    pub fn id(&self) -> String {
        let suffix = if self.hardware { ".hardware" } else { "" };
        format!("{}{suffix}", self.technique)
    }

    /// True if it traces rays.
    pub fn traces(&self) -> bool {
        !matches!(self.technique.as_str(), "off" | "ssr")
    }

    /// True if it is this crate's.
    pub fn is_ours(&self) -> bool {
        !matches!(self.technique.as_str(), "off" | "ssr" | "solari")
    }

    /// True if the others are compared with it besides the ground truth.
    pub fn is_reference(&self) -> bool {
        self.technique == "reference"
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffix = if self.hardware { " (hardware)" } else { "" };
        write!(f, "{}{suffix}", self.technique)
    }
}

/// Tracers by the words of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, IntoStaticStr, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum TracerName {
    /// Ray queries.
    RayQuery,
    /// The crate's BVH.
    Bvh,
}

impl TracerName {
    /// The word.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// A scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SceneSource {
    /// A scene that is built from code.
    BuiltIn(String),
    /// A glTF file.
    File(PathBuf),
}

impl SceneSource {
    /// The scene's name, in a form for file names.
    pub fn name(&self) -> String {
        let name = match self {
            Self::BuiltIn(name) => name.clone(),
            Self::File(path) => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        name.to_ascii_lowercase()
            .replace(|c: char| !c.is_ascii_alphanumeric(), "_")
    }
}

/// The work of one process: techniques that can share an app.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The scene.
    pub scene: SceneSource,
    /// The tracer of this job's techniques.
    pub tracer: TracerName,
    /// Only Bevy Solari, instead of everything else.
    pub solari: bool,
    /// The first job of its scene, with the ground truth and the techniques that don't trace.
    pub first: bool,
    /// The techniques.
    pub variants: Vec<Variant>,
    /// How much is measured.
    pub protocol: Protocol,
    /// The folder of results.
    pub out: PathBuf,
    /// The folder of ground truths.
    pub cache: PathBuf,
}

impl Job {
    /// A word for file names.
    pub fn id(&self) -> String {
        let scene = self.scene.name();
        match (self.solari, self.first) {
            (true, _) => format!("{scene}.solari"),
            (false, true) => scene,
            (false, false) => format!("{scene}.{}", self.tracer.as_str()),
        }
    }

    /// The folder of this job's state.
    pub fn state(&self) -> PathBuf {
        self.out.join("state").join(self.id())
    }

    /// The folder of images of one view.
    pub fn images(&self, view: u32) -> PathBuf {
        self.out.join("images").join(self.id()).join(view_name(view))
    }

    /// The folder of the ground truth and the image without reflections, which all jobs of a scene share.
    pub fn shared_images(&self, view: u32) -> PathBuf {
        self.out.join("images").join(self.scene.name()).join(view_name(view))
    }

    /// The file of a view's true light, which all jobs of a scene share.
    pub fn true_light(&self, view: u32) -> PathBuf {
        self.shared_images(view).join("light.f32")
    }

    /// The techniques in the order of their images: `reference` first, since the others are compared with it.
    pub fn image_order(&self) -> Vec<&Variant> {
        let mut order: Vec<&Variant> = self.variants.iter().collect();
        order.sort_by_key(|variant| !variant.is_reference());
        order
    }

    /// Frames of this job if none is done yet.
    pub fn frames(&self) -> u64 {
        let protocol = &self.protocol;
        let views = u64::from(protocol.views);
        let shared = if self.first {
            views * (protocol.truth_frames() + u64::from(SHARED_FRAMES))
        } else {
            0
        };
        let one = protocol.image_frames() + u64::from(protocol.rounds()) * protocol.turn_frames();
        LOAD_FRAMES + shared + self.variants.len() as u64 * one
    }
}

fn view_name(view: u32) -> String {
    format!("view-{view}")
}

/// The file of an image in a view's folder.
pub fn image_file(folder: &Path, id: &str, kind: ImageKind) -> PathBuf {
    folder.join(match kind {
        ImageKind::Final => format!("{id}.png"),
        ImageKind::Run(run) => format!("{id}.run-{run:02}.png"),
        ImageKind::FlipFinal => format!("{id}.flip.png"),
        ImageKind::FlipReflection => format!("{id}.reflection-flip.png"),
        ImageKind::Recovery(frame) => format!("{id}.cut-{frame:02}.png"),
        ImageKind::LightInMotion => format!("{id}.light-in-motion.png"),
        ImageKind::StaticLight => format!("{id}.static-light.png"),
        ImageKind::Noise => format!("{id}.noise.png"),
        ImageKind::Bias => format!("{id}.bias.png"),
    })
}

/// The images of a technique in a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageKind {
    /// The frame after some frames of motion.
    Final,
    /// The image of a further run, which differs only in its noise.
    Run(u32),
    /// The error of that against the ground truth.
    FlipFinal,
    /// The error of the reflection alone against `reference`.
    FlipReflection,
    /// This number of frames after a camera cut.
    Recovery(u32),
    /// The error of the reflected light after some frames of motion.
    LightInMotion,
    /// The error of the reflected light after a number of static frames.
    StaticLight,
    /// The part of the reflected light's error in motion that differs from run to run.
    Noise,
    /// The part of it that doesn't.
    Bias,
}

/// The order in which techniques take turns in a round. Each time another one goes first, and every other round runs backwards,
/// so that no technique always follows the same one.
pub fn order(count: usize, round: u32) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    if count > 0 {
        order.rotate_left(round as usize / 2 % count);
    }
    if round % 2 == 1 {
        order.reverse();
    }
    order
}

#[cfg(test)]
impl Job {
    /// A small job with results in a folder, for tests.
    pub fn example(out: &Path, techniques: &[&str]) -> Self {
        Self {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: techniques.iter().map(|name| Variant::new(name)).collect(),
            protocol: Protocol {
                timing_frames: 1,
                views: 1,
                still_views: 0,
                ..Protocol::new(true, true)
            },
            out: out.to_owned(),
            cache: out.join("cache"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_fair() {
        let rounds: Vec<_> = (0..6).map(|round| order(3, round)).collect();
        assert_eq!(
            rounds[..4],
            [vec![0, 1, 2], vec![2, 1, 0], vec![1, 2, 0], vec![0, 2, 1]]
        );
        // Over all rounds each one has each place equally often.
        for place in 0..3 {
            let mut seen: Vec<usize> = rounds.iter().map(|order| order[place]).collect();
            seen.sort_unstable();
            assert_eq!(seen, [0, 0, 1, 1, 2, 2]);
        }
        assert!(order(0, 5).is_empty());
    }

    #[test]
    fn a_quick_run_is_short() {
        for is_cpu in [false, true] {
            let frames = |quick| {
                let protocol = Protocol::new(quick, is_cpu);
                let job = Job::example(Path::new(""), &techniques(quick));
                Job { protocol, ..job }.frames()
            };
            let (quick, full) = (frames(true), frames(false));
            assert!(quick * 5 < full);
            // Three scenes at 2 frames a second on a CPU and at 150 on a GPU.
            let limit = if is_cpu { 10 * 60 * 2 } else { 2 * 60 * 150 };
            assert!(3 * quick < limit, "{quick}");
        }
    }

    #[test]
    fn names_are_good_for_files() {
        let file = SceneSource::File("/a/My Scene (2).glb".into());
        assert_eq!(file.name(), "my_scene__2_");
        let hardware = Variant {
            hardware: true,
            ..Variant::new("low")
        };
        assert_eq!(
            (hardware.id(), hardware.to_string()),
            ("low.hardware".into(), "low (hardware)".into())
        );
    }

    #[test]
    fn jobs_survive_the_way_to_json_and_back() {
        let job = Job {
            scene: SceneSource::File("scene.glb".into()),
            tracer: TracerName::RayQuery,
            solari: true,
            ..Job::example(Path::new("out"), &["solari"])
        };
        let text = serde_json::to_string(&job).unwrap();
        assert_eq!(serde_json::from_str::<Job>(&text).unwrap(), job);
        assert!(text.contains("\"ray-query\"") && job.id() == "scene.solari");
    }

    #[test]
    fn the_reference_has_its_images_first() {
        let job = Job::example(Path::new("out"), &["off", "ssr", "reference", "low"]);
        let order: Vec<String> = job.image_order().iter().map(|variant| variant.id()).collect();
        assert_eq!(order, ["reference", "off", "ssr", "low"]);
    }
}
