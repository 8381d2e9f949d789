//! Debug views and counters of known scenes.

use crate::{
    common::app_with,
    pictures::{reflect, spawn, use_coarse_shadow_maps, warm_up},
    stage::{BEFORE_THE_MIRROR, denoised, report, settings_of, spawn_camera, spawn_mesh, unlit, until},
};
use bevy::{
    core_pipeline::tonemapping::Tonemapping,
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    math::UVec2,
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
};
use bevy_glint::{
    RATE_LEGEND, RayTracedReflections, ReflectionDebugCounters, ReflectionDebugSplit, ReflectionDebugView,
    ReflectionNonFiniteReport, ReflectionTechnique, ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};

const SIZE: UVec2 = UVec2::new(96, 54);
/// Number of pixels that can't be a coincidence.
const MANY: usize = 180;

/// Returns `None` if this machine can't trace.
fn app() -> Option<HeadlessApp> {
    app_with(SIZE, Output::Linear, ReflectionTracerChoice::Auto, |app| {
        app.add_plugins(RenderDiagnosticsPlugin);
    })
}

fn switch(app: &mut HeadlessApp, camera: Entity, technique: ReflectionTechnique) {
    app.world().entity_mut(camera).insert(denoised(technique));
    warm_up(app);
}

/// All tests of the demo in one app, because starting it takes longer than most of them.
#[test]
#[ignore = "long: a large scene in each debug view"]
fn views_of_the_demo() {
    let Some(mut app) = app() else { return };
    let app = &mut app;
    use_coarse_shadow_maps(app);
    let camera = spawn(app, SceneName::Demo, ReflectionTechnique::Variable);
    switch(app, camera, ReflectionTechnique::Variable);
    counters_find_no_bad_pixels(app, camera);
    a_past_that_is_forgotten_is_rejected(app, camera);
    every_view_shows_something(app, camera);
    switch(app, camera, ReflectionTechnique::Converged);
    techniques_without_textures_keep_the_picture(app, camera);
    switch(app, camera, ReflectionTechnique::Reference);
    the_reference_has_one_ray_per_reflecting_pixel(app, camera);
}

/// Some frames after the view was chosen.
#[track_caller]
fn show(app: &mut HeadlessApp, camera: Entity, view: ReflectionDebugView) -> Vec<Vec3> {
    app.world().entity_mut(camera).insert(view);
    // Its pipeline is compiled in the frame that needs it first.
    app.step(5);
    capture(app)
}

#[track_caller]
fn capture(app: &HeadlessApp) -> Vec<Vec3> {
    let pixels = app.capture_linear().unwrap();
    let pixels: Vec<_> = pixels.into_iter().map(|[r, g, b, _]| Vec3::new(r, g, b)).collect();
    assert!(pixels.iter().all(|pixel| pixel.is_finite()));
    pixels
}

fn is_colored(pixel: &Vec3) -> bool {
    pixel.max_element() - pixel.min_element() > 0.2
}

/// The colour is one of a factor between 0.05 and 1 times `color`.
fn is_shade_of(pixel: Vec3, color: LinearRgba) -> bool {
    let color = color.to_vec3();
    let scale = pixel.max_element() / color.max_element();
    (0.05..1.01).contains(&scale) && (pixel - color * scale).abs().max_element() < 0.01 * scale
}

fn every_view_shows_something(app: &mut HeadlessApp, camera: Entity) {
    for view in ReflectionDebugView::ALL {
        let pixels = show(app, camera, view);
        let name = view.name();
        let colored = pixels.iter().filter(|pixel| is_colored(pixel)).count();
        let lit = pixels.iter().filter(|pixel| pixel.max_element() > 0.02).count();
        println!("{name}: {colored} pixels with a colour, {lit} that aren't black");
        assert!(lit > MANY, "{name} is black");
        match view {
            ReflectionDebugView::ShadingRates => {
                let shades = |pixel: &Vec3| RATE_LEGEND.iter().position(|&(_, color)| is_shade_of(*pixel, color));
                let strange = pixels.iter().filter(|pixel| shades(pixel).is_none()).count();
                assert_eq!(strange, 0, "pixels of {name} with a colour that is not in the legend");
                for (entry, (rate, _)) in RATE_LEGEND.into_iter().enumerate() {
                    let count = pixels.iter().filter(|pixel| shades(pixel) == Some(entry)).count();
                    println!("    {rate}: {count}");
                }
                // The mirrors and tiles at several rates.
                assert!(colored > MANY);
            }
            ReflectionDebugView::RaysPerPixel
            | ReflectionDebugView::HitDistance
            | ReflectionDebugView::HistoryLength
            | ReflectionDebugView::Variance
            | ReflectionDebugView::RayWeight => assert!(colored > MANY, "{name} shows no heat"),
            ReflectionDebugView::NonFinite => assert_eq!(colored, 0, "{name} found something"),
            _ => {}
        }
    }
}

fn techniques_without_textures_keep_the_picture(app: &mut HeadlessApp, camera: Entity) {
    for view in ReflectionDebugView::ALL {
        let pixels = show(app, camera, view);
        let colored = pixels.iter().filter(|pixel| is_colored(pixel)).count();
        match view {
            ReflectionDebugView::HitDistance
            | ReflectionDebugView::Variance
            | ReflectionDebugView::RayWeight
            | ReflectionDebugView::NonFinite => {
                assert_eq!(colored, 0, "{} shows what doesn't exist", view.name());
            }
            ReflectionDebugView::RaysPerPixel | ReflectionDebugView::HistoryLength => {
                assert!(colored > MANY, "{} shows no heat", view.name());
            }
            ReflectionDebugView::Reconstructed | ReflectionDebugView::Reflection => {
                let lit = pixels.iter().filter(|pixel| pixel.max_element() > 0.02).count();
                assert!(lit > MANY, "{} is black", view.name());
            }
            _ => {}
        }
    }
}

fn the_reference_has_one_ray_per_reflecting_pixel(app: &mut HeadlessApp, camera: Entity) {
    let pixels = show(app, camera, ReflectionDebugView::RaysPerPixel);
    let rays = |pixels: &[Vec3], color: Vec3| {
        let colored = pixels.iter().filter(|pixel| is_colored(pixel));
        let (these, others): (Vec<Vec3>, Vec<Vec3>) = colored.partition(|pixel| pixel.distance(color) < 0.01);
        assert!(
            others.is_empty(),
            "{} pixels of other colours: {}",
            others.len(),
            others[0]
        );
        these.len()
    };
    assert!(rays(&pixels, Vec3::X) > MANY);

    // A quarter: log2(1/4) is two thirds of the way from log2(1/64) to 0.
    app.world().entity_mut(camera).insert(RayTracedReflections {
        full_resolution_mirrors: false,
        ..denoised(ReflectionTechnique::Quarter)
    });
    warm_up(app);
    let pixels = show(app, camera, ReflectionDebugView::RaysPerPixel);
    assert!(rays(&pixels, Vec3::new(2.0 / 3.0, 1.0, 0.0)) > MANY);
}

fn a_past_that_is_forgotten_is_rejected(app: &mut HeadlessApp, camera: Entity) {
    let red = |pixels: Vec<Vec3>| pixels.into_iter().filter(|pixel| *pixel == Vec3::X).count();
    app.world().entity_mut(camera).insert(ReflectionDebugView::Rejected);
    warm_up(app);
    app.step(16);
    let settled = red(capture(app));
    settings_of(app, camera).reset = true;
    app.step(1);
    let fresh = red(capture(app));
    assert!(fresh > MANY && settled * 2 < fresh, "{fresh} pixels, {settled} later");
}

#[test]
fn a_reflection_alone_is_what_a_mirror_shows() {
    let Some(mut app) = app() else { return };
    // Unlit objects over a mirror without light: its image contains only the reflection.
    let camera = spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    let picture = show(&mut app, camera, ReflectionDebugView::Off);
    let reflection = show(&mut app, camera, ReflectionDebugView::Reflection);
    let mut reflecting = 0;
    for (i, (shown, alone)) in picture.iter().zip(&reflection).enumerate() {
        if *alone != Vec3::ZERO {
            reflecting += 1;
            let difference = shown.distance(*alone);
            assert!(
                difference < 0.01 * shown.max_element() + 1e-3,
                "pixel {i}: {shown} and {alone}"
            );
        }
    }
    assert!(reflecting > MANY / 3, "{reflecting} pixels reflect");

    app.world().entity_mut(camera).insert(ReflectionDebugSplit::default());
    let divided = show(&mut app, camera, ReflectionDebugView::Reflection);
    for (i, pixel) in divided.into_iter().enumerate() {
        let column = i as u32 % SIZE.x;
        let expected = if column < SIZE.x / 2 {
            picture[i]
        } else if column < SIZE.x / 2 + 2 {
            Vec3::ONE
        } else {
            reflection[i]
        };
        assert!(pixel.distance(expected) < 1e-3, "pixel {i}: {pixel}, not {expected}");
    }
}

/// The view shows normals of glass with nothing opaque in front of it. The rest of the image is dark, and all of it without glass.
#[test]
fn the_front_layer_shows_its_normals() {
    let Some(mut app) = app() else { return };
    let app = &mut app;
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    let turn = Quat::from_rotation_y(0.5) * Quat::from_rotation_x(-0.3);
    let glass = StandardMaterial {
        base_color: Color::NONE,
        alpha_mode: AlphaMode::Premultiplied,
        ..default()
    };
    let at = Transform::from_rotation(turn);
    let sheet = spawn_mesh(app, Rectangle::new(40.0, 40.0), glass, at);
    let before = Transform::from_xyz(0.4, 0.0, 1.8);
    spawn_mesh(app, Cuboid::from_length(0.5), unlit([255, 128, 0]), before);
    reflect(app, camera, ReflectionTechnique::Variable);
    let picture = show(app, camera, ReflectionDebugView::Off);
    let pixel = |pixels: &[Vec3], x: u32| pixels[(SIZE.y / 2 * SIZE.x + x) as usize];
    let [left, right] = [SIZE.x / 4, 5 * SIZE.x / 6];
    let is_grey = |color: Vec3| color.max_element() - color.min_element() < 1e-3;

    let pixels = show(app, camera, ReflectionDebugView::FrontLayer);
    let expected = 0.5 + 0.5 * (turn * Vec3::Z);
    let shown = pixel(&pixels, left);
    assert!(shown.distance(expected) < 0.004, "{shown}, expected {expected}");
    let shown = pixel(&pixels, right);
    assert!(is_grey(shown) && (0.01..0.15).contains(&shown.x), "{shown}");

    app.world().entity_mut(camera).insert(ReflectionDebugSplit::default());
    let divided = show(app, camera, ReflectionDebugView::FrontLayer);
    assert_eq!(pixel(&divided, left), pixel(&picture, left));
    assert_eq!(pixel(&divided, right), pixel(&pixels, right));
    app.world().entity_mut(camera).remove::<ReflectionDebugSplit>();

    let bytes = |app: &mut HeadlessApp| report(app).view_memory[0].front_layer_bytes;
    assert!(bytes(app) > 0);
    let rays = DiagnosticPath::const_new("render/reflection_front_layer_rays");
    let count = |app: &mut HeadlessApp| app.world().resource::<DiagnosticsStore>().get(&rays)?.value();
    // Results arrive some frames later.
    until(app, "few rays are counted", |app| {
        count(app).is_some_and(|rays| rays > 100.0)
    });

    app.world().despawn(sheet);
    let pixels = show(app, camera, ReflectionDebugView::FrontLayer);
    assert!(pixels.iter().all(|pixel| is_grey(*pixel)));
    app.step(70);
    assert_eq!(bytes(app), 0);
}

#[test]
fn rough_things_reflect_nothing() {
    let Some(mut app) = app() else { return };
    let rough = StandardMaterial {
        perceptual_roughness: 1.0,
        ..default()
    };
    spawn_mesh(&mut app, Cuboid::from_length(2.0), rough, Transform::IDENTITY);
    let mut environment = environment(SceneName::Furnace, app.world());
    environment.tonemapping = Tonemapping::None;
    let camera = app.spawn_camera(Transform::from_xyz(0.0, 0.0, 5.0));
    environment.insert(&mut app.world().entity_mut(camera));
    reflect(&mut app, camera, ReflectionTechnique::Variable);
    app.world().entity_mut(camera).insert(RayTracedReflections {
        roughness_cutoff: 0.6,
        ..default()
    });
    warm_up(&mut app);
    let picture = show(&mut app, camera, ReflectionDebugView::Off);
    assert!(picture.iter().any(|pixel| pixel.max_element() > 0.1));
    let pixels = show(&mut app, camera, ReflectionDebugView::Reflection);
    assert!(pixels.iter().all(|pixel| *pixel == Vec3::ZERO));
    let skipped = RATE_LEGEND[10].1;
    let pixels = show(&mut app, camera, ReflectionDebugView::ShadingRates);
    assert!(pixels.iter().all(|pixel| is_shade_of(*pixel, skipped)));
}

fn counters_find_no_bad_pixels(app: &mut HeadlessApp, camera: Entity) {
    let report = |app: &mut HeadlessApp| ReflectionNonFiniteReport::read(app.world().resource::<DiagnosticsStore>());
    assert_eq!(report(app), None);
    app.world().entity_mut(camera).insert(ReflectionDebugCounters);
    warm_up(app);
    // Results arrive some frames later.
    until(app, "there is no report", |app| {
        report(app).is_some_and(|report| report.radiance != Some(0.0))
    });
    let report = report(app).unwrap();
    println!("{report:?}");
    assert_eq!(report.pixels, 0);
    assert!(report.radiance.is_some_and(|radiance| radiance > 0.0));
    assert!(report.worst.cmplt(SIZE).all());
    app.world().entity_mut(camera).remove::<ReflectionDebugCounters>();
}
