//! Materials of other types than `StandardMaterial`, and stand-ins: the wall behind the camera in a mirror.

use crate::{
    common::app_with,
    pictures::{BOTH, reflect, warm_up},
    stage::{BLUE, GREEN, RED, SIZE, add, behind, report, spawn_mesh, spawn_mirror, texel, unlit, wall},
};
use bevy::{
    pbr::{ExtendedMaterial, Lightmap, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
};
use bevy_glint::{
    ReflectedMaterial, ReflectedMaterial3d, ReflectedMaterialPlugin, ReflectedMesh3d, ReflectionTechnique,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName, capture_log, take_log};

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Waves {
    #[uniform(100)]
    time: Vec4,
}

impl MaterialExtension for Waves {}

type Water = ExtendedMaterial<StandardMaterial, Waves>;

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Lava {
    #[uniform(0)]
    heat: Vec4,
}

impl Material for Lava {}

impl ReflectedMaterial for Lava {
    fn reflected(&self) -> StandardMaterial {
        unlit(GREEN)
    }
}

/// A material that no plugin registers for rays.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Mud {
    #[uniform(0)]
    depth: Vec4,
}

impl Material for Mud {}

/// A mirror before a camera.
fn stage(tracer: ReflectionTracerChoice) -> Option<HeadlessApp> {
    let mut app = app_with(SIZE, Output::Picture, tracer, |app| {
        app.add_plugins((
            // Adding it twice does no harm.
            ReflectedMaterialPlugin::<StandardMaterial>::default(),
            ReflectedMaterialPlugin::<Water>::default(),
            ReflectedMaterialPlugin::<Lava>::default(),
            MaterialPlugin::<Water>::default(),
            MaterialPlugin::<Lava>::default(),
            MaterialPlugin::<Mud>::default(),
        ));
    })?;
    let camera = spawn_mirror(&mut app, 0.0, SceneName::MirrorRoom);
    reflect(&mut app, camera, ReflectionTechnique::Reference);
    Some(app)
}

fn water(color: [u8; 3]) -> Water {
    Water {
        base: unlit(color),
        extension: Waves::default(),
    }
}

/// Asserts that the mirror shows a colour, or neither red, green nor blue.
#[track_caller]
fn assert_shows(app: &mut HeadlessApp, what: &str, color: Option<[u8; 3]>) {
    warm_up(app);
    app.step(4);
    let picture = app.capture().unwrap();
    for known in [RED, GREEN, BLUE] {
        let is_like = |pixel: &&[u8]| (0..3).all(|channel| pixel[channel].abs_diff(known[channel]) < 40);
        let share = picture.chunks_exact(4).filter(is_like).count() * 100 / (SIZE.x * SIZE.y) as usize;
        println!("{what}: {share} % of {known:?}");
        let expected = if color == Some(known) { 80..=100 } else { 0..=1 };
        assert!(
            expected.contains(&share),
            "{what}: {share} % of {known:?}, not {color:?}"
        );
    }
}

#[test]
fn rays_see_materials_and_hit_stand_ins() {
    for tracer in BOTH {
        let Some(mut app) = stage(tracer) else { continue };
        materials_of_known_types_are_seen(&mut app);
        rays_hit_stand_ins(&mut app);
        lightmaps_come_change_and_go(&mut app);
    }
}

fn materials_of_known_types_are_seen(app: &mut HeadlessApp) {
    assert_shows(app, "nothing", None);
    let mesh: Handle<Mesh> = add(app, wall().into());
    let water = add(app, water(RED));
    let object = (Mesh3d(mesh), MeshMaterial3d(water.clone()), behind(8.0));
    let object = app.world().spawn(object).id();
    assert_shows(app, "water", Some(RED));
    let mut waters = app.world().resource_mut::<Assets<Water>>();
    waters.get_mut(&water).unwrap().base = unlit(BLUE);
    assert_shows(app, "water whose base changed", Some(BLUE));
    // In one frame, the new material's system can run before the old one's.
    let lava = add(app, Lava::default());
    let mut entity = app.world().entity_mut(object);
    entity
        .remove::<MeshMaterial3d<Water>>()
        .insert(MeshMaterial3d(lava.clone()));
    assert_shows(app, "lava", Some(GREEN));
    let mut entity = app.world().entity_mut(object);
    entity
        .remove::<MeshMaterial3d<Lava>>()
        .insert(MeshMaterial3d(water.clone()));
    assert_shows(app, "water again", Some(BLUE));
    let red = add(app, unlit(RED));
    app.world().entity_mut(object).insert(ReflectedMaterial3d(red));
    assert_shows(app, "a stand-in", Some(RED));
    app.world().entity_mut(object).remove::<ReflectedMaterial3d>();
    assert_shows(app, "without the stand-in", Some(BLUE));
    app.world().entity_mut(object).remove::<MeshMaterial3d<Water>>();
    assert_shows(app, "without a material", None);
    app.world().despawn(object);
}

fn rays_hit_stand_ins(app: &mut HeadlessApp) {
    let wall: Handle<Mesh> = add(app, wall().into());
    let dot: Handle<Mesh> = add(app, Rectangle::new(0.01, 0.01).into());
    let green = add(app, unlit(GREEN));
    let object = (Mesh3d(dot.clone()), MeshMaterial3d(green), behind(8.0));
    let object = app.world().spawn(object).id();
    assert_shows(app, "its own mesh", None);
    app.world().entity_mut(object).insert(ReflectedMesh3d(wall.clone()));
    assert_shows(app, "a stand-in", Some(GREEN));
    app.world().entity_mut(object).remove::<ReflectedMesh3d>();
    assert_shows(app, "its own mesh again", None);
    app.world().entity_mut(object).insert(ReflectedMesh3d(wall.clone()));
    app.world().entity_mut(object).remove::<Mesh3d>();
    assert_shows(app, "nothing else", Some(GREEN));
    let mut entity = app.world().entity_mut(object);
    entity.remove::<ReflectedMesh3d>().insert(Mesh3d(dot));
    assert_shows(app, "without the stand-in", None);
    app.world().entity_mut(object).insert(Mesh3d(wall.clone()));
    assert_shows(app, "another mesh", Some(GREEN));
    let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
    meshes.get_mut(&wall).unwrap().enable_raytracing = false;
    assert_shows(app, "a mesh that keeps rays out", None);
    let mut meshes = app.world().resource_mut::<Assets<Mesh>>();
    meshes.get_mut(&wall).unwrap().enable_raytracing = true;
    assert_shows(app, "a mesh that lets them in again", Some(GREEN));
    app.world().despawn(object);
}

/// Mean red, green and blue of the mirror.
fn mean_light(app: &mut HeadlessApp) -> [f32; 3] {
    warm_up(app);
    app.step(4);
    let picture = app.capture().unwrap();
    let mut sums = [0.0; 3];
    for pixel in picture.chunks_exact(4) {
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += f32::from(*value);
        }
    }
    sums.map(|sum| sum / (SIZE.x * SIZE.y) as f32)
}

fn lightmaps_come_change_and_go(app: &mut HeadlessApp) {
    let mesh = Mesh::from(wall());
    let uvs = mesh.attribute(Mesh::ATTRIBUTE_UV_0).unwrap().clone();
    let material = StandardMaterial {
        base_color: Color::linear_rgb(0.2, 0.2, 0.2),
        lightmap_exposure: 2000.0,
        ..default()
    };
    let mesh = mesh.with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, uvs);
    let object = spawn_mesh(app, mesh, material, behind(8.0));
    let dark = mean_light(app);
    // The image arrives after the component that refers to it.
    let image = app.world().resource::<Assets<Image>>().reserve_handle();
    let lightmap = Lightmap {
        image: image.clone(),
        ..default()
    };
    app.world().entity_mut(object).insert(lightmap);
    assert_eq!(mean_light(app), dark, "before the image is loaded");
    for (color, channel) in [(RED, 0), (BLUE, 2)] {
        let mut images = app.world().resource_mut::<Assets<Image>>();
        images.insert(&image, texel(color)).unwrap();
        let lit = mean_light(app);
        for other in 0..3 {
            let gain = lit[other] - dark[other];
            let expected = if other == channel { 30.0..255.0 } else { -1.0..1.0 };
            assert!(expected.contains(&gain), "{color:?}: {lit:?} instead of {dark:?}");
        }
    }
    app.world().entity_mut(object).remove::<Lightmap>();
    assert_eq!(mean_light(app), dark, "without a lightmap");
    app.world().despawn(object);
}

#[test]
fn unseen_objects_are_counted_and_told_once() {
    let Some(mut app) = stage(ReflectionTracerChoice::Bvh) else {
        return;
    };
    capture_log();
    take_log();
    let mesh: Handle<Mesh> = add(&mut app, wall().into());
    let mud = add(&mut app, Mud::default());
    let object = (Mesh3d(mesh), MeshMaterial3d(mud), behind(8.0));
    let objects: Vec<Entity> = (0..3).map(|_| app.world().spawn(object.clone()).id()).collect();
    app.step(40);
    assert_eq!(report(&mut app).unseen, [("Mud".to_owned(), 3)]);
    let told = |log: Vec<glint_scenes::LogMessage>| {
        let about = log.into_iter().filter(|message| message.text.contains("`Mud`"));
        about.map(|message| message.text).collect::<Vec<_>>()
    };
    let messages = told(take_log());
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert!(
        messages[0].contains("`Mud` are missing from ray-traced reflections (so far 3)"),
        "{messages:?}"
    );
    let red = add(&mut app, unlit(RED));
    app.world().entity_mut(objects[0]).insert(ReflectedMaterial3d(red));
    app.world().entity_mut(objects[1]).insert(bevy_glint::NotReflected);
    app.step(40);
    assert_eq!(report(&mut app).unseen, [("Mud".to_owned(), 1)]);
    app.world().despawn(objects[2]);
    app.step(2);
    assert_eq!(report(&mut app).unseen, []);
    assert!(told(take_log()).is_empty(), "it is told once");
}
