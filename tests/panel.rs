//! The settings panel and the options menu, used as a person does: by clicking on what can be read. No window, no GPU.

#![cfg(feature = "egui")]

use bevy::{
    prelude::*,
    render::{
        RenderPlugin,
        settings::{RenderCreation, WgpuSettings},
    },
};
use bevy_egui::{
    EguiPlugin, EguiRenderOutput,
    egui::{self, Event, Modifiers, PointerButton, Pos2, RawInput, Rect, Shape, Ui},
};
use bevy_glint::{
    Backend, CombinedThresholds, DebugView, HardwareRates, Preset, RayTracedReflections, RayTracedReflectionsPlugin,
    ReflectionSettingsPanel, ReflectionSettingsPanelPlugin, ShadingRateHeuristic, StatusReport, Technique, Tracer,
    ui::{
        CameraSettings, Quality, ReflectionsOff, camera_settings_ui, quality_menu, reflection_measurements_ui,
        reflection_settings_ui, switch_reflections, why_no_hardware, why_no_reflections,
    },
};

/// What buttons that reset say.
const RESET: &str = "⟲";

/// A screen that shows something, with a pointer.
struct Screen<T> {
    context: egui::Context,
    data: T,
    draw: fn(&mut Ui, &mut T),
    seconds: f64,
    /// What can be read, and where; what is drawn last comes last.
    texts: Vec<(String, Rect)>,
}

impl<T> Screen<T> {
    fn new(data: T, draw: fn(&mut Ui, &mut T)) -> Self {
        let mut screen = Self {
            context: egui::Context::default(),
            data,
            draw,
            seconds: 0.0,
            texts: Vec::new(),
        };
        screen.rest();
        screen
    }

    fn frame(&mut self, events: Vec<Event>) {
        self.seconds += 0.1;
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, egui::vec2(900.0, 1600.0))),
            time: Some(self.seconds),
            events,
            ..RawInput::default()
        };
        let (data, draw) = (&mut self.data, self.draw);
        let output = self.context.run_ui(input, |ui| draw(ui, data));
        self.texts.clear();
        for clipped in &output.shapes {
            read(&clipped.shape, clipped.clip_rect, &mut self.texts);
        }
        output.drop_without_applying_deltas();
    }

    /// Frames without input, in which layouts and animations come to rest.
    fn rest(&mut self) {
        for _ in 0..5 {
            self.frame(vec![]);
        }
    }

    fn click(&mut self, place: Rect) {
        let button = |pressed| Event::PointerButton {
            pos: place.center(),
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::default(),
        };
        self.frame(vec![Event::PointerMoved(place.center())]);
        self.frame(vec![button(true)]);
        self.frame(vec![button(false)]);
        self.rest();
    }

    /// Where a text is; of several the one on top.
    #[track_caller]
    fn find(&self, text: &str) -> Rect {
        let found = self.texts.iter().rev().find(|(known, _)| known == text);
        match found {
            Some((_, place)) => *place,
            None => panic!("`{text}` is not on the screen: {:?}", self.texts),
        }
    }

    /// Where a text is in the row that begins with `label`.
    #[track_caller]
    fn find_beside(&self, label: &str, text: &str) -> Rect {
        let row = self.find(label).center().y;
        let in_row = |place: &Rect| (place.center().y - row).abs() < 10.0;
        let found = self.texts.iter().find(|(known, place)| known == text && in_row(place));
        match found {
            Some((_, place)) => *place,
            None => panic!("`{text}` is not in the row of `{label}`: {:?}", self.texts),
        }
    }

    #[track_caller]
    fn click_on(&mut self, text: &str) {
        self.click(self.find(text));
    }

    /// Opens the list in a row, which shows `current`, and clicks on another entry.
    #[track_caller]
    fn choose(&mut self, label: &str, current: &str, entry: &str) {
        self.click(self.find_beside(label, current));
        self.click_on(entry);
    }
}

/// Collects texts that are at least partly visible.
fn read(shape: &Shape, clip: Rect, texts: &mut Vec<(String, Rect)>) {
    match shape {
        Shape::Text(text) => {
            let place = text.visual_bounding_rect();
            if clip.intersects(place) {
                texts.push((text.galley.text().to_owned(), place));
            }
        }
        Shape::Vec(shapes) => shapes.iter().for_each(|shape| read(shape, clip, texts)),
        _ => {}
    }
}

/// A device that can do everything.
fn able() -> StatusReport {
    StatusReport {
        adapter: "a device".into(),
        tracer: Some(Tracer::RayQuery),
        hardware_rates: HardwareRates::Available,
        ..default()
    }
}

fn panel(settings: CameraSettings, report: StatusReport) -> Screen<(CameraSettings, StatusReport)> {
    Screen::new((settings, report), |ui, (settings, report)| {
        camera_settings_ui(ui, settings, report, Entity::PLACEHOLDER);
    })
}

fn on() -> CameraSettings {
    CameraSettings { on: true, ..default() }
}

#[test]
fn a_click_chooses_and_a_click_resets() {
    let mut panel = panel(on(), able());
    panel.choose("Technique", "Variable", "Quarter");
    assert_eq!(panel.data.0.reflections.technique, Technique::Quarter);
    panel.click(panel.find_beside("Technique", RESET));
    assert_eq!(panel.data.0, on());

    panel.click(panel.find_beside("Shadow rays", "on"));
    assert!(!panel.data.0.reflections.shadow_rays);
    panel.click(panel.find_beside("Shadow rays", RESET));
    assert_eq!(panel.data.0, on());

    panel.choose("Heuristic", "Combined", "Grazing");
    assert!(matches!(panel.data.0.heuristic, ShadingRateHeuristic::Grazing(_)));
    panel.choose("Size of tiles", "16x16", "8x8");
    panel.click_on("Debug view");
    panel.choose("View", "off", "shading rates");
    assert_eq!(panel.data.0.debug_view, DebugView::ShadingRates);
}

#[test]
fn a_preset_leaves_the_back_end_alone() {
    let mut settings = on();
    settings.reflections.backend = Backend::Hardware;
    let mut panel = panel(settings, able());
    panel.choose("Preset", "Medium", "Ultra");
    let settings = &panel.data.0;
    assert_eq!(settings.preset(), Some(Preset::Ultra));
    assert_eq!(settings.reflections.backend, Backend::Hardware);
}

#[test]
fn what_the_device_cannot_do_cannot_be_chosen() {
    let mut report = able();
    report.hardware_rates = HardwareRates::Missing("it lacks the extension".into());
    assert!(why_no_hardware(&report).is_some_and(|reason| reason.contains("it lacks the extension")));
    let mut panel = panel(on(), report);
    panel.choose("Back end", "Automatic", "Hardware");
    assert_eq!(panel.data.0.reflections.backend, Backend::Auto);
    panel.data.1 = able();
    panel.rest();
    panel.choose("Back end", "Automatic", "Hardware");
    assert_eq!(panel.data.0.reflections.backend, Backend::Hardware);
}

#[test]
fn what_has_no_effect_is_greyed_out() {
    let mut panel = panel(on(), able());
    panel.choose("Technique", "Variable", "Reference");
    let reference = panel.data.0.clone();
    panel.click(panel.find_beside("Back end", "Automatic"));
    panel.click(panel.find_beside("Full-size mirrors", "on"));
    panel.click(panel.find_beside("Tracer", "Ray queries"));
    assert_eq!(panel.data.0, reference);
}

#[test]
fn without_a_tracer_nothing_can_be_switched_on() {
    let mut report = able();
    report.tracer = None;
    report.reasons = vec!["it is too old".into()];
    assert!(why_no_reflections(&report).is_some_and(|reason| reason.contains("it is too old")));
    assert_eq!(why_no_reflections(&StatusReport::default()), None, "not known yet");
    let mut panel = panel(CameraSettings::default(), report);
    panel.click_on("Reflections");
    assert!(!panel.data.0.on);
}

#[test]
fn to_look_changes_nothing() {
    let mut settings = on();
    settings.reflections.max_ray_length = f32::INFINITY;
    settings.reflections.roughness_cutoff = -1.0;
    settings.reflections.denoiser.samples = 100;
    settings.heuristic = ShadingRateHeuristic::Combined(CombinedThresholds {
        edge: f32::INFINITY,
        ..default()
    });
    let panel = panel(settings.clone(), able());
    assert_eq!(panel.data.0, settings);
}

#[test]
fn off_removes_and_on_brings_back() {
    let mut world = World::new();
    let settings = RayTracedReflections {
        technique: Technique::Quarter,
        roughness_cutoff: 0.25,
        reset: false,
        ..default()
    };
    let camera = world
        .spawn((
            Camera3d::default(),
            settings.clone(),
            ShadingRateHeuristic::PAPER_GRAZING,
        ))
        .id();
    let mut panel = Screen::new((world, None::<Entity>), |ui, (world, camera)| {
        reflection_settings_ui(ui, world, camera);
        reflection_measurements_ui(ui, world, *camera);
    });
    assert_eq!(panel.data.1, Some(camera));

    panel.click_on("Reflections");
    let world = &panel.data.0;
    assert!(world.get::<RayTracedReflections>(camera).is_none());
    assert_eq!(
        world.get::<ReflectionsOff>(camera),
        Some(&ReflectionsOff(settings.clone()))
    );

    panel.click_on("Reflections");
    let world = &panel.data.0;
    assert!(world.get::<ReflectionsOff>(camera).is_none());
    let restored = RayTracedReflections {
        reset: true,
        ..settings
    };
    assert_eq!(world.get::<RayTracedReflections>(camera), Some(&restored));
    assert_eq!(
        world.get::<ShadingRateHeuristic>(camera),
        Some(&ShadingRateHeuristic::PAPER_GRAZING)
    );

    panel.choose("Technique", "Quarter", "Variable");
    let world = &panel.data.0;
    let technique = world
        .get::<RayTracedReflections>(camera)
        .map(|settings| settings.technique);
    assert_eq!(technique, Some(Technique::Variable));
}

#[test]
fn an_empty_world_has_nothing_to_show() {
    let panel = Screen::new((World::new(), None::<Entity>), |ui, (world, camera)| {
        reflection_settings_ui(ui, world, camera);
        reflection_measurements_ui(ui, world, *camera);
    });
    assert!(panel.find("There is no 3D camera.").is_positive());
    assert_eq!(panel.data.1, None);
}

#[test]
fn cameras_are_switched() {
    let mut world = World::new();
    let camera = world.spawn(Camera3d::default()).id();
    let mut camera = world.entity_mut(camera);
    switch_reflections(&mut camera, false);
    assert!(!camera.contains::<ReflectionsOff>(), "it had nothing to keep");
    switch_reflections(&mut camera, true);
    assert_eq!(
        camera.get::<RayTracedReflections>(),
        Some(&RayTracedReflections::default())
    );
    switch_reflections(&mut camera, false);
    assert!(camera.contains::<ReflectionsOff>() && !camera.contains::<RayTracedReflections>());
}

#[test]
fn the_options_menu_chooses_a_quality() {
    let mut menu = Screen::new((Quality::default(), 0), |ui, (quality, changes)| {
        if quality_menu(ui, quality).changed() {
            *changes += 1;
        }
    });
    menu.click_on("High");
    assert_eq!(menu.data, (Quality::High, 1));
    menu.click_on("High");
    assert_eq!(menu.data, (Quality::High, 1));
    menu.click_on("Off");
    assert_eq!(menu.data, (Quality::Off, 2));
}

#[test]
fn qualities_are_written_and_read() {
    for quality in Quality::ALL {
        assert_eq!(quality.to_string().parse(), Ok(quality));
    }
    let error = "best".parse::<Quality>().unwrap_err().to_string();
    assert_eq!(error, "`best` is unknown; choose one of: off, low, medium, high, ultra");
}

#[test]
fn qualities_are_applied_to_cameras() {
    let mut world = World::new();
    let id = world.spawn(Camera3d::default()).id();
    let mut camera = world.entity_mut(id);
    assert_eq!(Quality::of(camera.as_readonly()), Some(Quality::Off));
    for quality in Quality::ALL {
        quality.apply(&mut camera);
        assert_eq!(Quality::of(camera.as_readonly()), Some(quality));
        let settings = quality.settings();
        assert_eq!(
            camera.get::<RayTracedReflections>(),
            settings.as_ref().map(|all| &all.0)
        );
        if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
            reflections.reset = false;
        }
        quality.apply(&mut camera);
        let reset = camera.get::<RayTracedReflections>().is_some_and(|all| all.reset);
        assert!(!reset, "the same quality again is no change");
    }
    if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
        reflections.backend = Backend::Compute;
        reflections.roughness_cutoff = 0.125;
    }
    assert_eq!(Quality::of(camera.as_readonly()), None);
    Quality::Low.apply(&mut camera);
    let backend = camera.get::<RayTracedReflections>().map(|all| all.backend);
    assert_eq!(backend, Some(Backend::Compute));

    let mut commands = world.commands();
    Quality::Off.queue(&mut commands.entity(id));
    world.flush();
    assert_eq!(Quality::of(world.entity(id)), Some(Quality::Off));
}

#[test]
fn a_key_opens_the_panel_even_where_nothing_draws_it() {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        RayTracedReflectionsPlugin::default(),
        ReflectionSettingsPanelPlugin {
            key: Some(KeyCode::KeyP),
            ..default()
        },
    ))
    .init_resource::<ButtonInput<KeyCode>>();
    app.finish();
    app.cleanup();
    assert!(!app.is_plugin_added::<EguiPlugin>());
    let is_open = |app: &App| app.world().resource::<ReflectionSettingsPanel>().open;
    app.update();
    assert!(!is_open(&app));
    app.world_mut()
        .resource_mut::<ButtonInput<KeyCode>>()
        .press(KeyCode::KeyP);
    app.update();
    assert!(is_open(&app));
}

/// With a window in name only.
#[test]
fn an_app_without_a_gpu_lays_the_panel_out() {
    for others_draw_with_egui in [false, true] {
        let mut app = App::new();
        let no_gpu = RenderPlugin {
            render_creation: RenderCreation::Automatic(Box::new(WgpuSettings {
                backends: None,
                ..default()
            })),
            ..default()
        };
        app.add_plugins(
            DefaultPlugins
                .set(no_gpu)
                .disable::<bevy::winit::WinitPlugin>()
                .disable::<bevy::log::LogPlugin>()
                .disable::<bevy::app::TerminalCtrlCHandlerPlugin>(),
        );
        if others_draw_with_egui {
            app.add_plugins(EguiPlugin::default());
        }
        app.add_plugins((
            RayTracedReflectionsPlugin::default(),
            ReflectionSettingsPanelPlugin {
                open: true,
                ..default()
            },
        ));
        app.finish();
        app.cleanup();
        let camera = app
            .world_mut()
            .spawn((Camera3d::default(), RayTracedReflections::default()))
            .id();
        for _ in 0..4 {
            app.update();
        }
        let drawn = app.world().get::<EguiRenderOutput>(camera);
        assert!(drawn.is_some_and(|output| !output.paint_jobs.is_empty()));
        assert_eq!(app.world().resource::<ReflectionSettingsPanel>().camera, Some(camera));
    }
}
