//! Surfaces that rays don't see, found on the screen: `ScreenTraces::March`.

use super::{LOWER, Stage, WAYS, lower};
use crate::{
    pictures::{any_tracer, differing_pixels, dump, flip, reflect},
    stage::{SIZE, clear_glass, metal},
};
use bevy::prelude::*;
use bevy_glint::{NotReflected, ReflectionDenoiser, ReflectionTechnique, ReflectionTracerChoice, ScreenTraces};

/// Mean FLIP of the board in the mirror and the image of a camera in its place: its outline is known to a pixel, and a small image has
/// few of these.
const SAME: f32 = 0.15;
/// Minimum mean FLIP without the board.
const OTHER: f32 = 0.25;

/// Mean FLIP of the lower half of two images.
fn apart(name: &str, expected: &[u8], actual: &[u8]) -> f32 {
    dump(name, SIZE, expected, actual);
    let apart = flip(LOWER, lower(expected), lower(actual)).0;
    println!("{name}: mean FLIP {apart}");
    apart
}

/// A board that no ray sees.
fn unseen(tracer: ReflectionTracerChoice, floor: StandardMaterial) -> Option<Stage> {
    let mut stage = Stage::new(tracer, floor)?;
    stage.app.world().entity_mut(stage.board).insert(NotReflected);
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
    Some(stage)
}

#[test]
fn reflections_show_what_rays_do_not_see() {
    for tracer in any_tracer() {
        let Some(mut stage) = unseen(tracer, metal(0.0)) else {
            continue;
        };
        let expected = stage.expected();
        for way in WAYS {
            let name = format!("march-{tracer:?}-{}", stage.trace_by(way));
            let reused = stage.capture(ScreenTraces::Reuse);
            let marched = stage.capture(ScreenTraces::March);
            let missing = apart(&format!("{name}-reuse"), &expected, &reused);
            let same = apart(&name, &expected, &marched);
            assert!(same < SAME, "{name}: the mirror lacks the board: {same}");
            assert!(missing > OTHER, "{name}: rays see the board by themselves: {missing}");
        }
        the_ground_truth_shows_none(&mut stage);
        views_never_rest(&mut stage, &expected);
        views_in_motion_find_it(&mut stage, &expected);
    }
}

fn the_ground_truth_shows_none(stage: &mut Stage) {
    stage.set(|settings| {
        settings.technique = ReflectionTechnique::Converged;
        settings.max_bounces = 1;
    });
    let [without, with] = [ScreenTraces::Off, ScreenTraces::March].map(|traces| stage.capture(traces));
    assert_eq!(differing_pixels(&without, &with, 0), 0);
}

/// It doesn't fade out of static images.
fn views_never_rest(stage: &mut Stage, expected: &[u8]) {
    stage.set(|settings| {
        settings.technique = ReflectionTechnique::Variable;
        settings.denoiser = ReflectionDenoiser::default();
    });
    stage.capture(ScreenTraces::March);
    stage.app.step(40);
    let later = stage.app.capture().unwrap();
    let same = apart("march-at-rest", expected, &later);
    assert!(same < SAME, "{same}");
}

fn views_in_motion_find_it(stage: &mut Stage, expected: &[u8]) {
    let moved = stage.pan();
    let same = apart("march-in-motion", expected, &moved);
    assert!(same < SAME, "{same}");
}

/// Glass sees this frame.
#[test]
fn reflections_on_glass_show_what_rays_do_not_see() {
    let Some(mut stage) = unseen(ReflectionTracerChoice::Bvh, clear_glass()) else {
        return;
    };
    let without = stage.capture(ScreenTraces::Reuse);
    let with = stage.capture(ScreenTraces::March);
    dump("march-glass", SIZE, &without, &with);
    let sum = |picture: &[u8]| -> u32 { lower(picture).chunks_exact(4).map(|pixel| u32::from(pixel[0])).sum() };
    let (without, with) = (sum(&without), sum(&with));
    println!("red on the glass: {without} without, {with} with");
    assert!(with > 2 * without.max(1));
}

/// If rays see everything on the screen, the march finds nothing before their hits.
#[test]
fn what_rays_see_is_theirs() {
    let Some(mut stage) = Stage::smooth() else { return };
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
    let [reused, marched] = [ScreenTraces::Reuse, ScreenTraces::March].map(|traces| stage.capture(traces));
    dump("march-seen", SIZE, &reused, &marched);
    let different = differing_pixels(&reused, &marched, 3);
    println!("{different} pixels differ");
    assert!(different < 40, "{different}");
}
