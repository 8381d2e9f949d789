//! Apps without a window, for all test programs.

use bevy::{math::UVec2, prelude::*};
use bevy_glint::{
    RayTracedReflectionsPlugin, ReflectionRetention, ReflectionStatus, ReflectionTracer, ReflectionTracerChoice,
};
use core::time::Duration;
use glint_scenes::{HeadlessApp, HeadlessError, HeadlessSettings, Output, SceneAnimationPlugin};
use std::path::Path;

/// Environment variable with a folder of shader modules that take the place of the crate's. With a fault in one of them, a test shows
/// without a build that it can fail.
const SHADERS: &str = "GLINT_TEST_SHADERS";

/// An app that traces, or `None` (with the reason printed) if this machine can't.
pub fn app(size: UVec2, output: Output, tracer: ReflectionTracerChoice) -> Option<HeadlessApp> {
    app_with(size, output, tracer, |_| {})
}

/// Like [`app`], with more plugins.
pub fn app_with(
    size: UVec2,
    output: Output,
    tracer: ReflectionTracerChoice,
    add: impl FnOnce(&mut App),
) -> Option<HeadlessApp> {
    app_on_device(size, output, tracer, |_| {}, add)
}

/// Like [`app_with`], with plugins that configure the device.
pub fn app_on_device(
    size: UVec2,
    output: Output,
    tracer: ReflectionTracerChoice,
    before: impl FnOnce(&mut App),
    add: impl FnOnce(&mut App),
) -> Option<HeadlessApp> {
    let settings = HeadlessSettings {
        size,
        output,
        log: std::env::var_os("RUST_LOG").is_some(),
        one_thread: true,
        ..default()
    };
    app_of(settings, tracer, before, add)
}

/// Like [`app_on_device`], with all settings.
pub fn app_of(
    settings: HeadlessSettings,
    tracer: ReflectionTracerChoice,
    before: impl FnOnce(&mut App),
    add: impl FnOnce(&mut App),
) -> Option<HeadlessApp> {
    let result = HeadlessApp::with_device(settings, before, |app| {
        let reflections = RayTracedReflectionsPlugin {
            tracer,
            // The harness already draws deferred, and cameras lack the components that tests remove.
            deferred_by_default: false,
            ..default()
        };
        app.add_plugins((SceneAnimationPlugin, reflections))
            // Only tests that say so depend on the wall clock.
            .insert_resource(ReflectionRetention(Duration::ZERO));
        add(app);
    });
    let mut app = if_renders(result)?;
    let report = app.world().resource::<ReflectionStatus>().report();
    if tracer == ReflectionTracerChoice::RayQuery && report.tracer != Some(ReflectionTracer::RayQuery) {
        let required = std::env::var_os("GLINT_REQUIRE_RAY_QUERY").is_some();
        assert!(!required, "ray queries are required, but: {report}");
        println!("skipped: {report}");
        return None;
    }
    if let Some(folder) = std::env::var_os(SHADERS) {
        let replaced = app.replace_shaders("bevy_glint", Path::new(&folder));
        assert!(
            replaced.is_ok_and(|replaced| !replaced.is_empty()),
            "{SHADERS} has no shaders"
        );
    }
    Some(app)
}

/// The app, or `None` (with the reason printed) if this machine can't render.
pub fn if_renders(result: Result<HeadlessApp, HeadlessError>) -> Option<HeadlessApp> {
    match result {
        Ok(app) => Some(app),
        Err(error @ HeadlessError::NoRenderer) => {
            let is_required = std::env::var_os("GLINT_REQUIRE_GPU").is_some();
            assert!(!is_required, "a GPU is required, but: {error}");
            println!("skipped: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}
