//! Scenes that change between frames: the mirror follows them, and nothing is built without need.

use crate::{
    pictures::{assert_flip, crop, differing_pixels, flip, linear_app, picture_app, reflect, warm_up},
    resolution::resize,
    stage::{
        BEFORE_THE_MIRROR, BLUE, GREEN, RED, SIZE, add, edit_material, image, metal, report, share_app, spawn_camera,
        spawn_mesh, spawn_mirror, unlit, until, until_at_rest,
    },
};
use bevy::{
    asset::RenderAssetUsages,
    camera::{ClearColorConfig, RenderTarget, Viewport},
    ecs::entity_disabling::Disabled,
    image::Image,
    math::UVec2,
    prelude::*,
    render::render_resource::TextureFormat,
};
use bevy_glint::{NotReflected, RayTracedReflections, ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};

/// Behind the camera, where only the mirror shows it.
const LEFT: Vec3 = Vec3::new(-2.5, 0.0, 6.0);
const RIGHT: Vec3 = Vec3::new(2.5, 0.0, 6.0);

fn cube(size: f32) -> Mesh {
    Cuboid::from_length(size).into()
}

/// A change must be visible in the second frame at the latest, not counting frames in which a mesh is being built.
fn settle(app: &mut HeadlessApp) {
    app.step(1);
    until(app, "meshes stay pending", |app| report(app).meshes_pending == 0);
    app.step(1);
}

#[test]
fn changes_are_followed() {
    share_app(&[
        entities_that_change_are_followed,
        assets_that_change_are_followed,
        a_still_scene_builds_nothing,
        without_a_camera_that_reflects_the_scene_is_freed,
        a_viewport_shows_what_a_target_of_its_size_shows,
        a_reduced_resolution_stays_inside,
    ]);
}

/// The image in a mirror doesn't go along with the mirror.
#[test]
fn a_mirror_that_spins_is_as_sharp_as_one_that_stands() {
    let Some(mut app) = picture_app(SIZE) else { return };
    let sphere = Sphere::new(1.4).mesh().uv(256, 128);
    let sphere = spawn_mesh(&mut app, sphere, metal(0.0), Transform::IDENTITY);
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    for (index, color) in (0u8..12).zip([RED, GREEN, BLUE].into_iter().cycle()) {
        let angle = f32::from(index) * core::f32::consts::FRAC_PI_6;
        let place = Vec3::new(4.0 * angle.sin(), 0.5 * (f32::from(index % 4) - 1.5), 4.0 * angle.cos());
        spawn_mesh(&mut app, cube(0.8), unlit(color), Transform::from_translation(place));
    }
    let technique = ReflectionTechnique::Reference;
    reflect(&mut app, camera, technique);
    // With the whole denoiser.
    let settings = RayTracedReflections { technique, ..default() };
    app.world().entity_mut(camera).insert(settings);
    warm_up(&mut app);
    app.step(16);
    let standing = app.capture().unwrap();
    for _ in 0..16 {
        app.world().get_mut::<Transform>(sphere).unwrap().rotate_y(0.08);
        app.step(1);
    }
    let spinning = app.capture().unwrap();
    assert_flip("spinning-mirror", SIZE, &standing, &spinning, 0.02);
}

/// Pixels of a colour in the left and the right half of the image.
fn halves(picture: &[u8], color: [u8; 3]) -> [usize; 2] {
    let width = SIZE.x as usize;
    let mut counts = [0; 2];
    for (i, pixel) in picture.chunks_exact(4).enumerate() {
        if pixel[..3].iter().zip(color).all(|(a, b)| a.abs_diff(b) <= 24) {
            counts[usize::from(i % width >= width / 2)] += 1;
        }
    }
    counts
}

/// Asserts that the current image shows a colour in these halves and not in the others, and returns its number of pixels.
#[track_caller]
fn expect(app: &mut HeadlessApp, what: &str, color: [u8; 3], shown: [bool; 2]) -> usize {
    settle(app);
    let counts = halves(&app.capture().unwrap(), color);
    for (half, (count, shown)) in ["left", "right"].into_iter().zip(counts.into_iter().zip(shown)) {
        let right = if shown { count >= 25 } else { count == 0 };
        assert!(
            right,
            "{what}: {count} pixels of {color:?} in the {half} half; expected there: {shown}"
        );
    }
    counts[0] + counts[1]
}

fn entities_that_change_are_followed(app: &mut HeadlessApp, _: ReflectionTracerChoice) {
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let subject = spawn_mesh(app, cube(2.0), unlit(RED), Transform::from_translation(LEFT));
    app.warm_up(20_000).unwrap();
    expect(app, "no reflections yet", RED, [false, false]);
    reflect(app, camera, ReflectionTechnique::Reference);
    let size = expect(app, "at first", RED, [true, false]);

    app.world().get_mut::<Transform>(subject).unwrap().translation = RIGHT;
    let moved = expect(app, "moved", RED, [false, true]);
    assert!(
        moved.abs_diff(size) * 10 < size,
        "{moved} pixels after the move, {size} before"
    );
    app.world().entity_mut(subject).insert(Visibility::Hidden);
    expect(app, "hidden", RED, [false, false]);
    app.world().entity_mut(subject).insert(Visibility::Visible);
    expect(app, "shown again", RED, [false, true]);
    app.world().entity_mut(subject).insert(NotReflected);
    expect(app, "opted out", RED, [false, false]);
    app.world().entity_mut(subject).remove::<NotReflected>();
    expect(app, "opted in", RED, [false, true]);
    app.world().entity_mut(subject).insert(Disabled);
    expect(app, "disabled", RED, [false, false]);
    app.world().entity_mut(subject).remove::<Disabled>();
    expect(app, "enabled", RED, [false, true]);

    let second = spawn_mesh(app, cube(2.0), unlit(BLUE), Transform::from_translation(LEFT));
    expect(app, "a second one came", BLUE, [true, false]);
    expect(app, "and the first stays", RED, [false, true]);
    app.world().despawn(subject);
    expect(app, "despawned", RED, [false, false]);
    expect(app, "the second stays", BLUE, [true, false]);
    // The new object takes the slot of the old one.
    spawn_mesh(app, cube(2.0), unlit(GREEN), Transform::from_translation(RIGHT));
    expect(app, "a third one came", GREEN, [false, true]);

    // Children follow their parents.
    let parent = app.world().spawn((Transform::IDENTITY, Visibility::default())).id();
    app.world().entity_mut(second).insert(ChildOf(parent));
    app.world().get_mut::<Transform>(parent).unwrap().translation = RIGHT - LEFT + Vec3::Y * 2.5;
    expect(app, "moved by its parent", BLUE, [false, true]);
    app.world().entity_mut(parent).insert(Visibility::Hidden);
    expect(app, "hidden by its parent", BLUE, [false, false]);
}

/// A cube gets a texture with changing texels. In the end it is green and has no texture.
fn expect_changes_of_a_texture(app: &mut HeadlessApp, subject: Entity) {
    let texels = |color: [u8; 3]| [color[0], color[1], color[2], 255].repeat(16);
    let image = image(UVec2::splat(4), TextureFormat::Rgba8UnormSrgb, texels(BLUE));
    let image = add(app, image);
    edit_material(app, subject, |material| {
        material.base_color = Color::WHITE;
        material.base_color_texture = Some(image.clone());
    });
    expect(app, "textured", BLUE, [true, false]);
    let mut images = app.world().resource_mut::<Assets<Image>>();
    images.get_mut(&image).unwrap().data = Some(texels(RED));
    expect(app, "texels changed", RED, [true, false]);
    expect(app, "the old texels are gone", BLUE, [false, false]);
    edit_material(app, subject, |material| *material = unlit(GREEN));
    expect(app, "texture removed", GREEN, [true, false]);
}

/// The mesh of a green cube, which covers `size` pixels, is edited, removed, replaced and taken from the render world.
fn expect_changes_of_a_mesh(app: &mut HeadlessApp, subject: Entity, size: usize) {
    let mesh = app.world().get::<Mesh3d>(subject).unwrap().0.clone();
    *app.world().resource_mut::<Assets<Mesh>>().get_mut(&mesh).unwrap() = cube(1.0);
    let small = expect(app, "mesh changed", GREEN, [true, false]);
    assert!(
        small * 5 < size * 2,
        "{small} pixels after the cube was halved, {size} before"
    );
    let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
    meshes.remove(&mesh);
    meshes.insert(mesh.id(), cube(2.0)).unwrap();
    let replaced = expect(app, "another mesh under the same id", GREEN, [true, false]);
    assert!(
        replaced.abs_diff(size) * 10 < size,
        "{replaced} pixels after the mesh was removed and inserted, {size} before"
    );
    let other = app.world().resource_mut::<Assets<Mesh>>().add(cube(2.0));
    app.world().entity_mut(subject).insert(Mesh3d(other));
    let large = expect(app, "another mesh", GREEN, [true, false]);
    assert!(
        large.abs_diff(size) * 10 < size,
        "{large} pixels with another large cube, {size} with the first"
    );

    // Data of the main world replace data that only the render world had.
    let mut mesh = cube(2.0);
    mesh.asset_usage = RenderAssetUsages::RENDER_WORLD;
    let mesh = app.world().resource_mut::<Assets<Mesh>>().add(mesh);
    app.world().entity_mut(subject).insert(Mesh3d(mesh.clone()));
    app.step(1);
    assert_eq!(
        report(app).meshes_pending,
        1,
        "a mesh counts from the frame that brings its data"
    );
    expect(app, "a mesh of the render world", GREEN, [true, false]);
    let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
    meshes.insert(mesh.id(), cube(1.0)).unwrap();
    let small = expect(app, "its data are back in the main world", GREEN, [true, false]);
    assert!(small * 5 < size * 2, "{small} pixels with half the cube, {size} before");
}

fn assets_that_change_are_followed(app: &mut HeadlessApp, _: ReflectionTracerChoice) {
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let subject = spawn_mesh(app, cube(2.0), unlit(RED), Transform::from_translation(LEFT));
    reflect(app, camera, ReflectionTechnique::Reference);
    let size = expect(app, "at first", RED, [true, false]);

    edit_material(app, subject, |material| {
        material.base_color = Color::srgb_u8(0, 255, 0);
    });
    expect(app, "recoloured", GREEN, [true, false]);
    expect(app, "the old colour is gone", RED, [false, false]);

    expect_changes_of_a_texture(app, subject);
    expect_changes_of_a_mesh(app, subject, size);
    let blue = app.world().resource_mut::<Assets<StandardMaterial>>().add(unlit(BLUE));
    app.world().entity_mut(subject).insert(MeshMaterial3d(blue));
    expect(app, "another material", BLUE, [true, false]);
    app.world().entity_mut(subject).remove::<Mesh3d>();
    expect(app, "without a mesh", BLUE, [false, false]);
}

/// A texture that never loads leaves its material plain, and lets the view converge.
#[test]
fn a_missing_texture_keeps_no_view_from_converging() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let camera = spawn_mirror(&mut app, 0.0, SceneName::Demo);
    let missing = app.world().resource::<AssetServer>().load("no/such/image.png");
    let material = StandardMaterial {
        base_color_texture: Some(missing),
        ..metal(0.6)
    };
    spawn_mesh(&mut app, cube(2.0), material, Transform::from_translation(LEFT));
    let beside = Transform::from_translation(RIGHT.with_z(0.5));
    spawn_mesh(&mut app, cube(2.0), metal(0.6), beside);
    reflect(&mut app, camera, ReflectionTechnique::Converged);
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().reset = true;
    let early = change_of_a_frame(&mut app);
    app.step(60);
    let late = change_of_a_frame(&mut app);
    println!("a frame changes the image by {early} at first, and by {late} later");
    assert!(early > 0.0 && 5.0 * late < early, "{early} at first, {late} later");
}

fn change_of_a_frame(app: &mut HeadlessApp) -> f32 {
    let mut capture = || {
        app.step(1);
        app.capture_linear().unwrap()
    };
    let [before, after] = [capture(), capture()];
    before.iter().zip(&after).map(|(a, b)| (a[1] - b[1]).abs()).sum()
}

fn a_still_scene_builds_nothing(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let subject = spawn_mesh(app, cube(2.0), unlit(RED), Transform::from_translation(LEFT));
    reflect(app, camera, ReflectionTechnique::Reference);
    // Objects that rest are merged, once.
    until_at_rest(app);
    let builds = |app: &mut HeadlessApp| {
        let report = report(app);
        (report.tlas_builds, report.blas_builds)
    };
    let before = builds(app);
    assert!(before.0 > 0 && before.1 >= 2, "{tracer:?}: {before:?}");
    app.step(10);
    assert_eq!(
        builds(app),
        before,
        "{tracer:?}: builds of top level and meshes in a still scene"
    );
    // A moving camera doesn't change anything for rays either.
    app.world().get_mut::<Transform>(camera).unwrap().translation.x = 0.1;
    app.step(2);
    assert_eq!(builds(app), before, "{tracer:?}: only the camera moved");
    app.world().get_mut::<Transform>(subject).unwrap().translation = RIGHT;
    app.step(4);
    assert_eq!(
        builds(app),
        (before.0 + 1, before.1),
        "{tracer:?}: one object moved once"
    );
}

fn without_a_camera_that_reflects_the_scene_is_freed(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    // In white surroundings a mirror without its environment's light would be black.
    let camera = spawn_mirror(app, 0.0, SceneName::Furnace);
    spawn_mesh(app, cube(2.0), unlit(RED), Transform::from_translation(LEFT));
    app.warm_up(20_000).unwrap();
    app.step(2);
    let never = app.capture().unwrap();
    assert!(never[4 * 100] > 100, "the environment is seen in the mirror");
    reflect(app, camera, ReflectionTechnique::Reference);
    let first = expect(app, "with reflections", RED, [true, false]);
    let active = report(app);
    assert_eq!(active.instances, 2);
    assert!(active.scene_bytes > 0 && active.triangles > 0, "{active:?}");

    app.world().entity_mut(camera).remove::<RayTracedReflections>();
    app.step(2);
    let idle = report(app);
    assert_eq!(
        (idle.instances, idle.scene_bytes, idle.meshes, idle.triangles),
        (0, 0, 0, 0),
        "{idle:?}"
    );
    let picture = app.capture().unwrap();
    assert_eq!(
        differing_pixels(&never, &picture, 1),
        0,
        "{tracer:?}: something of the reflections stays"
    );

    reflect(app, camera, ReflectionTechnique::Reference);
    assert_eq!(expect(app, "once more", RED, [true, false]), first);
    assert_eq!(report(app).instances, 2);
    // An inactive camera doesn't count.
    app.world().get_mut::<Camera>(camera).unwrap().is_active = false;
    app.step(2);
    assert_eq!(report(app).instances, 0);
}

/// A viewport of half the width.
fn half_viewport(x: u32) -> Option<Viewport> {
    Some(Viewport {
        physical_position: UVec2::new(x, 0),
        physical_size: UVec2::new(SIZE.x / 2, SIZE.y),
        ..default()
    })
}

/// Cameras in the left half, in the right half, and in a target of their size, all in the same place.
fn spawn_cameras(app: &mut HeadlessApp, name: SceneName, whole: &RenderTarget) -> [Entity; 3] {
    let targets = [
        (app.target(), half_viewport(0), 0),
        (app.target(), half_viewport(SIZE.x / 2), 1),
        (whole.clone(), None, 2),
    ];
    let environment = environment(name, app.world());
    let [left, right, alone] = targets.map(|(target, viewport, order)| {
        let (transform, projection) = glint_scenes::camera(name);
        let camera = Camera {
            viewport,
            order,
            ..default()
        };
        let entity = app.spawn_camera((transform, Projection::from(projection), camera, target));
        environment.clone().insert(&mut app.world().entity_mut(entity));
        entity
    });
    app.world().get_mut::<Camera>(right).unwrap().clear_color = ClearColorConfig::None;
    [left, right, alone]
}

fn a_viewport_shows_what_a_target_of_its_size_shows(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    let name = SceneName::MirrorRoom;
    glint_scenes::spawn(name, app.world());
    let whole = app.add_target(half, Output::Picture);
    let [left, right, alone] = spawn_cameras(app, name, &whole);
    app.warm_up(20_000).unwrap();
    app.step(2);
    let off = app.capture().unwrap();
    reflect(app, alone, ReflectionTechnique::Reference);
    reflect(app, left, ReflectionTechnique::Reference);
    app.step(2);
    let on = app.capture().unwrap();
    let whole = app.read_target(&whole).unwrap();

    let columns = half.x as usize;
    let left_of = |picture: &[u8]| crop(picture, SIZE.x, 0..columns);
    let right_of = |picture: &[u8]| crop(picture, SIZE.x, columns..2 * columns);
    let changed = flip(half, &left_of(&off), &left_of(&on)).0;
    assert!(
        changed > 0.01,
        "{tracer:?}: reflections change the left half by {changed} only"
    );
    assert_flip(&format!("viewport-{tracer:?}"), half, &whole, &left_of(&on), 0.01);
    let differing = differing_pixels(&right_of(&off), &right_of(&on), 1);
    assert_eq!(differing, 0, "{tracer:?}: the right half doesn't reflect");

    // A viewport that doesn't start at the corner.
    app.world().entity_mut(alone).remove::<RayTracedReflections>();
    for (camera, x) in [(left, half.x), (right, 0)] {
        app.world().get_mut::<Camera>(camera).unwrap().viewport = half_viewport(x);
    }
    warm_up(app);
    let swapped = right_of(&app.capture().unwrap());
    assert_flip(&format!("viewport-right-{tracer:?}"), half, &whole, &swapped, 0.01);
}

fn a_reduced_resolution_stays_inside(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    let inside = UVec2::new(60, 40);
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    spawn_mesh(app, cube(2.0), unlit(RED), Transform::from_translation(LEFT));
    app.warm_up(20_000).unwrap();
    resize(app, camera, inside);
    app.warm_up(20_000).unwrap();
    app.step(2);
    let off = app.capture().unwrap();
    reflect(app, camera, ReflectionTechnique::Reference);
    // Upscalers also request the denoiser's history at the smaller size.
    app.world().entity_mut(camera).insert(RayTracedReflections::default());
    warm_up(app);
    app.step(4);
    let on = app.capture().unwrap();
    let (mut changed_inside, mut changed_outside) = (0, 0);
    for (i, (a, b)) in off.chunks_exact(4).zip(on.chunks_exact(4)).enumerate() {
        let (x, y) = (i as u32 % SIZE.x, i as u32 / SIZE.x);
        let changed = usize::from(a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1));
        if x < inside.x && y < inside.y {
            changed_inside += changed;
        } else {
            changed_outside += changed;
        }
    }
    assert!(changed_inside > 60, "{tracer:?}: {changed_inside} pixels reflect");
    assert_eq!(
        changed_outside, 0,
        "{tracer:?}: pixels beyond the reduced resolution changed"
    );

    // The small image is the image of a small target.
    let target = app.add_target(inside, Output::Picture);
    let small = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    let reflections = RayTracedReflections::default();
    app.world().entity_mut(small).insert((target.clone(), reflections));
    warm_up(app);
    app.step(4);
    let small = app.read_target(&target).unwrap();
    let rows = on.chunks_exact(4 * SIZE.x as usize).take(inside.y as usize);
    let shown: Vec<u8> = rows.flat_map(|row| &row[..4 * inside.x as usize]).copied().collect();
    assert_flip(&format!("reduced-{tracer:?}"), inside, &small, &shown, 0.01);
}
