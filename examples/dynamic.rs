//! Everything moves: a dozen coloured lights, things that orbit and spin, a large mirror that turns and slides, and balls that appear
//! and vanish. Nothing has to be said to the library about any of it.
//!
//! `cargo run --release --example dynamic`
//!
//! `cargo run --release --example dynamic -- --headless --frames 120 --out dynamic.png` renders 120 frames of 1/60 s: the same moment
//! each time.
//!
//! | key | does |
//! | --- | --- |
//! | Space | stops and starts the clock |
//! | R | reflections on or off |
//! | V | the next debug view |

mod common;

use argh::FromArgs;
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping, light::NotShadowCaster, prelude::*};
use bevy_glint::{Backend, DebugView, RayTracedReflections};
use common::{
    ReflectionOptions, Size, TechniqueWord, TracerWord,
    help::{self, Help, Keys},
};
use glint_scenes::{Environment, HeadlessSettings};
use std::{
    f32::consts::{PI, TAU},
    path::PathBuf,
    process::ExitCode,
};

const KEYS: Keys = &[
    ("Space", "stop or start the clock"),
    ("R", "reflections on or off"),
    ("V", "next debug view"),
];
const LIGHTS: usize = 12;
const OBJECTS: usize = 20;
/// Seconds for which a ball stays.
const STAY: f32 = 3.0;
/// Seconds between the births of two balls.
const INTERVAL: f32 = 0.3;
const BALL_RADIUS: f32 = 0.2;

/// Show a room in which everything moves.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// off, reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, paper, low, medium, high or ultra
    /// (default: medium)
    #[argh(option, default = "TechniqueWord::default()")]
    technique: TechniqueWord,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels (default: 1280x720 in a window, 640x360 for a picture)
    #[argh(option)]
    size: Option<Size>,
    /// frames of 1/60 s to render before the picture is taken
    #[argh(option, default = "60")]
    frames: u32,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
}

impl Arguments {
    fn reflections(&self) -> ReflectionOptions {
        ReflectionOptions {
            technique: self.technique.clone(),
            tracer: self.tracer,
            backend: self.backend,
        }
    }
}

/// What the key switches on again.
#[derive(Resource)]
struct Options(ReflectionOptions);

fn main() -> ExitCode {
    let arguments: Arguments = argh::from_env();
    common::report(if arguments.headless {
        picture(&arguments)
    } else {
        window(&arguments)
    })
}

fn picture(arguments: &Arguments) -> Result<(), String> {
    let settings = HeadlessSettings {
        size: common::size_or_default(arguments.size, true),
        log: true,
        ..default()
    };
    let reflections = arguments.reflections();
    let mut app = common::headless_app(settings, &reflections, |app| {
        add_motion(app);
        common::add_reflections(app, &reflections);
    })?;
    set_up_room(app.world());
    let camera = app.spawn_camera(DebugView::Off);
    set_up_camera(&mut app.world().entity_mut(camera), &reflections);
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "dynamic")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("dynamic", size, &reflections)?;
    add_motion(&mut app);
    common::add_reflections(&mut app, &reflections);
    help::add(&mut app, "dynamic", KEYS);
    app.insert_resource(Options(reflections.clone()))
        .add_systems(Update, press_keys)
        .add_systems(Startup, move |world: &mut World| {
            set_up_room(world);
            let mut camera = world.spawn((common::window_camera(3.0), DebugView::Off));
            set_up_camera(&mut camera, &reflections);
        });
    common::run(app)
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    camera: Single<(Entity, &mut DebugView, Has<RayTracedReflections>)>,
    options: Res<Options>,
    mut time: ResMut<Time<Virtual>>,
    mut help: ResMut<Help>,
    mut commands: Commands,
) {
    let (camera, mut view, is_on) = camera.into_inner();
    if keyboard.just_pressed(KeyCode::Space) {
        time.toggle();
    }
    if keyboard.just_pressed(KeyCode::KeyV) {
        let next = (*view as usize + 1) % DebugView::ALL.len();
        *view = DebugView::ALL[next];
    }
    if keyboard.just_pressed(KeyCode::KeyR) {
        if is_on {
            commands.entity(camera).remove::<RayTracedReflections>();
        } else {
            let options = options.0.clone();
            commands
                .entity(camera)
                .queue(move |mut camera: EntityWorldMut| common::reflection_camera(&mut camera, &options));
        }
    }
    let clock = if time.is_paused() { "stopped" } else { "running" };
    let reflections = if is_on { "on" } else { "off" };
    help::say(
        &mut help,
        format!("reflections {reflections}, view {}, clock {clock}", view.name()),
    );
}

/// The camera sees nothing but the room: what isn't lit by its lights is black.
fn set_up_camera(camera: &mut EntityWorldMut, reflections: &ReflectionOptions) {
    let environment = Environment {
        light: None,
        skybox: None,
        exposure: Exposure { ev100: 9.3 },
        tonemapping: Tonemapping::TonyMcMapface,
    };
    camera.insert((
        Transform::from_xyz(0.0, 2.3, 5.6).looking_at(Vec3::new(0.0, 1.2, 0.0), Vec3::Y),
        Projection::from(PerspectiveProjection {
            fov: 52f32.to_radians(),
            ..default()
        }),
    ));
    environment.insert(camera);
    common::reflection_camera(camera, reflections);
}

/// A mesh as an asset.
fn mesh(world: &mut World, shape: impl Into<Mesh>) -> Handle<Mesh> {
    world.resource_mut::<Assets<Mesh>>().add(shape)
}

/// A material as an asset.
fn material(world: &mut World, color: Color, metallic: f32, perceptual_roughness: f32) -> Handle<StandardMaterial> {
    world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
        base_color: color,
        metallic,
        perceptual_roughness,
        ..default()
    })
}

fn set_up_room(world: &mut World) {
    let floor = material(world, Color::srgb(0.08, 0.08, 0.1), 0.0, 0.12);
    let plaster = material(world, Color::srgb(0.62, 0.6, 0.56), 0.0, 0.85);
    let slab = mesh(world, Cuboid::from_length(1.0));
    let sides = [
        (&floor, Vec3::new(0.0, -0.1, 0.0), Vec3::new(12.2, 0.2, 12.2)),
        (&plaster, Vec3::new(0.0, 5.1, 0.0), Vec3::new(12.2, 0.2, 12.2)),
        (&plaster, Vec3::new(-6.1, 2.5, 0.0), Vec3::new(0.2, 5.0, 12.2)),
        (&plaster, Vec3::new(6.1, 2.5, 0.0), Vec3::new(0.2, 5.0, 12.2)),
        (&plaster, Vec3::new(0.0, 2.5, -6.1), Vec3::new(12.0, 5.0, 0.2)),
        (&plaster, Vec3::new(0.0, 2.5, 6.1), Vec3::new(12.0, 5.0, 0.2)),
    ];
    for (material, center, extent) in sides {
        world.spawn((
            Mesh3d(slab.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_translation(center).with_scale(extent),
        ));
    }
    set_up_mirror(world);
    set_up_lights(world);
    set_up_objects(world);
    set_up_balls(world);
}

fn set_up_mirror(world: &mut World) {
    let silver = material(world, Color::srgb(0.95, 0.95, 0.96), 1.0, 0.0);
    let wood = material(world, Color::srgb(0.24, 0.13, 0.07), 0.0, 0.5);
    let glass = mesh(world, Cuboid::new(3.4, 2.5, 0.04));
    let frame = mesh(world, Cuboid::new(3.6, 2.7, 0.04));
    world.spawn((
        Mirror,
        Mesh3d(glass),
        MeshMaterial3d(silver),
        Transform::default(),
        children![(
            Mesh3d(frame),
            MeshMaterial3d(wood),
            Transform::from_xyz(0.0, 0.0, -0.03)
        )],
    ));
}

/// Every third light is a spot that follows the middle of the room and casts shadows; each has a glowing bulb.
fn set_up_lights(world: &mut World) {
    let bulb = mesh(world, Sphere::new(0.07).mesh().uv(24, 12));
    for i in 0..LIGHTS {
        let part = i as f32 / LIGHTS as f32;
        let color = Color::hsl(360.0 * part, 0.85, 0.6);
        let glow = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
            base_color: Color::BLACK,
            emissive: color.to_linear() * 6.0,
            reflectance: 0.0,
            perceptual_roughness: 1.0,
            ..default()
        });
        let orbit = Orbit {
            center: Vec3::new(0.0, if i % 3 == 0 { 3.9 } else { 1.3 + 1.6 * part }, -0.4),
            extent: Vec3::new(2.2 + 2.4 * part, 0.5, 1.4 + 0.6 * part),
            rate: if i % 2 == 0 { 0.07 } else { -0.09 },
            phase: part,
        };
        // A bulb that casts shadows would keep all light inside.
        let bulb = (Mesh3d(bulb.clone()), MeshMaterial3d(glow), NotShadowCaster);
        let mut light = world.spawn((orbit, Transform::default(), Visibility::default(), children![bulb]));
        if i % 3 == 0 {
            let spot = SpotLight {
                color,
                intensity: 220_000.0,
                range: 14.0,
                inner_angle: 0.25,
                outer_angle: 0.5,
                shadow_maps_enabled: true,
                ..default()
            };
            light.insert((spot, LookAt(Vec3::new(0.0, 0.4, -0.6))));
        } else {
            light.insert(PointLight {
                color,
                intensity: 38_000.0,
                range: 9.0,
                radius: 0.07,
                ..default()
            });
        }
    }
}

/// Mirrors, gloss and rough things of four shapes on two rings.
fn set_up_objects(world: &mut World) {
    let shapes = [
        mesh(world, Cuboid::from_length(0.5)),
        mesh(world, Sphere::new(0.32).mesh().uv(48, 24)),
        mesh(world, Torus::new(0.18, 0.36)),
        mesh(world, Cylinder::new(0.22, 0.6)),
    ];
    for i in 0..OBJECTS {
        let part = i as f32 / OBJECTS as f32;
        let metallic = if i % 3 == 0 { 1.0 } else { 0.0 };
        let color = Color::hsl(360.0 * (part * 3.0).fract(), 0.7, 0.5);
        let material = material(world, color, metallic, 0.6 * (part * 7.0).fract());
        let ring = if i % 2 == 0 { 2.1 } else { 3.7 };
        world.spawn((
            Mesh3d(shapes[i % shapes.len()].clone()),
            MeshMaterial3d(material),
            Transform::default(),
            Orbit {
                center: Vec3::new(0.0, 0.75 + 0.5 * (part * 5.0).fract(), 0.2),
                extent: Vec3::new(ring, 0.2, 0.6 * ring),
                rate: if i % 2 == 0 { 0.04 } else { -0.03 },
                phase: part,
            },
            Spin(Vec3::new(0.6, 1.1, 0.3) * (0.5 + part)),
        ));
    }
}

fn set_up_balls(world: &mut World) {
    let look = BallLook {
        mesh: mesh(world, Sphere::new(BALL_RADIUS).mesh().uv(48, 24)),
        materials: [
            material(world, Color::srgb(0.95, 0.95, 0.96), 1.0, 0.02),
            material(world, Color::srgb(0.9, 0.3, 0.08), 0.0, 0.25),
            material(world, Color::srgb(0.96, 0.76, 0.35), 1.0, 0.35),
        ],
    };
    world.insert_resource(look);
}

/// All that moves is a function of the time alone, whatever the number of frames.
fn add_motion(app: &mut App) {
    app.add_systems(
        Update,
        (
            (orbit, spin, look_at).chain(),
            move_mirror,
            (spawn_balls, bounce_balls).chain(),
        ),
    );
}

/// Runs along an ellipse in the horizontal plane while bobbing up and down.
#[derive(Component)]
struct Orbit {
    center: Vec3,
    /// Half axes (x, z) and height of the bob (y), in metres.
    extent: Vec3,
    /// Turns per second.
    rate: f32,
    /// Where it starts, in turns.
    phase: f32,
}

fn orbit(time: Res<Time>, mut moving: Query<(&Orbit, &mut Transform)>) {
    for (orbit, mut transform) in &mut moving {
        let angle = TAU * (time.elapsed_secs() * orbit.rate + orbit.phase).fract();
        let place = Vec3::new(ops::cos(angle), ops::sin(2.0 * angle), ops::sin(angle));
        transform.translation = orbit.center + orbit.extent * place;
    }
}

/// Turns: radians per second about each axis.
#[derive(Component)]
struct Spin(Vec3);

fn spin(time: Res<Time>, mut spinning: Query<(&Spin, &mut Transform)>) {
    for (Spin(rate), mut transform) in &mut spinning {
        transform.rotation = Quat::from_scaled_axis(*rate * time.elapsed_secs());
    }
}

/// Points at a place.
#[derive(Component)]
struct LookAt(Vec3);

fn look_at(mut looking: Query<(&LookAt, &mut Transform)>) {
    for (LookAt(target), mut transform) in &mut looking {
        transform.look_at(*target, Vec3::Y);
    }
}

#[derive(Component)]
struct Mirror;

fn move_mirror(time: Res<Time>, mut mirror: Single<&mut Transform, With<Mirror>>) {
    let seconds = time.elapsed_secs();
    mirror.translation = Vec3::new(1.4 * ops::sin(0.5 * seconds), 1.55, -3.2);
    mirror.rotation = Quat::from_rotation_y(0.5 * ops::sin(0.8 * seconds + 0.4));
}

/// What balls are made of.
#[derive(Resource)]
struct BallLook {
    mesh: Handle<Mesh>,
    materials: [Handle<StandardMaterial>; 3],
}

/// Jumps up and down for a while.
#[derive(Component)]
struct Ball {
    /// When it appeared, in seconds.
    born: f32,
    place: Vec3,
}

fn spawn_balls(time: Res<Time>, look: Res<BallLook>, mut next: Local<u32>, mut commands: Commands) {
    loop {
        // At the start there are some of every age.
        let born = *next as f32 * INTERVAL - STAY;
        if born > time.elapsed_secs() {
            return;
        }
        // Spread evenly: each a golden angle after the one before.
        let angle = 2.4 * *next as f32;
        let radius = 0.8 + 2.2 * (0.618 * *next as f32).fract();
        let material = &look.materials[*next as usize % look.materials.len()];
        commands.spawn((
            Mesh3d(look.mesh.clone()),
            MeshMaterial3d(material.clone()),
            Transform::default(),
            Ball {
                born,
                place: Vec3::new(radius * ops::cos(angle), BALL_RADIUS, 0.6 + radius * ops::sin(angle)),
            },
        ));
        *next += 1;
    }
}

fn bounce_balls(time: Res<Time>, mut balls: Query<(Entity, &Ball, &mut Transform)>, mut commands: Commands) {
    for (entity, ball, mut transform) in &mut balls {
        let age = time.elapsed_secs() - ball.born;
        if age > STAY {
            commands.entity(entity).despawn();
        } else {
            transform.translation = ball.place + Vec3::Y * (1.2 * ops::sin(PI * age / 0.75).abs());
        }
    }
}
