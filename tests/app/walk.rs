//! A character that walks along a mirror, and then stops and waves. Each technique shows the same instant as without history, with no
//! ghost at the character's old position. Converged images give its old and new position.

use crate::{
    convergence::{TECHNIQUES, capture, switch},
    pictures::linear_app,
    poses::{Arm, ELBOW, arm, spawn_arm},
    stage::{BEFORE_THE_MIRROR, SIZE, behind, metal, spawn_camera, spawn_mesh, unlit, wall},
};
use bevy::prelude::*;
use bevy_glint::RayTracedReflections;
use glint_scenes::{HeadlessApp, SceneName};

/// The frame at which the character stops and starts waving.
const STANDS: u32 = 20;
/// Frames that are compared: on the way, and while it waves.
const SEEN: [u32; 4] = [13, 18, 33, 36];
/// Frames of the way to there.
const WALK: u32 = 12;
/// Age of the measured trail, in frames.
const BEFORE: u32 = 5;
/// Frames of the truth.
const TRUE_FRAMES: u32 = 64;
/// Images without history. Their mean has little noise.
const FRESH: u16 = 8;
/// Light that the history can leave at the character's old position, relative to the light of the character. Histories of two frames are
/// a part of images of a single ray, in a mirror that the denoiser smooths. Without marks on posed objects it is 0.13 to 0.3 while it
/// waves.
const MOST_LEFT: f32 = 0.15;
/// As above, for a technique that has few rays in the whole mirror.
const MOST_LEFT_BY_COARSE_RATES: f32 = 0.2;
/// Light that the history can remove at the character's new position. Without marks it is up to 0.6.
const MOST_MISSING: f32 = 0.35;
const LEAST_PIXELS: usize = 10;

/// Poses both legs for a frame.
fn pose(app: &mut HeadlessApp, legs: &[Arm; 2], frame: u32) {
    let walked = 0.22 * frame.min(STANDS) as f32;
    for (leg, side) in legs.iter().zip([1.0, -1.0]) {
        let swing = (0.35 * frame as f32).sin() * side;
        let waves = frame > STANDS;
        // A waving character only moves its upper bones: the objects don't move.
        let hip = Transform::from_xyz(walked - 3.0 + 0.4 * side, -2.0, 6.5)
            .with_rotation(Quat::from_rotation_z(if waves { 0.0 } else { 0.3 * swing }));
        let bend = if waves {
            0.22 * (frame - STANDS) as f32
        } else {
            0.5 * swing
        };
        let knee = Transform::from_translation(ELBOW).with_rotation(Quat::from_rotation_z(-bend));
        for (joint, place) in leg.joints.iter().zip([hip, knee]) {
            *app.world().get_mut::<Transform>(*joint).unwrap() = place;
        }
    }
}

/// Pixels in which an image shows at least half of the character, with or without their neighbours.
fn shown(picture: &[f32], of: f32, with_neighbours: bool) -> Vec<bool> {
    let (width, height) = (SIZE.x as i32, SIZE.y as i32);
    let is_light =
        |x: i32, y: i32| (0..width).contains(&x) && (0..height).contains(&y) && picture[(y * width + x) as usize] > of;
    let around = if with_neighbours { -1..=1 } else { 0..=0 };
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    places
        .map(|(x, y)| {
            around
                .clone()
                .any(|dy| around.clone().any(|dx| is_light(x + dx, y + dy)))
        })
        .collect()
}

/// Mean difference of two images over the pixels in the first mask and outside the second.
fn mean_difference(a: &[f32], b: &[f32], within: &[bool], without: &[bool]) -> f32 {
    let pixels = (0..a.len()).filter(|&pixel| within[pixel] && !without[pixel]);
    let differences: Vec<f32> = pixels.map(|pixel| a[pixel] - b[pixel]).collect();
    assert!(
        differences.len() >= LEAST_PIXELS,
        "{} pixels tell anything",
        differences.len()
    );
    differences.iter().sum::<f32>() / differences.len() as f32
}

/// A frame of converged images.
struct Instant {
    frame: u32,
    truth: Vec<f32>,
    truth_before: Vec<f32>,
}

impl Instant {
    /// Surplus light at the character's old place, and missing light at its new one, compared with an image without a past.
    fn ghost(&self, picture: &[f32], fresh: &[f32]) -> [f32; 2] {
        let light = self.truth.iter().copied().fold(0.0, f32::max);
        let [now, before] =
            [&self.truth, &self.truth_before].map(|truth| [false, true].map(|wide| shown(truth, 0.5 * light, wide)));
        let left = mean_difference(picture, fresh, &before[0], &now[1]);
        let missing = mean_difference(fresh, picture, &now[0], &before[1]);
        [left / light, missing / light]
    }
}

/// Image of an instant by a technique without a past.
fn fresh(app: &mut HeadlessApp, camera: Entity, name: &str) -> Vec<f32> {
    let mut sum = vec![0.0; (SIZE.x * SIZE.y) as usize];
    for _ in 0..FRESH {
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().reset = true;
        app.step(1);
        for (sum, light) in sum.iter_mut().zip(capture(app, name)) {
            *sum += light / f32::from(FRESH);
        }
    }
    sum
}

fn truth(app: &mut HeadlessApp, camera: Entity, legs: &[Arm; 2], frame: u32) -> Vec<f32> {
    pose(app, legs, frame);
    app.step(2);
    switch(app, camera, "converged");
    app.step(TRUE_FRAMES);
    capture(app, "converged")
}

/// Light that the past adds and removes once the character has moved to its place in a frame.
fn walk_to(app: &mut HeadlessApp, camera: Entity, legs: &[Arm; 2], name: &str, instant: &Instant) -> [f32; 2] {
    pose(app, legs, instant.frame - WALK);
    switch(app, camera, name);
    app.step(2);
    for frame in instant.frame - WALK..=instant.frame {
        pose(app, legs, frame);
        app.step(1);
    }
    let picture = capture(app, name);
    instant.ghost(&picture, &fresh(app, camera, name))
}

#[test]
#[ignore = "long: a walk of many frames with each technique"]
fn a_character_walks_along_a_mirror_without_ghosts() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    spawn_mesh(app, Rectangle::new(60.0, 60.0), unlit([0, 0, 90]), behind(9.0));
    let legs = [(); 2].map(|()| spawn_arm(app, arm(), unlit([255, 200, 90])));
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    let mut wrong = Vec::new();
    for roughness in [0.0, 0.15] {
        let mirror = spawn_mesh(app, wall(), metal(roughness), Transform::IDENTITY);
        let instants = SEEN.map(|frame| Instant {
            frame,
            truth_before: truth(app, camera, &legs, frame - BEFORE),
            truth: truth(app, camera, &legs, frame),
        });
        for name in TECHNIQUES.into_iter().chain(["low", "medium", "high", "converged"]) {
            // While it walks, and while it waves.
            for phase in instants.chunks(2) {
                let (mut left, mut missing) = (0.0, 0.0);
                for instant in phase {
                    let [too_much, too_little] = walk_to(app, camera, &legs, name, instant);
                    left += too_much / phase.len() as f32;
                    missing += too_little / phase.len() as f32;
                }
                let frame = phase[0].frame;
                let line =
                    format!("roughness {roughness}, {name}, from frame {frame}: {left:.3} left, {missing:.3} missing");
                println!("{line}");
                let most_left = if name == "vrs-grazing" {
                    MOST_LEFT_BY_COARSE_RATES
                } else {
                    MOST_LEFT
                };
                if !(left < most_left && missing < MOST_MISSING) {
                    wrong.push(line);
                }
            }
        }
        app.world().despawn(mirror);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
