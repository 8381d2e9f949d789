//! Apps as they ship: rendering on its own thread, and pipelines compiled in the background.

use bevy::{
    app::{PluginsState, TerminalCtrlCHandlerPlugin},
    camera::RenderTarget,
    core_pipeline::tonemapping::Tonemapping,
    log::LogPlugin,
    prelude::*,
    render::{
        render_resource::TextureFormat,
        view::screenshot::{Screenshot, ScreenshotCaptured},
    },
    tasks::tick_global_task_pools_on_main_thread,
    window::ExitCondition,
    winit::WinitPlugin,
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionStatusReport, ReflectionTracerChoice,
};
use std::{
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

const FRAMES: u32 = 20_000;

/// An app of an ordinary user, except for the window.
fn app(tracer: ReflectionTracerChoice) -> App {
    let mut app = App::new();
    app.add_plugins((
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .disable::<WinitPlugin>()
            .disable::<LogPlugin>()
            .disable::<TerminalCtrlCHandlerPlugin>(),
        RayTracedReflectionsPlugin { tracer, ..default() },
    ));
    while app.plugins_state() == PluginsState::Adding {
        tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app
}

fn report(app: &App) -> ReflectionStatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

fn spawn(app: &mut App, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    let world = app.world_mut();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// A camera before a mirror, which renders into an image.
fn spawn_camera(app: &mut App) -> Handle<Image> {
    let mirror = StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    };
    spawn(app, Rectangle::new(12.0, 12.0), mirror, Transform::IDENTITY);
    let image = Image::new_target_texture(96, 64, TextureFormat::Rgba8UnormSrgb, None);
    let image = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    app.world_mut().spawn((
        Camera3d::default(),
        RenderTarget::from(image.clone()),
        RayTracedReflections::default(),
        Tonemapping::None,
        Msaa::Off,
        Transform::from_xyz(0.0, 0.0, 3.0),
    ));
    image
}

/// Requests an image, which arrives some frames later.
fn ask(app: &mut App, image: &Handle<Image>) -> Receiver<Image> {
    let (sender, receiver) = channel();
    app.world_mut()
        .spawn(Screenshot::image(image.clone()))
        .observe(move |captured: On<ScreenshotCaptured>| _ = sender.send(captured.image.clone()));
    receiver
}

#[test]
fn an_app_as_it_ships_reflects_what_moves() {
    let mut app = app(ReflectionTracerChoice::Bvh);
    if report(&app).tracer.is_none() {
        assert!(std::env::var_os("GLINT_REQUIRE_GPU").is_none(), "a GPU is required");
        println!("skipped: {}", report(&app));
        return;
    }
    let image = spawn_camera(&mut app);
    let red = StandardMaterial {
        base_color: Color::srgb(1.0, 0.0, 0.0),
        unlit: true,
        ..default()
    };
    let at = Transform::from_xyz(-2.0, 0.0, 6.0);
    let cube = spawn(&mut app, Cuboid::from_length(2.0), red.clone(), at);
    let mut picture = None;
    for frame in 0..FRAMES {
        // Objects move, come and go while pipelines are compiled and meshes are built.
        let wave = 0.3 * (frame as f32 * 0.2).sin();
        app.world_mut().get_mut::<Transform>(cube).unwrap().translation.y = wave;
        if frame % 16 == 0 {
            let passing = spawn(
                &mut app,
                Sphere::new(0.2),
                red.clone(),
                at.with_translation(Vec3::new(2.0, 0.0, 6.0)),
            );
            app.update();
            app.world_mut().despawn(passing);
        }
        app.update();
        if picture.is_none() && report(&app).ready && report(&app).instances >= 2 {
            picture = Some((frame, ask(&mut app, &image)));
        }
        let asked = picture.as_ref().filter(|(asked, _)| frame > asked + 2);
        let arrived = asked.and_then(|(_, picture)| picture.try_recv().ok());
        if let Some(shown) = arrived {
            let red = |pixel: &&[u8]| pixel[0] > 200 && pixel[1] < 60 && pixel[2] < 60;
            let count = shown
                .data
                .iter()
                .flat_map(|data| data.chunks_exact(4))
                .filter(red)
                .count();
            println!("{count} red pixels after {frame} frames");
            if count > 60 {
                return;
            }
            // The cube can arrive after the objects that pass.
            picture = None;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("no picture of the cube after {FRAMES} frames: {}", report(&app));
}
