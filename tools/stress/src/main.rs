//! Hostile scenes, faults and long runs for as long as one likes: `cargo xtask stress --minutes 30`.

use argh::FromArgs;
use bevy::math::UVec2;
use bevy_glint::TracerChoice;
use glint_stress::{
    pulse,
    report::Line,
    section::Only,
    supervisor::{Plan, say},
    work::Work,
};
use std::{
    path::PathBuf,
    process::ExitCode,
    str::FromStr,
    time::{Duration, Instant},
};

/// Attack the reflections with hostile scenes, faults of the device and long runs.
#[derive(FromArgs)]
struct Arguments {
    /// minutes to run (default: 10)
    #[argh(option, default = "10.0")]
    minutes: f64,
    /// seed of the first scene (default: 1)
    #[argh(option, default = "1")]
    seed: u64,
    /// auto (both where the device has ray queries), ray-query or bvh (default: auto)
    #[argh(option, default = "TracerChoice::Auto")]
    tracer: TracerChoice,
    /// a section (faults, energy, stability, long-run, bounds, viewer, scenes), a fault such as device-lost, or an ingredient that
    /// all scenes have, such as mesh-needles
    #[argh(option)]
    only: Option<Only>,
    /// size of all pictures in pixels, such as 48x32
    #[argh(option)]
    size: Option<Size>,
    /// number of scenes, or of files for the viewer
    #[argh(option)]
    count: Option<u64>,
    /// frames of each scene, or of the long run
    #[argh(option)]
    frames: Option<u32>,
    /// places of the ingredients that are kept of the first scene, separated by commas, or none
    #[argh(option)]
    keep: Option<Places>,
    /// compile all shaders with runtime checks (default: in every other process that renders scenes)
    #[argh(switch)]
    checked: bool,
    /// the program `glint_viewer` (default: the one that cargo built beside this program)
    #[argh(option)]
    viewer: Option<PathBuf>,
    /// what this process does for another one
    #[argh(option, hidden_help)]
    work: Option<Only>,
    /// seconds that it may take
    #[argh(option, hidden_help, default = "60")]
    seconds: u64,
    /// without reflections
    #[argh(switch, hidden_help)]
    plain: bool,
}

/// Width and height.
#[derive(Clone, Copy)]
struct Size(UVec2);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split_once(['x', 'X'])
            .and_then(|(width, height)| Some(UVec2::new(width.parse().ok()?, height.parse().ok()?)))
            .filter(|size| size.min_element() >= 1 && size.max_element() <= 8192)
            .map(Self)
            .ok_or_else(|| format!("`{text}` is not a size such as 48x32, each from 1 to 8192"))
    }
}

/// Places of ingredients.
#[derive(Clone)]
struct Places(Vec<usize>);

impl FromStr for Places {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self(Vec::new()));
        }
        let places: Result<Vec<usize>, _> = text.split(',').map(|place| place.trim().parse()).collect();
        places
            .map(Self)
            .map_err(|_| format!("`{text}` is not a list of places such as 0,3"))
    }
}

fn main() -> ExitCode {
    let arguments: Arguments = argh::from_env();
    if let Some(only) = arguments.work {
        pulse::start();
        let work = work(&arguments, only);
        let next = work.run(&mut |line| line.tell());
        Line::End(next).tell();
        return ExitCode::SUCCESS;
    }
    if !(arguments.minutes > 0.0) || !arguments.minutes.is_finite() {
        say("error: --minutes must be more than 0");
        return ExitCode::FAILURE;
    }
    let plan = plan(&arguments);
    let outcome = plan.run(&mut |line| say(line));
    say(&outcome.to_string());
    if outcome.is_good() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn work(arguments: &Arguments, only: Only) -> Work {
    Work {
        only,
        tracer: arguments.tracer,
        seed: arguments.seed,
        count: arguments.count,
        keep: arguments.keep.clone().map(|places| places.0),
        frames: arguments.frames,
        size: arguments.size.map(|size| size.0),
        checked: arguments.checked,
        plain: arguments.plain,
        viewer: arguments.viewer.clone(),
        minutes: arguments.minutes,
        deadline: Instant::now() + Duration::from_secs(arguments.seconds),
    }
}

fn plan(arguments: &Arguments) -> Plan {
    let mut handed_on = Vec::new();
    let mut hand_on = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            handed_on.extend([name.to_owned(), value]);
        }
    };
    hand_on("--count", arguments.count.map(|count| count.to_string()));
    hand_on("--frames", arguments.frames.map(|frames| frames.to_string()));
    let size = arguments.size.map(|Size(size)| format!("{}x{}", size.x, size.y));
    hand_on("--size", size);
    let keep = arguments.keep.as_ref().map(|Places(places)| {
        let places: Vec<_> = places.iter().map(ToString::to_string).collect();
        if places.is_empty() {
            "none".to_owned()
        } else {
            places.join(",")
        }
    });
    hand_on("--keep", keep);
    let viewer = arguments.viewer.as_ref();
    hand_on("--viewer", viewer.map(|path| path.to_string_lossy().into_owned()));
    // A kept part is one of a scene.
    let only = match (arguments.only, &arguments.keep, arguments.count) {
        (None, Some(_), _) | (None, _, Some(_)) => "scenes".parse().ok(),
        (only, ..) => only,
    };
    Plan {
        only,
        tracer: arguments.tracer,
        seed: arguments.seed,
        time: Duration::from_secs_f64(60.0 * arguments.minutes.min(1e6)),
        checked: arguments.checked,
        handed_on,
        once: arguments.count.is_some() || arguments.keep.is_some(),
    }
}
