//! The options menu of a game, with a row for reflections between its other rows.
//!
//! `cargo run --release --features egui --example quality_menu`
//!
//! [`ReflectionQuality`] is the player's choice: one word that is saved with the game's other settings and inserted on its cameras. At the
//! first start and with the button Auto, the game measures the machine. If no rays can be traced, the row is disabled and shows the reason.

use bevy::{prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
use bevy_egui::{EguiContexts, EguiPlugin, EguiPrimaryContextPass, egui};
use bevy_glint::{
    prelude::*,
    ui::{auto_quality_menu, why_no_reflections},
};
use std::{env, fs, io::ErrorKind, path::PathBuf};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the game adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins((RayTracedReflectionsPlugin::default(), EguiPlugin::default()))
        .add_plugins(RenderDiagnosticsPlugin)
        .insert_resource(GameSettings {
            volume: 0.8,
            reflections: None,
        })
        .insert_resource(SettingsFile(env::temp_dir().join("bevy_glint_quality_menu.txt")))
        .insert_resource(MenuIsOpen(true))
        .add_observer(take_over_quality)
        .add_systems(Startup, (load_settings, setup, show_keys))
        .add_systems(Update, (toggle_menu, save_settings))
        .add_systems(Update, apply_settings.run_if(resource_changed::<GameSettings>))
        .add_systems(EguiPrimaryContextPass, show_menu.run_if(|menu: Res<MenuIsOpen>| menu.0));
}

/// All settings that players of this game choose.
#[derive(Resource, Clone, PartialEq)]
pub struct GameSettings {
    /// 0 to 1.
    pub volume: f32,
    /// Quality of the reflections of all cameras; `None` until one is found that suits the machine.
    pub reflections: Option<ReflectionQuality>,
}

/// The file of the settings, a line for each: `reflections = high`. A game has its own folder for it.
#[derive(Resource)]
pub struct SettingsFile(pub PathBuf);

#[derive(Resource)]
struct MenuIsOpen(bool);

fn load_settings(file: Res<SettingsFile>, mut settings: ResMut<GameSettings>, mut commands: Commands) {
    let text = match fs::read_to_string(&file.0) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return,
        Err(error) => {
            error!("{} can't be read: {error}", file.0.display());
            // The file might still contain settings: never overwrite them.
            return commands.remove_resource::<SettingsFile>();
        }
    };
    for line in text.lines() {
        let is_known = match line.split_once(" = ") {
            Some(("volume", word)) => word.parse().map(|volume| settings.volume = volume).is_ok(),
            Some(("reflections", word)) => word.parse().map(|quality| settings.reflections = Some(quality)).is_ok(),
            _ => false,
        };
        if !is_known {
            warn!("the line `{line}` of {} is ignored", file.0.display());
        }
    }
}

fn show_menu(
    mut contexts: EguiContexts,
    mut settings: ResMut<GameSettings>,
    status: Res<ReflectionStatus>,
    efforts: Query<&ReflectionEffort, With<ReflectionBudget>>,
) -> Result {
    let mut shown = settings.clone();
    egui::Window::new("Options")
        .anchor(egui::Align2::CENTER_TOP, [0.0, 24.0])
        .show(contexts.ctx_mut()?, |ui| {
            egui::Grid::new("options").num_columns(2).show(ui, |ui| {
                ui.label("Volume");
                ui.add(egui::Slider::new(&mut shown.volume, 0.0..=1.0));
                ui.end_row();
                ui.label("Reflections");
                let reason = why_no_reflections(&status.report());
                ui.add_enabled_ui(reason.is_none(), |ui| auto_quality_menu(ui, &mut shown.reflections))
                    .response
                    .on_disabled_hover_text(reason.unwrap_or_default());
                ui.end_row();
                for effort in &efforts {
                    ui.label("Rays left by the budget");
                    ui.label(format!("{:.0} %", 100.0 * effort.0));
                    ui.end_row();
                }
            });
        });
    // Only a real change triggers change detection.
    settings.set_if_neq(shown);
    Ok(())
}

/// Gives every camera its reflections: at the start, and after each choice of the player.
fn apply_settings(settings: Res<GameSettings>, cameras: Query<Entity, With<Camera3d>>, mut commands: Commands) {
    for camera in &cameras {
        let mut camera = commands.entity(camera);
        match settings.reflections {
            Some(quality) => camera.remove::<ReflectionAutoQuality>().insert(quality),
            None => camera.insert(ReflectionAutoQuality::default()),
        };
    }
}

/// Keeps the quality that suits the machine, as if the player had chosen it.
fn take_over_quality(chosen: On<ReflectionQualityChosen>, mut settings: ResMut<GameSettings>) {
    settings.reflections = Some(chosen.quality);
}

/// Writes the file once the mouse button is released, since a slider changes settings in every frame.
fn save_settings(
    settings: Res<GameSettings>,
    file: Option<Res<SettingsFile>>,
    buttons: Res<ButtonInput<MouseButton>>,
    mut unsaved: Local<bool>,
) {
    *unsaved |= settings.is_changed() && !settings.is_added();
    let Some(file) = file else { return };
    if !*unsaved || buttons.pressed(MouseButton::Left) {
        return;
    }
    *unsaved = false;
    // Without the second line, the next start measures again.
    let reflections = settings.reflections.map(|quality| format!("reflections = {quality}\n"));
    let text = format!("volume = {}\n{}", settings.volume, reflections.unwrap_or_default());
    if let Err(error) = fs::write(&file.0, text) {
        error!("{} can't be written: {error}", file.0.display());
    }
}

fn toggle_menu(keyboard: Res<ButtonInput<KeyCode>>, mut menu: ResMut<MenuIsOpen>) {
    menu.0 ^= keyboard.just_pressed(KeyCode::Escape);
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Escape: open or close the menu".to_owned();
}

/// A hall of coloured columns with a golden ring over a polished floor.
fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    let mut material = |base_color, metallic, perceptual_roughness| {
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color,
            metallic,
            perceptual_roughness,
            ..default()
        }))
    };
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(30.0, 30.0))),
        material(Color::srgb(0.1, 0.08, 0.07), 0.0, 0.05),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Torus::new(0.5, 1.0).mesh().major_resolution(96).minor_resolution(32))),
        material(Color::srgb(1.0, 0.78, 0.34), 1.0, 0.1),
        Transform::from_xyz(0.0, 1.1, 0.5).with_rotation(Quat::from_euler(EulerRot::YXZ, 0.5, 1.2, 0.0)),
    ));
    let column = meshes.add(Cylinder::new(0.35, 4.0));
    for index in 0..12 {
        let (side, row) = ((index % 2 * 2 - 1) as f32, (index / 2) as f32);
        commands.spawn((
            Mesh3d(column.clone()),
            material(Color::hsl(30.0 * index as f32, 0.6, 0.5), 0.0, 0.5),
            Transform::from_xyz(2.4 * side, 2.0, 5.0 - 2.2 * row),
        ));
    }
    commands.spawn((
        DirectionalLight {
            illuminance: 6_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.5, -1.0, -0.8), Vec3::Y),
    ));
    let zenith = Color::srgb(0.4, 0.5, 0.8);
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, zenith, Color::WHITE, Color::BLACK);
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.6, 1.7, 6.0).looking_at(Vec3::new(0.0, 1.0, 0.0), Vec3::Y),
        sky.with_intensity(600.0),
    ));
}
