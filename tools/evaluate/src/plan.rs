//! What is to be measured, and where it goes.

use crate::protocol::{LEAD_FRAMES, Protocol};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// Frames that the pipelines and the scene take to be ready, for estimates only.
const SETTLE_FRAMES: u64 = 40;

/// The techniques in the order of tables. `solari` is measured apart from the others.
pub const TECHNIQUES: [&str; 14] = [
    "off",
    "ssr",
    "reference",
    "quarter",
    "quarter-inline",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-combined",
    "paper",
    "low",
    "medium",
    "high",
    "ultra",
    "solari",
];

/// The techniques of a quick run.
pub const QUICK_TECHNIQUES: [&str; 10] = [
    "off",
    "ssr",
    "reference",
    "quarter",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-combined",
    "paper",
    "medium",
    "solari",
];

/// The built-in scenes that are measured unless others are named.
pub const SCENES: [&str; 3] = ["atrium", "temple", "street"];

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
    #[must_use]
    pub fn new(technique: &str) -> Self {
        Self {
            technique: technique.to_owned(),
            hardware: false,
        }
    }

    /// A word for file names.
    #[must_use]
    pub fn id(&self) -> String {
        let suffix = if self.hardware { ".hardware" } else { "" };
        format!("{}{suffix}", self.technique)
    }

    /// Whether it traces rays.
    #[must_use]
    pub fn traces(&self) -> bool {
        !matches!(self.technique.as_str(), "off" | "ssr")
    }

    /// Whether it is this crate's.
    #[must_use]
    pub fn is_ours(&self) -> bool {
        !matches!(self.technique.as_str(), "off" | "ssr" | "solari")
    }

    /// Whether it is what the others are compared with besides the ground truth.
    #[must_use]
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

/// What finds the surfaces that rays hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TracerName {
    /// Ray queries.
    RayQuery,
    /// The crate's BVH.
    Bvh,
}

impl TracerName {
    /// The word.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::RayQuery => "ray-query",
            Self::Bvh => "bvh",
        }
    }
}

/// A scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SceneSource {
    /// One that is built from code.
    BuiltIn(String),
    /// A glTF file.
    File(PathBuf),
}

impl SceneSource {
    /// The scene's name, which is good for file names.
    #[must_use]
    pub fn name(&self) -> String {
        let name = match self {
            Self::BuiltIn(name) => name.clone(),
            Self::File(path) => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        let safe = |c: char| {
            if c.is_ascii_alphanumeric() {
                c.to_ascii_lowercase()
            } else {
                '_'
            }
        };
        name.chars().map(safe).collect()
    }
}

/// What one process measures: techniques that can share an app.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The scene.
    pub scene: SceneSource,
    /// The tracer of this job's techniques.
    pub tracer: TracerName,
    /// Bevy Solari alone, instead of everything else.
    pub solari: bool,
    /// Whether this is the first job of its scene, with the ground truth and with what doesn't trace.
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
    #[must_use]
    pub fn id(&self) -> String {
        let scene = self.scene.name();
        match (self.solari, self.first) {
            (true, _) => format!("{scene}.solari"),
            (false, true) => scene,
            (false, false) => format!("{scene}.{}", self.tracer.as_str()),
        }
    }

    /// The folder in which the state of this job is kept.
    #[must_use]
    pub fn state(&self) -> PathBuf {
        self.out.join("state").join(self.id())
    }

    /// The folder of pictures of one view.
    #[must_use]
    pub fn pictures(&self, view: u32) -> PathBuf {
        self.out.join("images").join(self.id()).join(view_name(view))
    }

    /// The folder of the ground truth and the picture without reflections, which all jobs of a scene share.
    #[must_use]
    pub fn shared_pictures(&self, view: u32) -> PathBuf {
        self.out.join("images").join(self.scene.name()).join(view_name(view))
    }

    /// The techniques in the order in which pictures are taken: `reference` first, so that those of the others can be compared with it
    /// as soon as they are there.
    #[must_use]
    pub fn picture_order(&self) -> Vec<&Variant> {
        let mut order: Vec<&Variant> = self.variants.iter().collect();
        order.sort_by_key(|variant| !variant.is_reference());
        order
    }

    /// Frames that this job renders when nothing of it is done yet.
    #[must_use]
    pub fn frames(&self) -> u64 {
        let protocol = &self.protocol;
        let views = u64::from(protocol.views);
        let shared = if self.first {
            views * (protocol.truth_frames() + u64::from(LEAD_FRAMES))
        } else {
            0
        };
        let one = protocol.picture_frames() + u64::from(protocol.rounds()) * protocol.turn_frames();
        SETTLE_FRAMES + shared + self.variants.len() as u64 * one
    }
}

fn view_name(view: u32) -> String {
    format!("view-{view}")
}

/// A file of a picture in a view's folder.
#[must_use]
pub fn picture_file(folder: &Path, id: &str, kind: PictureKind) -> PathBuf {
    folder.join(match kind {
        PictureKind::Final => format!("{id}.png"),
        PictureKind::FlipFinal => format!("{id}.flip.png"),
        PictureKind::FlipReflection => format!("{id}.reflection-flip.png"),
        PictureKind::Recovery(frame) => format!("{id}.cut-{frame:02}.png"),
    })
}

/// The pictures of a technique in a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureKind {
    /// What is seen after some frames of motion.
    Final,
    /// The error of that against the ground truth.
    FlipFinal,
    /// The error of the reflection alone against `reference`.
    FlipReflection,
    /// What is seen so many frames after a camera cut.
    Recovery(u32),
}

/// The order in which techniques take turns in a round: another one goes first each time, and every other round runs backwards,
/// so that none always follows the same one.
#[must_use]
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

/// Width and height, such as `1920x1080`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels in a row, 16 to 16384.
    pub width: u32,
    /// Rows, 16 to 16384.
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| {
            text.trim()
                .parse::<u32>()
                .ok()
                .filter(|side| (16..=16_384).contains(side))
        };
        text.split_once(['x', 'X'])
            .and_then(|(width, height)| {
                Some(Self {
                    width: side(width)?,
                    height: side(height)?,
                })
            })
            .ok_or_else(|| format!("`{text}` is no size such as 1280x720 (16 to 16384 each)"))
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
            let job = |quick, techniques: &[&str]| Job {
                scene: SceneSource::BuiltIn("atrium".into()),
                tracer: TracerName::Bvh,
                solari: false,
                first: true,
                variants: techniques.iter().map(|name| Variant::new(name)).collect(),
                protocol: Protocol::new(quick, is_cpu),
                out: PathBuf::new(),
                cache: PathBuf::new(),
            };
            let (quick, full) = (job(true, &QUICK_TECHNIQUES), job(false, &TECHNIQUES));
            assert!(quick.frames() * 5 < full.frames());
            // Three scenes at 2 frames a second on a CPU and at 150 on a GPU.
            let limit = if is_cpu { 10 * 60 * 2 } else { 2 * 60 * 150 };
            assert!(3 * quick.frames() < limit, "{}", quick.frames());
        }
    }

    #[test]
    fn a_quick_run_has_the_rows_that_decide() {
        for name in [
            "off",
            "ssr",
            "reference",
            "quarter",
            "vrs-roughness",
            "vrs-grazing",
            "vrs-combined",
            "paper",
            "medium",
            "solari",
        ] {
            assert!(QUICK_TECHNIQUES.contains(&name) && TECHNIQUES.contains(&name), "{name}");
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
    fn sizes() {
        assert_eq!(
            "320x180".parse(),
            Ok(Size {
                width: 320,
                height: 180
            })
        );
        for wrong in ["", "320", "8x8", "320x", "axb", "99999x10"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn jobs_survive_the_way_to_json_and_back() {
        let job = Job {
            scene: SceneSource::File("scene.glb".into()),
            tracer: TracerName::RayQuery,
            solari: true,
            first: false,
            variants: vec![Variant::new("solari")],
            protocol: Protocol::new(true, true),
            out: "out".into(),
            cache: "cache".into(),
        };
        let text = serde_json::to_string(&job).unwrap();
        assert_eq!(serde_json::from_str::<Job>(&text).unwrap(), job);
        assert_eq!(job.id(), "scene.solari");
    }

    #[test]
    fn the_reference_has_its_pictures_first() {
        let job = Job {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: ["off", "ssr", "reference", "low"].map(Variant::new).to_vec(),
            protocol: Protocol::new(true, true),
            out: "out".into(),
            cache: "cache".into(),
        };
        let order: Vec<&str> = job
            .picture_order()
            .iter()
            .map(|variant| variant.technique.as_str())
            .collect();
        assert_eq!(order, ["reference", "off", "ssr", "low"]);
    }
}
