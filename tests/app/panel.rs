//! The settings panel and the options menu, used like a person by clicking on labels. No window, no GPU.

use crate::plugin::plugins_without_gpu;
use bevy::{
    input::{
        ButtonState,
        gamepad::{RawGamepadButtonChangedEvent, RawGamepadEvent},
        keyboard::{Key, KeyboardInput, NativeKey},
        mouse::MouseButtonInput,
    },
    prelude::*,
    window::{CursorMoved, PrimaryWindow, WindowEvent},
};
use bevy_egui::{EguiContext, EguiOutput, EguiPlugin, EguiRenderOutput, egui::Ui};
use bevy_glint::{
    CombinedThresholds, HardwareVrsSupport, RayTracedReflections, RayTracedReflectionsPlugin, ReflectionAutoQuality,
    ReflectionBackend, ReflectionBudget, ReflectionDebugView, ReflectionEffort, ReflectionPreset, ReflectionQuality,
    ReflectionSettingsPanel, ReflectionSettingsPanelPlugin, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracer, ReflectionsOff, ShadingRateHeuristic,
    ui::{
        CameraSettings, auto_quality_menu, camera_settings_ui, quality_menu, reflection_measurements_ui,
        reflection_settings_ui, switch_reflections, why_no_hardware, why_no_reflections,
    },
};

use egui_kittest::{
    Harness, Node,
    kittest::{AccessKitNode, Queryable},
};

/// Text of the buttons that reset a setting.
const RESET: &str = "⟲";

/// A screen that shows something, with a pointer.
struct Screen<T: 'static>(Harness<'static, T>);

impl<T> Screen<T> {
    fn new(data: T, draw: fn(&mut Ui, &mut T)) -> Self {
        let mut screen = Self(Harness::builder().with_size([900.0, 1600.0]).build_ui_state(draw, data));
        screen.rest();
        screen
    }

    fn data(&self) -> &T {
        self.0.state()
    }

    /// Frames without input, in which layouts and animations end.
    fn rest(&mut self) {
        self.0.run_steps(5);
    }

    /// The widgets that show a text, in drawing order.
    fn all<'a>(&'a self, text: &'a str) -> Vec<Node<'a>> {
        let shows =
            move |node: &AccessKitNode<'_>| [node.label(), node.value()].iter().flatten().any(|shown| shown == text);
        self.0.query_all_by(shows).collect()
    }

    /// Finds a widget by its text; if there are several, the top one.
    #[track_caller]
    fn find<'a>(&'a self, text: &'a str) -> Node<'a> {
        let found = self.all(text).pop();
        found.unwrap_or_else(|| panic!("`{text}` is not on the screen: {:?}", self.0))
    }

    /// A widget by its text, in the row that begins with `label`.
    #[track_caller]
    fn find_beside<'a>(&'a self, label: &'a str, text: &'a str) -> Node<'a> {
        let row = self.find(label).rect().center().y;
        let mut found = self.all(text).into_iter();
        found
            .find(|node| (node.rect().center().y - row).abs() < 10.0)
            .unwrap_or_else(|| panic!("`{text}` is not in the row of `{label}`: {:?}", self.0))
    }

    #[track_caller]
    fn click_on(&mut self, text: &str) {
        self.find(text).click();
        self.rest();
    }

    #[track_caller]
    fn click_beside(&mut self, label: &str, text: &str) {
        self.find_beside(label, text).click();
        self.rest();
    }

    /// Opens the list in a row, which shows `current`, and clicks on another entry.
    #[track_caller]
    fn choose(&mut self, label: &str, current: &str, entry: &str) {
        self.click_beside(label, current);
        self.click_on(entry);
    }
}

/// A device that can do everything.
fn able() -> ReflectionStatusReport {
    ReflectionStatusReport {
        adapter: "a device".into(),
        tracer: Some(ReflectionTracer::RayQuery),
        hardware_vrs: HardwareVrsSupport::Available,
        ..default()
    }
}

fn panel(settings: CameraSettings, report: ReflectionStatusReport) -> Screen<(CameraSettings, ReflectionStatusReport)> {
    Screen::new((settings, report), |ui, (settings, report)| {
        camera_settings_ui(ui, settings, report, Entity::PLACEHOLDER);
    })
}

fn panel_of(world: World) -> Screen<(World, Option<Entity>)> {
    Screen::new((world, None), |ui, (world, camera)| {
        reflection_settings_ui(ui, world, camera);
    })
}

fn on() -> CameraSettings {
    CameraSettings { on: true, ..default() }
}

#[test]
fn a_click_chooses_and_a_click_resets() {
    let mut panel = panel(on(), able());
    panel.choose("Technique", "Variable", "Quarter");
    assert_eq!(panel.data().0.reflections.technique, ReflectionTechnique::Quarter);
    panel.click_beside("Technique", RESET);
    assert_eq!(panel.data().0, on());

    panel.click_beside("Shadow rays", "on");
    assert!(!panel.data().0.reflections.shadow_rays);
    panel.click_beside("Shadow rays", RESET);
    assert_eq!(panel.data().0, on());

    panel.choose("Heuristic", "Adaptive", "Grazing");
    assert!(matches!(panel.data().0.heuristic, ShadingRateHeuristic::Grazing(_)));
    panel.choose("Size of tiles", "16x16", "8x8");
    panel.click_on("Debug view");
    panel.choose("View", "off", "shading rates");
    assert_eq!(panel.data().0.debug_view, ReflectionDebugView::ShadingRates);
}

#[test]
fn a_budget_comes_and_goes() {
    let mut world = World::new();
    let camera = world.spawn((Camera3d::default(), RayTracedReflections::default())).id();
    let mut panel = panel_of(world);
    panel.click_on("Budget");
    panel.click_beside("Hold GPU time", "off");
    assert_eq!(panel.data().0.get(camera), Some(&ReflectionBudget::default()));
    let world = &mut panel.0.state_mut().0;
    world.entity_mut(camera).insert(ReflectionEffort(0.42));
    panel.rest();
    panel.find_beside("Effort now", "42 %");
    panel.click_beside("Hold GPU time", "on");
    assert_eq!(panel.data().0.get::<ReflectionBudget>(camera), None);
    assert_eq!(panel.data().0.get(camera), Some(&ReflectionEffort::default()));
}

#[test]
fn the_search_for_a_quality_is_seen_and_can_be_ended() {
    let mut world = World::new();
    let budget = ReflectionBudget {
        milliseconds: 1.5,
        ..default()
    };
    let camera = world
        .spawn((Camera3d::default(), RayTracedReflections::default(), budget))
        .id();
    let mut panel = panel_of(world);
    panel.click_on("Budget");
    panel.click_beside("Find quality", "off");
    let search = panel.data().0.get::<ReflectionAutoQuality>(camera);
    assert_eq!(search.map(|search| search.milliseconds), Some(1.5));
    panel.find_beside("Find quality", "on");
    // It ends by itself.
    let world = &mut panel.0.state_mut().0;
    world.entity_mut(camera).remove::<ReflectionAutoQuality>();
    panel.rest();
    panel.click_beside("Find quality", "off");
    panel.click_beside("Find quality", "on");
    assert_eq!(panel.data().0.get::<ReflectionAutoQuality>(camera), None);
}

#[test]
fn a_preset_leaves_the_back_end_alone() {
    let mut settings = on();
    settings.reflections.backend = ReflectionBackend::HardwareVrs;
    let mut panel = panel(settings, able());
    panel.choose("Preset", "Medium", "Ultra");
    let settings = &panel.data().0;
    assert_eq!(settings.preset(), Some(ReflectionPreset::Ultra));
    assert_eq!(settings.reflections.backend, ReflectionBackend::HardwareVrs);
}

#[test]
fn what_the_device_cannot_do_cannot_be_chosen() {
    let mut report = able();
    report.hardware_vrs = HardwareVrsSupport::Missing("it lacks the extension".into());
    assert!(why_no_hardware(&report).is_some_and(|reason| reason.contains("it lacks the extension")));
    let mut panel = panel(on(), report);
    panel.choose("Back end", "Automatic", "Hardware");
    assert_eq!(panel.data().0.reflections.backend, ReflectionBackend::Auto);
    panel.0.state_mut().1 = able();
    panel.rest();
    panel.choose("Back end", "Automatic", "Hardware");
    assert_eq!(panel.data().0.reflections.backend, ReflectionBackend::HardwareVrs);
}

#[test]
fn what_has_no_effect_is_greyed_out() {
    let mut panel = panel(on(), able());
    panel.choose("Technique", "Variable", "Reference");
    let reference = panel.data().0.clone();
    panel.click_beside("Back end", "Automatic");
    panel.click_beside("Full-size mirrors", "on");
    panel.click_beside("Tracer", "Ray queries");
    assert_eq!(panel.data().0, reference);
}

#[test]
fn without_a_tracer_nothing_can_be_switched_on() {
    let mut report = able();
    report.tracer = None;
    report.reasons = vec!["it is too old".into()];
    assert!(why_no_reflections(&report).is_some_and(|reason| reason.contains("it is too old")));
    assert_eq!(
        why_no_reflections(&ReflectionStatusReport::default()),
        None,
        "not known yet"
    );
    let mut panel = panel(CameraSettings::default(), report);
    panel.click_on("Reflections");
    assert!(!panel.data().0.on);
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
    assert_eq!(panel.data().0, settings);
}

#[test]
fn off_removes_and_on_brings_back() {
    let mut world = World::new();
    let settings = RayTracedReflections {
        technique: ReflectionTechnique::Quarter,
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
    assert_eq!(panel.data().1, Some(camera));

    panel.click_on("Reflections");
    let world = &panel.data().0;
    assert!(world.get::<RayTracedReflections>(camera).is_none());
    assert_eq!(
        world.get::<ReflectionsOff>(camera),
        Some(&ReflectionsOff(settings.clone()))
    );

    panel.click_on("Reflections");
    let world = &panel.data().0;
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
    let world = &panel.data().0;
    let technique = world
        .get::<RayTracedReflections>(camera)
        .map(|settings| settings.technique);
    assert_eq!(technique, Some(ReflectionTechnique::Variable));
}

#[test]
fn an_empty_world_has_nothing_to_show() {
    let panel = Screen::new((World::new(), None::<Entity>), |ui, (world, camera)| {
        reflection_settings_ui(ui, world, camera);
        reflection_measurements_ui(ui, world, *camera);
    });
    panel.find("There is no 3D camera.");
    assert_eq!(panel.data().1, None);
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
    let mut menu = Screen::new((ReflectionQuality::default(), 0), |ui, (quality, changes)| {
        *changes += u32::from(quality_menu(ui, quality).changed());
    });
    menu.click_on("High");
    assert_eq!(menu.data(), &(ReflectionQuality::High, 1));
    menu.click_on("High");
    assert_eq!(menu.data(), &(ReflectionQuality::High, 1));
    menu.click_on("Off");
    assert_eq!(menu.data(), &(ReflectionQuality::Off, 2));
}

#[test]
fn the_options_menu_leaves_the_choice_to_the_machine() {
    let mut menu = Screen::new((Some(ReflectionQuality::High), 0), |ui, (quality, changes)| {
        *changes += u32::from(auto_quality_menu(ui, quality).changed());
    });
    menu.click_on("Auto");
    assert_eq!(menu.data(), &(None, 1));
    menu.click_on("Auto");
    assert_eq!(menu.data(), &(None, 1));
    menu.click_on("Low");
    assert_eq!(menu.data(), &(Some(ReflectionQuality::Low), 2));
}

#[test]
fn the_quality_of_a_camera_follows_the_panel() {
    let mut world = World::new();
    let id = world.spawn((Camera3d::default(), ReflectionQuality::Medium)).id();
    let mut camera = world.entity_mut(id);
    camera.insert(RayTracedReflections::default());
    let mut change = |change: fn(&mut CameraSettings)| {
        let before = CameraSettings::read(camera.as_readonly());
        let mut after = before.clone();
        change(&mut after);
        after.write(&before, &mut camera);
        camera.get::<ReflectionQuality>().copied()
    };
    let high = change(|settings| settings.apply_preset(ReflectionPreset::High));
    assert_eq!(high, Some(ReflectionQuality::High));
    let none = change(|settings| settings.reflections.roughness_cutoff = 0.125);
    assert_eq!(none, Some(ReflectionQuality::High), "no quality is like this");
    assert_eq!(change(|settings| settings.on = false), Some(ReflectionQuality::Off));
    camera.remove::<ReflectionQuality>();
    switch_reflections(&mut camera, true);
    assert!(!camera.contains::<ReflectionQuality>(), "it is up to the app");
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

/// An app with a window in name only.
struct Game {
    app: App,
    window: Entity,
    camera: Entity,
}

impl Game {
    fn new(others_draw_with_egui: bool) -> Self {
        let mut app = App::new();
        app.add_plugins(plugins_without_gpu());
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
        let world = app.world_mut();
        let camera = world.spawn((Camera3d::default(), RayTracedReflections::default())).id();
        let window = world
            .query_filtered::<Entity, With<PrimaryWindow>>()
            .single(world)
            .unwrap();
        let mut game = Self { app, window, camera };
        game.rest();
        let context = game.app.world_mut().get_mut::<EguiContext>(camera);
        context.unwrap().get_mut().enable_accesskit();
        game.rest();
        game
    }

    /// Frames without input, in which layouts end.
    fn rest(&mut self) {
        for _ in 0..4 {
            self.app.update();
        }
    }

    /// The middle of the widget with a text.
    fn find(&self, text: &str) -> Option<Vec2> {
        let output = self.app.world().get::<EguiOutput>(self.camera)?;
        let nodes = &output.platform_output.accesskit_update.as_ref()?.nodes;
        let (_, node) = nodes.iter().find(|(_, node)| node.label() == Some(text))?;
        let place = node.bounds()?;
        Some(Vec2::new((place.x0 + place.x1) as f32, (place.y0 + place.y1) as f32) / 2.0)
    }

    /// The text of the widget with the focus.
    fn focus(&self) -> Option<String> {
        let output = self.app.world().get::<EguiOutput>(self.camera)?;
        let update = output.platform_output.accesskit_update.as_ref()?;
        let (_, node) = update.nodes.iter().find(|(id, _)| *id == update.focus)?;
        node.label().map(str::to_owned)
    }

    /// Presses and releases a button of a gamepad.
    fn push(&mut self, gamepad: Entity, button: GamepadButton) {
        for value in [1.0, 0.0] {
            let changed = RawGamepadButtonChangedEvent::new(gamepad, button, value);
            self.app.world_mut().write_message(RawGamepadEvent::from(changed));
            self.app.update();
        }
        self.rest();
    }

    fn point(&mut self, position: Vec2) {
        let (window, delta) = (self.window, None);
        let moved = CursorMoved {
            window,
            position,
            delta,
        };
        self.app.world_mut().write_message(WindowEvent::from(moved));
        self.app.update();
    }

    fn button(&mut self, state: ButtonState) {
        let (button, window) = (MouseButton::Left, self.window);
        let input = MouseButtonInput { button, state, window };
        self.app.world_mut().write_message(WindowEvent::from(input));
        self.app.update();
    }

    fn drag(&mut self, from: Vec2, to: Vec2) {
        self.point(from);
        self.button(ButtonState::Pressed);
        self.point(to);
        self.button(ButtonState::Released);
        self.rest();
    }

    fn press(&mut self, key_code: KeyCode) {
        for state in [ButtonState::Pressed, ButtonState::Released] {
            self.app.world_mut().write_message(KeyboardInput {
                key_code,
                logical_key: Key::Unidentified(NativeKey::Unidentified),
                state,
                text: None,
                repeat: false,
                window: self.window,
            });
            self.app.update();
        }
        self.rest();
    }
}

#[test]
fn an_app_without_a_gpu_lays_the_panel_out() {
    for others_draw_with_egui in [false, true] {
        let game = Game::new(others_draw_with_egui);
        let world = game.app.world();
        let drawn = world.get::<EguiRenderOutput>(game.camera);
        assert!(drawn.is_some_and(|output| !output.paint_jobs.is_empty()));
        assert_eq!(world.resource::<ReflectionSettingsPanel>().camera, Some(game.camera));
    }
}

#[test]
fn a_gamepad_chooses_and_presses() {
    let mut game = Game::new(false);
    let gamepad = game.app.world_mut().spawn(Gamepad::default()).id();
    let reflects = |game: &Game| game.app.world().get::<RayTracedReflections>(game.camera).is_some();
    let chosen = (0..40).find(|_| {
        game.push(gamepad, GamepadButton::DPadDown);
        game.focus().as_deref() == Some("Reflections")
    });
    assert!(chosen.is_some(), "the focus is on {:?}", game.focus());
    for on in [false, true] {
        game.push(gamepad, GamepadButton::South);
        assert_eq!(reflects(&game), on);
    }
    game.push(gamepad, GamepadButton::DPadUp);
    assert_ne!(game.focus().as_deref(), Some("Reflections"));
    game.push(gamepad, GamepadButton::DPadDown);
    assert_eq!(game.focus().as_deref(), Some("Reflections"));
    game.press(KeyCode::F2);
    game.push(gamepad, GamepadButton::South);
    assert!(reflects(&game), "the panel is closed");
}

/// Events of a window reach the panel through the plugin's own systems.
#[test]
fn pointer_and_keys_reach_the_panel() {
    let mut game = Game::new(false);
    let reflects = |game: &Game| game.app.world().get::<RayTracedReflections>(game.camera).is_some();
    let switch = game.find("Reflections").expect("the panel is open");
    for on in [false, true] {
        game.drag(switch, switch);
        assert_eq!(reflects(&game), on);
    }

    let (bar, way) = (Vec2::new(158.0, 22.0), Vec2::new(250.0, 40.0));
    game.drag(bar, bar + way);
    let dragged = game.find("Reflections").expect("the panel is still open");
    assert!((dragged - switch).abs_diff_eq(way, 1.0), "{switch} {dragged}");

    game.press(KeyCode::F2);
    assert_eq!(game.find("Reflections"), None);
    game.press(KeyCode::F2);
    assert_eq!(game.find("Reflections"), Some(dragged));
}
