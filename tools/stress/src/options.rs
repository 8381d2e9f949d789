//! Options of a stress run: read from the command line, narrowed for each worker process, and printed to repeat a failure.

use crate::{selection::Selection, word::word};
use bevy::math::UVec2;
use bevy_glint::ReflectionTracerChoice;
use clap::{Args, ValueEnum};
use core::{fmt, str::FromStr};
use glint_scenes::ImageSize;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Longest side of an image: weak devices support no more.
const MOST_PIXELS: u32 = 8192;

/// Options of a stress run.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Minutes to run.
    #[arg(long, value_name = "N", default_value = "10", value_parser = positive)]
    pub minutes: f64,
    /// Seed of the first scene.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Tracer that finds the surfaces that rays hit.
    #[arg(long, value_enum, value_name = "NAME", default_value_t)]
    pub tracer: Tracer,
    /// A section (faults, energy, stability, long-run, bounds, viewer or scenes), a fault such as device-lost, or a generator that
    /// all scenes use, such as mesh-needles.
    #[arg(long, value_name = "NAME")]
    pub only: Option<Selection>,
    /// Size of all images in pixels, such as 48x32.
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<(u32, u32)>,
    /// Number of scenes, or of files for the viewer.
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Render this number of scenes in as many sittings as it takes, and record findings in the corpus.
    #[arg(long, value_name = "N", conflicts_with_all = ["count", "keep", "only"])]
    pub campaign: Option<u64>,
    /// Folder of the campaign.
    #[arg(long, value_name = "DIR", default_value = "target/stress-campaign")]
    pub corpus: PathBuf,
    /// Frames of each scene, or of the long run.
    #[arg(long, value_name = "N")]
    pub frames: Option<u32>,
    /// Positions of the generators to keep of the first scene, separated by commas, or `none`.
    #[arg(long, value_name = "POSITIONS")]
    pub keep: Option<Keep>,
    /// Compile all shaders with runtime checks [default: in every other process that renders scenes].
    #[arg(long)]
    pub checked: bool,
    /// Compare rays with brute force in each scene [default: in one of ten, and in recipes that failed].
    #[arg(long)]
    #[serde(default)]
    pub rays: bool,
    /// The program `glint_viewer` [default: the one that cargo built beside this program].
    #[arg(long, value_name = "PATH")]
    pub viewer: Option<PathBuf>,
}

impl Options {
    /// The same options for one part of the run.
    pub fn only(&self, selection: Selection) -> Self {
        Self {
            only: Some(selection),
            campaign: None,
            ..self.clone()
        }
    }

    /// The size of images, or a default if none was requested.
    pub fn size_or(&self, default: UVec2) -> UVec2 {
        self.size.map_or(default, UVec2::from)
    }
}

/// The options that repeat the run, apart from its time.
impl fmt::Display for Options {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "--tracer {} --seed {}", word(&self.tracer), self.seed)?;
        let option = |text: Option<String>| text.unwrap_or_default();
        f.write_str(&option(self.only.map(|only| format!(" --only {only}"))))?;
        f.write_str(&option(
            self.size.map(|(width, height)| format!(" --size {width}x{height}")),
        ))?;
        f.write_str(&option(self.count.map(|count| format!(" --count {count}"))))?;
        f.write_str(&option(self.frames.map(|frames| format!(" --frames {frames}"))))?;
        f.write_str(&option(self.keep.as_ref().map(|keep| format!(" --keep {keep}"))))?;
        f.write_str(if self.checked { " --checked" } else { "" })?;
        f.write_str(if self.rays { " --rays" } else { "" })
    }
}

/// Tracers that can be requested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum Tracer {
    /// Both if the device has ray queries.
    #[default]
    Auto,
    /// The ray queries of the device.
    RayQuery,
    /// The bounding volume hierarchy in compute shaders.
    Bvh,
}

impl From<Tracer> for ReflectionTracerChoice {
    fn from(tracer: Tracer) -> Self {
        match tracer {
            Tracer::Auto => Self::Auto,
            Tracer::RayQuery => Self::RayQuery,
            Tracer::Bvh => Self::Bvh,
        }
    }
}

/// Positions of generators in a scenario.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Keep(pub Vec<usize>);

impl fmt::Display for Keep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("none");
        }
        let positions: Vec<_> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&positions.join(","))
    }
}

impl FromStr for Keep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self(Vec::new()));
        }
        let positions: Result<_, _> = text.split(',').map(|position| position.trim().parse()).collect();
        positions
            .map(Self)
            .map_err(|_| "choose positions such as 0,3, or `none`".to_owned())
    }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let ImageSize(size) = text.parse()?;
    let is_small = size.max_element() <= MOST_PIXELS;
    is_small
        .then(|| size.into())
        .ok_or_else(|| format!("choose sides of at most {MOST_PIXELS} pixels"))
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| *number > 0.0 && *number <= 1e6);
    number.ok_or_else(|| "choose a number above 0, up to a million".to_owned())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use clap::{Command, FromArgMatches};

    /// Reads options from the text of a command line.
    pub fn parse(text: &str) -> Result<Options, clap::Error> {
        let words = ["stress"].into_iter().chain(text.split_whitespace());
        let matches = Options::augment_args(Command::new("stress")).try_get_matches_from(words)?;
        Options::from_arg_matches(&matches)
    }

    #[test]
    fn printed_options_are_read_back() {
        for text in [
            "",
            "--tracer bvh --only scenes --seed 41 --keep 0,3 --frames 2 --size 1x1 --checked --rays",
            "--tracer ray-query --only mesh-needles --seed 18446744073709551615 --count 7",
            "--keep none --only device-lost",
        ] {
            let options = parse(text).unwrap();
            assert_eq!(parse(&options.to_string()).unwrap(), options, "{text}");
            let json = serde_json::to_string(&options).unwrap();
            assert_eq!(serde_json::from_str::<Options>(&json).unwrap(), options, "{json}");
        }
        assert_eq!(parse("").unwrap().to_string(), "--tracer auto --seed 1");
    }

    #[test]
    fn bad_options_are_refused() {
        for text in [
            "--minutes 0",
            "--minutes=-1",
            "--minutes nan",
            "--minutes inf",
            "--size 0x3",
            "--size 9000x3",
            "--size 48",
            "--keep 0,x",
            "--only flood",
            "--tracer rays",
            "--seed -1",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert_eq!(parse("--minutes 0.5").unwrap().minutes, 0.5);
    }
}
