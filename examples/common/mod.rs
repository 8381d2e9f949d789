//! What the examples share: the command line's vocabulary and the one place where the reflections are switched on.

#![allow(dead_code, reason = "each example uses a part")]

pub mod help;
pub mod screen;

use bevy::{
    camera::{Camera3d, Hdr},
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass},
        tonemapping::DebandDither,
    },
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
};
use bevy_glint::{
    Backend, RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, TECHNIQUE_NAMES, TracerChoice,
    named_settings,
};
use glint_scenes::{HeadlessApp, HeadlessSettings};
use std::{
    fmt,
    path::{Path, PathBuf},
    process::ExitCode,
    str::FromStr,
};

/// The folder that assets are loaded from, wherever the example is started.
pub const ASSETS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets");

/// Declares an enum whose variants are words on the command line.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $($variant:ident = $word:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub enum $name { #[default] $($variant),+ }

        impl FromStr for $name {
            type Err = String;

            fn from_str(word: &str) -> Result<Self, String> {
                match word {
                    $($word => Ok(Self::$variant),)+
                    _ => Err(format!("'{word}' is none of: {}", [$($word),+].join(", "))),
                }
            }
        }
    };
}

words!(/** What traces the rays. */ TracerWord { Auto = "auto", RayQuery = "ray-query", Bvh = "bvh" });

/// How reflections are computed: a name that [`named_settings`] knows, or `off`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TechniqueWord(String);

impl TechniqueWord {
    /// No reflections but those of the environment map.
    pub const OFF: &str = "off";

    /// The average over frames of a still camera.
    pub fn converged() -> Self {
        Self("converged".to_owned())
    }

    pub fn is_converged(&self) -> bool {
        self.0 == "converged"
    }

    pub fn is_off(&self) -> bool {
        self.0 == Self::OFF
    }
}

impl Default for TechniqueWord {
    fn default() -> Self {
        Self("medium".to_owned())
    }
}

impl FromStr for TechniqueWord {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        if word != Self::OFF {
            named_settings(word).map_err(|_| format!("'{word}' is none of: off, {TECHNIQUE_NAMES}"))?;
        }
        Ok(Self(word.to_owned()))
    }
}

impl fmt::Display for TechniqueWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

/// What the command line says about the reflections.
#[derive(Clone, Debug, Default)]
pub struct ReflectionOptions {
    pub technique: TechniqueWord,
    pub tracer: TracerWord,
    pub backend: Backend,
}

/// Opens the device for the back end that was asked for; must come before Bevy's plugins. Without the crate feature
/// `hardware-vrs` the camera's own warning says what is missing.
fn open_device(app: &mut App, options: &ReflectionOptions) {
    #[cfg(feature = "hardware-vrs")]
    if options.backend == Backend::Hardware {
        app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
    }
    #[cfg(not(feature = "hardware-vrs"))]
    let _ = (app, options);
}

/// An app without a window; `add` adds what isn't Bevy's.
pub fn headless_app(
    settings: HeadlessSettings,
    options: &ReflectionOptions,
    add: impl FnOnce(&mut App),
) -> Result<HeadlessApp, String> {
    HeadlessApp::with_device(settings, |app| open_device(app, options), add).map_err(|error| error.to_string())
}

/// Adds the plugin.
pub fn add_reflections(app: &mut App, options: &ReflectionOptions) {
    let tracer = match options.tracer {
        TracerWord::Auto => TracerChoice::Auto,
        TracerWord::RayQuery => TracerChoice::RayQuery,
        TracerWord::Bvh => TracerChoice::Bvh,
    };
    app.add_plugins(RayTracedReflectionsPlugin { tracer });
}

/// Gives a camera its reflections.
pub fn reflection_camera(camera: &mut EntityWorldMut, options: &ReflectionOptions) {
    camera.insert((Hdr, Msaa::Off, DepthPrepass, DeferredPrepass));
    if let Ok((mut reflections, heuristic)) = named_settings(&options.technique.0) {
        reflections.backend = options.backend;
        camera.insert((reflections, heuristic));
    }
}

/// Meshes are built in the background: waits until rays can hit all of them. The ground truth is one of a moment.
pub fn wait_for_scene(app: &mut HeadlessApp, technique: &TechniqueWord) {
    settle(app);
    if technique.is_converged() {
        app.world().resource_mut::<Time<Virtual>>().pause();
    }
}

/// Renders with the clock standing still until rays can hit everything, then lets every history begin anew and the clock run: what
/// moves is where it was, however long that took.
pub fn settle(app: &mut HeadlessApp) {
    app.world().resource_mut::<Time<Virtual>>().pause();
    for _ in 0..10_000 {
        if !is_pending(app.world()) {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
        app.step(1);
    }
    // What was uploaded last is traced in the next frame.
    app.step(2);
    let world = app.world();
    for mut reflections in world.query::<&mut RayTracedReflections>().iter_mut(world) {
        reflections.reset = true;
    }
    world.resource_mut::<Time<Virtual>>().unpause();
}

/// A camera reflects, and rays can't hit everything yet.
fn is_pending(world: &mut World) -> bool {
    let is_wanted = world.query::<&RayTracedReflections>().iter(world).next().is_some();
    let report = world.resource::<ReflectionStatus>().report();
    is_wanted && report.tracer.is_some() && (!report.ready || report.meshes_pending > 0)
}

/// Renders until everything is loaded, compiled and can be hit by rays.
pub fn prepare(app: &mut HeadlessApp) -> Result<(), String> {
    app.warm_up(20_000).map_err(|error| error.to_string())?;
    settle(app);
    Ok(())
}

/// Writes the picture and says where it is.
pub fn save(app: &HeadlessApp, out: Option<&Path>, name: &str) -> Result<(), String> {
    let path = picture_path(out, name);
    app.save(&path).map_err(|error| error.to_string())?;
    println!("wrote {}", path.display());
    Ok(())
}

/// Where the picture goes: as the command line says, else named after the example.
pub fn picture_path(out: Option<&Path>, name: &str) -> PathBuf {
    out.map_or_else(|| default_picture(name), Path::to_path_buf)
}

/// The size that was asked for, else that of a window, or of a picture that a CPU can render, too.
pub fn size_or_default(size: Option<Size>, headless: bool) -> UVec2 {
    let default = if headless {
        UVec2::new(640, 360)
    } else {
        UVec2::new(1280, 720)
    };
    size.map_or(default, |size| size.0)
}

/// A size such as `1920x1080`.
#[derive(Clone, Copy, Debug)]
pub struct Size(pub UVec2);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split_once(['x', 'X'])
            .and_then(|(w, h)| Some(UVec2::new(w.trim().parse().ok()?, h.trim().parse().ok()?)))
            .filter(|size| size.min_element() >= 1 && size.max_element() <= 16_384)
            .map(Size)
            .ok_or_else(|| format!("'{text}' is not a size such as 1280x720 (each between 1 and 16384)"))
    }
}

/// An app with a window and a camera to fly with.
pub fn windowed_app(title: &str, size: UVec2, options: &ReflectionOptions) -> Result<App, String> {
    let unix = cfg!(all(unix, not(target_os = "macos")));
    if unix && std::env::var_os("DISPLAY").is_none() && std::env::var_os("WAYLAND_DISPLAY").is_none() {
        return Err("there is no display to open a window on; pass --headless --out FILE.png for a picture".to_owned());
    }
    let window = Window {
        title: title.to_owned(),
        resolution: (size.x, size.y).into(),
        ..default()
    };
    let mut app = App::new();
    open_device(&mut app, options);
    app.add_plugins((
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: Some(window),
                ..default()
            })
            .set(AssetPlugin {
                file_path: ASSETS.to_owned(),
                unapproved_path_mode: bevy::asset::UnapprovedPathMode::Allow,
                ..default()
            }),
        FreeCameraPlugin,
    ))
    .insert_resource(DefaultOpaqueRendererMethod::deferred());
    Ok(app)
}

/// The camera of a window; `speed` in metres per second.
pub fn window_camera(speed: f32) -> impl Bundle {
    (view_camera(), fly(speed))
}

/// A camera of a window that nothing moves. It draws deferred, with or without reflections.
pub fn view_camera() -> impl Bundle {
    let prepasses = (DepthPrepass, DeferredPrepass);
    (Camera3d::default(), Hdr, Msaa::Off, DebandDither::Enabled, prepasses)
}

/// Lets a camera fly; `speed` in metres per second. Bevy's controller moves one camera of an app.
pub fn fly(speed: f32) -> FreeCamera {
    FreeCamera {
        walk_speed: speed,
        run_speed: 4.0 * speed,
        ..default()
    }
}

/// Where a picture goes when nothing is said.
pub fn default_picture(name: &str) -> PathBuf {
    PathBuf::from(format!("{name}.png"))
}

/// Says what went wrong in one sentence.
pub fn report(result: Result<(), String>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("error: {reason}");
            ExitCode::FAILURE
        }
    }
}

/// Runs an app with a window until it is closed.
pub fn run(mut app: App) -> Result<(), String> {
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(_) => Err("the app ended with an error".to_owned()),
    }
}
