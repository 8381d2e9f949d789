//! Contents of pixels: surfaces that must not reflect, cameras that can't, and finite numbers only.

use super::{BEHIND, facing_the_mirror};
use crate::{
    pictures::{apps, crop, differing_pixels, picture_app, red_pixels, reflect, warm_up},
    stage::{BEFORE_THE_MIRROR, RED, SIZE, metal, report, spawn_camera, spawn_mesh, unlit},
};
use bevy::{
    asset::RenderAssetUsages,
    camera::Hdr,
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    diagnostic::FrameCount,
    ecs::world::EntityWorldMut,
    material::OpaqueRendererMethod,
    math::UVec2,
    mesh::{PrimitiveTopology, VertexAttributeValues},
    pbr::ScreenSpaceReflections,
    prelude::*,
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};

#[test]
fn pixels_that_must_not_reflect_are_left_alone() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::Furnace);
        // Bevy draws transparent surfaces a little differently with these prepasses, which the component will add.
        app.world()
            .entity_mut(camera)
            .insert((NormalPrepass, MotionVectorPrepass));
        let gray = StandardMaterial {
            base_color: Color::srgb(0.5, 0.5, 0.5),
            ..metal(0.0)
        };
        let columns = [
            gray.clone(),
            StandardMaterial {
                unlit: true,
                ..gray.clone()
            },
            StandardMaterial {
                opaque_render_method: OpaqueRendererMethod::Forward,
                ..gray.clone()
            },
            StandardMaterial {
                base_color: Color::srgba(0.5, 0.5, 0.5, 0.5),
                alpha_mode: AlphaMode::Blend,
                ..gray.clone()
            },
            StandardMaterial {
                perceptual_roughness: 0.9,
                ..gray.clone()
            },
        ];
        for (column, material) in columns.into_iter().enumerate() {
            let transform = Transform::from_xyz(0.7 * (column as f32 - 2.0), 0.0, 0.0);
            spawn_mesh(&mut app, Rectangle::new(0.5, 1.5), material, transform);
        }
        // Whatever reflects turns red.
        let at = facing_the_mirror(BEHIND);
        spawn_mesh(&mut app, Rectangle::new(60.0, 60.0), unlit(RED), at);
        app.warm_up(20_000).unwrap();
        app.step(12);
        let off = app.capture().unwrap();
        app.world().entity_mut(camera).insert(RayTracedReflections {
            roughness_cutoff: 0.6,
            transparent: false,
            forward: false,
            ..default()
        });
        warm_up(&mut app);
        let on = app.capture().unwrap();
        let middle = |column: usize| 4 * (32 * SIZE.x as usize + (48.0 + (column as f32 - 2.0) * 0.7 * 25.75) as usize);
        let colors = |picture: &[u8]| [0, 1, 2, 3, 4].map(|column| picture[middle(column)..][..3].to_vec());
        println!("{tracer:?}: off {:?}, on {:?}", colors(&off), colors(&on));
        let mut changed = [0; 5];
        for (i, (a, b)) in off.chunks_exact(4).zip(on.chunks_exact(4)).enumerate() {
            // 25.75 pixels to the metre and 0.7 m to the column.
            let column = ((i as u32 % SIZE.x) as f32 - 48.0) / (0.7 * 25.75) + 2.5;
            let column = (column.max(0.0) as usize).min(4);
            changed[column] += usize::from(a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1));
        }
        println!("{tracer:?}: {changed:?} pixels changed in the columns");
        assert!(
            changed[0] > 250,
            "{tracer:?}: the mirror reflects in {} pixels only",
            changed[0]
        );
        assert_eq!(
            changed[1..],
            [0; 4],
            "{tracer:?}: unlit, forward, transparent, rough (and the sky beside them)"
        );
    }
}

type Prepasses = (DepthPrepass, DeferredPrepass, NormalPrepass, MotionVectorPrepass);

#[test]
fn a_camera_that_lacks_something_shows_an_ordinary_picture() {
    let screen_space = |camera: &mut EntityWorldMut| {
        camera.insert(ScreenSpaceReflections::default());
    };
    let forward = |camera: &mut EntityWorldMut| {
        // With deferred materials Bevy panics for a camera that has other prepasses.
        camera.remove::<Prepasses>();
    };
    let multisampled = |camera: &mut EntityWorldMut| {
        camera.remove::<Prepasses>().insert(Msaa::Sample4);
    };
    let no_hdr = |camera: &mut EntityWorldMut| {
        camera.remove::<Hdr>();
    };
    let cases: [(&str, fn(&mut EntityWorldMut)); 4] = [
        ("screen-space reflections, too", screen_space),
        ("no deferred prepass", forward),
        ("multisampling", multisampled),
        ("no HDR", no_hdr),
    ];
    let Some(mut app) = picture_app(SIZE) else { return };
    glint_scenes::spawn(SceneName::MirrorRoom, app.world());
    let shot = |app: &mut HeadlessApp| {
        app.warm_up(20_000).unwrap();
        app.step(4);
        // Noise depends on the frame number.
        app.world().resource_mut::<FrameCount>().0 = 7;
        app.step(1);
        app.capture().unwrap()
    };
    let spawn_camera = |app: &mut HeadlessApp| {
        let (transform, projection) = glint_scenes::camera(SceneName::MirrorRoom);
        let environment = environment(SceneName::MirrorRoom, app.world());
        let camera = app.spawn_camera((transform, Projection::from(projection)));
        environment.insert(&mut app.world().entity_mut(camera));
        camera
    };
    for (name, change) in cases {
        let camera = spawn_camera(&mut app);
        change(&mut app.world().entity_mut(camera));
        let off = shot(&mut app);
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
        app.step(4);
        // The plugin has added the components. Removes them again.
        change(&mut app.world().entity_mut(camera));
        let on = shot(&mut app);
        assert_eq!(differing_pixels(&off, &on, 1), 0, "{name}");
        app.world().despawn(camera);
    }

    // Bevy itself switches multisampling off for deferred cameras, and reflections are traced then.
    let camera = spawn_camera(&mut app);
    let off = shot(&mut app);
    app.world()
        .entity_mut(camera)
        .insert((RayTracedReflections::default(), Msaa::Sample4));
    warm_up(&mut app);
    let on = shot(&mut app);
    assert_eq!(app.world().get::<Msaa>(camera), Some(&Msaa::Off));
    assert!(
        differing_pixels(&off, &on, 12) > 100,
        "the same camera reflects where nothing is missing"
    );
}

/// A wall of plastic and metal tiles, from exact mirrors to rough ones.
fn spawn_reflecting_tiles(app: &mut HeadlessApp) {
    for (row, metallic) in [(-0.5, 0.0), (0.5, 1.0)] {
        for (column, perceptual_roughness) in [(-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)] {
            let material = StandardMaterial {
                metallic,
                perceptual_roughness,
                ..default()
            };
            let at = Transform::from_xyz(column, row, 0.0);
            spawn_mesh(app, Rectangle::new(0.9, 0.9), material, at);
        }
    }
}

/// Objects with meshes, materials and transforms that are too bright, empty, flat or not finite, among intact ones.
fn spawn_odd_objects(app: &mut HeadlessApp) {
    let nan = f32::NAN;
    let triangles = |positions: Vec<[f32; 3]>| {
        let mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default());
        mesh.with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, VertexAttributeValues::Float32x3(positions))
    };
    let cube = || Mesh::from(Cuboid::from_length(1.5));
    let (white, at) = (StandardMaterial::default(), Transform::from_xyz);
    let corner = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    let broken = corner
        .into_iter()
        .chain([[nan, 0.0, 0.0], [0.0, nan, 1.0], [f32::INFINITY, 0.0, 0.0]])
        .collect();
    let glowing = StandardMaterial {
        emissive: LinearRgba::rgb(1.0e6, 1.0e6, 1.0e6),
        ..default()
    };
    let unknown = StandardMaterial {
        emissive: LinearRgba::rgb(nan, f32::INFINITY, -1.0),
        perceptual_roughness: nan,
        metallic: nan,
        reflectance: nan,
        ..default()
    };
    for (mesh, material, transform) in [
        (cube(), glowing, at(-2.5, 0.0, 6.0)),
        (cube(), unknown, at(2.5, 0.0, 6.0)),
        (cube(), white.clone(), at(0.0, 0.0, 6.0)),
        (cube(), white.clone(), at(0.0, 2.0, 6.0).with_scale(Vec3::ZERO)),
        (
            cube(),
            white.clone(),
            at(0.0, 2.0, 6.0).with_scale(Vec3::new(1.0, 0.0, 1.0)),
        ),
        (triangles(broken), white.clone(), at(0.0, -2.0, 6.0)),
        (triangles(vec![]), white.clone(), at(0.0, -2.0, 6.0)),
        (triangles(vec![[0.0; 3]]), white.clone(), at(0.0, -2.0, 6.0)),
        (triangles(vec![[0.0; 3]; 3]), white, at(0.0, -2.0, 6.0)),
    ] {
        spawn_mesh(app, mesh, material, transform);
    }
}

/// An intact light, and lights of intensities that are not finite.
fn spawn_odd_lights(app: &mut HeadlessApp) {
    // Their range ends behind the camera: they light objects in the mirrors, and no directly visible ones.
    for intensity in [f32::NAN, f32::INFINITY] {
        let light = PointLight {
            intensity,
            range: 2.0,
            ..default()
        };
        app.world().spawn((light, Transform::from_xyz(0.0, 0.0, 5.1)));
    }
    app.world().spawn((
        DirectionalLight {
            illuminance: 10.0,
            ..default()
        },
        Transform::default(),
    ));
}

#[test]
fn every_pixel_is_a_number() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_reflecting_tiles(&mut app);
        spawn_odd_objects(&mut app);
        spawn_odd_lights(&mut app);
        for technique in [ReflectionTechnique::Reference, ReflectionTechnique::Converged] {
            reflect(&mut app, camera, technique);
            app.step(4);
            let pixels = app.capture_linear().unwrap();
            let wrong = pixels
                .iter()
                .filter(|pixel| !pixel.iter().all(|value| value.is_finite()))
                .count();
            let brightest = pixels.iter().map(|pixel| pixel[0]).fold(0.0, f32::max);
            println!("{tracer:?}, {technique:?}: brightest {brightest}, {wrong} pixels are no numbers");
            assert_eq!(wrong, 0, "{tracer:?}, {technique:?}: pixels that are NaN or infinite");
            assert!(
                brightest > 1000.0,
                "{tracer:?}, {technique:?}: the glowing cube is reflected, but only {brightest}"
            );
        }
        // The intact cubes and the intact triangle, but not the flattened, empty or shrunken ones.
        assert!(report(&mut app).instances >= 6 + 4, "{:?}", report(&mut app));
    }
}

/// Images that are too wide for a technique are rejected, and the app keeps running.
#[test]
fn wide_pictures_are_declined() {
    let size = UVec2::new(8_320, 8);
    let Some(mut app) = picture_app(size) else { return };
    spawn_mesh(&mut app, Rectangle::new(4_000.0, 12.0), metal(0.0), Transform::IDENTITY);
    let at = facing_the_mirror(Vec3::Z * 6.0);
    spawn_mesh(&mut app, Rectangle::new(8_000.0, 60.0), unlit(RED), at);
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    let red = |app: &HeadlessApp, columns| red_pixels(&crop(&app.capture().unwrap(), size.x, columns));
    let reference = RayTracedReflections {
        technique: ReflectionTechnique::Reference,
        ..default()
    };
    app.world().entity_mut(camera).insert(reference);
    app.warm_up(2_000).unwrap();
    app.step(4);
    let declined = report(&mut app);
    assert!(!declined.ready && declined.active_backends.is_empty(), "{declined}");
    assert_eq!(red(&app, 0..8_320), 0);
    reflect(&mut app, camera, ReflectionTechnique::Quarter);
    let parts = [red(&app, 0..128), red(&app, 7_680..7_808)];
    assert_eq!(parts, [128 * 8; 2]);
}
