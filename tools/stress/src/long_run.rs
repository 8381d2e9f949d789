//! Ten thousand frames of a moving camera: brightness doesn't drift, histories keep to their range, memory stays flat.

use crate::{
    checks,
    judge::{Drift, Judgement},
    pulse,
    stage::Stage,
};
use bevy::{core_pipeline::tonemapping::Tonemapping, diagnostic::FrameCount, prelude::*};
use bevy_glint::{RayTracedReflections, internals::Target, named_settings};
use glint_scenes::{SceneName, SceneOptions, environment};
use std::{fs, time::Instant};

/// Frames after which the camera is where it began: whole cycles of the blue noise, so that laps differ as little as they can.
pub const LAP: u32 = 128;
/// Frames of a whole run: ten thousand in whole laps.
pub const FRAMES: u32 = 79 * LAP;
/// The mean brightness of the late laps may differ from that of the early ones by so much.
pub const MOST_DRIFT: f64 = 0.005;
/// Laps until the history is full.
const WARM_LAPS: usize = 1;
/// Laps after which memory is looked at for the first time: by then caches are full.
const FULL_LAPS: usize = 2;
/// Memory of the process may grow by so much after the first laps, ..
const MOST_GROWTH: f64 = 0.05;
/// .. and so many bytes, which allocators keep.
const SLACK_BYTES: u64 = 48 << 20;
/// What the library says that it owns on the device may grow by so many bytes.
const DEVICE_SLACK_BYTES: u64 = 1 << 20;
/// Frames between two looks at the targets.
const LOOK: u32 = LAP / 4;
/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 5000;

/// Bytes of the process, where the system tells, and bytes that the library owns on the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Main memory of this process.
    pub process: Option<u64>,
    /// Textures and buffers of the library.
    pub device: u64,
}

/// What a run came to.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Frames that were rendered along the path.
    pub frames: u32,
    /// Mean brightness of the laps.
    pub laps: Vec<f64>,
    /// Memory after the first laps and at the end.
    pub memory: Option<(Memory, Memory)>,
    /// What must not be.
    pub problems: Vec<String>,
    /// What couldn't be decided.
    pub open: Vec<String>,
}

impl Outcome {
    /// How the later laps differ from the earlier ones, without those that fill the history; `None` of too few.
    #[must_use]
    pub fn drift(&self) -> Option<Drift> {
        Drift::of(self.laps.get(WARM_LAPS..).unwrap_or_default())
    }

    /// Drift and memory in words.
    #[must_use]
    pub fn describe(&self) -> String {
        let drift = self.drift().map_or_else(
            || "too few laps to tell of a drift".to_owned(),
            |Drift { change, margin, values }| {
                format!(
                    "brightness changes by {:+.3} % +- {:.3} % from the first {values} laps to the last",
                    100.0 * change,
                    100.0 * margin
                )
            },
        );
        let megabytes = |bytes: u64| bytes >> 20;
        let memory = self.memory.map_or_else(String::new, |(first, last)| {
            let process = first
                .process
                .zip(last.process)
                .map_or_else(String::new, |(first, last)| {
                    format!(
                        ", memory of the process went from {} to {} MiB",
                        megabytes(first),
                        megabytes(last)
                    )
                });
            let (first, last) = (megabytes(first.device), megabytes(last.device));
            format!("{process}, that of the library on the device from {first} to {last} MiB")
        });
        format!("{} frames, {} laps, {drift}{memory}", self.frames, self.laps.len())
    }
}

/// Renders up to so many frames, or as many as there is time for. Frame numbers run over halfway, so that whatever that does shows as a
/// drift.
///
/// # Errors
///
/// If the scene can't be rendered.
pub fn run(stage: &mut Stage, size: UVec2, frames: u32, deadline: Instant) -> Result<Outcome, String> {
    stage.reset_clocks();
    let options = SceneOptions {
        texture_size: 64,
        ..default()
    };
    let name = SceneName::Demo;
    let root = glint_scenes::spawn_with(name, stage.world(), &options);
    let (home, projection) = glint_scenes::camera(name);
    let (settings, heuristic) = named_settings("vrs-combined").map_err(|error| error.to_string())?;
    let max_history = settings.denoiser.max_history;
    let camera = stage.spawn_camera(size, (home, Projection::from(projection), settings, heuristic));
    let surroundings = environment(name, stage.world());
    surroundings.insert(&mut stage.world().entity_mut(camera));
    stage.world().entity_mut(camera).insert(Tonemapping::None);
    let settled = stage.settle(PATIENCE);
    // Things that move by themselves would make laps differ.
    stage.world().resource_mut::<Time<Virtual>>().pause();
    let mut outcome = Outcome::default();
    if !settled || stage.world().get::<RayTracedReflections>(camera).is_none() {
        outcome.problems.push("the scene was never ready".to_owned());
    }
    stage.settle_merges(PATIENCE);
    stage.world().insert_resource(FrameCount(u32::MAX - frames / 2));
    let meshes = stage.status().map(|status| status.meshes);
    let mut sum = 0.0;
    for frame in 0..frames {
        if Instant::now() > deadline {
            break;
        }
        if let Some(mut transform) = stage.world().get_mut::<Transform>(camera) {
            *transform = pose(home, frame);
        }
        stage.step(1);
        let picture = stage.picture(camera)?;
        if let Some(index) = picture.non_finite().first() {
            outcome
                .problems
                .push(format!("frame {frame}: pixel {index} is no number"));
            break;
        }
        sum += picture.mean();
        outcome.frames = frame + 1;
        if outcome.frames.is_multiple_of(LAP) {
            outcome.laps.push(sum / f64::from(LAP));
            sum = 0.0;
            if outcome.laps.len() == FULL_LAPS {
                outcome.memory = Some((memory(stage), Memory::default()));
            }
        }
        if outcome.frames.is_multiple_of(LOOK) {
            pulse::doing(format!("long run: {} of {frames} frames", outcome.frames));
            let wrong = look(stage, camera, max_history);
            if !wrong.is_empty() {
                outcome
                    .problems
                    .extend(wrong.into_iter().map(|text| format!("frame {frame}: {text}")));
                break;
            }
        }
    }
    if let Some((_, last)) = &mut outcome.memory {
        *last = memory(stage);
    }
    if stage.status().map(|status| status.meshes) != meshes {
        outcome
            .problems
            .push("meshes came or went, though nothing changed but the camera".to_owned());
    }
    judge(&mut outcome);
    stage.world().despawn(camera);
    stage.world().despawn(root);
    stage.step(3);
    stage.reset_clocks();
    outcome
        .problems
        .extend(checks::leftovers(stage).into_iter().map(|problem| problem.text));
    outcome.problems.extend(stage.take_errors());
    Ok(outcome)
}

/// A loop with a turn of the head.
fn pose(home: Transform, frame: u32) -> Transform {
    let angle = core::f32::consts::TAU * (frame % LAP) as f32 / LAP as f32;
    let offset = home.right() * (0.4 * ops::sin(angle)) + home.up() * (0.1 * ops::sin(2.0 * angle));
    Transform {
        translation: home.translation + offset,
        rotation: Quat::from_rotation_y(0.1 * ops::sin(angle)) * home.rotation,
        ..home
    }
}

/// Targets in their ranges, histories no longer than the camera allows.
fn look(stage: &Stage, camera: Entity, max_history: f32) -> Vec<String> {
    let wrong = checks::targets(stage, camera).into_iter();
    let mut texts: Vec<_> = wrong.map(|problem| problem.text).collect();
    if let Some(history) = stage.copy(camera, Target::HistoryRadiance) {
        let length = |texel: &[u32]| crate::picture::half((texel[1] >> 16) as u16);
        let lengths = history.words.chunks_exact(history.texel.max(2)).map(length);
        let longest = lengths.fold(0.0, f32::max);
        // Half floats of that size are steps of 1/32.
        if longest > max_history + 0.1 {
            texts.push(format!(
                "a history of {longest} frames, where {max_history} are allowed"
            ));
        }
    } else {
        texts.push("the camera doesn't reflect any more".to_owned());
    }
    texts
}

fn judge(outcome: &mut Outcome) {
    let percent = |value: f64| 100.0 * value;
    match outcome.drift() {
        None => outcome.open.push(format!(
            "whether brightness drifts: {} laps are too few",
            outcome.laps.len()
        )),
        Some(drift) => {
            let text = format!(
                "the mean brightness drifts by {:+.3} % +- {:.3} %, at most {:.1} % are allowed",
                percent(drift.change),
                percent(drift.margin),
                percent(MOST_DRIFT)
            );
            match drift.judge(MOST_DRIFT) {
                Judgement::Holds => {}
                Judgement::Fails => outcome.problems.push(text),
                Judgement::Undecided => outcome
                    .open
                    .push(format!("{text}: the interval is too wide, take more frames or pixels")),
            }
        }
    }
    let Some((first, last)) = outcome.memory else { return };
    if let (Some(first), Some(last)) = (first.process, last.process) {
        let most = (first as f64 * (1.0 + MOST_GROWTH)) as u64 + SLACK_BYTES;
        if last > most {
            let text = format!("memory of the process grew from {first} to {last} bytes");
            outcome.problems.push(text);
        }
    }
    if last.device > first.device + DEVICE_SLACK_BYTES {
        let text = format!(
            "memory of the library on the device grew from {} to {} bytes",
            first.device, last.device
        );
        outcome.problems.push(text);
    }
}

fn memory(stage: &Stage) -> Memory {
    let device = stage.status().map_or(0, |status| {
        let views: u64 = status.view_memory.iter().map(|view| view.bytes()).sum();
        status.scene_bytes + views
    });
    Memory {
        process: resident_bytes(),
        device,
    }
}

/// Bytes of main memory that this process holds; only Linux tells.
#[must_use]
pub fn resident_bytes() -> Option<u64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1024 * kilobytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(laps: &[f64]) -> Outcome {
        let mut outcome = Outcome {
            laps: laps.to_vec(),
            ..Outcome::default()
        };
        judge(&mut outcome);
        outcome
    }

    #[test]
    fn drift_counts_from_the_laps_that_are_warm() {
        assert_eq!(outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0]).drift(), None);
        assert_eq!(outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0]).open.len(), 1);
        let steady = outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]);
        assert!(steady.problems.is_empty() && steady.open.is_empty(), "{steady:?}");
        let brighter = outcome(&[9.0, 2.0, 2.0, 2.0, 2.02, 2.02, 2.02]);
        assert_eq!((brighter.problems.len(), brighter.open.len()), (1, 0), "{brighter:?}");
        let noisy = outcome(&[9.0, 2.0, 1.9, 2.1, 2.0, 2.1, 1.9]);
        assert_eq!((noisy.problems.len(), noisy.open.len()), (0, 1), "{noisy:?}");
    }

    #[test]
    fn memory_may_not_grow() {
        let mut grown = Outcome {
            laps: vec![1.0; 10],
            ..Outcome::default()
        };
        let small = Memory {
            process: Some(1 << 30),
            device: 1 << 20,
        };
        let large = Memory {
            process: Some(2 << 30),
            device: 5 << 20,
        };
        grown.memory = Some((small, small));
        judge(&mut grown);
        assert!(grown.problems.is_empty(), "{grown:?}");
        grown.memory = Some((small, large));
        judge(&mut grown);
        assert_eq!(grown.problems.len(), 2, "{grown:?}");
    }

    #[test]
    fn the_camera_comes_back() {
        let home = Transform::from_xyz(1.0, 2.0, 3.0);
        assert!(pose(home, LAP).translation.distance(pose(home, 0).translation) < 1e-5);
        assert_ne!(pose(home, LAP / 4), home);
        assert!(FRAMES >= 10_000 && FRAMES.is_multiple_of(LAP));
    }
}
