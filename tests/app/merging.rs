//! Static objects are merged into trees in world space, and merging must not be visible.

use crate::{
    pictures::{assert_flip, flip, picture_app, reflect, spawn, warm_up},
    stage::{SIZE, add, edit_material, image, metal, report, spawn_camera, spawn_mesh, unlit, until_at_rest},
};
use bevy::{
    camera::Viewport,
    image::ImageSampler,
    math::{Affine2, UVec2},
    mesh::{UvChannel, VertexAttributeValues},
    prelude::*,
    render::render_resource::TextureFormat,
};
use bevy_glint::{RayTracedReflections, ReflectionStatusReport, ReflectionTechnique};
use glint_scenes::{HeadlessApp, SceneName};

#[test]
fn merging_is_not_seen() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let camera = spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    let first = app.capture().unwrap();
    let merged = until_merged(&mut app);
    assert!(
        merged.instances > 1 && merged.merged_instances == merged.instances,
        "{merged:?}"
    );
    assert!(merged.merge_builds >= 1 && merged.merged_triangles > 0, "{merged:?}");
    assert_flip("merged", SIZE, &first, &app.capture().unwrap(), 0.002);

    // A static scene stays unchanged.
    app.step(20);
    assert_eq!(report(&mut app), merged);

    let world = app.world();
    let mut objects = world.query_filtered::<Entity, With<Mesh3d>>();
    let subject = objects.iter(world).next().unwrap();
    world.get_mut::<Transform>(subject).unwrap().translation.x += 0.5;
    app.step(3);
    assert_eq!(report(&mut app).merged_instances, 0, "the moved object is seen at once");
    let moved = app.capture().unwrap();
    let again = until_merged(&mut app);
    assert_eq!(again.merged_instances, again.instances);
    assert_flip("merged-again", SIZE, &moved, &app.capture().unwrap(), 0.002);

    app.world().entity_mut(subject).despawn();
    app.step(3);
    let gone = report(&mut app);
    assert_eq!((gone.merged_instances, gone.instances), (0, merged.instances - 1));
    let less = app.capture().unwrap();
    until_merged(&mut app);
    assert_flip("merged-less", SIZE, &less, &app.capture().unwrap(), 0.002);

    app.world().entity_mut(camera).remove::<RayTracedReflections>();
    app.step(3);
    let idle = report(&mut app);
    assert_eq!((idle.merged_instances, idle.merged_triangles), (0, 0));
}

/// Alpha-masked objects share trees with all others.
#[test]
#[ignore = "long: hundreds of frames until all is merged"]
fn masked_objects_are_merged() {
    let Some(mut app) = picture_app(SIZE) else { return };
    spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    let solid = until_merged(&mut app);
    let opaque = app.capture().unwrap();

    let world = app.world();
    let mut objects = world.query::<(Entity, &MeshMaterial3d<StandardMaterial>)>();
    let objects: Vec<_> = objects
        .iter(world)
        .map(|(entity, material)| (entity, material.id()))
        .collect();
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    // All but the mirror are unlit.
    let is_subject = |id: AssetId<StandardMaterial>| materials.get(id).is_some_and(|material| material.unlit);
    let masked: Vec<_> = objects.into_iter().filter(|(_, id)| is_subject(*id)).take(2).collect();
    assert_eq!(masked.len(), 2);
    for (_, id) in &masked {
        materials.get_mut(*id).unwrap().alpha_mode = AlphaMode::Mask(0.5);
    }
    warm_up(&mut app);
    let single = app.capture().unwrap();
    assert_flip("masked", SIZE, &opaque, &single, 0.002);
    let merged = until_merged(&mut app);
    assert_eq!(merged.merged_instances, merged.instances);
    assert!(merged.merge_builds > solid.merge_builds, "{merged:?}");
    assert_flip("masked-merged", SIZE, &single, &app.capture().unwrap(), 0.002);

    // Parts that the alpha test cuts out are invisible from the first frame on, although the tree took them for solid.
    assert!(merged.micromap_builds > 0);
    let mut materials = app.world().resource_mut::<Assets<StandardMaterial>>();
    for (_, id) in &masked {
        materials.get_mut(*id).unwrap().base_color.set_alpha(0.0);
    }
    warm_up(&mut app);
    let cut_out = app.capture().unwrap();
    assert!(flip(SIZE, &opaque, &cut_out).0 > 0.01);
    let merged = until_merged(&mut app);
    assert_eq!(merged.merged_instances, merged.instances);
    assert_flip("masked-out-merged", SIZE, &cut_out, &app.capture().unwrap(), 0.002);
    for (entity, _) in &masked {
        app.world().entity_mut(*entity).despawn();
    }
    warm_up(&mut app);
    assert_flip("masked-out", SIZE, &app.capture().unwrap(), &cut_out, 0.002);
}

/// Spawns a mirror and a wall of 2,400 tiles. An explosion moves every second tile. Returns these tiles.
fn spawn_wall(app: &mut HeadlessApp, is_apart: bool) -> Vec<Entity> {
    let floor = Transform::from_translation(Vec3::new(0.0, -0.05, 0.0));
    spawn_mesh(app, Cuboid::new(12.0, 0.1, 12.0), metal(0.0), floor);
    let mesh = add(app, Mesh::from(Cuboid::from_length(0.1)));
    let paints = [[200, 60, 40], [40, 120, 200]].map(|color| add(app, unlit(color)));
    let mut half = Vec::new();
    for index in 0..2_400 {
        // The last of them are low, where the mirror shows them.
        let (column, row) = (index % 60, 39 - index / 60);
        let mut place = Transform::from_xyz(0.15 * (column as f32 - 30.0), 0.15 * row as f32 + 0.1, -4.0);
        let is_taken = index % 2 == 0;
        if is_taken && is_apart {
            place.translation += flight(index);
        }
        let material = MeshMaterial3d(paints[(column / 8 + row / 8) % 2].clone());
        let tile = app.world().spawn((Mesh3d(mesh.clone()), material, place)).id();
        if is_taken {
            half.push(tile);
        }
    }
    half
}

/// Where the explosion takes a tile.
fn flight(index: usize) -> Vec3 {
    Vec3::new(
        0.4 * ((index % 7) as f32 - 3.0),
        0.3 * (index % 5) as f32,
        0.5 + 0.2 * (index % 11) as f32,
    )
}

/// More merged objects than a task takes move in one frame. Rays hit them at once where they are, and nowhere else.
#[test]
fn an_explosion_of_merged_objects_is_seen_at_once() {
    let mut pictures = Vec::new();
    for is_apart in [true, false] {
        let Some(mut app) = picture_app(SIZE) else { return };
        let half = spawn_wall(&mut app, is_apart);
        let view = Transform::from_xyz(0.0, 3.0, 5.0).looking_at(Vec3::new(0.0, 0.5, -2.0), Vec3::Y);
        let camera = spawn_camera(&mut app, view, SceneName::Demo);
        reflect(&mut app, camera, ReflectionTechnique::Reference);
        if !is_apart {
            let merged = until_merged(&mut app);
            assert_eq!(merged.merged_instances, merged.instances, "{merged:?}");
            // Some leave the tree of static objects in each frame.
            app.step(12);
            for (index, tile) in half.into_iter().enumerate() {
                app.world().get_mut::<Transform>(tile).unwrap().translation += flight(2 * index);
            }
            app.step(1);
            let cut = report(&mut app);
            assert_eq!(
                (cut.merged_instances, cut.instances),
                (merged.instances - 1_200, merged.instances),
                "half of the tree was cut out"
            );
        }
        pictures.push(app.capture().unwrap());
    }
    let [expected, actual] = pictures.try_into().unwrap();
    assert_flip("explosion", SIZE, &expected, &actual, 0.002);
}

/// Waits like [`until_at_rest`], with a view of few pixels: an object that has changed rests for hundreds of frames before it is merged.
#[track_caller]
fn until_merged(app: &mut HeadlessApp) -> ReflectionStatusReport {
    let part = Viewport {
        physical_size: UVec2::splat(16),
        ..default()
    };
    set_viewport(app, Some(part));
    until_at_rest(app);
    set_viewport(app, None);
    app.step(3);
    report(app)
}

fn set_viewport(app: &mut HeadlessApp, viewport: Option<Viewport>) {
    let world = app.world();
    let mut cameras = world.query::<&mut Camera>();
    for mut camera in cameras.iter_mut(world) {
        camera.viewport.clone_from(&viewport);
    }
}

/// An unlit object of the mirror room. Its texture is solid at its first UV coordinates, and cut out at the second ones.
struct Subject {
    entity: Entity,
    mesh: AssetId<Mesh>,
}

impl Subject {
    fn new(app: &mut HeadlessApp) -> Self {
        let world = app.world();
        let mut objects = world.query::<(Entity, &Mesh3d, &MeshMaterial3d<StandardMaterial>)>();
        let materials = world.resource::<Assets<StandardMaterial>>();
        let found = objects
            .iter(world)
            .map(|(entity, mesh, material)| (entity, mesh.id(), material.id()))
            .find(|(_, _, id)| materials.get(*id).is_some_and(|material| material.unlit));
        let (entity, mesh, _) = found.expect("all but the mirror are unlit");
        let texels = vec![255, 255, 255, 255, 255, 255, 255, 0];
        let mut image = image(UVec2::new(2, 1), TextureFormat::Rgba8UnormSrgb, texels);
        image.sampler = ImageSampler::nearest();
        let image = world.resource_mut::<Assets<Image>>().add(image);
        edit_material(app, entity, |material| {
            material.base_color_texture = Some(image);
            material.alpha_mode = AlphaMode::Mask(0.5);
        });
        let subject = Self { entity, mesh };
        subject.edit_mesh(app, |mesh| {
            let count = mesh.count_vertices();
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_0, vec![[0.25f32, 0.5]; count]);
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_1, vec![[0.75f32, 0.5]; count]);
        });
        subject
    }

    fn edit_mesh(&self, app: &mut HeadlessApp, edit: impl Fn(&mut Mesh)) {
        let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
        edit(&mut meshes.get_mut(self.mesh).expect("the mesh stays"));
    }

    /// Spreads a texture of 48 x 48 texels over the object.
    fn show(&self, app: &mut HeadlessApp, texels: Vec<u8>) -> Handle<Image> {
        self.edit_mesh(app, |mesh| {
            let Some(VertexAttributeValues::Float32x3(positions)) = mesh.attribute(Mesh::ATTRIBUTE_POSITION) else {
                panic!("meshes have positions");
            };
            let uvs: Vec<[f32; 2]> = positions.iter().map(|p| [p[0] + p[2] + 0.5, p[1] + 0.5]).collect();
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_0, uvs);
        });
        let mut image = image(UVec2::splat(48), TextureFormat::Rgba8UnormSrgb, texels);
        image.sampler = ImageSampler::linear();
        let image = add(app, image);
        let texture = Some(image.clone());
        edit_material(app, self.entity, |material| material.base_color_texture = texture);
        warm_up(app);
        image
    }

    /// Chooses the UV coordinates, and moves the first ones.
    fn choose(&self, app: &mut HeadlessApp, channel: UvChannel, moved: f32) {
        edit_material(app, self.entity, |material| {
            material.base_color_channel = channel;
            material.uv_transform = Affine2::from_translation(Vec2::new(moved, 0.0));
        });
    }
}

/// Micromaps, and trees without cut-out triangles, look the same as the texture alone.
#[test]
#[ignore = "long: hundreds of frames until all is merged"]
fn micromaps_are_not_seen() {
    let Some(mut app) = picture_app(SIZE) else { return };
    spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    until_merged(&mut app);
    let solid = app.capture().unwrap();
    let subject = Subject::new(&mut app);
    let disc = |hole: bool| {
        let texel = move |x: i32, y: i32| {
            let distance = (((x - 24).pow(2) + (y - 24).pow(2)) as f32).sqrt();
            let alpha = (((18.0 - distance) * 0.5).clamp(0.0, 1.0) * 255.0) as u8;
            [255, 200, 100, if hole { 255 - alpha } else { alpha }]
        };
        (0..48)
            .flat_map(move |y| (0..48).flat_map(move |x| texel(x, y)))
            .collect::<Vec<u8>>()
    };
    let image = subject.show(&mut app, disc(false));
    let expected = app.capture().unwrap();
    assert!(flip(SIZE, &solid, &expected).0 > 0.005, "a part is cut out");
    let before = report(&mut app);
    let rested = until_merged(&mut app);
    assert!(rested.micromap_builds > before.micromap_builds, "{rested:?}");
    assert_eq!(rested.merged_instances, rested.instances);
    assert_flip("micromaps", SIZE, &expected, &app.capture().unwrap(), 0.0005);

    // Another image in the same asset: data of the first one is dropped.
    let mut images = app.world().resource_mut::<Assets<Image>>();
    images.get_mut(&image).expect("the image stays").data = Some(disc(true));
    warm_up(&mut app);
    let hole = app.capture().unwrap();
    assert!(flip(SIZE, &expected, &hole).0 > 0.005);
    let again = until_merged(&mut app);
    assert!(again.micromap_builds > rested.micromap_builds, "{again:?}");
    assert_eq!(again.merged_instances, again.instances);
    assert_flip("micromaps-changed", SIZE, &hole, &app.capture().unwrap(), 0.0005);
}

/// Cut-outs follow the texture, both sets of UV coordinates, the transform of the first one, and the alpha of vertices:
/// in objects that count as moving, and in merged ones.
#[test]
fn cut_outs_follow_material_and_mesh() {
    let Some(mut app) = picture_app(SIZE) else { return };
    spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    until_merged(&mut app);
    let solid = app.capture().unwrap();
    let subject = Subject::new(&mut app);
    let hide = |app: &mut HeadlessApp, visibility: Visibility| {
        *app.world().get_mut::<Visibility>(subject.entity).unwrap() = visibility;
        warm_up(app);
    };
    hide(&mut app, Visibility::Hidden);
    let without = app.capture().unwrap();
    assert!(flip(SIZE, &solid, &without).0 > 0.005);
    hide(&mut app, Visibility::Inherited);

    let check = |app: &mut HeadlessApp, what: &str, expected: &[u8]| {
        warm_up(app);
        assert_flip(what, SIZE, expected, &app.capture().unwrap(), 0.002);
    };
    // Each change waits longer, so this is checked where the masks themselves differ.
    let check_merged = |app: &mut HeadlessApp, what: &str, expected: &[u8]| {
        let merged = until_merged(app);
        assert_eq!(merged.merged_instances, merged.instances, "{what}");
        assert_flip(what, SIZE, expected, &app.capture().unwrap(), 0.002);
    };
    check(&mut app, "first-set", &solid);
    check_merged(&mut app, "first-set-merged", &solid);
    subject.choose(&mut app, UvChannel::Uv1, 0.0);
    check(&mut app, "second-set", &without);
    check_merged(&mut app, "second-set-merged", &without);
    subject.choose(&mut app, UvChannel::Uv1, 0.5);
    check(&mut app, "second-set-stays", &without);
    subject.choose(&mut app, UvChannel::Uv0, 0.5);
    check(&mut app, "first-set-moved", &without);
    subject.choose(&mut app, UvChannel::Uv0, 0.0);
    subject.edit_mesh(&mut app, |mesh| {
        let count = mesh.count_vertices();
        mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, vec![[1.0f32, 1.0, 1.0, 0.0]; count]);
    });
    check(&mut app, "vertex-alpha", &without);
}
