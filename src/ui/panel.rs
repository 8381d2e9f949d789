//! The plugin, its window, and the parts of the window for custom panels.

use super::{
    camera::CameraSettings,
    gamepad::press_keys,
    settings_ui::camera_settings_ui,
    timings::{Measurements, entry, measurements_ui, mebibytes},
};
use crate::{
    device::ReflectionTracer,
    settings::{RayTracedReflections, ReflectionsOff},
    status::{ReflectionStatus, ReflectionStatusReport, ReflectionViewMemory},
};
use bevy::{
    app::{App, Plugin, PreUpdate, Update},
    asset::Assets,
    camera::Camera3d,
    diagnostic::DiagnosticsStore,
    ecs::prelude::*,
    image::Image,
    input::{
        ButtonInput, InputSystems,
        keyboard::{KeyCode, KeyboardInput},
    },
    log::debug,
    reflect::Reflect,
    shader::Shader,
};
use bevy_egui::{
    EguiContext, EguiInputSet, EguiPlugin, EguiPrimaryContextPass, PrimaryEguiContext,
    egui::{Align, ComboBox, Layout, ScrollArea, Ui, Window, vec2},
};

const TITLE: &str = "Ray-traced reflections";
const SETTINGS_WIDTH: f32 = 350.0;
const MEASUREMENTS_WIDTH: f32 = 240.0;
const WINDOW_WIDTH: f32 = SETTINGS_WIDTH + MEASUREMENTS_WIDTH + 30.0;
const WINDOW_HEIGHT: f32 = 640.0;

/// Shows a window with the settings of each camera and their cost, on the primary context of `bevy_egui`.
///
/// Add it after `DefaultPlugins`, and after [`EguiPlugin`] if the app adds that itself; otherwise this plugin adds it, which works
/// together with other users of egui. In an app without a renderer it does nothing. For times and rays, add Bevy's
/// `RenderDiagnosticsPlugin`, too.
///
/// Besides the pointer, Tab and the arrow keys choose a widget, the left and the right arrow move a slider, Enter presses a button, and Escape
/// closes a list. On a gamepad these are the directional pad, the lower and the right face button.
#[derive(Clone, Copy, Debug)]
pub struct ReflectionSettingsPanelPlugin {
    /// `true` if the window is open from the start. Default: false.
    pub open: bool,
    /// The key that opens and closes the window, if any. Default: F2.
    pub key: Option<KeyCode>,
}

impl Default for ReflectionSettingsPanelPlugin {
    fn default() -> Self {
        Self {
            open: false,
            key: Some(KeyCode::F2),
        }
    }
}

/// The state of the window.
#[derive(Resource, Reflect, Clone, Debug, PartialEq)]
#[reflect(Resource, Debug, Clone, PartialEq)]
pub struct ReflectionSettingsPanel {
    /// `true` if the window is open.
    pub open: bool,
    /// The key that opens and closes it, if any.
    pub key: Option<KeyCode>,
    /// The camera that it shows; if there is no such camera, the first one that reflects.
    pub camera: Option<Entity>,
}

impl Plugin for ReflectionSettingsPanelPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<CameraSettings>()
            .register_type::<ReflectionSettingsPanel>()
            .register_type::<Measurements>()
            .insert_resource(ReflectionSettingsPanel {
                open: self.open,
                key: self.key,
                camera: None,
            })
            .add_systems(Update, toggle_panel);
        if !app.is_plugin_added::<EguiPlugin>() {
            if !can_draw(app.world()) {
                debug!("no settings panel, since the app has no renderer or no input");
                return;
            }
            app.add_plugins(EguiPlugin::default());
        }
        app.add_systems(
            PreUpdate,
            press_keys
                .after(InputSystems)
                .in_set(EguiInputSet::ReadBevyMessages)
                .run_if(is_open),
        )
        .add_systems(EguiPrimaryContextPass, show_panel);
    }
}

/// Returns whether the resources that [`EguiPlugin`] needs exist.
fn can_draw(world: &World) -> bool {
    world.contains_resource::<Assets<Shader>>()
        && world.contains_resource::<Assets<Image>>()
        && world.contains_resource::<Messages<KeyboardInput>>()
}

fn is_open(panel: Option<Res<ReflectionSettingsPanel>>) -> bool {
    panel.is_some_and(|panel| panel.open)
}

fn toggle_panel(keys: Option<Res<ButtonInput<KeyCode>>>, panel: Option<ResMut<ReflectionSettingsPanel>>) {
    let (Some(keys), Some(mut panel)) = (keys, panel) else {
        return;
    };
    if panel.key.is_some_and(|key| keys.just_pressed(key)) {
        panel.open = !panel.open;
    }
}

fn show_panel(world: &mut World, contexts: &mut QueryState<&'static mut EguiContext, With<PrimaryEguiContext>>) {
    let Some(before) = world.get_resource::<ReflectionSettingsPanel>().cloned() else {
        return;
    };
    if !before.open {
        return;
    }
    // A handle, so that the world isn't borrowed while the window is drawn.
    let Some(context) = contexts
        .iter_mut(world)
        .next()
        .map(|mut context| context.get_mut().clone())
    else {
        return;
    };
    let mut after = before.clone();
    Window::new(TITLE)
        .open(&mut after.open)
        .default_pos([8.0, 8.0])
        .default_size([WINDOW_WIDTH, WINDOW_HEIGHT])
        .resizable([false, true])
        .fade_in(false)
        .show(&context, |ui| columns(ui, world, &mut after.camera));
    if after != before {
        world.insert_resource(after);
    }
}

/// Settings on the left, measurements on the right.
fn columns(ui: &mut Ui, world: &mut World, camera: &mut Option<Entity>) {
    let height = ui.available_height().max(0.0);
    let column = Layout::top_down(Align::Min);
    ui.horizontal_top(|ui| {
        ui.allocate_ui_with_layout(vec2(SETTINGS_WIDTH, height), column, |ui| {
            ScrollArea::vertical()
                .id_salt("settings")
                .auto_shrink([false, true])
                .show(ui, |ui| reflection_settings_ui(ui, world, camera));
        });
        ui.allocate_ui_with_layout(vec2(MEASUREMENTS_WIDTH, height), column, |ui| {
            ScrollArea::vertical()
                .id_salt("measurements")
                .auto_shrink([false, true])
                .show(ui, |ui| reflection_measurements_ui(ui, world, *camera));
        });
    });
}

/// A camera that can reflect.
struct Candidate {
    entity: Entity,
    name: String,
    /// It reflects, or did before it was switched off.
    used: bool,
}

fn candidates(world: &mut World) -> Vec<Candidate> {
    type Item<'a> = (Entity, Option<&'a Name>, Has<RayTracedReflections>, Has<ReflectionsOff>);
    let mut cameras = world.query_filtered::<Item, With<Camera3d>>();
    let mut candidates: Vec<_> = cameras
        .iter(world)
        .map(|(entity, name, on, off)| Candidate {
            entity,
            name: name.map_or_else(|| format!("Camera {entity}"), Name::to_string),
            used: on || off,
        })
        .collect();
    candidates.sort_by_key(|candidate| (!candidate.used, candidate.entity));
    candidates
}

/// The settings of a camera, for custom panels. `camera` is the shown one; if it isn't a 3D camera, it is replaced by the first one
/// that reflects. Changes apply immediately.
pub fn reflection_settings_ui(ui: &mut Ui, world: &mut World, camera: &mut Option<Entity>) {
    let cameras = candidates(world);
    let shown = cameras
        .iter()
        .find(|candidate| Some(candidate.entity) == *camera)
        .or(cameras.first());
    let Some(shown) = shown else {
        ui.label("There is no 3D camera.");
        return;
    };
    *camera = Some(shown.entity);
    if cameras.len() > 1 {
        ComboBox::from_id_salt("camera")
            .width(200.0)
            .selected_text(shown.name.as_str())
            .show_ui(ui, |ui| {
                for candidate in &cameras {
                    ui.selectable_value(camera, Some(candidate.entity), candidate.name.as_str());
                }
            });
    }
    let entity = camera.unwrap_or(shown.entity);
    let Ok(before) = world.get_entity(entity).map(CameraSettings::read) else {
        return;
    };
    let mut after = before.clone();
    camera_settings_ui(ui, &mut after, &report(world), entity);
    if after != before
        && let Ok(mut camera) = world.get_entity_mut(entity)
    {
        after.write(&before, &mut camera);
    }
}

/// Shows the cost of a camera's reflections and the capabilities of this machine, for custom panels.
pub fn reflection_measurements_ui(ui: &mut Ui, world: &World, camera: Option<Entity>) {
    let report = report(world);
    let memory = report.view_memory.iter().find(|memory| Some(memory.camera) == camera);
    let measurements = world
        .get_resource::<DiagnosticsStore>()
        .map(|diagnostics| Measurements::read(diagnostics, memory.map(|memory| memory.pixels)));
    ui.vertical(|ui| {
        measurements_ui(ui, &measurements.unwrap_or_default());
        if let Some(memory) = memory {
            memory_ui(ui, memory);
        }
        ui.add_space(4.0);
        status_ui(ui, &report);
    });
}

fn memory_ui(ui: &mut Ui, memory: &ReflectionViewMemory) {
    entry(ui, "This camera", &mebibytes(memory.bytes() as f64)).on_hover_ui(|ui| {
        for (label, bytes) in &memory.parts {
            entry(ui, label, &mebibytes(*bytes as f64));
        }
    });
    if memory.front_layer_bytes > 0 {
        let text = mebibytes(memory.front_layer_bytes as f64);
        entry(ui, "Of it, glass and water", &text);
    }
}

fn report(world: &World) -> ReflectionStatusReport {
    world
        .get_resource::<ReflectionStatus>()
        .map(ReflectionStatus::report)
        .unwrap_or_default()
}

fn status_ui(ui: &mut Ui, report: &ReflectionStatusReport) {
    ui.strong("Device");
    if report.adapter.is_empty() {
        ui.weak("The renderer has not started.");
        return;
    }
    ui.label(report.adapter.as_str());
    let tracer = match report.tracer {
        Some(ReflectionTracer::RayQuery) => "ray queries",
        Some(ReflectionTracer::Bvh) => "BVH",
        None => "none",
    };
    entry(ui, "Tracer", tracer);
    for reason in &report.reasons {
        ui.weak(format!("{reason}."));
    }
    entry(ui, "Objects", &report.instances.to_string());
    entry(ui, "Triangles", &report.triangles.to_string());
    if report.meshes_without_room > 0 {
        entry(ui, "Meshes without room", &report.meshes_without_room.to_string());
    }
    if report.meshes_pending > 0 {
        entry(ui, "Meshes to build", &report.meshes_pending.to_string());
    } else if !report.ready && !report.active_backends.is_empty() {
        ui.weak("Pipelines are being compiled.");
    }
}
