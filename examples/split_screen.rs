//! Two players on one screen: each camera has its own viewport, settings and history, and can go without reflections.
//!
//! `cargo run --release --example split_screen`
//!
//! `cargo run --release --example split_screen -- --headless --left high --right off --out split_screen.png`
//!
//! | key | does |
//! | --- | --- |
//! | 1, 2 | reflections of the left player, of the right player, on or off |
//! | 3, 4 | the next preset for the left player, for the right player |
//! | Tab | the keys that fly and the mouse move the other player |

mod common;

use argh::FromArgs;
use bevy::{
    camera_controller::free_camera::{FreeCamera, FreeCameraState},
    prelude::*,
};
use bevy_glint::{Backend, Preset, RayTracedReflections};
use common::{
    ReflectionOptions, Size, TechniqueWord, TracerWord,
    help::{self, Help, Keys},
    screen::{Column, fit_columns},
};
use glint_scenes::{HeadlessSettings, SceneAnimationPlugin, SceneName};
use std::{path::PathBuf, process::ExitCode};

const SCENE: SceneName = SceneName::Demo;
const KEYS: Keys = &[
    ("1, 2", "reflections of the left or right player on or off"),
    ("3, 4", "next preset of the left or right player"),
    ("Tab", "move the other player"),
];
/// Metres per second.
const SPEED: f32 = 3.0;

/// Show two players on one screen.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// off, paper, low, medium, high, ultra or the name of a technique (default: high)
    #[argh(option, default = "word(Preset::High)")]
    left: TechniqueWord,
    /// the same for the right player (default: low)
    #[argh(option, default = "word(Preset::Low)")]
    right: TechniqueWord,
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

/// The name of a preset as a word of the command line.
fn word(preset: Preset) -> TechniqueWord {
    preset.name().parse().unwrap_or_default()
}

/// A player: a camera, the settings of its reflections, and whether they are on.
#[derive(Component, Clone)]
struct Player {
    /// 0 is left, 1 is right.
    seat: u32,
    reflections: ReflectionOptions,
    is_on: bool,
}

impl Player {
    /// Switches the camera's reflections on or off. With the component goes all that it used.
    fn apply(&self, camera: &mut EntityWorldMut) {
        camera.remove::<RayTracedReflections>();
        if self.is_on {
            common::reflection_camera(camera, &self.reflections);
        }
    }

    fn next_preset(&mut self) {
        let present = Preset::ALL
            .into_iter()
            .position(|preset| word(preset) == self.reflections.technique);
        let next = present.map_or(0, |index| (index + 1) % Preset::ALL.len());
        self.reflections.technique = word(Preset::ALL[next]);
        self.is_on = true;
    }

    fn describe(&self) -> String {
        if self.is_on {
            self.reflections.technique.to_string()
        } else {
            TechniqueWord::OFF.to_owned()
        }
    }
}

impl Arguments {
    fn players(&self) -> [Player; 2] {
        [(0, &self.left), (1, &self.right)].map(|(seat, technique)| Player {
            seat,
            is_on: !technique.is_off(),
            reflections: ReflectionOptions {
                technique: if technique.is_off() {
                    TechniqueWord::default()
                } else {
                    technique.clone()
                },
                tracer: self.tracer,
                backend: self.backend,
            },
        })
    }
}

/// Makes a camera a player's.
fn set_up_camera(world: &mut World, camera: Entity, player: Player) {
    let environment = glint_scenes::environment(SCENE, world);
    let position = [Vec3::new(-0.9, 1.8, 8.5), Vec3::new(3.4, 1.5, 5.2)][player.seat as usize];
    let target = [Vec3::new(0.15, 1.22, 0.0), Vec3::new(-1.6, 0.9, -1.0)][player.seat as usize];
    let mut camera = world.entity_mut(camera);
    camera.insert((
        Camera {
            order: player.seat as isize,
            ..default()
        },
        Column {
            index: player.seat,
            count: 2,
        },
        Transform::from_translation(position).looking_at(target, Vec3::Y),
        Projection::from(PerspectiveProjection {
            fov: 48f32.to_radians(),
            ..default()
        }),
    ));
    environment.insert(&mut camera);
    player.apply(&mut camera);
    camera.insert(player);
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
    let [left, right] = arguments.players();
    let device = left.reflections.clone();
    let mut app = common::headless_app(settings, &device, |app| {
        app.add_plugins(SceneAnimationPlugin).add_systems(Update, fit_columns);
        common::add_reflections(app, &device);
    })?;
    glint_scenes::spawn(SCENE, app.world());
    for player in [left, right] {
        let camera = app.spawn_camera(());
        set_up_camera(app.world(), camera, player);
    }
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "split_screen")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let players = arguments.players();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("split_screen", size, &players[0].reflections)?;
    app.add_plugins(SceneAnimationPlugin)
        .add_systems(Update, (fit_columns, press_keys, change_pilot));
    common::add_reflections(&mut app, &players[0].reflections);
    help::add(&mut app, "split_screen", KEYS);
    app.add_systems(Startup, move |world: &mut World| {
        glint_scenes::spawn(SCENE, world);
        for player in players.clone() {
            let camera = world.spawn(common::view_camera()).id();
            let is_pilot = player.seat == 0;
            set_up_camera(world, camera, player);
            if is_pilot {
                world.entity_mut(camera).insert(common::fly(SPEED));
            }
        }
    });
    common::run(app)
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    mut players: Query<(Entity, &mut Player)>,
    mut help: ResMut<Help>,
    mut commands: Commands,
) {
    let mut states = [String::new(), String::new()];
    for (camera, mut player) in &mut players {
        let seat = player.seat as usize;
        let switch = keyboard.just_pressed([KeyCode::Digit1, KeyCode::Digit2][seat]);
        let preset = keyboard.just_pressed([KeyCode::Digit3, KeyCode::Digit4][seat]);
        if switch {
            player.is_on = !player.is_on;
        }
        if preset {
            player.next_preset();
        }
        if switch || preset {
            let player = player.clone();
            commands
                .entity(camera)
                .queue(move |mut camera: EntityWorldMut| player.apply(&mut camera));
        }
        states[seat] = player.describe();
    }
    help::say(&mut help, states.join(" and "));
}

/// Bevy's controller moves the one camera that has it.
fn change_pilot(
    keyboard: Res<ButtonInput<KeyCode>>,
    pilot: Single<Entity, (With<Player>, With<FreeCamera>)>,
    other: Single<Entity, (With<Player>, Without<FreeCamera>)>,
    mut commands: Commands,
) {
    if keyboard.just_pressed(KeyCode::Tab) {
        commands.entity(*pilot).remove::<(FreeCamera, FreeCameraState)>();
        commands.entity(*other).insert(common::fly(SPEED));
    }
}
