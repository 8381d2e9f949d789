//! The same frames with and without runtime checks in the library's shaders.
//!
//! Bevy compiles shaders without checks, and an access out of bounds can then read anything. With checks it reads something harmless.
//! Different frames indicate accesses out of bounds in arrays of fixed size and binding arrays, endless loops, and integer divisions by
//! zero. Buffers and images aren't covered if the driver itself checks them, as the CPU driver does: wgpu then relies on these checks.

use crate::{
    generators::Generator,
    harness::{Harness, HarnessSettings},
    image::LinearImage,
    log_capture::{self, catch_panic, drop_quietly},
    path_equivalence::{describe_difference, restart, tolerated},
    scenario::Scenario,
    static_scene::{StaticScene, StaticSceneView},
    tally::Tally,
    verdict::Verdict,
};
use bevy::{math::UVec2, prelude::Entity};
use bevy_glint::{
    ReflectionDebugView, ReflectionTracerChoice,
    internals::{Copied, Target},
};
use glint_scenes::{Random, SceneName};

/// Maximum number of frames to wait for assets, pipelines and meshes.
const PATIENCE: u32 = 5000;
/// Frames in which histories fill before they are compared.
const FRAMES: u32 = 6;
/// Techniques of the scenes that are not hostile.
const TECHNIQUES: [&str; 3] = ["vrs-combined", "reference", "paper"];
/// Number of hostile scenes.
const HOSTILE: u64 = 9;
/// Generators of each.
const GENERATORS: usize = 8;
/// Largest relative difference of pixels on a GPU with a compiler that translates checked code differently.
const MOST_DIFFERENCE: f32 = 0.02;
/// Targets to compare, besides rates and the image.
const TARGETS: [Target; 4] = [
    Target::RaySample,
    Target::RayRadiance,
    Target::Reconstructed,
    Target::HistoryRadiance,
];

/// A scene to render in both ways.
#[derive(Clone, Debug, PartialEq)]
pub enum Case {
    Static(StaticScene, &'static str),
    Hostile(Scenario),
}

impl Case {
    /// All cases of a run.
    pub fn all(seed: u64, size: UVec2) -> Vec<Self> {
        let scenes = [
            StaticScene::BuiltIn(SceneName::Demo),
            StaticScene::BuiltIn(SceneName::EmissiveFloor),
            StaticScene::Random(seed),
        ];
        let known = scenes
            .into_iter()
            .zip(TECHNIQUES)
            .map(|(scene, technique)| Self::Static(scene, technique));
        let hostile = (0..HOSTILE).map(|index| Self::Hostile(hostile(seed.wrapping_add(index), size)));
        known.chain(hostile).collect()
    }

    pub fn describe(&self) -> String {
        match self {
            Self::Static(scene, technique) => format!("{} by {technique}", scene.name()),
            Self::Hostile(scenario) => format!("hostile scene of seed {} ({})", scenario.seed, scenario.describe()),
        }
    }
}

/// A scenario of generators with data that shaders look up by index, without changes from frame to frame.
fn hostile(seed: u64, size: UVec2) -> Scenario {
    let is_wanted = |generator: &Generator| {
        let changes = matches!(
            generator,
            Generator::File(_) | Generator::View(_) | Generator::Settings(_) | Generator::Event(_)
        );
        !changes && !generator.is_heavy()
    };
    let all: Vec<_> = Generator::all().into_iter().filter(is_wanted).collect();
    let mut random = Random::new(seed);
    let generators = (0..GENERATORS).map(|_| random.pick(&all)).collect();
    Scenario::new(seed, size, FRAMES, generators)
}

/// The contents of the targets after a frame.
struct Snapshot {
    rates: Copied,
    /// `None` for targets that the technique doesn't have.
    targets: [Option<Copied>; TARGETS.len()],
    image: LinearImage,
}

/// Two apps on one device, without checks and with them.
pub struct Bounds {
    size: UVec2,
    tracer: ReflectionTracerChoice,
    harnesses: Option<[Harness; 2]>,
}

impl Bounds {
    /// Opens both. Fails if there is no device, or none with this tracer.
    pub fn new(tracer: ReflectionTracerChoice, size: UVec2) -> Result<Self, String> {
        let mut bounds = Self {
            size,
            tracer,
            harnesses: None,
        };
        bounds.open()?;
        Ok(bounds)
    }

    fn open(&mut self) -> Result<&mut [Harness; 2], String> {
        let open = |checked: bool| {
            Harness::new(&HarnessSettings {
                tracer: self.tracer,
                checked,
                ..HarnessSettings::default()
            })
        };
        match &mut self.harnesses {
            Some(harnesses) => Ok(harnesses),
            none => Ok(none.insert([open(false)?, open(true)?])),
        }
    }

    /// Name and driver of the device.
    pub fn adapter(&self) -> String {
        let status = self.harnesses.as_ref().and_then(|[plain, _]| plain.status());
        status.map(|status| status.adapter).unwrap_or_default()
    }

    /// Renders a case in both ways. Returns the work for it, too.
    pub fn compare(&mut self, case: &Case) -> (Verdict, Tally) {
        let size = self.size;
        let [plain, checked] = match self.open() {
            Ok(harnesses) => harnesses,
            Err(error) => {
                let reason = format!("the device can't be opened again: {error}");
                return (Verdict::Undecided(reason), Tally::default());
            }
        };
        log_capture::clear();
        let compared = catch_panic(|| compare_snapshots(plain, checked, case, size));
        let mut tally = plain.take_tally();
        tally += checked.take_tally();
        tally.scenes += 1;
        let verdict = match compared {
            Ok(compared) => compared.unwrap_or_else(Verdict::Undecided),
            Err(panic) => {
                drop_quietly(self.harnesses.take());
                if log_capture::is_own(&panic) {
                    Verdict::Failed(vec![panic])
                } else {
                    Verdict::Undecided(format!("Bevy panics: {panic}"))
                }
            }
        };
        (verdict, tally)
    }
}

/// The error is the reason why the case is inconclusive.
fn compare_snapshots(plain: &mut Harness, checked: &mut Harness, case: &Case, size: UVec2) -> Result<Verdict, String> {
    let (first, second) = (snapshot(plain, case, size)?, snapshot(checked, case, size)?);
    let exact = plain.is_cpu();
    let mut problems = differences(&first, &second, exact);
    if !problems.is_empty() {
        // A real difference occurs each time, and frames without checks are all the same.
        if differences(&first, &snapshot(checked, case, size)?, exact).is_empty() {
            return Err("two frames with checks differ from each other".to_owned());
        }
        if !differences(&first, &snapshot(plain, case, size)?, exact).is_empty() {
            return Err("two frames without checks differ, too".to_owned());
        }
    }
    problems.extend(checked.take_errors());
    Ok(if problems.is_empty() {
        Verdict::Passed(String::new())
    } else {
        Verdict::Failed(problems)
    })
}

fn snapshot(harness: &mut Harness, case: &Case, size: UVec2) -> Result<Snapshot, String> {
    match case {
        Case::Static(scene, technique) => StaticSceneView::with(harness, *scene, size, |harness, view| {
            view.switch(harness, technique, ReflectionDebugView::Off)?;
            take(harness, view.camera)
        }),
        Case::Hostile(scenario) => {
            harness.reset_clocks();
            let scene = scenario.build(harness);
            harness.wait_for_files(&scene.files, PATIENCE);
            harness.wait_until_idle(PATIENCE);
            let result = take(harness, scene.cameras[0]);
            scene.remove(harness);
            harness.step(3);
            result
        }
    }
}

/// Restarts a camera once the scene is static, so that it draws the same samples each time.
fn take(harness: &mut Harness, camera: Entity) -> Result<Snapshot, String> {
    harness.wait_for_merges(PATIENCE);
    restart(harness, &[camera], FRAMES);
    let targets = TARGETS.map(|target| harness.copy(camera, target));
    let Some(rates) = harness.copy(camera, Target::Rate).filter(|_| targets[0].is_some()) else {
        return Err("the camera doesn't reflect".to_owned());
    };
    let image = harness.image(camera)?;
    Ok(Snapshot { rates, targets, image })
}

fn differences(first: &Snapshot, second: &Snapshot, exact: bool) -> Vec<String> {
    let mut problems = Vec::new();
    if first.rates != second.rates {
        problems.push("rates differ with runtime checks".to_owned());
    }
    let both = |index: usize| Some([first.targets[index].clone()?, second.targets[index].clone()?]);
    // Rays are recorded in the first target.
    let records = both(0);
    for (index, target) in TARGETS.into_iter().enumerate() {
        if let (Some(pair), Some(records)) = (both(index), &records)
            && let Some(difference) = describe_difference(&pair, &first.rates, records, target, exact)
        {
            problems.push(format!("{target:?}: {difference} with runtime checks"));
        }
    }
    let total = first.image.texels.len();
    let different = differing_pixels(&first.image, &second.image, exact);
    if different > tolerated(total, exact) {
        problems.push(format!("{different} of {total} pixels differ with runtime checks"));
    }
    problems
}

fn differing_pixels(first: &LinearImage, second: &LinearImage, exact: bool) -> usize {
    if first.size != second.size {
        return first.texels.len().max(second.texels.len());
    }
    let differ = |(a, b): (&f32, &f32)| {
        let same = a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
        let near = !exact && (a - b).abs() <= MOST_DIFFERENCE * a.abs().max(b.abs()).max(1.0);
        !(same || near)
    };
    let pairs = first.texels.iter().zip(&second.texels);
    pairs.filter(|(a, b)| a.iter().zip(*b).any(differ)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_follow_from_the_seed() {
        let size = UVec2::splat(8);
        let cases = Case::all(5, size);
        assert_eq!(cases, Case::all(5, size));
        assert_ne!(cases, Case::all(6, size));
        assert_eq!(cases.len() as u64, TECHNIQUES.len() as u64 + HOSTILE);
        for case in cases {
            if let Case::Hostile(scenario) = case {
                assert_eq!(scenario.generators.len(), GENERATORS);
                let is_event = |(_, generator): &(usize, Generator)| matches!(generator, Generator::Event(_));
                assert!(!scenario.generators.iter().any(is_event));
            }
        }
    }

    #[test]
    fn pixels_differ_by_bits_or_by_parts() {
        let image = |value: f32| LinearImage {
            size: UVec2::ONE,
            texels: vec![[value, 0.0, f32::NAN, 1.0]],
        };
        assert_eq!(differing_pixels(&image(1.0), &image(1.0), true), 0);
        assert_eq!(differing_pixels(&image(1.0), &image(1.001), true), 1);
        assert_eq!(differing_pixels(&image(1.0), &image(1.001), false), 0);
        assert_eq!(differing_pixels(&image(1.0), &image(f32::NAN), false), 1);
    }
}
