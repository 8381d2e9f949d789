//! The scenes built from code, in a window or as a picture.
//!
//! `cargo run --release --example demo -- --headless --out demo.png`

mod common;

use argh::FromArgs;
use bevy::prelude::*;
use bevy_glint::Backend;
use common::{ReflectionOptions, Size, TechniqueWord, TracerWord};
use glint_scenes::{
    CameraPath, HeadlessSettings, SceneAnimationPlugin, SceneName, SceneOptions, camera, environment, spawn_with,
};
use std::{path::PathBuf, process::ExitCode};

/// What a picture shows if nothing else is said: clean after few frames, so that a CPU can render it, too.
const PICTURE: &str = "ultra";
const PICTURE_SIZE: UVec2 = UVec2::new(960, 540);
/// As many frames as the longest history holds.
const PICTURE_FRAMES: u32 = 32;

/// Show a scene with ray-traced reflections.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// demo, atrium, `atrium_small`, temple, street, `mirror_room`, furnace or `emissive_floor`
    #[argh(option, default = "SceneName::Demo")]
    scene: SceneName,
    /// off, reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, converged, paper, low, medium, high or
    /// ultra (default: medium in a window, ultra for a picture)
    #[argh(option)]
    technique: Option<TechniqueWord>,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels (default: 1280x720 in a window, 960x540 for a picture, which a CPU can render, too)
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken (default: 32; converged wants hundreds)
    #[argh(option, default = "PICTURE_FRAMES")]
    frames: u32,
    /// fineness of curved parts, 0.25 to 8
    #[argh(option, default = "1.0")]
    detail: f32,
    /// where the camera of a picture is on the scene's path, 0 to 1
    #[argh(option)]
    path: Option<f32>,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
}

impl Arguments {
    fn technique(&self) -> TechniqueWord {
        let word = if self.headless {
            PICTURE.parse::<TechniqueWord>().unwrap_or_default()
        } else {
            TechniqueWord::default()
        };
        self.technique.clone().unwrap_or(word)
    }

    fn size(&self) -> UVec2 {
        let default = if self.headless {
            PICTURE_SIZE
        } else {
            UVec2::new(1280, 720)
        };
        self.size.map_or(default, |size| size.0)
    }

    fn reflections(&self) -> ReflectionOptions {
        ReflectionOptions {
            technique: self.technique(),
            tracer: self.tracer,
            backend: self.backend,
        }
    }

    fn options(&self) -> SceneOptions {
        SceneOptions {
            detail: self.detail,
            ..default()
        }
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
        size: arguments.size(),
        log: true,
        ..default()
    };
    let reflections = arguments.reflections();
    let mut app = common::headless_app(settings, &reflections, |app| {
        app.add_plugins(SceneAnimationPlugin);
        common::add_reflections(app, &reflections);
    })?;
    let camera = app.spawn_scene(arguments.scene, &arguments.options());
    common::reflection_camera(&mut app.world().entity_mut(camera), &reflections);
    if let Some(t) = arguments.path {
        let path = CameraPath::of(arguments.scene);
        app.world().entity_mut(camera).insert(path.pose(t * path.seconds));
    }
    app.warm_up(4000).map_err(|error| error.to_string())?;
    common::wait_for_scene(&mut app, &arguments.technique());
    app.step(arguments.frames.max(1));
    let path = arguments
        .out
        .clone()
        .unwrap_or_else(|| common::default_picture(arguments.scene.as_str()));
    app.save(&path).map_err(|error| error.to_string())?;
    println!("wrote {}", path.display());
    Ok(())
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let mut app = common::windowed_app("bevy_glint", arguments.size(), &reflections)?;
    app.add_plugins(SceneAnimationPlugin);
    common::add_reflections(&mut app, &reflections);
    let arguments = arguments.clone();
    app.add_systems(Startup, move |world: &mut World| {
        spawn_with(arguments.scene, world, &arguments.options());
        let (transform, projection) = camera(arguments.scene);
        let environment = environment(arguments.scene, world);
        let mut camera = world.spawn((common::window_camera(3.0), transform, Projection::from(projection)));
        environment.insert(&mut camera);
        common::reflection_camera(&mut camera, &reflections);
    });
    common::run(app)
}
