//! Compares reflections with references: mirrored geometry, a white furnace, a path tracer, and the other tracer.

mod close_lamp;
mod rare_light;
mod reflected_light;

use crate::{
    bounces::set_bounces,
    common::{app, app_with},
    pictures::{
        apps, apps_of_both, assert_flip, dump, flip, picture_app, reflect, spawn, use_coarse_shadow_maps, warm_up,
    },
    stage::until_at_rest,
};
use bevy::{
    camera::Hdr,
    core_pipeline::tonemapping::Tonemapping,
    math::{UVec2, Vec3},
    prelude::*,
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique, ReflectionTracerChoice};
use bevy_solari::{
    SolariPlugins,
    pathtracer::{Pathtracer, PathtracingPlugin},
    prelude::RaytracingMesh3d,
};
use glint_scenes::{FURNACE_ROUGHNESS, HeadlessApp, Output, SceneName};

/// A mirror floor shows the image of a camera mirrored at the floor.
#[test]
fn a_mirror_shows_the_mirrored_geometry() {
    mirror(false);
}

/// The floor is lit like Bevy's own lighting: hits are shaded like surfaces that the camera sees directly.
#[test]
fn a_mirror_shows_the_mirrored_light() {
    mirror(true);
}

fn mirror(lit: bool) {
    let size = UVec2::new(320, 240);
    for (tracer, mut app) in apps_of_both(size, Output::Picture) {
        if lit {
            app.world().add_observer(light_up);
        }
        let camera = spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
        app.step(2);
        let reflected = app.capture().unwrap();

        // Mirrored at y = 0, the image is upside down. Its rows are turned back below.
        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        let mut transform = *app.world().get::<Transform>(camera).unwrap();
        let mirrored = |v: Vec3| Vec3::new(v.x, -v.y, v.z);
        let (eye, forward) = (mirrored(transform.translation), mirrored(*transform.forward()));
        transform = Transform::from_translation(eye).looking_to(forward, -mirrored(*transform.up()));
        // A camera can be turned but not mirrored: its up vector is the mirrored one negated, and flipping the image negates it again.
        *app.world().get_mut::<Transform>(camera).unwrap() = transform;
        hide_floor(&mut app);
        app.step(4);
        let below = app.capture().unwrap();

        let width = size.x as usize;
        let (mut compared, mut wrong) = (0, 0);
        for y in size.y as usize / 2..size.y as usize {
            for x in 0..width {
                let flipped = (size.y as usize - 1 - y) * width + x;
                let (a, b) = (&reflected[4 * (y * width + x)..][..3], &below[4 * flipped..][..3]);
                // Only the floor's pixels: elsewhere the real scene is in front, or both sides show the background.
                if on_floor(x, y, size) {
                    compared += 1;
                    let apart = a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 12);
                    wrong += usize::from(apart);
                }
            }
        }
        println!("mirror, lit {lit}, {tracer:?}: {wrong} of {compared} pixels differ");
        assert!(compared > 5000, "the floor is in the picture");
        if wrong * 100 > compared * 3 {
            dump(&format!("mirror-{lit}-{tracer:?}"), size, &below, &reflected);
        }
        // Edges can be a pixel off, since the G-buffer's normals have 12 bits.
        assert!(wrong * 100 <= compared * 3, "{wrong} of {compared} pixels differ");
    }
}

/// Lights without shadows, and all unlit materials become lit ones of several kinds.
fn light_up(_: On<Add<RayTracedReflections>>, mut materials: ResMut<Assets<StandardMaterial>>, mut commands: Commands) {
    let mut kinds = [(0.0, 0.5), (0.9, 0.4), (0.0, 0.9), (0.5, 0.3)].into_iter().cycle();
    for (_, material) in materials.iter_mut() {
        if material.unlit {
            let (metallic, perceptual_roughness) = kinds.next().unwrap_or_default();
            *material = StandardMaterial {
                unlit: false,
                metallic,
                perceptual_roughness,
                ..material.clone()
            };
        }
    }
    commands.insert_resource(GlobalAmbientLight::NONE);
    commands.spawn((
        DirectionalLight {
            illuminance: 2.0,
            shadow_maps_enabled: false,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.3, -1.0, -0.6), Vec3::Y),
    ));
    commands.spawn((
        PointLight {
            intensity: 30.0,
            radius: 0.05,
            shadow_maps_enabled: false,
            ..default()
        },
        Transform::from_xyz(0.5, 1.0, 1.0),
    ));
    commands.spawn((
        SpotLight {
            intensity: 60.0,
            shadow_maps_enabled: false,
            ..default()
        },
        Transform::from_xyz(-0.5, 0.1, 1.5).looking_at(Vec3::new(0.0, 0.6, -0.3), Vec3::Y),
    ));
}

fn hide_floor(app: &mut HeadlessApp) {
    let world = app.world();
    let mut floors = world.query::<(&MeshMaterial3d<StandardMaterial>, &mut Visibility)>();
    let metals: Vec<_> = world
        .resource::<Assets<StandardMaterial>>()
        .iter()
        .filter(|(_, material)| material.metallic == 1.0)
        .map(|(id, _)| id)
        .collect();
    for (material, mut visibility) in floors.iter_mut(world) {
        if metals.contains(&material.id()) {
            *visibility = Visibility::Hidden;
        }
    }
}

/// The part of the image with nothing in front of the floor.
fn on_floor(x: usize, y: usize, size: UVec2) -> bool {
    let (x, y) = (x as f32 / size.x as f32, y as f32 / size.y as f32);
    (0.25..0.75).contains(&x) && (0.72..0.95).contains(&y)
}

/// In a white furnace a white surface looks like the background, whatever its roughness, and so does its reflection in other white
/// surfaces.
#[test]
fn a_white_furnace_stays_white() {
    let size = UVec2::new(180, 90);
    for (tracer, mut app) in apps(size, Output::Linear) {
        let camera = spawn(&mut app, SceneName::Furnace, ReflectionTechnique::Converged);
        // Merging restarts the mean.
        until_at_rest(&mut app);
        let bounces = match tracer {
            ReflectionTracerChoice::RayQuery => &[1, 4][..],
            _ => &[1, 2, 4, 8],
        };
        for max_bounces in bounces {
            // Hits of all roughnesses reflect.
            set_bounces(&mut app, camera, *max_bounces, 1.0);
            app.step(16);
            assert_white(&app, &format!("{tracer:?}, {max_bounces} bounces"));
        }
    }
}

fn assert_white(app: &HeadlessApp, name: &str) {
    let size = app.size();
    let pixels = app.capture_linear().unwrap();
    let background = pixels[0][0];
    assert!(
        (background - 1.0).abs() < 0.01,
        "the environment has a radiance of 1, not {background}"
    );
    // Spheres on a grid of one metre, seen from 7 m with a vertical field of view of 32 degrees.
    let pixels_per_metre = size.y as f32 / (2.0 * 7.0 * 16f32.to_radians().tan());
    for (row, kind) in [(-0.5, "dielectric"), (0.5, "metal")] {
        for (column, roughness) in FURNACE_ROUGHNESS.into_iter().enumerate() {
            let x = size.x as f32 / 2.0 + (column as f32 - 2.5) * pixels_per_metre;
            let y = size.y as f32 / 2.0 - row * pixels_per_metre;
            let radius = (0.3 * pixels_per_metre) as i32;
            let (mut sum, mut count) = (0.0, 0);
            for dy in -radius..=radius {
                for dx in -radius..=radius {
                    if dx * dx + dy * dy <= radius * radius {
                        let i = (y as i32 + dy) * size.x as i32 + x as i32 + dx;
                        sum += pixels[i as usize][..3].iter().sum::<f32>() / 3.0;
                        count += 1;
                    }
                }
            }
            let mean = sum / count as f32;
            println!("furnace, {name}: {kind} of roughness {roughness}: {mean:.4}");
            assert!(
                (mean - background).abs() < 0.01,
                "{name}: {kind} of roughness {roughness} shows {mean}"
            );
        }
    }
}

/// Bevy's path tracer agrees if one bounce is enough.
#[test]
#[ignore = "long: 512 frames and a path tracer"]
fn converged_agrees_with_a_path_tracer() {
    let size = UVec2::new(160, 90);
    // The path tracer smooths edges by moving its rays within a pixel; here more pixels do the same.
    const FINER: u32 = 3;
    let Some(mut ours) = app(size * FINER, Output::Linear, ReflectionTracerChoice::RayQuery) else {
        return;
    };
    spawn(&mut ours, SceneName::EmissiveFloor, ReflectionTechnique::Converged);
    ours.step(48);
    let converged = shrink(&ours.capture_linear().unwrap(), size, FINER);
    drop(ours);

    let traced = app_with(size, Output::Picture, ReflectionTracerChoice::RayQuery, |app| {
        app.add_plugins((SolariPlugins, PathtracingPlugin));
    });
    let Some(mut theirs) = traced else { return };
    let camera = theirs.spawn_scene(SceneName::EmissiveFloor, &Default::default());
    let world = theirs.world();
    let meshes: Vec<_> = world
        .query::<(Entity, &Mesh3d)>()
        .iter(world)
        .map(|(e, m)| (e, m.0.clone()))
        .collect();
    for (entity, mesh) in meshes {
        world.entity_mut(entity).insert(RaytracingMesh3d(mesh));
    }
    let usages = bevy::camera::CameraMainTextureUsages::default()
        .with(bevy::render::render_resource::TextureUsages::STORAGE_BINDING);
    world
        .entity_mut(camera)
        .insert((Pathtracer { reset: true }, Hdr, Msaa::Off, Tonemapping::None, usages));
    theirs.warm_up(20_000).unwrap();
    theirs.world().get_mut::<Pathtracer>(camera).unwrap().reset = true;
    theirs.step(1);
    theirs.world().get_mut::<Pathtracer>(camera).unwrap().reset = false;
    theirs.step(768);
    let truth = theirs.capture().unwrap();
    dump("path-tracer", size, &truth, &converged);
    assert_flip("path-tracer", size, &truth, &converged, 0.02);
}

/// The mean of each block of pixels, as sRGB bytes.
fn shrink(pixels: &[[f32; 4]], size: UVec2, factor: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    for y in 0..size.y {
        for x in 0..size.x {
            let mut sum = Vec3::ZERO;
            for (dy, dx) in (0..factor).flat_map(|dy| (0..factor).map(move |dx| (dy, dx))) {
                let pixel = pixels[((y * factor + dy) * size.x * factor + x * factor + dx) as usize];
                sum += Vec3::new(pixel[0], pixel[1], pixel[2]).clamp(Vec3::ZERO, Vec3::ONE);
            }
            let mean = sum / (factor * factor) as f32;
            let color = Srgba::from(LinearRgba::rgb(mean.x, mean.y, mean.z));
            bytes.extend(color.to_u8_array());
        }
    }
    bytes
}

/// The tracers see the same scene.
#[test]
#[ignore = "long: the same images with another tracer"]
fn both_tracers_show_the_same_picture() {
    let size = UVec2::new(128, 72);
    let mut pictures_of_both = Vec::new();
    for (_, mut app) in apps_of_both(size, Output::Picture) {
        use_coarse_shadow_maps(&mut app);
        let camera = spawn(&mut app, SceneName::Demo, ReflectionTechnique::Converged);
        app.world().resource_mut::<Time<Virtual>>().pause();
        app.step(16);
        let one = app.capture().unwrap();
        set_bounces(&mut app, camera, 3, 1.0);
        app.step(16);
        pictures_of_both.push([one, app.capture().unwrap()]);
    }
    let [of_one, of_other] = &pictures_of_both[..] else {
        return;
    };
    for ((name, first), second) in ["tracers", "tracers-3-bounces"].into_iter().zip(of_one).zip(of_other) {
        dump(name, size, first, second);
        assert_flip(name, size, first, second, 0.01);
    }
    let [one, three] = of_one;
    let added = flip(size, one, three).0;
    println!("three bounces instead of one: mean FLIP {added:.5}");
    assert!(added > 0.02, "{added}");
}

/// Tests the measure itself: it detects images that must differ.
#[test]
fn known_degradations_are_told_apart() {
    let size = UVec2::new(320, 180);
    let Some(mut app) = picture_app(size) else { return };
    let camera = app.spawn_scene(SceneName::MirrorRoom, &Default::default());
    warm_up_plain(&mut app);
    let off = app.capture().unwrap();
    reflect(&mut app, camera, ReflectionTechnique::Reference);
    app.step(2);
    let on = app.capture().unwrap();
    assert_eq!(flip(size, &on, &on).0, 0.0);
    let without = flip(size, &on, &off).0;
    let shifted: Vec<u8> = on.iter().skip(4).chain(&on[..4]).copied().collect();
    let moved = flip(size, &on, &shifted).0;
    println!("reflection off: {without:.4}, one pixel to the side: {moved:.4}");
    assert!(without > 0.02 && moved > 0.01, "{without} {moved}");
    warm_up(&mut app);
}

fn warm_up_plain(app: &mut HeadlessApp) {
    app.warm_up(20_000).unwrap();
    app.step(2);
}
