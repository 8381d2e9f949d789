//! Meshes of all formats, materials that do not reflect, cameras that cannot, values that are no numbers, any size.

#[path = "common/pictures.rs"]
mod pictures;

use bevy::{
    asset::RenderAssetUsages,
    camera::Hdr,
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    diagnostic::FrameCount,
    ecs::world::EntityWorldMut,
    image::Image,
    material::OpaqueRendererMethod,
    math::UVec2,
    mesh::{Indices, MeshCompressionArgs, PrimitiveTopology, VertexAttributeValues},
    pbr::ScreenSpaceReflections,
    prelude::*,
    render::render_resource::{Extent3d, Face, TextureDimension, TextureFormat},
};
use bevy_glint::{RayTracedReflections, ReflectionStatus, StatusReport, Technique, TracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};
use pictures::{app, reflect, warm_up};

const BOTH: [TracerChoice; 2] = [TracerChoice::RayQuery, TracerChoice::Bvh];
const SIZE: UVec2 = UVec2::new(96, 64);
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
/// Behind the camera, where only the mirror shows it.
const BEHIND: Vec3 = Vec3::new(0.0, 0.0, 6.0);
/// Positions of the quantised mesh and its normals differ a little: so many pixels at edges may.
const EDGE_PIXELS: usize = 10;

fn unlit(color: [u8; 3]) -> StandardMaterial {
    let [r, g, b] = color;
    StandardMaterial {
        base_color: Color::srgb_u8(r, g, b),
        unlit: true,
        ..default()
    }
}

fn mirror_material() -> StandardMaterial {
    StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    }
}

fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    let world = app.world();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// A camera at a distance of three metres from the origin, in the surroundings of a scene.
fn camera(app: &mut HeadlessApp, surroundings: SceneName) -> Entity {
    let environment = environment(surroundings, app.world());
    let camera = app.spawn_camera(Transform::from_xyz(0.0, 0.0, 3.0));
    environment.insert(&mut app.world().entity_mut(camera));
    camera
}

/// With a mirror that fills its picture.
fn camera_with_mirror(app: &mut HeadlessApp) -> Entity {
    spawn_mesh(app, Rectangle::new(12.0, 12.0), mirror_material(), Transform::IDENTITY);
    camera(app, SceneName::MirrorRoom)
}

/// Turned towards the mirror.
fn facing_the_mirror(position: Vec3) -> Transform {
    Transform::from_translation(position).with_rotation(Quat::from_rotation_y(core::f32::consts::PI))
}

fn report(app: &mut HeadlessApp) -> StatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

fn count(picture: &[u8], color: [u8; 3]) -> usize {
    let close = |pixel: &&[u8]| pixel[..3].iter().zip(color).all(|(a, b)| a.abs_diff(b) <= 24);
    picture.chunks_exact(4).filter(close).count()
}

fn differing_pixels(a: &[u8], b: &[u8], tolerance: u8) -> usize {
    let apart = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > tolerance);
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(apart).count()
}

/// The picture while one more object is there.
fn picture_with(app: &mut HeadlessApp, mesh: Mesh, material: StandardMaterial, transform: Transform) -> Vec<u8> {
    let entity = spawn_mesh(app, mesh, material, transform);
    // A mesh of the render world alone is seen a frame later than others.
    app.step(2);
    warm_up(app);
    let picture = app.capture().unwrap();
    app.world().despawn(entity);
    picture
}

fn image(app: &mut HeadlessApp, width: u32, data: Vec<u8>) -> Handle<Image> {
    let extent = Extent3d {
        width,
        height: data.len() as u32 / 4 / width,
        depth_or_array_layers: 1,
    };
    let (format, usage) = (TextureFormat::Rgba8UnormSrgb, RenderAssetUsages::default());
    app.world()
        .resource_mut::<Assets<Image>>()
        .add(Image::new(extent, TextureDimension::D2, data, format, usage))
}

/// The attributes of a mesh, put together otherwise.
fn rebuilt(mesh: &Mesh, topology: PrimitiveTopology, indices: Indices) -> Mesh {
    let mut other = Mesh::new(topology, RenderAssetUsages::default()).with_inserted_indices(indices);
    for (attribute, values) in mesh.attributes() {
        other.insert_attribute(*attribute, values.clone());
    }
    other
}

#[test]
fn meshes_of_all_formats_look_alike() {
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = camera_with_mirror(&mut app);
        app.world().spawn((
            DirectionalLight {
                illuminance: 2.5,
                ..default()
            },
            Transform::default().looking_to(Vec3::new(-0.4, -0.5, 1.0), Vec3::Y),
        ));
        let (white, green) = ([255, 255, 255, 255], [0, 255, 0, 255]);
        let checker = image(&mut app, 2, [white, green, green, white].concat());
        reflect(&mut app, camera, Technique::Reference);
        let plain_material = StandardMaterial {
            base_color: Color::srgb(0.8, 0.6, 0.5),
            ..default()
        };
        let material = StandardMaterial {
            base_color_texture: Some(checker),
            ..plain_material.clone()
        };
        let at = Transform::from_translation(BEHIND).with_rotation(Quat::from_euler(EulerRot::XYZ, 0.5, 0.7, 0.2));

        let base = Mesh::from(Cuboid::new(2.0, 1.5, 1.0));
        let nothing = app.capture().unwrap();
        let expected = picture_with(&mut app, base.clone(), material.clone(), at);
        let plain = picture_with(&mut app, base.clone(), plain_material.clone(), at);
        assert!(
            differing_pixels(&nothing, &expected, 12) > 150,
            "the object is seen in the mirror"
        );
        assert!(
            differing_pixels(&plain, &expected, 12) > 50,
            "the texture is seen in the mirror"
        );

        let list: Vec<u32> = base.indices().unwrap().iter().map(|index| index as u32).collect();
        // Degenerate triangles lead from one triangle to the next; each begins at an even place of the strip.
        let strip = list
            .chunks_exact(3)
            .flat_map(|t| [t[0], t[0], t[0], t[1], t[2], t[2]])
            .collect();
        let narrow = list.iter().map(|index| *index as u16).collect();
        let tangents = vec![[0.6, 0.0, 0.8, -1.0]; base.count_vertices()];
        let mut only_rendered = base.clone();
        only_rendered.asset_usage = RenderAssetUsages::RENDER_WORLD;
        let compressed = base.clone().compressed_mesh(&MeshCompressionArgs::regular());
        let compressed = compressed.unwrap_or_else(|(_, errors)| panic!("{errors:?}"));
        let formats = [
            (
                "16-bit indices",
                rebuilt(&base, PrimitiveTopology::TriangleList, Indices::U16(narrow)),
            ),
            ("no indices", base.clone().with_duplicated_vertices()),
            (
                "strip",
                rebuilt(&base, PrimitiveTopology::TriangleStrip, Indices::U32(strip)),
            ),
            ("compressed", compressed),
            (
                "no normals",
                base.clone().with_removed_attribute(Mesh::ATTRIBUTE_NORMAL),
            ),
            (
                "tangents",
                base.clone().with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents),
            ),
            ("render world only", only_rendered),
        ];
        for (name, mesh) in formats {
            let actual = picture_with(&mut app, mesh, material.clone(), at);
            let different = differing_pixels(&expected, &actual, 12);
            println!("{tracer:?}, {name}: {different} pixels differ");
            assert!(
                different <= EDGE_PIXELS,
                "{tracer:?}, {name}: {different} pixels differ"
            );
        }

        // Without UVs a texture can't be seen, and bare positions are enough.
        let no_uvs = base.clone().with_removed_attribute(Mesh::ATTRIBUTE_UV_0);
        let bare = no_uvs.clone().with_removed_attribute(Mesh::ATTRIBUTE_NORMAL);
        let inverted = StandardMaterial {
            cull_mode: Some(Face::Front),
            ..plain_material.clone()
        };
        let unit = Mesh::from(Cuboid::from_length(1.0));
        let cases = [
            ("no UVs", no_uvs, material.clone(), at),
            ("bare", bare, material.clone(), at),
            (
                "mirrored",
                base.clone(),
                inverted,
                at.with_scale(Vec3::new(-1.0, 1.0, 1.0)),
            ),
            (
                "turned by two mirrors",
                base.clone(),
                plain_material.clone(),
                at.with_scale(Vec3::new(-1.0, -1.0, 1.0)),
            ),
            (
                "stretched",
                unit,
                plain_material.clone(),
                at.with_scale(Vec3::new(2.0, 1.5, 1.0)),
            ),
        ];
        for (name, mesh, material, transform) in cases {
            let actual = picture_with(&mut app, mesh, material, transform);
            let different = differing_pixels(&plain, &actual, 12);
            println!("{tracer:?}, {name}: {different} pixels differ");
            assert!(
                different <= EDGE_PIXELS,
                "{tracer:?}, {name}: {different} pixels differ"
            );
        }
    }
}

#[test]
fn faces_and_holes_are_seen_as_the_material_says() {
    let mut masked = Vec::new();
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = camera_with_mirror(&mut app);
        reflect(&mut app, camera, Technique::Reference);
        let quad = || Mesh::from(Rectangle::new(3.0, 3.0));
        let away = Transform::from_translation(BEHIND);
        let towards = facing_the_mirror(BEHIND);
        let both = StandardMaterial {
            double_sided: true,
            cull_mode: None,
            ..unlit(RED)
        };
        let back = StandardMaterial {
            cull_mode: Some(Face::Front),
            ..unlit(RED)
        };
        for (name, material, transform, shown) in [
            ("front face", unlit(RED), towards, true),
            ("back face", unlit(RED), away, false),
            ("front face of a double-sided one", both.clone(), towards, true),
            ("back face of a double-sided one", both, away, true),
            ("front face where front faces are culled", back.clone(), towards, false),
            ("back face where front faces are culled", back, away, true),
        ] {
            let pixels = count(&picture_with(&mut app, quad(), material, transform), RED);
            assert!(
                if shown { pixels > 300 } else { pixels == 0 },
                "{tracer:?}, {name}: {pixels} pixels"
            );
        }

        // Of eight columns of the texture every other one is a hole, through which the green quad is seen.
        let texels = (0..64u8)
            .flat_map(|i| [255, 255, 255, if i % 2 == 0 { 255 } else { 0 }])
            .collect();
        let grating = image(&mut app, 8, texels);
        spawn_mesh(
            &mut app,
            quad(),
            unlit(GREEN),
            facing_the_mirror(BEHIND + Vec3::Z * 0.05),
        );
        let grating = StandardMaterial {
            base_color_texture: Some(grating),
            alpha_mode: AlphaMode::Mask(0.5),
            ..unlit(RED)
        };
        let picture = picture_with(&mut app, quad(), grating, towards);
        let (bars, holes) = (count(&picture, RED), count(&picture, GREEN));
        println!("{tracer:?}: {bars} pixels of bars, {holes} of holes");
        assert!(
            bars > 150 && holes > 150 && bars.abs_diff(holes) * 4 < bars + holes,
            "{bars} of bars, {holes} of holes"
        );
        masked.push(picture);
    }
    if let [first, second] = &masked[..] {
        let different = differing_pixels(first, second, 12);
        assert!(
            different <= EDGE_PIXELS,
            "the tracers differ in {different} pixels of a masked material"
        );
    }
}

#[test]
fn pixels_that_must_not_reflect_are_left_alone() {
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = camera(&mut app, SceneName::Furnace);
        // Bevy draws transparent surfaces a little differently where these exist; the component will bring them.
        app.world()
            .entity_mut(camera)
            .insert((NormalPrepass, MotionVectorPrepass));
        let gray = StandardMaterial {
            base_color: Color::srgb(0.5, 0.5, 0.5),
            ..mirror_material()
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
        spawn_mesh(
            &mut app,
            Rectangle::new(60.0, 60.0),
            unlit(RED),
            facing_the_mirror(BEHIND),
        );
        app.warm_up(20_000).unwrap();
        app.step(12);
        let off = app.capture().unwrap();
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
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
        // With deferred materials Bevy panics over a camera that has other prepasses.
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
    let Some(mut app) = app(SIZE, Output::Picture, TracerChoice::Bvh) else {
        return;
    };
    glint_scenes::spawn(SceneName::MirrorRoom, app.world());
    let shot = |app: &mut HeadlessApp| {
        app.warm_up(20_000).unwrap();
        app.step(4);
        // Noise goes by the frame.
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
        // The component brought what it needs; take it away again.
        change(&mut app.world().entity_mut(camera));
        let on = shot(&mut app);
        assert_eq!(differing_pixels(&off, &on, 1), 0, "{name}");
        app.world().despawn(camera);
    }

    // Bevy itself switches multisampling off where a camera is deferred; then reflections are traced.
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

#[test]
fn every_pixel_is_a_number() {
    let nan = f32::NAN;
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Linear, tracer) else {
            continue;
        };
        let camera = camera(&mut app, SceneName::Furnace);
        for (row, metallic) in [(-0.5, 0.0), (0.5, 1.0)] {
            for (column, perceptual_roughness) in [(-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)] {
                let material = StandardMaterial {
                    metallic,
                    perceptual_roughness,
                    ..default()
                };
                spawn_mesh(
                    &mut app,
                    Rectangle::new(0.9, 0.9),
                    material,
                    Transform::from_xyz(column, row, 0.0),
                );
            }
        }
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
            spawn_mesh(&mut app, mesh, material, transform);
        }
        // Its range ends behind the camera: what is in the picture isn't lit by it, what is in the mirrors is.
        for intensity in [nan, f32::INFINITY] {
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
        for technique in [Technique::Reference, Technique::Converged] {
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
        // The intact cubes and the intact triangle: neither flattened, nor empty, nor shrunk to a point.
        assert!(report(&mut app).instances >= 6 + 4, "{:?}", report(&mut app));
    }
}

#[test]
fn scenes_of_any_size_are_traced() {
    for tracer in BOTH {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = camera(&mut app, SceneName::MirrorRoom);
        reflect(&mut app, camera, Technique::Reference);
        app.step(2);
        let none = report(&mut app);
        assert_eq!((none.instances, none.triangles), (0, 0), "{none:?}");

        let triangle = Triangle2d::new(Vec2::new(-1.0, -1.0), Vec2::new(1.0, -1.0), Vec2::new(0.0, 1.0));
        let one = spawn_mesh(&mut app, triangle, unlit(RED), facing_the_mirror(BEHIND));
        warm_up(&mut app);
        let single = report(&mut app);
        assert_eq!((single.instances, single.triangles), (1, 1), "{single:?}");
        spawn_mesh(
            &mut app,
            Rectangle::new(12.0, 12.0),
            mirror_material(),
            Transform::IDENTITY,
        );
        warm_up(&mut app);
        let pixels = count(&app.capture().unwrap(), RED);
        assert!(pixels > 60, "{tracer:?}: the triangle has {pixels} pixels");
        app.world().despawn(one);

        let world = app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(0.08));
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(unlit(GREEN));
        let many = (0..10_000).map(|i| {
            let position = BEHIND + Vec3::new((i % 100 - 50) as f32, (i / 100 - 50) as f32, 0.0) * 0.1;
            (
                Mesh3d(mesh.clone()),
                MeshMaterial3d(material.clone()),
                Transform::from_translation(position),
            )
        });
        let many: Vec<_> = many.collect();
        world.spawn_batch(many);
        warm_up(&mut app);
        let full = report(&mut app);
        assert_eq!(full.instances, 10_001, "{full:?}");
        assert!(full.scene_bytes > single.scene_bytes, "{full:?}");
        println!(
            "{tracer:?}: 10,000 objects in {} bytes, top level in {} ms",
            full.scene_bytes, full.tlas_build_ms
        );
        let picture = app.capture().unwrap();
        assert_eq!(count(&picture, RED), 0, "{tracer:?}: the triangle is gone");
        assert!(
            count(&picture, GREEN) > 1500,
            "{tracer:?}: {} pixels of ten thousand cubes",
            count(&picture, GREEN)
        );
    }
}
