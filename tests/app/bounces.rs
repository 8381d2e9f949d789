//! Reflections within reflections.

use crate::{
    pictures::{apps, linear_app, reflect, warm_up},
    stage::{begin_anew, behind, settings_of, spawn_camera, spawn_mesh, wall},
};
use bevy::{math::UVec2, prelude::*};
use bevy_glint::ReflectionTechnique;
use glint_scenes::{HeadlessApp, Output, SceneName};

/// The whole image shows the same, so a few pixels are enough.
const SIZE: UVec2 = UVec2::new(32, 20);
/// Reflectance of the mirrors in red, green and blue.
const REFLECTANCE: [f32; 3] = [0.9, 0.7, 0.5];

/// Mean light in the middle of the image.
fn middle(app: &mut HeadlessApp) -> [f32; 3] {
    const EDGE: u32 = 4;
    let pixels = app.capture_linear().unwrap();
    let [first_row, first_column] = [SIZE.y, SIZE.x].map(|all| (all - EDGE) / 2);
    let mut sum = Vec4::ZERO;
    for row in first_row..first_row + EDGE {
        for column in first_column..first_column + EDGE {
            sum += Vec4::from(pixels[(row * SIZE.x + column) as usize]);
        }
    }
    (sum / (EDGE * EDGE) as f32).truncate().to_array()
}

/// Two facing mirrors around the camera, in surroundings of a radiance of 1. Returns the camera and the mirror behind it.
fn spawn_mirrors(app: &mut HeadlessApp, [red, green, blue]: [f32; 3], perceptual_roughness: f32) -> (Entity, Entity) {
    let material = StandardMaterial {
        base_color: Color::linear_rgb(red, green, blue),
        metallic: 1.0,
        perceptual_roughness,
        ..default()
    };
    spawn_mesh(app, wall(), material.clone(), Transform::from_xyz(0.0, 0.0, -0.5));
    let other = spawn_mesh(app, wall(), material, behind(0.5));
    let camera = spawn_camera(app, Transform::IDENTITY, SceneName::Furnace);
    (camera, other)
}

/// Waits until it has an effect, and clears the history.
pub fn set_bounces(app: &mut HeadlessApp, camera: Entity, max_bounces: u32, bounce_roughness_cutoff: f32) {
    let mut settings = settings_of(app, camera);
    settings.max_bounces = max_bounces;
    settings.bounce_roughness_cutoff = bounce_roughness_cutoff;
    // The report is one frame old.
    app.step(2);
    begin_anew(app, camera);
}

/// After n bounces the light of the surroundings has been reflected by n + 1 mirrors, including the first one.
#[test]
#[ignore = "long: many bounces"]
fn facing_mirrors_show_powers_of_their_reflectance() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let (camera, other) = spawn_mirrors(app, REFLECTANCE, 0.0);
        for (technique, own_rays) in [
            (ReflectionTechnique::Converged, false),
            (ReflectionTechnique::Reference, false),
            (ReflectionTechnique::Quarter, true),
        ] {
            let name = format!("{tracer:?}, {technique:?}");
            *app.world().get_mut::<Visibility>(other).unwrap() = Visibility::Hidden;
            reflect(app, camera, technique);
            settings_of(app, camera).full_resolution_mirrors = own_rays;
            warm_up(app);
            app.step(4);
            let single = middle(app);
            for (single, reflectance) in single.iter().zip(REFLECTANCE) {
                assert!((single - reflectance).abs() < 0.01, "{name}: one mirror shows {single}");
            }
            *app.world().get_mut::<Visibility>(other).unwrap() = Visibility::Inherited;
            for bounces in [1, 2, 4, 8] {
                set_bounces(app, camera, bounces, 0.3);
                app.step(4);
                let shown = middle(app);
                let expected = single.map(|single| single.powi(bounces as i32 + 1));
                println!("{name}, {bounces} bounces: {shown:.4?}, expected {expected:.4?}");
                for (shown, expected) in shown.iter().zip(expected) {
                    assert!(
                        (shown - expected).abs() < 0.01 * expected + 1e-3,
                        "{name}, {bounces} bounces: {shown}, expected {expected}"
                    );
                }
            }
        }
    }
}

/// Ambient light represents light from all directions. If a ray goes on, it replaces ambient light.
#[test]
fn rays_that_go_on_take_the_place_of_ambient_light() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let (camera, _) = spawn_mirrors(app, [0.5; 3], 0.0);
        let ambient = AmbientLight {
            brightness: 1.0,
            ..default()
        };
        app.world().entity_mut(camera).insert(ambient);
        reflect(app, camera, ReflectionTechnique::Converged);
        // Only the last hit shows it.
        let light = [1, 8].map(|bounces| {
            set_bounces(app, camera, bounces, 0.3);
            app.step(4);
            middle(app)[1]
        });
        println!("{tracer:?}: {light:.4?} after 1 and 8 bounces");
        assert!(light[0] > 0.4 && light[1] < 0.02, "{tracer:?}: {light:?}");
    }
}

/// White walls look like white surroundings, however often light bounces between them.
#[test]
fn white_walls_stay_white() {
    let Some(mut app) = linear_app(2 * SIZE) else { return };
    let app = &mut app;
    let (camera, _) = spawn_mirrors(app, [1.0; 3], 0.0);
    reflect(app, camera, ReflectionTechnique::Converged);
    for perceptual_roughness in [0.1, 0.4, 0.7, 1.0] {
        for (_, material) in app.world().resource_mut::<Assets<StandardMaterial>>().iter_mut() {
            material.perceptual_roughness = perceptual_roughness;
        }
        for bounces in [1, 2, 4, 8] {
            set_bounces(app, camera, bounces, 1.0);
            app.step(16);
            let pixels = app.capture_linear().unwrap();
            let mean = pixels.iter().map(|[_, green, ..]| green).sum::<f32>() / pixels.len() as f32;
            println!("roughness {perceptual_roughness}, {bounces} bounces: {mean:.4}");
            assert!(
                (mean - 1.0).abs() < 0.01,
                "roughness {perceptual_roughness}, {bounces} bounces: {mean}"
            );
        }
    }
}

/// Above the cut-off a hit shows its environment, regardless of the number of bounces.
#[test]
fn rough_hits_end_the_path() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let (camera, _) = spawn_mirrors(app, REFLECTANCE, 0.2);
    reflect(app, camera, ReflectionTechnique::Converged);
    let mut shown = |bounces, cutoff| {
        set_bounces(app, camera, bounces, cutoff);
        app.step(20);
        middle(app)
    };
    let one = shown(1, 0.3);
    let rougher = shown(8, 0.19);
    let smoother = shown(8, 0.21);
    println!("one bounce {one:?}, above the cut-off {rougher:?}, below it {smoother:?}");
    for channel in 0..3 {
        assert!((rougher[channel] - one[channel]).abs() < 0.02 * one[channel]);
        assert!(smoother[channel] < 0.7 * one[channel]);
    }
}
