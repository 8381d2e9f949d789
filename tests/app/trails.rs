//! Moving objects in glossy surfaces, and objects that the camera passes, are nearly as exact as static ones.

use crate::{
    pictures::{app_of_device, dump, flip, limited, picture_app, reflect, warm_up},
    stage::{BLUE, GREEN, RED, metal, settings_of, spawn_camera, spawn_mesh, unlit},
};
use bevy::{
    mesh::morph::{MeshMorphWeights, MorphAttributes},
    prelude::*,
    render::settings::{WgpuLimits, WgpuSettings},
};
use bevy_glint::{RayTracedReflections, ReflectedParticle, ReflectedParticles, ReflectionTechnique};
use glint_scenes::{HeadlessApp, SceneName};

/// At fewer pixels, sampling a history between its pixels blurs more than the floor does.
const SIZE: UVec2 = UVec2::new(240, 160);

/// Factor on the static error that the error in motion can reach.
const LIMIT: f32 = 1.6;

/// A camera before a glossy floor, and an object above it.
struct Scene {
    camera: Entity,
    /// The object that moves, or that the camera passes.
    subject: Entity,
}

fn scene(app: &mut HeadlessApp, roughness: f32, subject: impl Into<Mesh>, material: StandardMaterial) -> Scene {
    let floor = Plane3d::default().mesh().size(30.0, 30.0);
    spawn_mesh(app, floor, metal(roughness), Transform::from_xyz(0.0, -1.0, 0.0));
    let subject = spawn_mesh(app, subject, material, Transform::from_xyz(0.2, -0.3, -1.0));
    let cube = Cuboid::from_length(0.5);
    spawn_mesh(app, cube, unlit(GREEN), Transform::from_xyz(0.2, -0.3, -2.5));
    let view = Transform::from_xyz(0.0, 0.4, 3.0).looking_at(Vec3::new(0.0, -1.0, -1.0), Vec3::Y);
    let camera = spawn_camera(app, view, SceneName::MirrorRoom);
    Scene { camera, subject }
}

type Build = fn(&mut HeadlessApp) -> Scene;
type Step = fn(&mut HeadlessApp, &Scene, f32);

/// Runs 24 frames of a movement, which ends with the scene as it was built. Returns the last of them, and a frame after 24 more static
/// frames. `images`: histories follow images in smooth surfaces, too. The first run also finds the truth.
fn run(
    technique: ReflectionTechnique,
    images: bool,
    truth: &mut Option<Vec<u8>>,
    build: Build,
    step: Step,
) -> Option<[Vec<u8>; 2]> {
    let mut app = picture_app(SIZE)?;
    let scene = build(&mut app);
    reflect(&mut app, scene.camera, technique);
    let mut settings = RayTracedReflections { technique, ..default() };
    // Static with the noise of motion.
    settings.denoiser.converge_static_views = false;
    settings.denoiser.virtual_history = images;
    app.world().entity_mut(scene.camera).insert(settings.clone());
    step(&mut app, &scene, -24.0);
    warm_up(&mut app);
    for _ in 0..24 {
        step(&mut app, &scene, 1.0);
        app.step(1);
    }
    let moving = app.capture().unwrap();
    app.step(24);
    let still = app.capture().unwrap();
    truth.get_or_insert_with(|| {
        settings.technique = ReflectionTechnique::Converged;
        app.world().entity_mut(scene.camera).insert(settings);
        warm_up(&mut app);
        app.step(128);
        app.capture().unwrap()
    });
    Some([moving, still])
}

/// The error in motion is little more than the static one, and at most this fraction of the error without histories that follow images:
/// for techniques with a ray for each pixel and for four. A fraction above 1 only keeps followed images from being much worse.
#[track_caller]
fn expect(name: &str, part: f32, build: Build, step: Step) {
    let mut truth = None;
    for technique in [ReflectionTechnique::Reference, ReflectionTechnique::Quarter] {
        let mut errors = |images| {
            let pictures = run(technique, images, &mut truth, build, step)?;
            let truth = truth.as_ref()?;
            dump(&format!("{name}-{technique:?}"), SIZE, truth, &pictures[0]);
            Some(pictures.map(|picture| flip(SIZE, truth, &picture).0))
        };
        let Some(([error, least], [without, _])) = errors(true).zip(errors(false)) else {
            return;
        };
        println!("{name}, {technique:?}: FLIP {error:.4} in motion, {least:.4} at rest, {without:.4} without");
        assert!(error < LIMIT * least, "{name}, {technique:?}: {error} and {least}");
        assert!(
            error < part * without,
            "{name}, {technique:?}: {error}, and {without} without"
        );
    }
}

fn place<'a>(app: &'a mut HeadlessApp, entity: Entity) -> Mut<'a, Transform> {
    app.world().get_mut::<Transform>(entity).unwrap()
}

fn lamp(app: &mut HeadlessApp, roughness: f32) -> Scene {
    scene(app, roughness, Sphere::new(0.35), unlit(RED))
}

const CROSS: Step = |app, scene, frames| place(app, scene.subject).translation.x += 0.06 * frames;

#[test]
#[ignore = "long: hundreds of frames of truth"]
fn a_lamp_that_crosses_a_glossy_floor_leaves_no_trail() {
    expect("crossing", 1.02, |app| lamp(app, 0.15), CROSS);
}

/// A floor with a particle above it.
fn particle(app: &mut HeadlessApp) -> Scene {
    let scene = scene(app, 0.15, Sphere::new(0.01), unlit(RED));
    let material = app.world().resource_mut::<Assets<StandardMaterial>>().add(unlit(RED));
    let particle = ReflectedParticle {
        size: Vec2::splat(0.7),
        ..default()
    };
    app.world().entity_mut(scene.subject).insert(ReflectedParticles {
        particles: vec![particle],
        material,
    });
    scene
}

/// Particles have no motion vectors. With the history of what is behind them, the factor is 1.41, and it is 1.28 without.
#[test]
fn a_particle_that_crosses_a_glossy_floor_leaves_no_trail() {
    let mut truth = None;
    let pictures = run(ReflectionTechnique::Quarter, true, &mut truth, particle, CROSS);
    let Some((pictures, truth)) = pictures.zip(truth) else {
        return;
    };
    let [error, least] = pictures.map(|picture| flip(SIZE, &truth, &picture).0);
    println!("FLIP {error:.4} in motion, {least:.4} at rest");
    assert!(error < 1.34 * least, "{error} and {least}");
}

/// Images of tests don't depend on how many frames came before.
#[test]
fn the_same_noise_follows_each_warm_up() {
    let Some(mut app) = picture_app(SIZE) else {
        return;
    };
    let scene = lamp(&mut app, 0.15);
    reflect(&mut app, scene.camera, ReflectionTechnique::Quarter);
    settings_of(&mut app, scene.camera).denoiser.converge_static_views = false;
    let mut image_after = |frames, restarts: bool| {
        app.step(frames);
        if restarts {
            warm_up(&mut app);
        } else {
            settings_of(&mut app, scene.camera).reset = true;
            app.step(6);
        }
        app.capture().unwrap()
    };
    let first = image_after(3, true);
    let [same, other] = [true, false].map(|restarts| flip(SIZE, &first, &image_after(6, restarts)).0);
    println!("FLIP {same:.4}, and {other:.4} with other noise");
    // Merging an object can change the last bits of a hit.
    assert!(same < 0.1 * other, "{same} and {other}");
}

/// A view that goes on with other settings, and so with other textures, shows no frame without a history.
#[test]
fn other_settings_keep_the_history() {
    let Some(mut app) = picture_app(SIZE) else {
        return;
    };
    let app = &mut app;
    let scene = lamp(app, 0.15);
    let mut settings = RayTracedReflections {
        technique: ReflectionTechnique::Reference,
        ..default()
    };
    settings.denoiser.converge_static_views = false;
    app.world().entity_mut(scene.camera).insert(settings.clone());
    let changes: [(&str, fn(&mut RayTracedReflections)); 5] = [
        ("quarter", |settings| settings.technique = ReflectionTechnique::Quarter),
        ("variable", |settings| {
            settings.technique = ReflectionTechnique::Variable;
        }),
        ("shared mirrors", |settings| settings.full_resolution_mirrors = false),
        ("light", |settings| settings.denoiser.follow_light_changes = false),
        ("reference", |settings| {
            settings.technique = ReflectionTechnique::Reference;
        }),
    ];
    // Compiles all passes.
    for (_, change) in changes {
        change(&mut settings_of(app, scene.camera));
        warm_up(app);
    }
    settings_of(app, scene.camera).technique = ReflectionTechnique::Converged;
    warm_up(app);
    app.step(128);
    let truth = app.capture().unwrap();
    app.world().entity_mut(scene.camera).insert(settings);
    warm_up(app);
    let error = |app: &HeadlessApp| flip(SIZE, &truth, &app.capture().unwrap()).0;
    // More than other noise changes, less than a frame without a history does.
    const LIMIT: f32 = 1.17;
    for (name, change) in changes {
        app.step(24);
        let before = error(app);
        change(&mut settings_of(app, scene.camera));
        let after = [1, 2].map(|_| {
            app.step(1);
            error(app)
        });
        println!("{name}: FLIP {before:.4}, then {after:.4?}");
        let is_kept = after.iter().all(|error| *error < LIMIT * before);
        assert!(is_kept, "{name}: {before}, then {after:?}");
    }
    let before = error(app);
    settings_of(app, scene.camera).reset = true;
    app.step(1);
    let without = error(app);
    println!("FLIP {before:.4}, then {without:.4} without a history");
    assert!(without > LIMIT * before, "{without}");
}

/// The smoother the floor, the more its history is worth.
#[test]
#[ignore = "long: hundreds of frames of truth"]
fn a_lamp_that_crosses_a_smooth_floor_is_sharp() {
    expect("crossing-smooth", 0.95, |app| lamp(app, 0.08), CROSS);
}

/// A lamp like that, which a morph target moves: histories know the motion of vertices.
#[test]
#[ignore = "long: hundreds of frames of truth"]
fn a_morphed_lamp_that_crosses_a_smooth_floor_is_sharp() {
    expect(
        "crossing-morphed",
        0.95,
        |app| {
            // Turned by a quarter, and twice as large.
            let mesh = Sphere::new(0.175).mesh().build();
            let target = vec![MorphAttributes::new(Vec3::Z * 0.5, Vec3::ZERO, Vec3::ZERO); mesh.count_vertices()];
            let scene = scene(app, 0.08, mesh.with_morph_targets(target), unlit(RED));
            let mut place = place(app, scene.subject);
            place.rotate_y(core::f32::consts::FRAC_PI_2);
            place.scale = Vec3::splat(2.0);
            let weights = MeshMorphWeights::Value { weights: vec![0.0] };
            app.world().entity_mut(scene.subject).insert(weights);
            scene
        },
        |app, scene, frames| {
            let mut weights = app.world().get_mut::<MeshMorphWeights>(scene.subject).unwrap();
            if let MeshMorphWeights::Value { weights } = &mut *weights {
                weights[0] += 0.06 * frames;
            }
        },
    );
}

#[test]
#[ignore = "long: hundreds of frames of truth"]
fn a_bar_that_turns_over_a_smooth_floor_leaves_no_trail() {
    expect(
        "turning",
        1.06,
        |app| {
            let scene = scene(app, 0.08, Cuboid::new(1.6, 0.1, 0.1), unlit(BLUE));
            place(app, scene.subject).translation.y = -0.5;
            scene
        },
        |app, scene, frames| place(app, scene.subject).rotate_y(0.05 * frames),
    );
}

#[test]
#[ignore = "long: hundreds of frames of truth"]
fn a_camera_that_passes_a_sphere_sees_no_trail() {
    expect(
        "passing",
        0.9,
        |app| lamp(app, 0.15),
        |app, scene, frames| {
            place(app, scene.camera).translation.x += 0.03 * frames;
        },
    );
}

/// A wall behind a floor, and a lamp that only the wall shows.
fn lit_wall(app: &mut HeadlessApp, roughness: f32) -> Scene {
    let floor = Plane3d::default().mesh().size(30.0, 30.0);
    spawn_mesh(app, floor, metal(roughness), Transform::from_xyz(0.0, -1.0, 0.0));
    let wall = StandardMaterial {
        perceptual_roughness: 0.9,
        ..default()
    };
    let cuboid = Cuboid::new(12.0, 5.0, 0.2);
    spawn_mesh(app, cuboid, wall, Transform::from_xyz(0.0, 0.0, -2.5));
    let view = Transform::from_xyz(0.0, 0.4, 3.0).looking_at(Vec3::new(0.0, -1.0, -1.0), Vec3::Y);
    let camera = spawn_camera(app, view, SceneName::MirrorRoom);
    let lamp = PointLight {
        intensity: 1.5,
        range: 8.0,
        ..default()
    };
    let subject = app.world().spawn((lamp, Transform::from_xyz(0.2, -0.2, -1.8))).id();
    Scene { camera, subject }
}

/// A panel behind a door that slides away.
fn door(app: &mut HeadlessApp, roughness: f32) -> Scene {
    let scene = scene(app, roughness, Cuboid::new(2.0, 2.0, 0.05), metal(1.0));
    place(app, scene.subject).translation = Vec3::new(1.5, 0.0, -1.5);
    let panel = Cuboid::new(3.0, 2.0, 0.1);
    spawn_mesh(app, panel, unlit([255, 220, 120]), Transform::from_xyz(0.2, 0.0, -2.0));
    scene
}

/// Errors in motion, in the third frame after it, and at rest, with rays that are traced again or without.
fn errors_after(
    technique: ReflectionTechnique,
    follow: bool,
    truth: &mut Option<Vec<u8>>,
    build: Build,
) -> Option<[f32; 3]> {
    let mut app = picture_app(SIZE)?;
    let scene = build(&mut app);
    reflect(&mut app, scene.camera, technique);
    let mut settings = RayTracedReflections { technique, ..default() };
    settings.denoiser.converge_static_views = false;
    settings.denoiser.follow_light_changes = follow;
    app.world().entity_mut(scene.camera).insert(settings.clone());
    // Once more after the shader is compiled that only such scenes need.
    for _ in 0..2 {
        CROSS(&mut app, &scene, -24.0);
        warm_up(&mut app);
        for _ in 0..24 {
            CROSS(&mut app, &scene, 1.0);
            app.step(1);
        }
    }
    let moving = app.capture().unwrap();
    app.step(3);
    let third = app.capture().unwrap();
    app.step(21);
    let still = app.capture().unwrap();
    let truth = truth.get_or_insert_with(|| {
        settings.technique = ReflectionTechnique::Converged;
        app.world().entity_mut(scene.camera).insert(settings);
        warm_up(&mut app);
        app.step(64);
        app.capture().unwrap()
    });
    dump(&format!("light-{technique:?}-{follow}"), SIZE, truth, &third);
    Some([moving, third, still].map(|picture| flip(SIZE, truth, &picture).0))
}

/// The light of a lamp that swings is gone from its old place after three frames. Without rays that are traced again, the error is 2.4 times
/// that at rest.
#[test]
fn light_of_a_lamp_that_swings_leaves_no_trail() {
    let build: Build = |app| lit_wall(app, 0.3);
    let errors = errors_after(ReflectionTechnique::Quarter, true, &mut None, build);
    let Some([_, third, still]) = errors else { return };
    println!("FLIP {third:.4} after three frames, {still:.4} at rest");
    assert!(third < 1.8 * still, "{third} and {still}");
}

/// After a pause, kept rays are old. They still show what changed in it.
#[test]
fn light_that_steps_after_a_pause_leaves_no_trail() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let scene = lit_wall(&mut app, 0.3);
    let technique = ReflectionTechnique::Quarter;
    reflect(&mut app, scene.camera, technique);
    let mut settings = RayTracedReflections { technique, ..default() };
    settings.denoiser.converge_static_views = false;
    let shine = |app: &mut HeadlessApp, intensity: f32, frames: u32| {
        app.world().get_mut::<PointLight>(scene.subject).unwrap().intensity = intensity;
        app.step(frames);
    };
    let images = [true, false].map(|follow| {
        settings.denoiser.follow_light_changes = follow;
        app.world().entity_mut(scene.camera).insert(settings.clone());
        // Once more after the shaders are compiled that only such scenes need.
        for _ in 0..2 {
            warm_up(&mut app);
            for frame in 0..16 {
                shine(&mut app, 0.8 + 0.001 * frame as f32, 1);
            }
        }
        app.step(40);
        shine(&mut app, 1.5, 3);
        app.capture().unwrap()
    });
    settings.technique = ReflectionTechnique::Converged;
    app.world().entity_mut(scene.camera).insert(settings);
    warm_up(&mut app);
    app.step(64);
    let truth = app.capture().unwrap();
    let [with, without] = images.map(|image| flip(SIZE, &truth, &image).0);
    println!("FLIP {with:.4} in the third frame, {without:.4} without kept rays");
    assert!(with < 0.6 * without, "{with} and {without}");
}

/// Kept rays are traced and shaded among the others, if the device has enough storage buffers.
#[test]
#[ignore = "long: an app for each way"]
fn kept_rays_find_the_same_on_the_way_as_alone() {
    const TOO_FEW: u32 = 11;
    let image = |buffers: Option<u32>, follow: bool| {
        let device = buffers.map_or_else(WgpuSettings::default, |buffers| {
            limited(WgpuLimits {
                max_storage_buffers_per_shader_stage: buffers,
                ..WgpuLimits::unlimited()
            })
        });
        let mut app = app_of_device(SIZE, device)?;
        let scene = lit_wall(&mut app, 0.3);
        let technique = ReflectionTechnique::Quarter;
        reflect(&mut app, scene.camera, technique);
        let mut settings = RayTracedReflections { technique, ..default() };
        settings.denoiser.follow_light_changes = follow;
        app.world().entity_mut(scene.camera).insert(settings);
        for _ in 0..2 {
            CROSS(&mut app, &scene, -12.0);
            warm_up(&mut app);
            for _ in 0..12 {
                CROSS(&mut app, &scene, 1.0);
                app.step(1);
            }
        }
        Some(app.capture().unwrap())
    };
    let (Some(shared), Some(alone), Some(without)) =
        (image(None, true), image(Some(TOO_FEW), true), image(None, false))
    else {
        return;
    };
    let [alone, without] = [alone, without].map(|image| flip(SIZE, &shared, &image).0);
    println!("FLIP {alone:.5} alone, {without:.5} without");
    assert!(alone < 0.001 && without > 0.01, "{alone} and {without}");
}

#[test]
#[ignore = "long: hundreds of frames"]
fn light_that_changes_leaves_no_trail_in_any_roughness() {
    // Parts of the errors without rays that are traced again.
    for (name, build, part) in [
        ("lamp, smooth", (|app| lit_wall(app, 0.15)) as Build, 0.7),
        ("lamp, rough", |app| lit_wall(app, 0.45), 0.7),
        // The door itself moves, so that its image is followed.
        ("door, smooth", |app| door(app, 0.15), 1.02),
        ("door, rough", |app| door(app, 0.3), 1.02),
    ] {
        for technique in [ReflectionTechnique::Reference, ReflectionTechnique::Quarter] {
            let mut truth = None;
            let mut errors = |follow| errors_after(technique, follow, &mut truth, build);
            let Some((with, without)) = errors(true).zip(errors(false)) else {
                return;
            };
            println!("{name}, {technique:?}: {with:.4?}, and {without:.4?} without");
            assert!(with[1] < 2.2 * with[2], "{name}, {technique:?}: {with:?}");
            assert!(
                with[1] < part * without[1],
                "{name}, {technique:?}: {with:?} and {without:?}"
            );
        }
    }
}
