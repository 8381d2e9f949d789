//! The examples render without a window: the plugin of each, with Bevy's plugins around it, cameras that draw into an image, and
//! simulated keys.
//!
//! Each image must differ from that without reflections by a stated amount. Images are kept in the folder `tmp` of the target
//! directory.

#[path = "../../examples"]
#[expect(dead_code, reason = "`main` opens a window")]
mod files {
    pub mod character;
    pub mod custom_heuristic;
    pub mod custom_material;
    pub mod facing_mirrors;
    pub mod glass_and_water;
    pub mod many_lights;
    pub mod minimal;
    pub mod moving_objects;
    #[cfg(feature = "egui")]
    pub mod quality_menu;
    pub mod reflection_methods;
    #[cfg(feature = "egui")]
    pub mod settings_panel;
    pub mod shading_rates;
    pub mod sparks;
    pub mod split_screen;
    pub mod water_material;
    pub mod wind;
}

use crate::{
    common::if_renders,
    pictures::PATIENCE,
    stage::{report, until},
};
use bevy::{
    camera::ShadowLodOrigin,
    input::{
        ButtonState,
        keyboard::{Key, KeyboardInput},
    },
    light::{DirectionalLightShadowMap, PointLightShadowMap},
    math::UVec2,
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
};
use bevy_glint::{RayTracedReflections, ReflectionStatusReport};
use files::*;
use glint_scenes::{HeadlessApp, HeadlessSettings, save_picture};
use std::{fs, ops::Range, path::Path, sync::LazyLock};

/// Size of the images, and number of frames after which a history is long enough to compare. With the environment variable
/// `GLINT_GALLERY`, images are as large and as clean as in README, and have Bevy's own shadow maps.
static LOOK: LazyLock<(UVec2, u32)> = LazyLock::new(|| {
    if is_gallery() {
        (UVec2::new(960, 540), 64)
    } else {
        (UVec2::new(128, 72), 8)
    }
});

fn is_gallery() -> bool {
    std::env::var_os("GLINT_GALLERY").is_some()
}

fn size() -> UVec2 {
    LOOK.0
}

/// An example that runs without a window.
struct Example {
    name: &'static str,
    app: HeadlessApp,
}

impl Example {
    /// Renders the first frames until rays can hit the whole scene. Returns `None` (with the reason printed) if this machine can't render.
    /// `change` is called before the first frame.
    fn start(name: &'static str, plugin: fn(&mut App), change: impl FnOnce(&mut World)) -> Option<Self> {
        let settings = HeadlessSettings {
            size: size(),
            ..default()
        };
        let app = HeadlessApp::new(settings, |app| {
            // The harness draws deferred; here the example decides.
            app.insert_resource(DefaultOpaqueRendererMethod::forward());
            if !is_gallery() {
                // A CPU takes long to draw large shadow maps.
                app.insert_resource(DirectionalLightShadowMap { size: 256 });
                app.insert_resource(PointLightShadowMap { size: 128 });
            }
            app.add_plugins(plugin);
        });
        let mut app = if_renders(app)?;
        let target = app.target();
        app.world()
            .add_observer(move |camera: On<Add<Camera3d>>, mut commands: Commands| {
                // Without a window only this component makes Bevy draw shadows.
                commands.entity(camera.entity).insert((target.clone(), ShadowLodOrigin));
            });
        change(app.world());
        // The first frame spawns the scene.
        app.step(1);
        let mut example = Self { name, app };
        example.wait_for_scene();
        Some(example)
    }

    /// Waits with the clock stopped until everything is compiled and, if a camera reflects, until rays can hit the whole scene.
    fn wait_for_scene(&mut self) {
        let was_paused = self.clock().is_paused();
        self.app.warm_up(PATIENCE).unwrap_or_else(|error| panic!("{error}"));
        self.clock().pause();
        until(&mut self.app, &format!("{} is not ready", self.name), |app| {
            let world = app.world();
            let is_wanted = world.query::<&RayTracedReflections>().iter(world).next().is_some();
            let report = report(app);
            !is_wanted || report.ready && report.meshes_pending == 0
        });
        // Uploads of the last frame are traced in the next one.
        self.app.step(2);
        if !was_paused {
            self.clock().unpause();
        }
    }

    fn report(&mut self) -> ReflectionStatusReport {
        report(&mut self.app)
    }

    /// Presses a key for one frame.
    fn press(&mut self, key: KeyCode) {
        for state in [ButtonState::Pressed, ButtonState::Released] {
            self.app.world().write_message(KeyboardInput {
                key_code: key,
                logical_key: Key::Unidentified(bevy::input::keyboard::NativeKey::Unidentified),
                state,
                text: None,
                repeat: false,
                window: Entity::PLACEHOLDER,
            });
            self.app.step(1);
        }
    }

    /// Renders with the clock stopped, and saves the image under a name.
    fn image(&mut self, what: &str) -> Vec<u8> {
        self.wait_for_scene();
        let was_paused = self.clock().is_paused();
        self.clock().pause();
        self.app.step(LOOK.1);
        if !was_paused {
            self.clock().unpause();
        }
        let image = self.app.capture().unwrap_or_else(|error| panic!("{error}"));
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("example-{}-{what}.png", self.name));
        save_picture(size(), image.clone(), &file).unwrap_or_else(|error| panic!("{error}"));
        image
    }

    /// The image after a key was pressed.
    fn image_after(&mut self, key: KeyCode, what: &str) -> Vec<u8> {
        self.press(key);
        self.image(what)
    }

    fn clock(&mut self) -> Mut<'_, Time<Virtual>> {
        self.app.world().resource_mut::<Time<Virtual>>()
    }

    /// Switches the reflections of all cameras off.
    fn remove_reflections(&mut self) {
        let world = self.app.world();
        let mut cameras = world.query_filtered::<Entity, With<RayTracedReflections>>();
        let cameras: Vec<Entity> = cameras.iter(world).collect();
        assert!(!cameras.is_empty(), "{}: no camera reflects", self.name);
        for camera in cameras {
            world.entity_mut(camera).remove::<RayTracedReflections>();
        }
    }

    /// Compares the current image with the one without reflections, which must be steady.
    #[track_caller]
    fn assert_reflects(&mut self, least: f32) {
        let on = self.image("on");
        self.remove_reflections();
        let off = self.image("off");
        let still = self.image("off");
        self.assert_same("without reflections", &off, &still);
        self.assert_differs("without reflections", &on, &off, least);
        // Without the light of reflections the image would be far darker, because Bevy's own reflections are gone, too.
        let [light, light_off] = [&on, &off].map(|image| difference(image, &vec![0; image.len()], 0..size().x));
        println!("{}: light {light:.1}, {light_off:.1} without reflections", self.name);
        assert!(light > LEAST_LIGHT * light_off, "{}: {light} of {light_off}", self.name);
    }

    #[track_caller]
    fn assert_differs(&self, what: &str, a: &[u8], b: &[u8], least: f32) {
        let found = difference(a, b, 0..size().x);
        println!("{}, {what}: {found:.2}, at least {least}", self.name);
        // A panel covers a smaller part of a larger image.
        let is_enough = found >= least || is_gallery();
        assert!(is_enough, "{}, {what}: {found} is less than {least}", self.name);
    }

    /// A key changes the image. `what` is the difference, `images` are the names of both.
    #[track_caller]
    fn assert_key_changes(&mut self, key: KeyCode, what: &str, images: [&str; 2], least: f32) {
        let before = self.image(images[0]);
        let after = self.image_after(key, images[1]);
        self.assert_differs(what, &before, &after, least);
    }

    #[track_caller]
    fn assert_same(&self, what: &str, a: &[u8], b: &[u8]) {
        let found = difference(a, b, 0..size().x);
        assert!(found < SAME, "{}, {what}: {found} is not the same", self.name);
    }
}

/// An example by the name of its file. Ends the test if this machine can't render.
macro_rules! start {
    ($name:ident) => {{
        let Some(example) = Example::start(stringify!($name), $name::plugin, |_| {}) else {
            return;
        };
        example
    }};
}

/// Light of an image with reflections, relative to the image with environment map reflections.
const LEAST_LIGHT: f32 = 0.8;

/// Dithering differs from frame to frame.
const SAME: f32 = 0.2;

/// Mean absolute difference of two images in some columns, in steps of 8 bits.
fn difference(a: &[u8], b: &[u8], columns: Range<u32>) -> f32 {
    assert_eq!((a.len(), b.len()), ((size().x * size().y * 4) as usize, a.len()));
    let is_inside = |index: &usize| columns.contains(&(*index as u32 / 4 % size().x)) && index % 4 != 3;
    let differences = (0..a.len()).filter(is_inside).map(|i| f32::from(a[i].abs_diff(b[i])));
    let count = columns.len() as f32 * size().y as f32 * 3.0;
    differences.sum::<f32>() / count
}

#[test]
#[ignore = "long: another app and its shaders"]
fn facing_mirrors() {
    let mut example = start!(facing_mirrors);
    let one = example.image_after(KeyCode::Digit1, "1-bounce");
    let two = example.image_after(KeyCode::Digit2, "2-bounces");
    let four = example.image_after(KeyCode::Digit3, "4-bounces");
    let eight = example.image_after(KeyCode::Digit4, "8-bounces");
    // Each row of rooms is smaller than the one before.
    example.assert_differs("two bounces instead of one", &one, &two, 2.0);
    example.assert_differs("four instead of two", &two, &four, 0.5);
    example.assert_differs("eight instead of four", &four, &eight, 0.1);
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: 10,000 lights"]
fn many_lights() {
    let mut example = start!(many_lights);
    let thousand = example.image_after(KeyCode::Space, "1008-lanterns");
    let few = example.image_after(KeyCode::Digit1, "16-lanterns");
    example.assert_differs("16 lanterns instead of 1,008", &thousand, &few, 1.0);
    example.press(KeyCode::Digit3);
    example.image("10000-lanterns");
    example.press(KeyCode::Digit2);
    example.assert_reflects(1.0);
}

#[test]
fn minimal() {
    let mut example = start!(minimal);
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn moving_objects() {
    let mut example = start!(moving_objects);
    example.app.step(30);
    let half_a_second = example.image("moving");
    example.app.step(30);
    let second = example.image("moving");
    example.assert_differs("half a second later", &half_a_second, &second, 5.0);
    example.press(KeyCode::Space);
    // The history still contains the objects that moved.
    example.app.step(75);
    let stopped = example.image("stopped");
    example.app.step(15);
    let later = example.image("later");
    // Only the noise of many small lamps is left.
    let noise = difference(&stopped, &later, 0..size().x);
    println!("with the clock stopped: {noise:.2}");
    assert!(noise < 1.5, "with the clock stopped the image changes by {noise}");
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn character() {
    let mut example = start!(character);
    example.app.step(30);
    let half_a_second = example.image("walking");
    assert_eq!(example.report().posed_instances, 1);
    example.press(KeyCode::Space);
    let posed = example.image("posed");
    example.assert_differs("a few steps later", &half_a_second, &posed, 0.2);
    example.press(KeyCode::KeyP);
    // The history still contains the other pose.
    example.app.step(60);
    let rigid = example.image("rigid");
    assert_eq!(example.report().posed_instances, 0);
    example.press(KeyCode::KeyP);
    example.app.step(60);
    let again = example.image("posed-again");
    // The part of the mirror that shows the figure. Some noise is left on the floor.
    let [change, noise] =
        [&rigid, &again].map(|image| difference(&posed, image, size().x * 57 / 160..size().x * 71 / 160));
    println!("in its bind pose: {change:.2}, posed again: {noise:.2}");
    assert!(change > 2.0 * noise, "{change} in its bind pose, {noise} posed again");
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn reflection_methods() {
    let mut example = start!(reflection_methods);
    let traced = example.image("traced");
    let truth = example.image_after(KeyCode::Digit4, "truth");
    let off = example.image_after(KeyCode::Digit1, "off");
    let screen_space = example.image_after(KeyCode::Digit2, "screen_space");
    let traced_again = example.image_after(KeyCode::Digit3, "traced_again");
    example.assert_differs("environment map", &traced, &off, 5.0);
    example.assert_differs("screen space", &traced, &screen_space, 5.0);
    example.assert_differs("screen space instead of nothing", &off, &screen_space, 1.0);
    let [error, error_off, error_screen_space] =
        [&traced, &off, &screen_space].map(|image| difference(image, &truth, 0..size().x));
    println!("errors: {error:.2} traced, {error_off:.2} off, {error_screen_space:.2} screen space");
    assert!(2.0 * error < error_off && 2.0 * error < error_screen_space);
    let again = difference(&traced, &traced_again, 0..size().x);
    assert!(again < error.max(1.0), "traced once more it differs by {again}");
}

#[test]
#[ignore = "long: another app and its shaders"]
fn shading_rates() {
    let mut example = start!(shading_rates);
    _ = example.image_after(KeyCode::Digit5, "adaptive");
    let combined = example.image_after(KeyCode::Digit4, "combined");
    let uniform = example.image_after(KeyCode::Digit1, "uniform");
    let roughness = example.image_after(KeyCode::Digit2, "roughness");
    let grazing = example.image_after(KeyCode::Digit3, "grazing");
    let combined_again = example.image_after(KeyCode::Digit4, "combined");
    let heat = example.image_after(KeyCode::KeyV, "rays");
    _ = example.image_after(KeyCode::KeyV, "on");
    let right = size().x / 2..size().x;
    // Rates are on the right.
    let pairs = [
        ("uniform", &combined, &uniform),
        ("roughness", &uniform, &roughness),
        ("grazing", &roughness, &grazing),
        ("combined", &grazing, &combined_again),
        ("rays", &combined_again, &heat),
    ];
    for (what, before, after) in pairs {
        let found = difference(before, after, right.clone());
        println!("{what}: {found:.2}");
        assert!(found > 3.0, "{what} changes rates by {found}");
    }
    assert!(difference(&combined, &combined_again, right) < 1.0);
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn split_screen() {
    let mut example = start!(split_screen);
    let halves = [0..size().x / 2, size().x / 2..size().x];
    let both = example.image("both");
    example.press(KeyCode::Digit1);
    let right = example.image("right");
    let [changed, same] = halves.clone().map(|half| difference(&both, &right, half));
    println!("the left player's key: {changed:.2} left, {same:.2} right");
    assert!(changed > 2.0 && same < 1.0);
    // From low to medium.
    example.press(KeyCode::Digit4);
    let medium = example.image("medium");
    let [same, changed] = halves.clone().map(|half| difference(&right, &medium, half));
    println!("another preset on the right: {same:.2} left, {changed:.2} right");
    assert!(changed > 0.2 && same < SAME);
    example.press(KeyCode::Digit2);
    example.press(KeyCode::Digit1);
    let left = example.image("left");
    let [same, changed] = halves.map(|half| difference(&both, &left, half));
    println!("the other way round: {same:.2} left, {changed:.2} right");
    assert!(changed > 2.0 && same < 0.5);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn custom_heuristic() {
    let mut example = start!(custom_heuristic);
    let shader = example.image_after(KeyCode::Digit1, "shader");
    let image = example.image_after(KeyCode::Digit2, "image");
    let own = example.image_after(KeyCode::Digit3, "own");
    _ = example.image_after(KeyCode::KeyV, "on");
    for (what, a, b) in [("shader", &shader, &own), ("image", &image, &own)] {
        let found = difference(a, b, 0..size().x);
        println!("{what}: {found:.2}");
        assert!(found > 3.0, "{what}: {found}");
    }
    example.assert_reflects(1.0);
}

#[test]
fn glass_and_water() {
    let mut example = start!(glass_and_water);
    let images = ["traced", "opaque-alone"];
    example.assert_key_changes(KeyCode::Space, "glass and water without rays", images, 1.0);
    example.press(KeyCode::Space);
    example.assert_reflects(1.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn water_material() {
    let mut example = start!(water_material);
    assert_eq!(example.report().unseen, []);
    example.assert_key_changes(KeyCode::Space, "water without waves", ["waves", "flat"], 1.0);
    example.press(KeyCode::Space);
    example.assert_reflects(1.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn custom_material() {
    let mut example = start!(custom_material);
    assert_eq!(example.report().unseen, []);
    example.assert_key_changes(KeyCode::Space, "the coarse mesh", ["dense", "coarse"], 0.1);
    example.assert_reflects(2.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn wind() {
    let mut example = start!(wind);
    example.press(KeyCode::Space);
    let still = example.image("still-in-the-water");
    assert_eq!(example.report().posed_instances, 0);
    example.press(KeyCode::Space);
    example.app.step(3);
    assert_eq!(example.report().posed_instances, 5);
    let swaying = example.image("on");
    example.assert_differs("plants that stand still in the water", &swaying, &still, 0.5);
    example.assert_reflects(1.0);
}

#[test]
#[ignore = "long: another app and its shaders"]
fn sparks() {
    let mut example = start!(sparks);
    let images = ["on", "not-in-the-floor"];
    example.assert_key_changes(KeyCode::Space, "a floor without sparks", images, 0.2);
    example.press(KeyCode::Space);
    example.assert_reflects(1.0);
}

#[cfg(feature = "egui")]
#[test]
#[ignore = "long: another app and its shaders"]
fn settings_panel() {
    let mut example = start!(settings_panel);
    example.assert_key_changes(KeyCode::F2, "the panel", ["open", "closed"], 10.0);
    example.assert_reflects(2.0);
}

#[cfg(feature = "egui")]
#[test]
#[ignore = "long: another app and its shaders"]
fn quality_menu() {
    use bevy_glint::ReflectionQuality;
    use quality_menu::{GameSettings, SettingsFile};

    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("example-quality_menu.txt");
    fs::write(
        &file,
        "volume = 0.5\nreflections = ultra\nlanguage = latin\nvolume = loud\n",
    )
    .expect("it can be written");
    let Some(mut example) = Example::start("quality_menu", quality_menu::plugin, |world| {
        world.insert_resource(SettingsFile(file.clone()));
    }) else {
        return;
    };
    let settings = example.app.world().resource::<GameSettings>();
    assert_eq!(
        (settings.volume, settings.reflections),
        (0.5, Some(ReflectionQuality::Ultra))
    );
    let open = example.image("open");
    let closed = example.image_after(KeyCode::Escape, "closed");
    example.assert_differs("the menu", &open, &closed, 3.0);
    // As the menu does.
    example.app.world().resource_mut::<GameSettings>().reflections = Some(ReflectionQuality::Off);
    example.app.step(2);
    assert_eq!(
        fs::read_to_string(&file).expect("it is saved"),
        "volume = 0.5\nreflections = off\n"
    );
    let off = example.image("off");
    example.assert_differs("the quality off", &closed, &off, 2.0);
    example.app.world().resource_mut::<GameSettings>().reflections = Some(ReflectionQuality::Low);
    example.app.step(2);
    example.assert_reflects(1.0);
    // As the button Auto does. A CPU doesn't reach any target, and is told to switch reflections off.
    example.app.world().resource_mut::<GameSettings>().reflections = None;
    let mut frames = 0..500;
    while frames.next().is_some() && example.app.world().resource::<GameSettings>().reflections.is_none() {
        example.app.step(1);
    }
    example.app.step(2);
    let chosen = example.app.world().resource::<GameSettings>().reflections;
    let chosen = chosen.expect("a quality was chosen");
    assert_eq!(
        fs::read_to_string(&file).expect("it is saved"),
        format!("volume = 0.5\nreflections = {chosen}\n")
    );
}

/// Users copy examples: one file each, of few lines, with only Bevy and this crate.
#[test]
fn examples_are_short_and_stand_alone() {
    const MOST_LINES: usize = 200;
    const CRATES: [&str; 4] = ["bevy", "bevy_egui", "bevy_glint", "std"];
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    for entry in fs::read_dir(folder).expect("there are examples") {
        let path = entry.expect("it can be read").path();
        let name = path.display();
        if path.ends_with("README.md") {
            continue;
        }
        assert!(
            path.extension().is_some_and(|end| end == "rs"),
            "{name} is no single file"
        );
        let text = fs::read_to_string(&path).expect("it is text");
        let lines = text.lines().count();
        assert!(lines <= MOST_LINES, "{name} has {lines} lines");
        for line in text.lines() {
            assert!(
                !line.starts_with("mod ") && !line.starts_with("#[path"),
                "{name}: {line}"
            );
            if let Some(import) = line.strip_prefix("use ") {
                let root = import.split([':', ';', ' ']).next().unwrap_or_default();
                assert!(CRATES.contains(&root), "{name}: {line}");
            }
        }
        // Included above, and so rendered.
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        assert!(
            include_str!("examples.rs").contains(&format!("mod {stem};")),
            "{name} has no test"
        );
    }
}
