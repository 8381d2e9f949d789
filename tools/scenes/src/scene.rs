//! The scenes by name.

use crate::{
    animation::Motion,
    atrium::{self, Richness},
    camera_path::CameraPath,
    demo,
    sky::Sky,
    small, street, temple,
};
use bevy::{
    asset::Assets,
    camera::{Camera, ClearColorConfig, Exposure, PerspectiveProjection},
    color::Color,
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    ecs::{
        entity::Entity,
        resource::Resource,
        world::{EntityWorldMut, World},
    },
    image::Image,
    light::{AmbientLight, EnvironmentMapLight, Skybox},
    transform::components::Transform,
};
use std::{error::Error, fmt, str::FromStr};

/// A scene that can be spawned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SceneName {
    /// Spheres and boxes of graded roughness and metalness on a polished floor between textured walls, with things that move.
    Demo,
    /// A two-storey colonnaded courtyard, richly carved and furnished: mostly rough stone and cloth, with thin metal; at least 250 thousand
    /// triangles.
    Atrium,
    /// The same courtyard with plain columns and little in it: at least 66 thousand triangles.
    AtriumSmall,
    /// A temple of polished floors and bronze: reflections nearly everywhere; at least 500 thousand triangles.
    Temple,
    /// A street after rain, full of windows and small things: millions of triangles by instancing.
    Street,
    /// A mirror floor below asymmetric unlit objects: its reflection is known exactly.
    MirrorRoom,
    /// White spheres of roughness 0 to 1, metal and dielectric, in a uniform white environment.
    Furnace,
    /// Emissive objects of black albedo over metal and dielectric floors of several roughnesses, without any other light.
    EmissiveFloor,
}

impl SceneName {
    /// Every scene.
    pub const ALL: [SceneName; 8] = [
        SceneName::Demo,
        SceneName::Atrium,
        SceneName::AtriumSmall,
        SceneName::Temple,
        SceneName::Street,
        SceneName::MirrorRoom,
        SceneName::Furnace,
        SceneName::EmissiveFloor,
    ];

    /// The name on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            SceneName::Demo => "demo",
            SceneName::Atrium => "atrium",
            SceneName::AtriumSmall => "atrium_small",
            SceneName::Temple => "temple",
            SceneName::Street => "street",
            SceneName::MirrorRoom => "mirror_room",
            SceneName::Furnace => "furnace",
            SceneName::EmissiveFloor => "emissive_floor",
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// The error of a name that is no scene's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownScene(String);

impl fmt::Display for UnknownScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = SceneName::ALL.map(SceneName::as_str).join(", ");
        write!(f, "there is no scene named '{}'; the scenes are {names}", self.0)
    }
}

impl Error for UnknownScene {}

impl FromStr for SceneName {
    type Err = UnknownScene;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let plain = |name: &str| name.trim().to_ascii_lowercase().replace('-', "_");
        Self::ALL
            .into_iter()
            .find(|scene| scene.as_str() == plain(name))
            .ok_or_else(|| UnknownScene(name.to_owned()))
    }
}

/// What can be chosen about a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// Fineness of curved parts: 1 gives each scene the triangles that its name promises. Clamped to 0.25..=8.
    pub detail: f32,
    /// Edge of procedural textures in texels, clamped to 4..=2048.
    pub texture_size: u32,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            detail: 1.0,
            texture_size: 512,
        }
    }
}

/// Spawns a scene with everything but the camera; returns the root, which carries [`SceneStatistics`](crate::SceneStatistics).
pub fn spawn(name: SceneName, world: &mut World) -> Entity {
    spawn_with(name, world, &SceneOptions::default())
}

/// Like [`spawn`], with options.
pub fn spawn_with(name: SceneName, world: &mut World, options: &SceneOptions) -> Entity {
    let options = SceneOptions {
        detail: if options.detail.is_finite() {
            options.detail.clamp(0.25, 8.0)
        } else {
            1.0
        },
        texture_size: options.texture_size.clamp(4, 2048),
    };
    let root = match name {
        SceneName::Demo => demo::spawn(world, &options),
        SceneName::Atrium => atrium::spawn(world, &options, Richness::Rich),
        SceneName::AtriumSmall => atrium::spawn(world, &options, Richness::Plain),
        SceneName::Temple => temple::spawn(world, &options),
        SceneName::Street => street::spawn(world, &options),
        SceneName::MirrorRoom => small::mirror_room(world),
        SceneName::Furnace => small::furnace(world),
        SceneName::EmissiveFloor => small::emissive_floor(world),
    };
    // Things that move start where they are at time zero, with or without the animation.
    for (motion, mut transform) in world.query::<(&Motion, &mut Transform)>().iter_mut(world) {
        motion.apply(0.0, &mut transform);
    }
    root
}

/// Where the camera of a scene stands, at the start of its path, and how it sees; the aspect ratio follows from the target.
pub fn camera(name: SceneName) -> (Transform, PerspectiveProjection) {
    let path = CameraPath::of(name);
    (
        path.pose(0.0),
        PerspectiveProjection {
            fov: path.vertical_degrees.to_radians(),
            near: 0.1,
            far: path.far,
            ..Default::default()
        },
    )
}

/// What the camera of a scene carries.
#[derive(Clone)]
pub struct Environment {
    /// Diffuse and specular light of the sky.
    pub light: Option<EnvironmentMapLight>,
    /// The visible sky; black without one.
    pub skybox: Option<Skybox>,
    /// Exposure of the camera.
    pub exposure: Exposure,
    /// How radiance becomes a picture.
    pub tonemapping: Tonemapping,
}

impl Environment {
    /// Puts the components on a camera. Ambient light is switched off: the environment map takes its place. Without a sky the background is
    /// black; dithering goes with the tone curve.
    pub fn insert(self, camera: &mut EntityWorldMut) {
        let ambient = AmbientLight {
            brightness: 0.0,
            ..Default::default()
        };
        let dither = if self.tonemapping == Tonemapping::None {
            DebandDither::Disabled
        } else {
            DebandDither::Enabled
        };
        camera.insert((self.exposure, self.tonemapping, dither, ambient));
        if self.skybox.is_none()
            && let Some(mut camera) = camera.get_mut::<Camera>()
        {
            camera.clear_color = ClearColorConfig::Custom(Color::BLACK);
        }
        if let Some(light) = self.light {
            camera.insert(light);
        }
        if let Some(skybox) = self.skybox {
            camera.insert(skybox);
        }
    }
}

/// Skies that were baked before, so that several cameras share them.
#[derive(Resource, Default)]
struct BakedSkies(Vec<(Sky, EnvironmentMapLight, Skybox)>);

/// A sky as the camera's light and background; `brightness` scales it to cd/m².
pub(crate) fn sky(world: &mut World, sky: Sky, brightness: f32) -> (EnvironmentMapLight, Skybox) {
    world.init_resource::<Assets<Image>>();
    world.init_resource::<BakedSkies>();
    world.resource_scope(|world, mut baked: bevy::ecs::change_detection::Mut<BakedSkies>| {
        if !baked.0.iter().any(|(other, ..)| *other == sky) {
            let mut images = world.resource_mut::<Assets<Image>>();
            let light = sky.environment(&mut images, brightness);
            let skybox = Skybox {
                image: Some(sky.background(&mut images)),
                brightness,
                ..Default::default()
            };
            baked.0.push((sky, light, skybox));
        }
        let (_, light, skybox) = baked.0.iter().find(|(other, ..)| *other == sky).cloned().unwrap_or((
            sky,
            EnvironmentMapLight::default(),
            Skybox::default(),
        ));
        (light.with_intensity(brightness), Skybox { brightness, ..skybox })
    })
}

/// The sky, exposure and tone mapping of a scene.
pub fn environment(name: SceneName, world: &mut World) -> Environment {
    match name {
        SceneName::Demo => demo::environment(world),
        SceneName::Atrium | SceneName::AtriumSmall => atrium::environment(world),
        SceneName::Temple => temple::environment(world),
        SceneName::Street => street::environment(world),
        SceneName::MirrorRoom | SceneName::Furnace | SceneName::EmissiveFloor => small::environment(name, world),
    }
}
