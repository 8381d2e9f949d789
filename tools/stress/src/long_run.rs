//! Ten thousand frames of a moving camera: brightness must not drift, histories must stay in their range, memory must not grow.

use crate::{
    harness::Harness,
    heartbeat, invariants,
    statistics::{Drift, LimitCheck},
};
use bevy::{core_pipeline::tonemapping::Tonemapping, diagnostic::FrameCount, prelude::*};
use bevy_glint::{RayTracedReflections, internals::Target, named_settings};
use glint_scenes::SceneName;
use half::f16;
use std::{fs, time::Instant};

/// Frames of a lap, after which the camera is back: whole cycles of the blue noise, so that laps differ as little as possible.
pub const LAP: u32 = 128;
/// Frames of a whole run: ten thousand in whole laps.
pub const FRAMES: u32 = 79 * LAP;
/// Largest relative change of the mean brightness from the early laps to the late ones.
pub const MOST_DRIFT: f64 = 0.005;
/// Laps until the history is full.
const WARM_LAPS: usize = 1;
/// Laps until caches are full and memory is measured for the first time.
const FULL_LAPS: usize = 2;
/// Largest relative growth of the process's memory after the first laps, in addition to [`SLACK_BYTES`].
const MOST_GROWTH: f64 = 0.05;
/// Bytes that allocators keep.
const SLACK_BYTES: u64 = 48 << 20;
/// Largest growth of the library's memory on the device in bytes.
const DEVICE_SLACK_BYTES: u64 = 1 << 20;
/// Frames between two checks of the targets.
const CHECK_INTERVAL: u32 = LAP / 4;
/// Maximum number of frames to wait for assets, pipelines and meshes.
const PATIENCE: u32 = 5000;

/// Memory in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Main memory of this process, if the system reports it.
    pub process: Option<u64>,
    /// Textures and buffers of the library on the device.
    pub device: u64,
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Frames that were rendered along the path.
    pub frames: u32,
    /// Mean brightness of each lap.
    pub laps: Vec<f64>,
    /// Memory after the first laps and at the end.
    pub memory: Option<(Memory, Memory)>,
    pub problems: Vec<String>,
    pub undecided: Vec<String>,
}

impl Outcome {
    /// Change from the earlier to the later laps, without the laps that fill the history; `None` if there are too few.
    pub fn drift(&self) -> Option<Drift> {
        Drift::of(self.laps.get(WARM_LAPS..).unwrap_or_default())
    }

    /// Describes drift and memory.
    pub fn describe(&self) -> String {
        let drift = self.drift().map_or_else(
            || "too few laps to tell of a drift".to_owned(),
            |Drift { change, margin, values }| {
                let (change, margin) = (100.0 * change, 100.0 * margin);
                format!(
                    "brightness changes by {change:+.3} % +- {margin:.3} % from the first {values} laps to the last"
                )
            },
        );
        let mut text = format!("{} frames, {} laps, {drift}", self.frames, self.laps.len());
        if let Some((first, last)) = self.memory {
            let megabytes = |bytes: u64| bytes >> 20;
            if let Some((first, last)) = first.process.zip(last.process) {
                let (first, last) = (megabytes(first), megabytes(last));
                text += &format!(", memory of the process went from {first} to {last} MiB");
            }
            let (first, last) = (megabytes(first.device), megabytes(last.device));
            text += &format!(", that of the library on the device from {first} to {last} MiB");
        }
        text
    }

    /// Compares drift and memory with their limits.
    fn check(&mut self) {
        let percent = |value: f64| 100.0 * value;
        if let Some(drift) = self.drift() {
            let text = format!(
                "the mean brightness drifts by {:+.3} % +- {:.3} %, at most {:.1} % are allowed",
                percent(drift.change),
                percent(drift.margin),
                percent(MOST_DRIFT)
            );
            match drift.check(MOST_DRIFT) {
                LimitCheck::Within => {}
                LimitCheck::Exceeded => self.problems.push(text),
                LimitCheck::Undecided => self
                    .undecided
                    .push(format!("{text}: the interval is too wide, take more frames or pixels")),
            }
        } else {
            let laps = self.laps.len();
            self.undecided
                .push(format!("whether brightness drifts: {laps} laps are too few"));
        }
        let Some((first, last)) = self.memory else { return };
        if let (Some(first), Some(last)) = (first.process, last.process)
            && last > (first as f64 * (1.0 + MOST_GROWTH)) as u64 + SLACK_BYTES
        {
            let text = format!("memory of the process grew from {first} to {last} bytes");
            self.problems.push(text);
        }
        if last.device > first.device + DEVICE_SLACK_BYTES {
            let (first, last) = (first.device, last.device);
            let text = format!("memory of the library on the device grew from {first} to {last} bytes");
            self.problems.push(text);
        }
    }
}

/// Renders frames until the deadline. Frame numbers overflow halfway, so that an effect shows as a drift.
/// Fails if the scene can't be rendered.
pub fn run(
    harness: &mut Harness,
    scene: SceneName,
    size: UVec2,
    frames: u32,
    deadline: Instant,
) -> Result<Outcome, String> {
    harness.reset_clocks();
    let (root, camera) = harness.spawn_scene(scene, 64, size);
    let (settings, heuristic) = named_settings("vrs-combined").map_err(|error| error.to_string())?;
    let max_history = settings.denoiser.max_history;
    let mut view = harness.world().entity_mut(camera);
    view.insert((settings, heuristic, Tonemapping::None));
    let is_idle = harness.wait_until_idle(PATIENCE);
    // Animations would make laps differ.
    harness.world().resource_mut::<Time<Virtual>>().pause();
    let mut outcome = Outcome::default();
    if !is_idle || harness.world().get::<RayTracedReflections>(camera).is_none() {
        outcome.problems.push("the scene was never ready".to_owned());
    }
    harness.wait_for_merges(PATIENCE);
    harness.world().insert_resource(FrameCount(u32::MAX - frames / 2));
    let meshes = harness.status().map(|status| status.meshes);
    render_laps(harness, camera, frames, (max_history, deadline), &mut outcome)?;
    if let Some((_, last)) = &mut outcome.memory {
        *last = memory(harness);
    }
    if harness.status().map(|status| status.meshes) != meshes {
        let text = "the number of meshes changed, though only the camera moved";
        outcome.problems.push(text.to_owned());
    }
    outcome.check();
    harness.world().despawn(camera);
    harness.world().despawn(root);
    harness.step(3);
    harness.reset_clocks();
    let leftovers = invariants::leftovers(harness).into_iter();
    outcome.problems.extend(leftovers.map(|problem| problem.text));
    outcome.problems.extend(harness.take_errors());
    Ok(outcome)
}

fn render_laps(
    harness: &mut Harness,
    camera: Entity,
    frames: u32,
    (max_history, deadline): (f32, Instant),
    outcome: &mut Outcome,
) -> Result<(), String> {
    let home = harness.world().get::<Transform>(camera).copied().unwrap_or_default();
    let mut sum = 0.0;
    for frame in 0..frames {
        if Instant::now() > deadline {
            break;
        }
        if let Some(mut transform) = harness.world().get_mut::<Transform>(camera) {
            *transform = pose(home, frame);
        }
        harness.step(1);
        let image = harness.image(camera)?;
        let mut wrong: Vec<String> = image.check_finite().err().into_iter().collect();
        sum += image.mean();
        outcome.frames = frame + 1;
        if outcome.frames.is_multiple_of(LAP) {
            outcome.laps.push(sum / f64::from(LAP));
            sum = 0.0;
            if outcome.laps.len() == FULL_LAPS {
                outcome.memory = Some((memory(harness), Memory::default()));
            }
        }
        if outcome.frames.is_multiple_of(CHECK_INTERVAL) {
            heartbeat::set_activity(format!("long run: {} of {frames} frames", outcome.frames));
            wrong.extend(check_targets(harness, camera, max_history));
        }
        if !wrong.is_empty() {
            let wrong = wrong.into_iter().map(|text| format!("frame {frame}: {text}"));
            outcome.problems.extend(wrong);
            break;
        }
    }
    Ok(())
}

/// The camera's pose on a loop with a turn of the head.
fn pose(home: Transform, frame: u32) -> Transform {
    let angle = core::f32::consts::TAU * (frame % LAP) as f32 / LAP as f32;
    let offset = home.right() * (0.4 * ops::sin(angle)) + home.up() * (0.1 * ops::sin(2.0 * angle));
    Transform {
        translation: home.translation + offset,
        rotation: Quat::from_rotation_y(0.1 * ops::sin(angle)) * home.rotation,
        ..home
    }
}

/// Checks that targets are in their ranges, and histories no longer than the camera allows.
fn check_targets(harness: &Harness, camera: Entity, max_history: f32) -> Vec<String> {
    let wrong = invariants::targets(harness, camera).into_iter();
    let mut texts: Vec<_> = wrong.map(|problem| problem.text).collect();
    let Some(history) = harness.copy(camera, Target::HistoryRadiance) else {
        texts.push("the camera doesn't reflect any more".to_owned());
        return texts;
    };
    let length = |texel: &[u32]| f16::from_bits((texel[1] >> 16) as u16).to_f32();
    let lengths = history.words.chunks_exact(history.texel.max(2)).map(length);
    let longest = lengths.fold(0.0, f32::max);
    // Half floats of that size are in steps of 1/32.
    if longest > max_history + 0.1 {
        texts.push(format!(
            "a history of {longest} frames, where {max_history} are allowed"
        ));
    }
    texts
}

fn memory(harness: &Harness) -> Memory {
    let device = harness.status().map_or(0, |status| {
        let views: u64 = status.view_memory.iter().map(|view| view.bytes()).sum();
        status.scene_bytes + views
    });
    Memory {
        process: resident_bytes(),
        device,
    }
}

/// Main memory of this process in bytes; known on Linux only.
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
        outcome.check();
        outcome
    }

    #[test]
    fn drift_counts_from_the_laps_that_are_warm() {
        assert_eq!(outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0]).drift(), None);
        assert_eq!(outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0]).undecided.len(), 1);
        let steady = outcome(&[9.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]);
        assert!(steady.problems.is_empty() && steady.undecided.is_empty(), "{steady:?}");
        let brighter = outcome(&[9.0, 2.0, 2.0, 2.0, 2.02, 2.02, 2.02]);
        assert_eq!(
            (brighter.problems.len(), brighter.undecided.len()),
            (1, 0),
            "{brighter:?}"
        );
        let noisy = outcome(&[9.0, 2.0, 1.9, 2.1, 2.0, 2.1, 1.9]);
        assert_eq!((noisy.problems.len(), noisy.undecided.len()), (0, 1), "{noisy:?}");
    }

    #[test]
    fn memory_may_not_grow() {
        let [small, large] = [1, 2].map(|gigabytes| Memory {
            process: Some(gigabytes << 30),
            device: gigabytes << 22,
        });
        for (last, problems) in [(small, 0), (large, 2)] {
            let mut outcome = Outcome {
                laps: vec![1.0; 10],
                memory: Some((small, last)),
                ..Outcome::default()
            };
            outcome.check();
            assert_eq!(outcome.problems.len(), problems, "{outcome:?}");
        }
    }

    #[test]
    fn the_camera_comes_back() {
        let home = Transform::from_xyz(1.0, 2.0, 3.0);
        assert!(pose(home, LAP).translation.distance(pose(home, 0).translation) < 1e-5);
        assert_ne!(pose(home, LAP / 4), home);
        assert!(FRAMES >= 10_000 && FRAMES.is_multiple_of(LAP));
    }
}
