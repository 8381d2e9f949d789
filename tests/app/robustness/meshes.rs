//! Objects that rays hit: meshes of all formats, faces and holes, and scenes of any size.

use super::{BEHIND, facing_the_mirror};
use crate::{
    pictures::{apps_of_both, differing_pixels, pixels_like, reflect, warm_up},
    stage::{
        self, BEFORE_THE_MIRROR, GREEN, RED, SIZE, add, metal, report, share_app, spawn_camera, spawn_mesh,
        spawn_mirror, unlit,
    },
};
use bevy::{
    asset::RenderAssetUsages,
    image::Image,
    mesh::{Indices, MeshCompressionArgs, PrimitiveTopology},
    prelude::*,
    render::render_resource::{Face, TextureFormat},
};
use bevy_glint::{ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Positions of the quantised mesh and its normals differ a little: this number of pixels at edges can differ.
const EDGE_PIXELS: usize = 10;

/// With a mirror that fills its image.
fn camera_with_mirror(app: &mut HeadlessApp) -> Entity {
    spawn_mirror(app, 0.0, SceneName::MirrorRoom)
}

fn count(picture: &[u8], color: [u8; 3]) -> usize {
    pixels_like(picture, color, 24)
}

/// The image with one more object.
fn picture_with(app: &mut HeadlessApp, mesh: Mesh, material: StandardMaterial, transform: Transform) -> Vec<u8> {
    let entity = spawn_mesh(app, mesh, material, transform);
    // A mesh that only the render world has is visible a frame later than others.
    app.step(2);
    warm_up(app);
    let picture = app.capture().unwrap();
    app.world().despawn(entity);
    picture
}

fn image(app: &mut HeadlessApp, width: u32, data: Vec<u8>) -> Handle<Image> {
    let size = UVec2::new(width, data.len() as u32 / 4 / width);
    add(app, stage::image(size, TextureFormat::Rgba8UnormSrgb, data))
}

/// The attributes of a mesh, put together otherwise.
fn rebuilt(mesh: &Mesh, topology: PrimitiveTopology, indices: Indices) -> Mesh {
    let mut other = Mesh::new(topology, RenderAssetUsages::default()).with_inserted_indices(indices);
    for (attribute, values) in mesh.attributes() {
        other.insert_attribute(*attribute, values.clone());
    }
    other
}

/// A cuboid in formats that must not make a difference.
fn formats(base: &Mesh) -> [(&'static str, Mesh); 7] {
    let list: Vec<u32> = base.indices().unwrap().iter().map(|index| index as u32).collect();
    // Degenerate triangles connect one triangle to the next; each begins at an even place of the strip.
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
    [
        (
            "16-bit indices",
            rebuilt(base, PrimitiveTopology::TriangleList, Indices::U16(narrow)),
        ),
        ("no indices", base.clone().with_duplicated_vertices()),
        (
            "strip",
            rebuilt(base, PrimitiveTopology::TriangleStrip, Indices::U32(strip)),
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
    ]
}

/// Objects that look like a cuboid of a plain material. `textured` is a material with a texture that they can't show.
fn plain_lookalikes(
    base: &Mesh,
    plain: &StandardMaterial,
    textured: &StandardMaterial,
    at: Transform,
) -> [(&'static str, Mesh, StandardMaterial, Transform); 5] {
    // Without UVs a texture isn't visible, and bare positions are enough.
    let no_uvs = base.clone().with_removed_attribute(Mesh::ATTRIBUTE_UV_0);
    let bare = no_uvs.clone().with_removed_attribute(Mesh::ATTRIBUTE_NORMAL);
    let inverted = StandardMaterial {
        cull_mode: Some(Face::Front),
        ..plain.clone()
    };
    let unit = Mesh::from(Cuboid::from_length(1.0));
    let scaled = |x, y, z| at.with_scale(Vec3::new(x, y, z));
    [
        ("no UVs", no_uvs, textured.clone(), at),
        ("bare", bare, textured.clone(), at),
        ("mirrored", base.clone(), inverted, scaled(-1.0, 1.0, 1.0)),
        (
            "turned by two mirrors",
            base.clone(),
            plain.clone(),
            scaled(-1.0, -1.0, 1.0),
        ),
        ("stretched", unit, plain.clone(), scaled(2.0, 1.5, 1.0)),
    ]
}

#[test]
fn rays_hit_what_is_there() {
    share_app(&[meshes_of_all_formats_look_alike, scenes_of_any_size_are_traced]);
}

fn meshes_of_all_formats_look_alike(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    let camera = camera_with_mirror(app);
    app.world().spawn((
        DirectionalLight {
            illuminance: 2.5,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.4, -0.5, 1.0), Vec3::Y),
    ));
    let (white, green) = ([255, 255, 255, 255], [0, 255, 0, 255]);
    let checker = image(app, 2, [white, green, green, white].concat());
    reflect(app, camera, ReflectionTechnique::Reference);
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
    let expected = picture_with(app, base.clone(), material.clone(), at);
    let plain = picture_with(app, base.clone(), plain_material.clone(), at);
    assert!(
        differing_pixels(&nothing, &expected, 12) > 150,
        "the object is seen in the mirror"
    );
    assert!(
        differing_pixels(&plain, &expected, 12) > 50,
        "the texture is seen in the mirror"
    );

    let formats = formats(&base).map(|(name, mesh)| (name, mesh, material.clone(), at, &expected));
    let lookalikes = plain_lookalikes(&base, &plain_material, &material, at)
        .map(|(name, mesh, material, transform)| (name, mesh, material, transform, &plain));
    for (name, mesh, material, transform, expected) in formats.into_iter().chain(lookalikes) {
        let actual = picture_with(app, mesh, material, transform);
        let different = differing_pixels(expected, &actual, 12);
        println!("{tracer:?}, {name}: {different} pixels differ");
        assert!(
            different <= EDGE_PIXELS,
            "{tracer:?}, {name}: {different} pixels differ"
        );
    }
}

#[test]
fn faces_and_holes_are_seen_as_the_material_says() {
    let mut masked = Vec::new();
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        let camera = camera_with_mirror(&mut app);
        reflect(&mut app, camera, ReflectionTechnique::Reference);
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

        // Every other column of the texture's eight is a hole, through which the green quad is visible.
        let texels = (0..64u8)
            .flat_map(|i| [255, 255, 255, if i % 2 == 0 { 255 } else { 0 }])
            .collect();
        let grating = image(&mut app, 8, texels);
        let at = facing_the_mirror(BEHIND + Vec3::Z * 0.05);
        spawn_mesh(&mut app, quad(), unlit(GREEN), at);
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

/// A ray passes through any number of surfaces that are cut out where it meets them.
#[test]
fn rays_pass_through_many_holes() {
    const LAYERS: usize = 400;
    for (tracer, mut app) in apps_of_both(SIZE / 2, Output::Picture) {
        let camera = camera_with_mirror(&mut app);
        let hole = image(&mut app, 1, vec![255, 255, 255, 0]);
        let material = StandardMaterial {
            base_color_texture: Some(hole),
            alpha_mode: AlphaMode::Mask(0.5),
            cull_mode: None,
            ..unlit(GREEN)
        };
        let mut layers = Mesh::from(Rectangle::new(9.0, 9.0));
        for layer in 1..LAYERS {
            let at = Transform::from_xyz(0.0, 0.0, 0.005 * layer as f32);
            layers
                .merge(&Mesh::from(Rectangle::new(9.0, 9.0)).transformed_by(at))
                .unwrap();
        }
        spawn_mesh(&mut app, layers, material, Transform::from_xyz(0.0, 0.0, 4.0));
        let at = facing_the_mirror(Vec3::Z * 8.0);
        spawn_mesh(&mut app, Rectangle::new(30.0, 30.0), unlit(RED), at);
        reflect(&mut app, camera, ReflectionTechnique::Reference);
        let red = count(&app.capture().unwrap(), RED);
        assert_eq!(red, (SIZE / 2).element_product() as usize, "{tracer:?}");
    }
}

fn scenes_of_any_size_are_traced(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    reflect(app, camera, ReflectionTechnique::Reference);
    app.step(2);
    let none = report(app);
    assert_eq!((none.instances, none.triangles), (0, 0), "{none:?}");

    let triangle = Triangle2d::new(Vec2::new(-1.0, -1.0), Vec2::new(1.0, -1.0), Vec2::new(0.0, 1.0));
    let one = spawn_mesh(app, triangle, unlit(RED), facing_the_mirror(BEHIND));
    warm_up(app);
    let single = report(app);
    assert_eq!((single.instances, single.triangles), (1, 1), "{single:?}");
    spawn_mesh(app, Rectangle::new(12.0, 12.0), metal(0.0), Transform::IDENTITY);
    warm_up(app);
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
    warm_up(app);
    let full = report(app);
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
