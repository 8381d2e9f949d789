//! White balls in a white furnace must be white at all roughnesses, whatever the technique, after the whole denoiser.

use crate::{
    energy::{Findings, Lengths, MOST_ROUNDS, SIGMAS, SINGLE_FRAMES},
    judge::{Judgement, judge, mean_and_deviation},
    picture::{Picture, luminance},
    stage::Stage,
    still::{StillScene, StillView, techniques},
};
use bevy::math::{IVec2, UVec2};
use bevy_glint::DebugView;
use glint_scenes::{FURNACE_ROUGHNESS, SceneName};
use std::time::Instant;

/// A white surface in a white furnace may be off by so much.
pub const MOST_ERROR: f64 = 0.02;
/// The accumulating technique: it has no history to be switched off, and after so many frames no noise to speak of.
const TRUTH: &str = "converged";

/// The middle of a ball in the picture.
struct Ball {
    name: String,
    pixels: Vec<usize>,
}

impl Ball {
    fn mean(&self, picture: &Picture) -> f64 {
        let sum: f64 = self
            .pixels
            .iter()
            .map(|pixel| f64::from(luminance(&picture.texels[*pixel])))
            .sum();
        sum / self.pixels.len().max(1) as f64
    }
}

/// Balls stand on a grid of one metre, seen from 7 m with a field of view of 32 degrees.
fn balls(size: UVec2) -> Vec<Ball> {
    let pixels_per_metre = size.y as f32 / (2.0 * 7.0 * 16f32.to_radians().tan());
    let radius = (0.28 * pixels_per_metre) as i32;
    let mut balls = Vec::new();
    for (row, kind) in [(-0.5, "dielectric"), (0.5, "metal")] {
        for (column, roughness) in FURNACE_ROUGHNESS.into_iter().enumerate() {
            let center = IVec2::new(
                (0.5 * size.x as f32 + (column as f32 - 2.5) * pixels_per_metre) as i32,
                (0.5 * size.y as f32 - row * pixels_per_metre) as i32,
            );
            let around = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| IVec2::new(x, y)));
            let pixels: Vec<usize> = around
                .filter(|offset| offset.length_squared() <= radius * radius)
                .map(|offset| center + offset)
                .filter(|place| place.cmpge(IVec2::ZERO).all() && place.cmplt(size.as_ivec2()).all())
                .map(|place| (place.y * size.x as i32 + place.x) as usize)
                .collect();
            if !pixels.is_empty() {
                let name = format!("{kind} of roughness {roughness}");
                balls.push(Ball { name, pixels });
            }
        }
    }
    balls
}

/// Measures techniques, the ground truth among them.
///
/// # Errors
///
/// If the scene can't be rendered.
pub fn measure(
    stage: &mut Stage,
    size: UVec2,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let mut all = names.map_or_else(|| techniques(stage), <[_]>::to_vec);
    all.push(TRUTH);
    let view = StillView::new(stage, StillScene::BuiltIn(SceneName::Furnace), size);
    let result = measure_in(stage, &view, &balls(size), lengths, &all, deadline);
    view.remove(stage);
    result
}

fn measure_in(
    stage: &mut Stage,
    view: &StillView,
    balls: &[Ball],
    lengths: Lengths,
    names: &[&'static str],
    deadline: Instant,
) -> Result<Findings, String> {
    let mut findings = Findings::default();
    for name in names.iter().copied() {
        if Instant::now() > deadline {
            break;
        }
        measure_one(stage, view, balls, lengths, name, deadline, &mut findings)?;
        findings.measured += 1;
    }
    Ok(findings)
}

fn measure_one(
    stage: &mut Stage,
    view: &StillView,
    balls: &[Ball],
    lengths: Lengths,
    name: &'static str,
    deadline: Instant,
    findings: &mut Findings,
) -> Result<(), String> {
    let noise = if name == TRUTH {
        vec![0.0; balls.len()]
    } else {
        noise(stage, view, balls, name)?
    };
    if !view.switch(stage, name, DebugView::Reconstructed)? {
        findings.note(format!("furnace: {name} can't be compiled"), true);
        return Ok(());
    }
    stage.step(lengths.settle);
    let mut sums = vec![0.0; balls.len()];
    let mut frames = 0;
    let mut rounds = 0;
    let measured: Vec<(f64, f64)> = loop {
        view.watch(stage, lengths.average, |picture| {
            for (sum, ball) in sums.iter_mut().zip(balls) {
                *sum += ball.mean(picture);
            }
        })?;
        frames += lengths.average;
        rounds += 1;
        let count = f64::from(frames.max(1));
        let measured: Vec<_> = sums
            .iter()
            .zip(&noise)
            .map(|(sum, noise)| (sum / count, SIGMAS * noise / count.sqrt()))
            .collect();
        let is_open = |(mean, margin): &(f64, f64)| judged(*mean, *margin) == Judgement::Undecided;
        if !measured.iter().any(is_open) || rounds == MOST_ROUNDS || Instant::now() > deadline {
            break measured;
        }
    };
    let mut worst: Option<(&Ball, f64, f64)> = None;
    for (ball, (mean, margin)) in balls.iter().zip(measured) {
        if worst.is_none_or(|(_, other, _)| (mean - 1.0).abs() > (other - 1.0).abs()) {
            worst = Some((ball, mean, margin));
        }
        let judgement = judged(mean, margin);
        if judgement != Judgement::Holds {
            findings.judged(describe(name, ball, mean, margin), judgement);
        }
    }
    if let Some((ball, mean, margin)) = worst {
        let line = describe(name, ball, mean, margin);
        findings.note(format!("{line}, the worst of {}", balls.len()), false);
    }
    Ok(())
}

/// How much each ball's mean differs from frame to frame where frames are independent.
fn noise(stage: &mut Stage, view: &StillView, balls: &[Ball], name: &str) -> Result<Vec<f64>, String> {
    view.switch_to_single_frames(stage, name, DebugView::Reconstructed)?;
    stage.step(2);
    let mut series = vec![Vec::new(); balls.len()];
    view.watch(stage, SINGLE_FRAMES, |picture| {
        for (values, ball) in series.iter_mut().zip(balls) {
            values.push(ball.mean(picture));
        }
    })?;
    Ok(series.iter().map(|values| mean_and_deviation(values).1).collect())
}

fn judged(mean: f64, margin: f64) -> Judgement {
    judge((mean - 1.0).abs(), margin, MOST_ERROR)
}

fn describe(name: &str, ball: &Ball, mean: f64, margin: f64) -> String {
    format!("furnace: {name}: {} shows {mean:.4} +- {margin:.4}", ball.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_lie_inside_of_the_picture() {
        let size = UVec2::new(120, 60);
        let white = Picture {
            size,
            texels: vec![[1.0; 4]; 120 * 60],
        };
        let balls = balls(size);
        assert_eq!(balls.len(), 2 * FURNACE_ROUGHNESS.len());
        for ball in balls {
            assert!((ball.mean(&white) - 1.0).abs() < 1e-5, "{}", ball.name);
            assert!(ball.pixels.iter().all(|pixel| *pixel < white.texels.len()));
        }
    }

    #[test]
    fn white_is_white_on_both_sides() {
        assert_eq!(judged(1.01, 0.001), Judgement::Holds);
        assert_eq!(judged(0.95, 0.001), Judgement::Fails);
        assert_eq!(judged(1.05, 0.001), Judgement::Fails);
        assert_eq!(judged(1.03, 0.03), Judgement::Undecided);
        assert_eq!(judged(f64::NAN, 0.0), Judgement::Fails);
    }
}
