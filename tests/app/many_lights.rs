//! More lights than hits evaluate one by one: some are sampled, and the mean is the light of all.

use crate::{
    common::app_with,
    pictures::{apps, linear_app, reflect, use_coarse_shadow_maps, warm_up},
    stage::{SIZE, behind, settings_of, spawn_camera, spawn_mesh, spawn_mirror},
};
use bevy::{
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    math::UVec2,
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Halves of the lights. Hits still evaluate each half one by one.
const HALF: usize = 240;
const COLORS: [Color; 3] = [
    Color::linear_rgb(1.0, 0.2, 0.1),
    Color::linear_rgb(0.2, 1.0, 0.3),
    Color::linear_rgb(0.1, 0.3, 1.0),
];

/// A room behind the camera, which the mirror before it shows, with objects that cast shadows.
fn spawn_room(app: &mut HeadlessApp, mirror_roughness: f32) -> Entity {
    let camera = spawn_mirror(app, mirror_roughness, SceneName::MirrorRoom);
    let paint = StandardMaterial {
        perceptual_roughness: 0.5,
        ..StandardMaterial::from(Color::WHITE)
    };
    spawn_mesh(app, Rectangle::new(30.0, 30.0), paint.clone(), behind(10.0));
    for index in 0..6 {
        let at = Transform::from_xyz(1.4 * index as f32 - 3.5, (index % 3) as f32 - 1.0, 8.0);
        spawn_mesh(app, Cuboid::from_length(0.8), paint.clone(), at);
    }
    camera
}

/// Lights of both halves, in turn.
fn spawn_lights(app: &mut HeadlessApp) -> [Vec<Entity>; 2] {
    [0, 1].map(|half| {
        let spawn = |index: usize| {
            let number = (2 * index + half) as f32;
            let place = Vec3::new(
                12.0 * (number * 0.754_877_7).fract() - 6.0,
                9.0 * (number * 0.569_840_3).fract() - 4.5,
                5.0 + 4.5 * (number * 0.380_279_5).fract(),
            );
            let light = PointLight {
                color: COLORS[index % 3],
                intensity: if index.is_multiple_of(16) { 4_000.0 } else { 700.0 },
                range: if index.is_multiple_of(16) { 12.0 } else { 4.0 },
                // Few: Bevy draws six maps for each of them.
                shadow_maps_enabled: index.is_multiple_of(48),
                ..default()
            };
            app.world().spawn((light, Transform::from_translation(place))).id()
        };
        (0..HALF).map(spawn).collect()
    })
}

/// The mirror's light while these halves shine, in linear RGB.
fn light_of(app: &mut HeadlessApp, lights: &[Vec<Entity>; 2], shining: [bool; 2], frames: u32) -> Vec<Vec3> {
    for (half, shines) in lights.iter().zip(shining) {
        for light in half {
            let visibility = if shines {
                Visibility::Inherited
            } else {
                Visibility::Hidden
            };
            app.world().entity_mut(*light).insert(visibility);
        }
    }
    app.step(2);
    warm_up(app);
    let world = app.world();
    let mut cameras = world.query::<&mut RayTracedReflections>();
    for mut camera in cameras.iter_mut(world) {
        camera.reset = true;
    }
    app.step(frames);
    capture(app)
}

fn capture(app: &mut HeadlessApp) -> Vec<Vec3> {
    let pixels = app.capture_linear().unwrap();
    pixels
        .into_iter()
        .map(|[red, green, blue, _]| vec3(red, green, blue))
        .collect()
}

/// Number of images in a mean. More of them have less noise, and take longer.
const IMAGES: usize = 6;

/// Light adds up: the sum of both halves, evaluated one by one, is the light of all.
#[test]
#[ignore = "long: hundreds of frames of noise"]
fn drawn_lights_bring_the_light_of_all() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        use_coarse_shadow_maps(app);
        let camera = spawn_room(app, 0.0);
        let lights = spawn_lights(app);
        for (technique, own_rays, frames, mean_limit, limit) in [
            (ReflectionTechnique::Converged, false, 64, 0.003, 0.04),
            (ReflectionTechnique::QuarterInline, false, 2, 0.02, 1.0),
            (ReflectionTechnique::Reference, false, 2, 0.02, 1.0),
            // Exact mirrors have their own rays, and draw more lights.
            (ReflectionTechnique::Quarter, true, 2, 0.02, 1.0),
        ] {
            if technique != ReflectionTechnique::Converged && tracer == ReflectionTracerChoice::RayQuery {
                continue;
            }
            reflect(app, camera, technique);
            settings_of(app, camera).full_resolution_mirrors = own_rays;
            // Halves have no noise.
            let [dark, first, second] =
                [[false, false], [true, false], [false, true]].map(|half| light_of(app, &lights, half, 2));
            let mut all = light_of(app, &lights, [true; 2], frames);
            if technique != ReflectionTechnique::Converged {
                // One image's light is off by a hundredth.
                for more in 1..IMAGES {
                    app.step(1);
                    for (sum, pixel) in all.iter_mut().zip(capture(app)) {
                        *sum += (pixel - *sum) / (more + 1) as f32;
                    }
                }
            }
            let expected = dark
                .iter()
                .zip(&first)
                .zip(&second)
                .map(|((dark, first), second)| first + second - dark);
            let expected: Vec<Vec3> = expected.collect();
            let mean = |pixels: &[Vec3]| pixels.iter().sum::<Vec3>() / pixels.len() as f32;
            let level = mean(&expected);
            let off = ((mean(&all) - level) / level).abs().max_element();
            let squares = all
                .iter()
                .zip(&expected)
                .map(|(all, expected)| ((*all - *expected) / level).length_squared());
            let spread = (squares.sum::<f32>() / (3 * all.len()) as f32).sqrt();
            let name = format!("{tracer:?}, {technique:?}, rays of their own: {own_rays}");
            println!(
                "{name}: {level:.4}, off by {:.3} %, by pixel {:.2} %",
                100.0 * off,
                100.0 * spread
            );
            assert!(
                level.min_element() > 0.01 + mean(&dark).max_element(),
                "{name}: {level}"
            );
            assert!(off < mean_limit, "{name}: the light is off by {off}");
            assert!(spread < limit, "{name}: pixels are off by {spread}");
        }
    }
}

const STREET: UVec2 = UVec2::new(128, 72);

/// A street of wet ground between houses, under lamps.
fn spawn_street(app: &mut HeadlessApp) -> Entity {
    let paint = |color: Color, perceptual_roughness: f32| StandardMaterial {
        base_color: color,
        perceptual_roughness,
        ..default()
    };
    let ground = paint(Color::srgb(0.2, 0.2, 0.2), 0.25);
    let at = Transform::from_xyz(0.0, -0.1, -35.0);
    spawn_mesh(app, Cuboid::new(9.0, 0.2, 90.0), ground, at);
    for index in 0..20u32 {
        let side = if index.is_multiple_of(2) { -1.0 } else { 1.0 };
        let at = Transform::from_xyz(side * 6.5, 4.0, -8.0 * (index / 2) as f32);
        let size = Cuboid::new(4.0 + 0.2 * (index % 3) as f32, 8.0, 7.5);
        spawn_mesh(app, size, paint(Color::srgb(0.6, 0.5, 0.4), 0.8), at);
    }
    let eye = Transform::from_xyz(0.0, 1.7, 3.0).looking_at(Vec3::new(0.0, 1.0, -10.0), Vec3::Y);
    spawn_camera(app, eye, SceneName::MirrorRoom)
}

/// This number of lamps along the street. They share its light.
fn spawn_lamps(app: &mut HeadlessApp, count: usize, shadow_maps_enabled: bool) -> Vec<Entity> {
    let spawn = |index: usize| {
        let part = (index as f32 + 0.5) / count as f32;
        let at = Vec3::new(
            8.0 * (part * 617.0).fract() - 4.0,
            4.0 + (part * 1_237.0).fract(),
            -75.0 * part,
        );
        let lamp = PointLight {
            intensity: 3e6 / count as f32,
            range: if count > 100 { 6.0 } else { 20.0 },
            shadow_maps_enabled,
            ..default()
        };
        app.world().spawn((lamp, Transform::from_translation(at))).id()
    };
    (0..count).map(spawn).collect()
}

/// Milliseconds of the passes that trace and shade: the minimum over some frames.
fn time(app: &mut HeadlessApp) -> Option<f64> {
    let path = DiagnosticPath::new("render/glint/trace/elapsed_gpu");
    let mut times = Vec::new();
    for _ in 0..8 {
        app.step(1);
        let store = app.world().resource::<DiagnosticsStore>();
        times.extend(store.get(&path).and_then(|diagnostic| diagnostic.value()));
    }
    times.into_iter().min_by(f64::total_cmp)
}

#[test]
#[ignore = "long: 10,000 lights"]
fn ten_thousand_lights_take_at_most_twice_the_time_of_ten() {
    let plugin = |app: &mut App| {
        app.add_plugins(RenderDiagnosticsPlugin);
    };
    let Some(mut app) = app_with(STREET, Output::Linear, ReflectionTracerChoice::Bvh, plugin) else {
        return;
    };
    let app = &mut app;
    let camera = spawn_street(app);
    reflect(app, camera, ReflectionTechnique::Reference);
    let mut least = [f64::INFINITY; 2];
    // The shortest times approach the true ones, later if something else keeps the device busy.
    for round in 0..12 {
        for (count, least) in [10, 10_000].into_iter().zip(&mut least) {
            let lamps = spawn_lamps(app, count, false);
            app.step(2);
            warm_up(app);
            let Some(time) = time(app) else {
                println!("skipped: the device has no timestamps");
                return;
            };
            *least = least.min(time);
            for lamp in lamps {
                app.world().despawn(lamp);
            }
        }
        let [ten, many] = least;
        if round >= 2 && many < 2.0 * ten {
            break;
        }
    }
    let [ten, many] = least;
    println!(
        "ten lights {ten:.2} ms, ten thousand {many:.2} ms: {:.2} times",
        many / ten
    );
    assert!(many < 2.0 * ten, "{many} ms instead of {ten} ms");
}

/// Up to 256 lights are evaluated one by one, so shaders and images don't change: a single frame has no noise.
#[test]
fn up_to_256_lights_none_is_drawn() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    use_coarse_shadow_maps(app);
    let camera = spawn_room(app, 0.0);
    let [mut first, mut second] = spawn_lights(app);
    for light in second.drain(16..) {
        app.world().despawn(light);
    }
    reflect(app, camera, ReflectionTechnique::Reference);
    let differs = |app: &mut HeadlessApp, lights: &[Vec<Entity>; 2]| {
        let one = light_of(app, lights, [true; 2], 3);
        app.step(1);
        let other = app.capture_linear().unwrap();
        let pairs = one.iter().zip(&other);
        pairs.filter(|(one, other)| one.to_array()[..] != other[..3]).count()
    };
    let few = differs(app, &[first.clone(), second.clone()]);
    // One more.
    let extra = PointLight {
        range: 4.0,
        ..default()
    };
    let light = app.world().spawn((extra, Transform::from_xyz(0.0, 0.0, 7.0))).id();
    first.push(light);
    let many = differs(app, &[first, second]);
    println!("pixels that differ from the next frame: {few} with 256 lights, {many} with 257");
    assert_eq!(few, 0);
    assert!(many > 1_000, "{many} pixels have noise");
}
