//! The same camera without reflections, with Bevy's screen-space reflections, with ray-traced ones, and with the ground truth.
//!
//! `cargo run --release --example compare`
//!
//! `cargo run --release --example compare -- --headless --all --out compare.png` writes all four in two rows; without `--all` the
//! picture shows what `--method` says.
//!
//! The scene stands still, so that the ground truth can converge. Keys:
//!
//! | key | shows |
//! | --- | --- |
//! | 1 | off: the environment map alone |
//! | 2 | screen-space reflections |
//! | 3 | ray-traced reflections as `--technique` says |
//! | 4 | the ground truth: one ray for each pixel and frame, averaged while nothing moves |
//!
//! Without a camera that reflects, the library lets go of what rays hit: after 1 or 2 it is built anew, and the environment map is
//! shown until then.

mod common;

use argh::FromArgs;
use bevy::{pbr::ScreenSpaceReflections, prelude::*};
use bevy_glint::{Backend, RayTracedReflections, Technique};
use common::{
    ReflectionOptions, Size, TechniqueWord, TracerWord,
    help::{self, Help, Keys},
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SceneName, SceneOptions};
use std::{path::PathBuf, process::ExitCode, str::FromStr};

const KEYS: Keys = &[
    ("1", "off"),
    ("2", "screen space"),
    ("3", "ray-traced"),
    ("4", "ground truth"),
];

/// Compare kinds of reflections.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// write a picture of all four in two rows
    #[argh(switch)]
    all: bool,
    /// what is shown first: off, ssr, ours or truth (default: ours)
    #[argh(option, default = "Method::Traced")]
    method: Method,
    /// demo, atrium or another scene
    #[argh(option, default = "SceneName::Demo")]
    scene: SceneName,
    /// settings of the third: reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, paper, low, medium, high
    /// or ultra (default: medium)
    #[argh(option, default = "TechniqueWord::default()")]
    technique: TechniqueWord,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels (default: 1280x720 in a window, 640x360 for a picture); with --all rounded down to even numbers
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken
    #[argh(option, default = "16")]
    frames: u32,
    /// the same for the ground truth
    #[argh(option, default = "64")]
    truth_frames: u32,
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
}

/// Where reflections come from.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    Off,
    ScreenSpace,
    Traced,
    Truth,
}

impl Method {
    const ALL: [Self; 4] = [Self::Off, Self::ScreenSpace, Self::Traced, Self::Truth];

    fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::ScreenSpace => "ssr",
            Self::Traced => "ours",
            Self::Truth => "truth",
        }
    }

    fn key(self) -> KeyCode {
        match self {
            Self::Off => KeyCode::Digit1,
            Self::ScreenSpace => KeyCode::Digit2,
            Self::Traced => KeyCode::Digit3,
            Self::Truth => KeyCode::Digit4,
        }
    }

    /// Switches a camera over to this method. Screen-space and ray-traced reflections can't be on one camera at a time.
    fn apply(self, camera: &mut EntityWorldMut, options: &ReflectionOptions) {
        camera.remove::<(RayTracedReflections, ScreenSpaceReflections)>();
        match self {
            Self::Off => {}
            Self::ScreenSpace => {
                camera.insert(ScreenSpaceReflections::default());
            }
            Self::Traced => common::reflection_camera(camera, options),
            // Nothing is left out.
            Self::Truth => {
                camera.insert(RayTracedReflections {
                    technique: Technique::Converged,
                    roughness_cutoff: 1.0,
                    roughness_fade: 0.0,
                    ..default()
                });
            }
        }
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|method| method.name() == word)
            .ok_or_else(|| format!("'{word}' is none of: {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// What the keys switch on again.
#[derive(Resource)]
struct Options(ReflectionOptions);

fn main() -> ExitCode {
    let arguments: Arguments = argh::from_env();
    common::report(if arguments.headless {
        picture(&arguments)
    } else {
        window(&arguments)
    })
}

fn picture(arguments: &Arguments) -> Result<(), String> {
    let size = common::size_or_default(arguments.size, true);
    let settings = HeadlessSettings {
        size: if arguments.all {
            (size / 2).max(UVec2::ONE)
        } else {
            size
        },
        log: true,
        ..default()
    };
    let reflections = arguments.reflections();
    let mut app = common::headless_app(settings, &reflections, |app| common::add_reflections(app, &reflections))?;
    let camera = app.spawn_scene(arguments.scene, &SceneOptions::default());
    if !arguments.all {
        render(&mut app, camera, arguments.method, arguments)?;
        return common::save(&app, arguments.out.as_deref(), "compare");
    }
    let mut pictures = Vec::new();
    for method in Method::ALL {
        render(&mut app, camera, method, arguments)?;
        pictures.push(app.capture().map_err(|error| error.to_string())?);
    }
    let path = common::picture_path(arguments.out.as_deref(), "compare");
    let bytes = two_rows(app.size(), &pictures);
    glint_scenes::save_picture(app.size() * 2, bytes, &path).map_err(|error| error.to_string())?;
    println!("wrote {}", path.display());
    Ok(())
}

/// Renders with a method until its history is long enough. The clock stands still.
fn render(app: &mut HeadlessApp, camera: Entity, method: Method, arguments: &Arguments) -> Result<(), String> {
    method.apply(&mut app.world().entity_mut(camera), &arguments.reflections());
    common::prepare(app)?;
    app.world().resource_mut::<Time<Virtual>>().pause();
    let frames = match method {
        Method::Truth => arguments.truth_frames,
        _ => arguments.frames,
    };
    app.step(frames.max(1));
    Ok(())
}

/// Four pictures of one size as one: two above, two below.
fn two_rows(size: UVec2, pictures: &[Vec<u8>]) -> Vec<u8> {
    let line = size.x as usize * 4;
    let mut bytes = Vec::with_capacity(pictures.len() * line * size.y as usize);
    for row in pictures.chunks(2) {
        for y in 0..size.y as usize {
            for picture in row {
                bytes.extend_from_slice(&picture[y * line..(y + 1) * line]);
            }
        }
    }
    bytes
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("compare", size, &reflections)?;
    app.insert_resource(arguments.method)
        .insert_resource(Options(reflections.clone()))
        .add_systems(Update, press_keys);
    common::add_reflections(&mut app, &reflections);
    help::add(&mut app, "compare", KEYS);
    let arguments = arguments.clone();
    app.add_systems(Startup, move |world: &mut World| {
        glint_scenes::spawn(arguments.scene, world);
        let (transform, projection) = glint_scenes::camera(arguments.scene);
        let environment = glint_scenes::environment(arguments.scene, world);
        let mut camera = world.spawn((common::window_camera(3.0), transform, Projection::from(projection)));
        environment.insert(&mut camera);
        arguments.method.apply(&mut camera, &reflections);
    });
    common::run(app)
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    camera: Single<Entity, With<Camera3d>>,
    options: Res<Options>,
    mut present: ResMut<Method>,
    mut help: ResMut<Help>,
    mut commands: Commands,
) {
    for method in Method::ALL {
        if keyboard.just_pressed(method.key()) && method != *present {
            *present = method;
            let options = options.0.clone();
            commands
                .entity(*camera)
                .queue(move |mut camera: EntityWorldMut| method.apply(&mut camera, &options));
        }
    }
    help::say(&mut help, present.name().to_owned());
}
