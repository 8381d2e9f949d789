//! Shows the scene in a window. The title explains the keys.

use crate::{
    arguments::Arguments,
    gltf,
    method::Method,
    plugins,
    record::{self, Recorder},
    source::Source,
};
use bevy::{
    asset::UnapprovedPathMode,
    camera::Hdr,
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass},
        tonemapping::DebandDither,
    },
    prelude::*,
};
use bevy_egui::EguiGlobalSettings;
use bevy_glint::{ReflectionBackend, ReflectionDebugView};
use std::env;

/// Metres per second.
const FLY_SPEED: f32 = 3.0;
const METHOD_KEYS: [KeyCode; 4] = [KeyCode::Digit1, KeyCode::Digit2, KeyCode::Digit3, KeyCode::Digit4];

/// The methods that keys choose from, and the present one.
#[derive(Resource)]
struct Viewer {
    title: String,
    backend: ReflectionBackend,
    methods: [Method; 4],
    method: Method,
}

/// Opens the window and returns once it is closed.
pub fn open(arguments: &Arguments) -> Result<(), String> {
    let source = arguments.source()?;
    let method = arguments.method()?;
    let is_x11_or_wayland = cfg!(all(unix, not(target_os = "macos")));
    if is_x11_or_wayland && env::var_os("DISPLAY").is_none() && env::var_os("WAYLAND_DISPLAY").is_none() {
        return Err("there is no display to open a window on; pass --headless --out FILE.png for an image".to_owned());
    }
    let size = arguments.size();
    let mut app = App::new();
    plugins::add_before_bevy(&mut app, arguments.backend);
    app.add_plugins((
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: Some(Window {
                    resolution: (size.x, size.y).into(),
                    ..default()
                }),
                ..default()
            })
            .set(AssetPlugin {
                // Files can be anywhere.
                unapproved_path_mode: UnapprovedPathMode::Allow,
                ..default()
            }),
        FreeCameraPlugin,
    ))
    // Input over the panel isn't meant for the camera.
    .insert_resource(EguiGlobalSettings {
        enable_absorb_bevy_input_system: true,
        ..default()
    })
    .insert_resource(viewer(&source, method, arguments))
    .insert_resource(Recorder::new(arguments.record.clone(), &source))
    .add_systems(Update, (press_keys, write_title, gltf::exit_on_failure))
    .add_systems(Last, record::record);
    plugins::add_after_bevy(&mut app, arguments);
    let title = source.title();
    let (path, view) = (arguments.path, arguments.view);
    app.add_systems(Startup, move |world: &mut World| spawn(&source, path, view, world));
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(_) => Err(format!("'{title}' could not be shown")),
    }
}

fn viewer(source: &Source, method: Method, arguments: &Arguments) -> Viewer {
    Viewer {
        title: source.title(),
        backend: arguments.backend,
        methods: [Method::Off, Method::ScreenSpace, method.clone(), Method::ground_truth()],
        method,
    }
}

/// Spawns the scene and a camera that flies. It renders deferred, with or without reflections.
fn spawn(source: &Source, path: f32, view: ReflectionDebugView, world: &mut World) {
    source.spawn(world);
    let fly = FreeCamera {
        walk_speed: FLY_SPEED,
        run_speed: 4.0 * FLY_SPEED,
        ..default()
    };
    let deferred = (Hdr, Msaa::Off, DepthPrepass, DeferredPrepass);
    let camera = world
        .spawn((Camera3d::default(), deferred, DebandDither::Enabled, fly, view))
        .id();
    source.set_up_camera(camera, path, world);
    let viewer = world.resource::<Viewer>();
    let (method, backend) = (viewer.method.clone(), viewer.backend);
    method.apply(&mut world.entity_mut(camera), backend);
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    camera: Single<(Entity, &mut ReflectionDebugView), With<FreeCamera>>,
    mut viewer: ResMut<Viewer>,
    mut commands: Commands,
) {
    let (camera, mut view) = camera.into_inner();
    for (index, key) in METHOD_KEYS.into_iter().enumerate() {
        if keyboard.just_pressed(key) && viewer.method != viewer.methods[index] {
            let (method, backend) = (viewer.methods[index].clone(), viewer.backend);
            viewer.method = method.clone();
            commands
                .entity(camera)
                .queue(move |mut camera: EntityWorldMut| method.apply(&mut camera, backend));
        }
    }
    if keyboard.just_pressed(KeyCode::KeyV) {
        let next = ReflectionDebugView::ALL
            .iter()
            .position(|known| *known == *view)
            .unwrap_or_default()
            + 1;
        *view = ReflectionDebugView::ALL[next % ReflectionDebugView::ALL.len()];
    }
}

fn write_title(
    viewer: Res<Viewer>,
    recorder: Res<Recorder>,
    view: Single<Ref<ReflectionDebugView>>,
    mut window: Single<&mut Window>,
) {
    if !viewer.is_changed() && !view.is_changed() && !recorder.is_changed() {
        return;
    }
    let [off, screen_space, traced, truth] = &viewer.methods;
    window.title = format!(
        "{}bevy_glint: {}: {}, view {} | 1: {off}, 2: {screen_space}, 3: {traced}, 4: {truth}, V: next view, F9: record a path, \
         W A S D Q E and the right mouse button: fly",
        if recorder.is_recording() {
            "RECORDING (F9: end) | "
        } else {
            ""
        },
        viewer.title,
        viewer.method,
        view.name(),
    );
}
