//! A scene with the settings panel, in a window or as a picture.
//!
//! `cargo run --release --features egui --example settings_panel`
//!
//! `cargo run --release --features egui --example settings_panel -- --headless --size 1280x720 --out settings_panel.png`
//!
//! F2 opens and closes the panel.

mod common;

use argh::FromArgs;
use bevy::{prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
use bevy_egui::EguiGlobalSettings;
use bevy_glint::{Backend, ui::ReflectionSettingsPanelPlugin};
use common::{ReflectionOptions, Size, TechniqueWord, TracerWord};
use glint_scenes::{HeadlessSettings, SceneAnimationPlugin, SceneName, SceneOptions, camera, environment, spawn_with};
use std::{path::PathBuf, process::ExitCode};

/// Show the settings panel beside a scene.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// a scene that `demo` knows
    #[argh(option, default = "SceneName::Demo")]
    scene: SceneName,
    /// how reflections begin: off, or a word that `demo` knows
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
    /// frames to render before the picture is taken
    #[argh(option, default = "32")]
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

    /// What both kinds of app have, after Bevy's plugins.
    fn add_plugins(&self, app: &mut App) {
        common::add_reflections(app, &self.reflections());
        app.add_plugins((
            SceneAnimationPlugin,
            // Measures what the panel shows.
            RenderDiagnosticsPlugin,
            ReflectionSettingsPanelPlugin {
                open: true,
                ..default()
            },
        ));
    }
}

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
    let mut app = common::headless_app(settings, &reflections, |app| arguments.add_plugins(app))?;
    // The camera that egui draws on: it takes the first one of an app, whatever that draws into.
    let camera = app.spawn_scene(arguments.scene, &SceneOptions::default());
    common::reflection_camera(&mut app.world().entity_mut(camera), &reflections);
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "settings_panel")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("bevy_glint: F2 opens and closes the panel", size, &reflections)?;
    // What the pointer and the keys do on the panel isn't meant for the camera.
    app.insert_resource(EguiGlobalSettings {
        enable_absorb_bevy_input_system: true,
        ..default()
    });
    arguments.add_plugins(&mut app);
    let scene = arguments.scene;
    app.add_systems(Startup, move |world: &mut World| {
        spawn_with(scene, world, &SceneOptions::default());
        let (transform, projection) = camera(scene);
        let environment = environment(scene, world);
        let mut camera = world.spawn((common::window_camera(3.0), transform, Projection::from(projection)));
        environment.insert(&mut camera);
        common::reflection_camera(&mut camera, &reflections);
    });
    common::run(app)
}
