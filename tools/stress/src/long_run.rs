//! Ten thousand frames of a moving camera: brightness doesn't drift, histories keep to their range, memory stays flat.

use crate::{checks, stage::Stage};
use bevy::{core_pipeline::tonemapping::Tonemapping, diagnostic::FrameCount, prelude::*};
use bevy_glint::{RayTracedReflections, inspect::Target, named_settings};
use glint_scenes::{SceneName, SceneOptions, environment};
use std::{fs, time::Instant};

/// Frames of a whole run.
pub const FRAMES: u32 = 10_000;
/// Frames after which the camera is where it began.
pub const LAP: u32 = 250;
/// The mean brightness of a lap may differ from that of the first ones by so much.
pub const MOST_DRIFT: f64 = 0.005;
/// Memory of the process may grow by so much after the first laps, ..
const MOST_GROWTH: f64 = 0.05;
/// .. and so many bytes, which allocators keep.
const SLACK_BYTES: u64 = 48 << 20;
/// Frames between two looks at the targets.
const LOOK: u32 = 50;
/// Laps until history and caches are full.
const WARM_LAPS: usize = 2;
/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 5000;

/// What a run came to.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Frames that were rendered along the path.
    pub frames: u32,
    /// Mean brightness of the laps.
    pub laps: Vec<f64>,
    /// Bytes of the process after the first laps and at the end, where the system tells.
    pub memory: Option<(u64, u64)>,
    /// What must not be.
    pub problems: Vec<String>,
}

impl Outcome {
    /// Largest difference of a lap from the first ones that count, relative to them.
    #[must_use]
    pub fn drift(&self) -> f64 {
        let laps = self.laps.get(WARM_LAPS..).unwrap_or_default();
        let Some((first, rest)) = laps.split_first() else {
            return 0.0;
        };
        let apart = rest.iter().map(|lap| (lap - first).abs());
        apart.fold(0.0, f64::max) / first.abs().max(1e-9)
    }
}

/// Renders up to so many frames, or as many as there is time for. Frame numbers run over on the way.
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
    stage.world().insert_resource(FrameCount(u32::MAX - frames / 2));
    // Built before; objects at rest may still be merged.
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
            if outcome.laps.len() == WARM_LAPS {
                outcome.memory = resident_bytes().map(|bytes| (bytes, bytes));
            }
        }
        if outcome.frames.is_multiple_of(LOOK) {
            let wrong = look(stage, camera, max_history);
            if !wrong.is_empty() {
                outcome
                    .problems
                    .extend(wrong.into_iter().map(|text| format!("frame {frame}: {text}")));
                break;
            }
        }
    }
    if let (Some((_, last)), Some(now)) = (&mut outcome.memory, resident_bytes()) {
        *last = now;
    }
    if stage.status().map(|status| status.meshes) != meshes {
        outcome
            .problems
            .push("meshes came or went, though nothing changed but the camera".to_owned());
    }
    outcome.problems.extend(verdict(&outcome));
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

fn verdict(outcome: &Outcome) -> Vec<String> {
    let mut problems = Vec::new();
    let drift = outcome.drift();
    if !(drift <= MOST_DRIFT) {
        problems.push(format!(
            "the mean brightness drifts by {:.3} %, at most {:.1} % are allowed",
            100.0 * drift,
            100.0 * MOST_DRIFT
        ));
    }
    if let Some((first, last)) = outcome.memory {
        let most = (first as f64 * (1.0 + MOST_GROWTH)) as u64 + SLACK_BYTES;
        if last > most {
            problems.push(format!("memory of the process grew from {first} to {last} bytes"));
        }
    }
    problems
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

    #[test]
    fn drift_counts_from_the_laps_that_are_warm() {
        let outcome = |laps: &[f64]| Outcome {
            laps: laps.to_vec(),
            ..Outcome::default()
        };
        assert_eq!(outcome(&[]).drift(), 0.0);
        assert_eq!(outcome(&[9.0, 5.0, 2.0]).drift(), 0.0);
        assert!((outcome(&[9.0, 5.0, 2.0, 2.0, 2.01]).drift() - 0.005).abs() < 1e-9);
        assert!(verdict(&outcome(&[9.0, 5.0, 2.0, 2.0, 2.02])).len() == 1);
    }

    #[test]
    fn the_camera_comes_back() {
        let home = Transform::from_xyz(1.0, 2.0, 3.0);
        assert!(pose(home, LAP).translation.distance(pose(home, 0).translation) < 1e-5);
        assert_ne!(pose(home, LAP / 4), home);
    }
}
