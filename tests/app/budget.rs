//! Budgets of time, and their effect on a camera's rays.

use crate::{
    common::app_with,
    pictures::{linear_app, spawn, use_coarse_shadow_maps, warm_up},
    stage::{self, begin_anew, frame},
    static_views::{capture, difference, room},
};
use bevy::{diagnostic::DiagnosticsStore, math::UVec2, prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
use bevy_glint::{
    RayTracedReflections, ReflectionBudget, ReflectionEffort, ReflectionTechnique, ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName};

const SIZE: UVec2 = UVec2::new(96, 54);
/// Enough frames to reach the lowest effort: a step is a quarter and takes eleven frames, or more if times arrive late.
const FRAMES: u32 = 330;

fn rays(app: &mut HeadlessApp) -> f64 {
    app.step(4);
    let store = app.world().resource::<DiagnosticsStore>();
    let mut counts = store.iter().filter(|d| d.path().as_str() == "render/reflection_rays");
    counts.next().and_then(|count| count.value()).unwrap()
}

#[test]
fn a_budget_takes_rays_and_gives_them_back() {
    let plugin = |app: &mut App| {
        app.add_plugins(RenderDiagnosticsPlugin);
    };
    let Some(mut app) = app_with(SIZE, Output::Linear, ReflectionTracerChoice::Auto, plugin) else {
        return;
    };
    use_coarse_shadow_maps(&mut app);
    let camera = spawn(&mut app, SceneName::EmissiveFloor, ReflectionTechnique::Variable);
    warm_up(&mut app);
    let all = rays(&mut app);

    // No device meets the first budget, and every device meets the second one, an hour.
    for (milliseconds, effort, least, most) in [(1e-3, 0.25, 0.2, 0.8), (3.6e6, 1.0, 0.99, 1.01)] {
        app.world().entity_mut(camera).insert(ReflectionBudget {
            milliseconds,
            ..default()
        });
        let reached = (0..FRAMES).any(|_| {
            app.step(1);
            app.world().get(camera) == Some(&ReflectionEffort(effort))
        });
        let found = app.world().get::<ReflectionEffort>(camera).copied();
        assert!(reached, "{milliseconds} ms: {found:?}, not {effort}");
        // The effort stays there.
        app.step(24);
        assert_eq!(
            app.world().get(camera),
            Some(&ReflectionEffort(effort)),
            "{milliseconds} ms"
        );
        let share = rays(&mut app) / all;
        println!("{milliseconds} ms: {share:.3} of the rays");
        assert!(least < share && share < most, "{milliseconds} ms: {share} of the rays");
    }
}

/// A budget moves the effort again and again; all of its frames estimate one image.
#[test]
fn pictures_come_to_rest_under_a_budget() {
    let Some(mut app) = linear_app(stage::SIZE) else { return };
    let app = &mut app;
    let camera = room(app, 0.5);
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().technique = ReflectionTechnique::Quarter;
    let noise = [[1.0, 1.0], [1.0, 0.8]].map(|efforts| {
        begin_anew(app, camera);
        let mut images = Vec::new();
        for step in 0..90 {
            app.world()
                .entity_mut(camera)
                .insert(ReflectionEffort(efforts[step % 2]));
            frame(app);
            if step >= 86 {
                images.push(capture(app));
            }
        }
        images
            .windows(2)
            .map(|pair| difference(&pair[0], &pair[1]))
            .sum::<f32>()
    });
    println!("from frame to frame: {noise:?}");
    assert!(noise[1] > 0.0 && noise[1] < noise[0], "{noise:?}");
}
