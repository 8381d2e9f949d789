//! White furnace test: white balls must be white at all roughnesses, whatever the technique, after the whole denoiser.

use crate::{
    energy::{Lengths, Measurements, SIGMAS, SINGLE_FRAMES},
    harness::Harness,
    image::{LinearImage, luminance},
    static_scene::{StaticScene, StaticSceneView},
    statistics::{LimitCheck, check_limit, mean_and_deviation},
};
use bevy::math::{IVec2, UVec2};
use bevy_glint::ReflectionDebugView;
use glint_scenes::{FURNACE_ROUGHNESS, SceneName};
use std::time::Instant;

/// Largest error of a white surface in a white furnace.
pub const MOST_ERROR: f64 = 0.02;
/// The accumulating technique. It has no history to switch off, and almost no noise after this many frames.
const GROUND_TRUTH: &str = "converged";

/// The middle of a ball in the image.
struct Ball {
    name: String,
    pixels: Vec<usize>,
}

impl Ball {
    fn mean(&self, image: &LinearImage) -> f64 {
        let luminance = |pixel: &usize| f64::from(luminance(&image.texels[*pixel]));
        self.pixels.iter().map(luminance).sum::<f64>() / self.pixels.len().max(1) as f64
    }
}

/// Balls on a grid of one metre, seen from 7 m with a field of view of 32 degrees.
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
            let square = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| IVec2::new(x, y)));
            let pixels: Vec<usize> = square
                .filter(|offset| offset.length_squared() <= radius * radius)
                .map(|offset| center + offset)
                .filter(|pixel| pixel.cmpge(IVec2::ZERO).all() && pixel.cmplt(size.as_ivec2()).all())
                .map(|pixel| (pixel.y * size.x as i32 + pixel.x) as usize)
                .collect();
            if !pixels.is_empty() {
                let name = format!("{kind} of roughness {roughness}");
                balls.push(Ball { name, pixels });
            }
        }
    }
    balls
}

/// Measures techniques, and the ground truth after them. Fails if the scene can't be rendered.
pub fn measure(
    harness: &mut Harness,
    size: UVec2,
    lengths: Lengths,
    techniques: &[&'static str],
    deadline: Instant,
) -> Result<Measurements, String> {
    let scene = StaticScene::BuiltIn(SceneName::Furnace);
    StaticSceneView::with(harness, scene, size, |harness, view| {
        let furnace = Furnace {
            view,
            balls: balls(size),
            lengths,
            deadline,
        };
        let techniques = [techniques, &[GROUND_TRUTH]].concat();
        Measurements::of(&techniques, deadline, |name, measurements| {
            furnace.measure(harness, name, measurements)
        })
    })
}

struct Furnace<'a> {
    view: &'a StaticSceneView,
    balls: Vec<Ball>,
    lengths: Lengths,
    deadline: Instant,
}

impl Furnace<'_> {
    fn measure(&self, harness: &mut Harness, name: &str, measurements: &mut Measurements) -> Result<(), String> {
        let noise = if name == GROUND_TRUTH {
            vec![0.0; self.balls.len()]
        } else {
            self.noise(harness, name)?
        };
        if !self.view.switch(harness, name, ReflectionDebugView::Reconstructed)? {
            measurements.add(format!("furnace: {name} can't be compiled"), true);
            return Ok(());
        }
        harness.step(self.lengths.settle);
        let mut worst: Option<(&Ball, f64, f64)> = None;
        for (ball, (mean, margin)) in self.balls.iter().zip(self.average(harness, &noise)?) {
            if worst.is_none_or(|(_, other, _)| (mean - 1.0).abs() > (other - 1.0).abs()) {
                worst = Some((ball, mean, margin));
            }
            let check = check_white(mean, margin);
            if check != LimitCheck::Within {
                measurements.add_checked(describe(name, ball, mean, margin), check);
            }
        }
        if let Some((ball, mean, margin)) = worst {
            let line = describe(name, ball, mean, margin);
            measurements.add(format!("{line}, the worst of {}", self.balls.len()), false);
        }
        Ok(())
    }

    /// Mean and margin of each ball, over as many rounds as its noise requires.
    fn average(&self, harness: &mut Harness, noise: &[f64]) -> Result<Vec<(f64, f64)>, String> {
        let mut sums = vec![0.0; self.balls.len()];
        let mut round = 0;
        loop {
            round += 1;
            self.view.watch(harness, self.lengths.average, |image| {
                for (sum, ball) in sums.iter_mut().zip(&self.balls) {
                    *sum += ball.mean(image);
                }
            })?;
            let frames = f64::from((round * self.lengths.average).max(1));
            let measure = |(sum, noise): (&f64, &f64)| (sum / frames, SIGMAS * noise / frames.sqrt());
            let measured: Vec<_> = sums.iter().zip(noise).map(measure).collect();
            let is_undecided = |(mean, margin): &(f64, f64)| check_white(*mean, *margin) == LimitCheck::Undecided;
            let is_over = round == self.lengths.rounds || Instant::now() > self.deadline;
            if is_over || !measured.iter().any(is_undecided) {
                return Ok(measured);
            }
        }
    }

    /// Standard deviation of each ball's mean from frame to frame, with independent frames.
    fn noise(&self, harness: &mut Harness, name: &str) -> Result<Vec<f64>, String> {
        self.view
            .switch_to_single_frames(harness, name, ReflectionDebugView::Reconstructed)?;
        harness.step(2);
        let mut series = vec![Vec::new(); self.balls.len()];
        self.view.watch(harness, SINGLE_FRAMES, |image| {
            for (values, ball) in series.iter_mut().zip(&self.balls) {
                values.push(ball.mean(image));
            }
        })?;
        Ok(series.iter().map(|values| mean_and_deviation(values).1).collect())
    }
}

fn check_white(mean: f64, margin: f64) -> LimitCheck {
    check_limit((mean - 1.0).abs(), margin, MOST_ERROR)
}

fn describe(name: &str, ball: &Ball, mean: f64, margin: f64) -> String {
    format!("furnace: {name}: {} shows {mean:.4} +- {margin:.4}", ball.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_lie_inside_of_the_image() {
        let size = UVec2::new(120, 60);
        let white = LinearImage {
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
    fn errors_count_in_both_directions() {
        assert_eq!(check_white(1.01, 0.001), LimitCheck::Within);
        assert_eq!(check_white(0.95, 0.001), LimitCheck::Exceeded);
        assert_eq!(check_white(1.05, 0.001), LimitCheck::Exceeded);
        assert_eq!(check_white(1.03, 0.03), LimitCheck::Undecided);
        assert_eq!(check_white(f64::NAN, 0.0), LimitCheck::Exceeded);
    }
}
