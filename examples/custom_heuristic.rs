//! Heuristics of one's own: foveated rendering, with full rate where somebody looks and fewer rays everywhere else, in two ways.
//!
//! - *shader*: `assets/shaders/foveated.wesl` decides for each tile, from its place and from what the library knows of it. It is built
//!   on `bevy_glint::rate::tile`.
//! - *image*: a texture holds the rate of each tile. In a window the fovea follows the mouse; in a picture it is in the middle.
//!
//! `cargo run --release --example custom_heuristic`
//!
//! `cargo run --release --example custom_heuristic -- --headless --rates --heuristic image --out custom_heuristic.png`
//!
//! | key | does |
//! | --- | --- |
//! | 1, 2, 3 | rates of the shader, of the image, of the library's own heuristic |
//! | V | shading rates in colours, or the picture |

mod common;

use argh::FromArgs;
use bevy::{
    asset::RenderAssetUsages,
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
    window::PrimaryWindow,
};
use bevy_glint::{Backend, DebugView, RateTileSize, ShadingRate, ShadingRateHeuristic, Technique};
use common::{
    ReflectionOptions, Size, TechniqueWord, TracerWord,
    help::{self, Help, Keys},
};
use glint_scenes::{HeadlessSettings, SceneAnimationPlugin, SceneName, SceneOptions};
use std::{path::PathBuf, process::ExitCode, str::FromStr};

const SCENE: SceneName = SceneName::Demo;
const SHADER: &str = "shaders/foveated.wesl";
const KEYS: Keys = &[
    ("1", "rates of a shader"),
    ("2", "rates of an image, around the mouse"),
    ("3", "rates of the library"),
    ("V", "shading rates or picture"),
];

/// Show heuristics of one's own.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// show shading rates as colours
    #[argh(switch)]
    rates: bool,
    /// shader, image or combined (default: shader)
    #[argh(option, default = "Choice::Shader")]
    heuristic: Choice,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels (default: 1280x720 in a window, 640x360 for a picture)
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken
    #[argh(option, default = "16")]
    frames: u32,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
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

    fn view(&self) -> DebugView {
        if self.rates {
            DebugView::ShadingRates
        } else {
            DebugView::Off
        }
    }
}

/// Who decides about rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Choice {
    Shader,
    Image,
    Combined,
}

impl Choice {
    const ALL: [Self; 3] = [Self::Shader, Self::Image, Self::Combined];

    fn name(self) -> &'static str {
        match self {
            Self::Shader => "shader",
            Self::Image => "image",
            Self::Combined => "combined",
        }
    }

    fn key(self) -> KeyCode {
        match self {
            Self::Shader => KeyCode::Digit1,
            Self::Image => KeyCode::Digit2,
            Self::Combined => KeyCode::Digit3,
        }
    }
}

impl FromStr for Choice {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|choice| choice.name() == word)
            .ok_or_else(|| format!("'{word}' is none of: {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// The user's own heuristics. The handles keep them loaded.
#[derive(Resource)]
struct Heuristics {
    shader: Handle<Shader>,
    image: Handle<Image>,
    /// What the image was made for: the size of the picture and the pixel that somebody looks at.
    made_for: (UVec2, UVec2),
}

impl Heuristics {
    /// Loads the shader and makes an image for a picture of that size.
    fn load(world: &mut World, size: UVec2) -> Self {
        let made_for = (size, size / 2);
        Self {
            shader: world.resource::<AssetServer>().load(SHADER),
            image: world
                .resource_mut::<Assets<Image>>()
                .add(rate_image(made_for.0, made_for.1)),
            made_for,
        }
    }

    /// The camera's component.
    fn component(&self, choice: Choice) -> ShadingRateHeuristic {
        match choice {
            Choice::Shader => ShadingRateHeuristic::Custom(self.shader.clone()),
            Choice::Image => ShadingRateHeuristic::Image(self.image.clone()),
            Choice::Combined => ShadingRateHeuristic::default(),
        }
    }
}

/// One texel for each tile of a picture: full rate around a pixel, coarser and coarser away from it.
fn rate_image(size: UVec2, fovea: UVec2) -> Image {
    let tile = Technique::Variable.trace_scale() * RateTileSize::default().trace_pixels();
    let tiles = (size + (tile - 1)) / tile;
    let mut texels = Vec::new();
    for y in 0..tiles.y {
        for x in 0..tiles.x {
            let center = (UVec2::new(x, y).as_vec2() + 0.5) * tile as f32;
            let eccentricity = center.distance(fovea.as_vec2()) / size.min_element() as f32;
            let rate = match eccentricity {
                near if near < 0.25 => ShadingRate::R1x1,
                near if near < 0.4 => ShadingRate::R2x1,
                near if near < 0.6 => ShadingRate::R2x2,
                far if far < 0.8 => ShadingRate::R4x2,
                _ => ShadingRate::R4x4,
            };
            texels.push(rate.code() as u8);
        }
    }
    let extent = Extent3d {
        width: tiles.x,
        height: tiles.y,
        depth_or_array_layers: 1,
    };
    Image::new(
        extent,
        TextureDimension::D2,
        texels,
        TextureFormat::R8Uint,
        RenderAssetUsages::default(),
    )
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
        assets: Some(common::ASSETS.to_owned()),
        log: true,
        ..default()
    };
    let reflections = arguments.reflections();
    let mut app = common::headless_app(settings, &reflections, |app| {
        app.add_plugins(SceneAnimationPlugin);
        common::add_reflections(app, &reflections);
    })?;
    let size = app.size();
    let camera = app.spawn_scene(SCENE, &SceneOptions::default());
    let heuristics = Heuristics::load(app.world(), size);
    let mut entity = app.world().entity_mut(camera);
    common::reflection_camera(&mut entity, &reflections);
    entity.insert((heuristics.component(arguments.heuristic), arguments.view()));
    app.world().insert_resource(heuristics);
    common::prepare(&mut app)?;
    app.step(arguments.frames.max(1));
    common::save(&app, arguments.out.as_deref(), "custom_heuristic")
}

fn window(arguments: &Arguments) -> Result<(), String> {
    let reflections = arguments.reflections();
    let size = common::size_or_default(arguments.size, false);
    let mut app = common::windowed_app("custom_heuristic", size, &reflections)?;
    app.add_plugins(SceneAnimationPlugin)
        .add_systems(Update, (press_keys, follow_mouse));
    common::add_reflections(&mut app, &reflections);
    help::add(&mut app, "custom_heuristic", KEYS);
    let arguments = arguments.clone();
    app.add_systems(Startup, move |world: &mut World| {
        glint_scenes::spawn(SCENE, world);
        let (transform, projection) = glint_scenes::camera(SCENE);
        let environment = glint_scenes::environment(SCENE, world);
        let heuristics = Heuristics::load(world, size);
        let mut camera = world.spawn((common::window_camera(3.0), transform, Projection::from(projection)));
        environment.insert(&mut camera);
        common::reflection_camera(&mut camera, &reflections);
        camera.insert((heuristics.component(arguments.heuristic), arguments.view()));
        world.insert_resource(heuristics);
    });
    common::run(app)
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    camera: Single<(&mut ShadingRateHeuristic, &mut DebugView)>,
    heuristics: Res<Heuristics>,
    mut help: ResMut<Help>,
) {
    let (mut heuristic, mut view) = camera.into_inner();
    for choice in Choice::ALL {
        let component = heuristics.component(choice);
        if keyboard.just_pressed(choice.key()) {
            *heuristic = component.clone();
        }
        if *heuristic == component {
            help::say(&mut help, choice.name().to_owned());
        }
    }
    if keyboard.just_pressed(KeyCode::KeyV) {
        *view = match *view {
            DebugView::Off => DebugView::ShadingRates,
            _ => DebugView::Off,
        };
    }
}

/// Makes the image anew whenever the mouse has moved by half a tile or the window has another size.
fn follow_mouse(
    window: Single<&Window, With<PrimaryWindow>>,
    mut heuristics: ResMut<Heuristics>,
    mut images: ResMut<Assets<Image>>,
) {
    let size = window.physical_size().max(UVec2::ONE);
    let gaze = window
        .physical_cursor_position()
        .map_or(size / 2, |position| position.as_uvec2() / 16 * 16);
    if heuristics.made_for == (size, gaze) {
        return;
    }
    heuristics.made_for = (size, gaze);
    if let Some(mut image) = images.get_mut(&heuristics.image) {
        *image = rate_image(size, gaze);
    }
}
