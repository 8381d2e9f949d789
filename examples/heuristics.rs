//! Two cameras side by side, each with a heuristic of its own: the same picture, and where each of both spends its rays.
//!
//! `cargo run --release --example heuristics`
//!
//! `cargo run --release --example heuristics -- --headless --rates --left grazing --out heuristics.png`
//!
//! The left camera flies, the right one goes along. Keys:
//!
//! | key | does |
//! | --- | --- |
//! | 1, 2 | the next heuristic on the left, on the right |
//! | V | shading rates in colours ([`RATE_LEGEND`](bevy_glint::RATE_LEGEND) names them), or the picture |

mod common;

use argh::FromArgs;
use bevy::{camera_controller::free_camera::FreeCamera, prelude::*};
use bevy_glint::{
    Backend, CombinedThresholds, DebugView, GrazingThresholds, RoughnessThresholds, ShadingRate, ShadingRateHeuristic,
};
use common::{
    ReflectionOptions, Size, TechniqueWord, TracerWord,
    help::{self, Help, Keys},
    screen::{Column, fit_columns},
};
use glint_scenes::{HeadlessSettings, SceneAnimationPlugin, SceneName};
use std::{path::PathBuf, process::ExitCode};

const SCENE: SceneName = SceneName::Demo;
const KEYS: Keys = &[
    ("1", "next heuristic on the left"),
    ("2", "next heuristic on the right"),
    ("V", "shading rates or picture"),
];

/// Show two heuristics side by side.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// show shading rates as colours
    #[argh(switch)]
    rates: bool,
    /// uniform, roughness, grazing or combined (default: roughness)
    #[argh(option, default = "ShadingRateHeuristic::Roughness(RoughnessThresholds::default())")]
    left: ShadingRateHeuristic,
    /// the same for the right half (default: combined)
    #[argh(option, default = "ShadingRateHeuristic::default()")]
    right: ShadingRateHeuristic,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels of both halves together (default: 1280x720 in a window, 640x360 for a picture)
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken
    #[argh(option, default = "16")]
    frames: u32,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
}

/// A camera's half of the screen.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
enum Half {
    Left,
    Right,
}

impl Half {
    const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The key that changes its heuristic.
    fn key(self) -> KeyCode {
        match self {
            Self::Left => KeyCode::Digit1,
            Self::Right => KeyCode::Digit2,
        }
    }
}

impl Arguments {
    fn reflections(&self) -> ReflectionOptions {
        ReflectionOptions {
            // All defaults, with a variable rate.
            technique: TechniqueWord::default(),
            tracer: self.tracer,
            backend: self.backend,
        }
    }

    /// Makes a camera one of both.
    fn set_up_camera(&self, world: &mut World, camera: Entity, half: Half) {
        let (transform, projection) = glint_scenes::camera(SCENE);
        let environment = glint_scenes::environment(SCENE, world);
        let (heuristic, index) = match half {
            Half::Left => (&self.left, 0),
            Half::Right => (&self.right, 1),
        };
        let view = if self.rates {
            DebugView::ShadingRates
        } else {
            DebugView::Off
        };
        let mut camera = world.entity_mut(camera);
        camera.insert((
            Camera {
                order: index as isize,
                ..default()
            },
            Column { index, count: 2 },
            transform,
            Projection::from(projection),
            half,
        ));
        environment.insert(&mut camera);
        common::reflection_camera(&mut camera, &self.reflections());
        camera.insert((heuristic.clone(), view));
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
    let mut app = common::headless_app(settings, &reflections, |app| {
        app.add_plugins(SceneAnimationPlugin).add_systems(Update, fit_columns);
        common::add_reflections(app, &reflections);
    })?;
    glint_scenes::spawn(SCENE, app.world());
    for half in Half::BOTH {
        let camera = app.spawn_camera(());
        arguments.set_up_camera(app.world(), camera, half);
    }
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "heuristics")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("heuristics", size, &reflections)?;
    app.add_plugins(SceneAnimationPlugin)
        .add_systems(Update, (fit_columns, press_keys, go_along));
    common::add_reflections(&mut app, &reflections);
    help::add(&mut app, "heuristics", KEYS);
    let arguments = arguments.clone();
    app.add_systems(Startup, move |world: &mut World| {
        glint_scenes::spawn(SCENE, world);
        for half in Half::BOTH {
            let camera = world.spawn(common::view_camera()).id();
            arguments.set_up_camera(world, camera, half);
            if half == Half::Left {
                world.entity_mut(camera).insert(common::fly(3.0));
            }
        }
    });
    common::run(app)
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    mut cameras: Query<(&Half, &mut ShadingRateHeuristic, &mut DebugView)>,
    mut help: ResMut<Help>,
) {
    let mut names = ["", ""];
    for (half, mut heuristic, mut view) in &mut cameras {
        if keyboard.just_pressed(half.key()) {
            *heuristic = next(&heuristic);
        }
        if keyboard.just_pressed(KeyCode::KeyV) {
            *view = match *view {
                DebugView::Off => DebugView::ShadingRates,
                _ => DebugView::Off,
            };
        }
        names[*half as usize] = name(&heuristic);
    }
    help::say(&mut help, names.join(" and "));
}

/// The heuristics in turn, each with its default thresholds.
fn next(heuristic: &ShadingRateHeuristic) -> ShadingRateHeuristic {
    match heuristic {
        ShadingRateHeuristic::Uniform(_) => ShadingRateHeuristic::Roughness(RoughnessThresholds::default()),
        ShadingRateHeuristic::Roughness(_) => ShadingRateHeuristic::Grazing(GrazingThresholds::default()),
        ShadingRateHeuristic::Grazing(_) => ShadingRateHeuristic::Combined(CombinedThresholds::default()),
        _ => ShadingRateHeuristic::Uniform(ShadingRate::R1x1),
    }
}

fn name(heuristic: &ShadingRateHeuristic) -> &'static str {
    match heuristic {
        ShadingRateHeuristic::Uniform(_) => "uniform",
        ShadingRateHeuristic::Roughness(_) => "roughness",
        ShadingRateHeuristic::Grazing(_) => "grazing",
        ShadingRateHeuristic::Combined(_) => "combined",
        ShadingRateHeuristic::Custom(_) => "custom",
        ShadingRateHeuristic::Image(_) => "image",
    }
}

/// The right camera stays with the left one.
fn go_along(
    leader: Single<&Transform, With<FreeCamera>>,
    mut others: Query<&mut Transform, (With<Half>, Without<FreeCamera>)>,
) {
    for mut transform in &mut others {
        transform.set_if_neq(**leader);
    }
}
