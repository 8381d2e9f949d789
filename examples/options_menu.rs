//! The options menu of a game: one row for reflections, saved with the game's other settings.
//!
//! `cargo run --release --features egui --example options_menu`
//!
//! Escape opens and closes the menu. The settings are lines of text, which `--file` places:
//!
//! ```text
//! volume = 0.8
//! reflections = high
//! ```

mod common;

use argh::FromArgs;
use bevy::prelude::*;
use bevy_egui::{EguiContexts, EguiPlugin, EguiPrimaryContextPass, egui};
use bevy_glint::{
    Backend, ReflectionStatus,
    ui::{Quality, quality_menu, why_no_reflections},
};
use common::{ReflectionOptions, Size, TechniqueWord, TracerWord};
use glint_scenes::{HeadlessSettings, SceneAnimationPlugin, SceneName, SceneOptions, camera, environment, spawn_with};
use std::{
    fmt, fs,
    io::ErrorKind,
    path::{Path, PathBuf},
    process::ExitCode,
    str::FromStr,
};

const SCENE: SceneName = SceneName::Demo;

/// Show the options menu of a game.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// off, low, medium, high or ultra, in place of what the file says
    #[argh(option)]
    quality: Option<Quality>,
    /// where settings are read from and written to (default: a file in the system's folder for temporary ones; none for a picture)
    #[argh(option)]
    file: Option<PathBuf>,
    /// width and height in pixels (default: 1280x720 in a window, 640x360 for a picture)
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken
    #[argh(option, default = "16")]
    frames: u32,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
}

/// What this game lets its players choose.
#[derive(Resource, Clone, Debug, PartialEq)]
struct GameSettings {
    volume: f32,
    reflections: Quality,
}

impl Default for GameSettings {
    fn default() -> Self {
        Self {
            volume: 0.8,
            reflections: Quality::default(),
        }
    }
}

impl fmt::Display for GameSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "volume = {}", self.volume)?;
        writeln!(f, "reflections = {}", self.reflections)
    }
}

impl FromStr for GameSettings {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut settings = Self::default();
        for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let (key, value) = line
                .split_once('=')
                .map(|(key, value)| (key.trim(), value.trim()))
                .ok_or_else(|| format!("'{line}' is not of the form `key = value`"))?;
            let wrong = |reason: &dyn fmt::Display| format!("{key}: {reason}");
            match key {
                "volume" => settings.volume = value.parse::<f32>().map_err(|error| wrong(&error))?,
                "reflections" => settings.reflections = value.parse::<Quality>().map_err(|error| wrong(&error))?,
                // Another version of the game may know it.
                _ => warn!("the setting '{key}' is unknown"),
            }
        }
        Ok(settings)
    }
}

/// Settings of a file; the default where there is none yet.
fn load(file: &Path) -> Result<GameSettings, String> {
    match fs::read_to_string(file) {
        Ok(text) => text
            .parse::<GameSettings>()
            .map_err(|error| format!("'{}' can't be used: {error}", file.display())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(GameSettings::default()),
        Err(error) => Err(format!("'{}' can't be read: {error}", file.display())),
    }
}

/// Where settings are saved, if they are.
#[derive(Resource)]
struct SettingsFile(Option<PathBuf>);

/// The menu is open.
#[derive(Resource)]
struct MenuIsOpen(bool);

/// Adds the menu and what its settings do.
fn add_menu(app: &mut App, settings: GameSettings, file: Option<PathBuf>) {
    app.add_plugins(EguiPlugin::default())
        .insert_resource(settings)
        .insert_resource(SettingsFile(file))
        .insert_resource(MenuIsOpen(true))
        .add_systems(
            Update,
            (
                toggle_menu,
                apply_settings.run_if(resource_changed::<GameSettings>),
                save_settings,
            ),
        )
        .add_systems(EguiPrimaryContextPass, show_menu.run_if(|menu: Res<MenuIsOpen>| menu.0));
}

fn toggle_menu(keys: Res<ButtonInput<KeyCode>>, mut menu: ResMut<MenuIsOpen>) {
    if keys.just_pressed(KeyCode::Escape) {
        menu.0 = !menu.0;
    }
}

fn show_menu(mut contexts: EguiContexts, mut settings: ResMut<GameSettings>, status: Res<ReflectionStatus>) {
    let Ok(context) = contexts.ctx_mut() else { return };
    let mut shown = settings.clone();
    egui::Window::new("Options")
        .anchor(egui::Align2::CENTER_CENTER, egui::Vec2::ZERO)
        .collapsible(false)
        .resizable(false)
        .show(context, |ui| {
            egui::Grid::new("options").num_columns(2).show(ui, |ui| {
                ui.label("Volume");
                ui.add(egui::Slider::new(&mut shown.volume, 0.0..=1.0));
                ui.end_row();
                ui.label("Reflections");
                let reason = why_no_reflections(&status.report());
                ui.add_enabled_ui(reason.is_none(), |ui| quality_menu(ui, &mut shown.reflections))
                    .response
                    .on_disabled_hover_text(reason.unwrap_or_default());
                ui.end_row();
            });
        });
    settings.set_if_neq(shown);
}

/// Runs when settings have changed, and once at the start.
fn apply_settings(settings: Res<GameSettings>, cameras: Query<Entity, With<Camera3d>>, mut commands: Commands) {
    for camera in &cameras {
        settings.reflections.queue(&mut commands.entity(camera));
    }
}

/// Writes the file once the pointer lets go: dragging a slider changes settings in every frame.
fn save_settings(
    settings: Res<GameSettings>,
    file: Res<SettingsFile>,
    buttons: Res<ButtonInput<MouseButton>>,
    mut unsaved: Local<bool>,
) {
    *unsaved |= settings.is_changed() && !settings.is_added();
    if !*unsaved || buttons.pressed(MouseButton::Left) {
        return;
    }
    *unsaved = false;
    if let Some(file) = &file.0
        && let Err(reason) = fs::write(file, settings.to_string())
    {
        error!("'{}' can't be written: {reason}", file.display());
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

/// How the app starts. The menu gives cameras their reflections.
fn reflections() -> ReflectionOptions {
    ReflectionOptions {
        technique: TechniqueWord::default(),
        tracer: TracerWord::default(),
        backend: Backend::default(),
    }
}

fn settings(arguments: &Arguments, file: Option<&Path>) -> Result<GameSettings, String> {
    let mut settings = file.map(load).transpose()?.unwrap_or_default();
    settings.reflections = arguments.quality.unwrap_or(settings.reflections);
    Ok(settings)
}

fn picture(arguments: &Arguments) -> Result<(), String> {
    let game = settings(arguments, arguments.file.as_deref())?;
    let headless = HeadlessSettings {
        size: common::size_or_default(arguments.size, true),
        log: true,
        ..default()
    };
    let mut app = common::headless_app(headless, &reflections(), |app| {
        app.add_plugins(SceneAnimationPlugin);
        common::add_reflections(app, &reflections());
        add_menu(app, game, arguments.file.clone());
    })?;
    app.spawn_scene(SCENE, &SceneOptions::default());
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "options_menu")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let file = arguments
        .file
        .clone()
        .unwrap_or_else(|| std::env::temp_dir().join("bevy_glint_options.txt"));
    let game = settings(arguments, Some(&file))?;
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("bevy_glint: Escape opens and closes the menu", size, &reflections())?;
    app.add_plugins(SceneAnimationPlugin);
    common::add_reflections(&mut app, &reflections());
    add_menu(&mut app, game, Some(file));
    app.add_systems(Startup, |world: &mut World| {
        spawn_with(SCENE, world, &SceneOptions::default());
        let (transform, projection) = camera(SCENE);
        let environment = environment(SCENE, world);
        let mut camera = world.spawn((common::window_camera(3.0), transform, Projection::from(projection)));
        environment.insert(&mut camera);
    });
    common::run(app)
}
