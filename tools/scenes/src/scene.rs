//! The scenes by name.

use crate::{
    animation::set_time,
    atrium::{self, Richness},
    camera_path::CameraPath,
    demo,
    environment::{Environment, SceneOptions},
    glass::{self, Finish},
    held_out::{arcade, bathroom, brushed, corridor, pedestal, pond, showroom},
    moving, shapes,
    sky::Sky,
    small, street, temple,
};
use bevy::{
    camera::PerspectiveProjection,
    ecs::{entity::Entity, world::World},
    transform::components::Transform,
};
use std::{error::Error, fmt};
use strum::{Display, EnumString, IntoStaticStr};

/// A scene that can be spawned. Its name is the variant's in lower case, with underscores or hyphens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Display, EnumString, IntoStaticStr)]
#[strum(serialize_all = "snake_case", ascii_case_insensitive)]
#[strum(parse_err_ty = UnknownScene, parse_err_fn = unknown_scene)]
pub enum SceneName {
    /// Spheres and boxes of graded roughness and metalness on a polished floor between textured walls, with moving objects.
    Demo,
    /// A two-storey colonnaded courtyard, richly carved and furnished: mostly rough stone and cloth, with thin metal; at least 250 thousand
    /// triangles.
    Atrium,
    /// The courtyard with plain columns and few objects: at least 66 thousand triangles.
    #[strum(to_string = "atrium_small", serialize = "atrium-small")]
    AtriumSmall,
    /// A temple of polished floors and bronze: reflections nearly everywhere; at least 500 thousand triangles.
    Temple,
    /// A street after rain, full of windows and small objects: millions of triangles by instancing.
    Street,
    /// The courtyard with people, a door, a swinging lamp, a flickering light and a rolling ball.
    #[strum(to_string = "atrium_moving", serialize = "atrium-moving")]
    AtriumMoving,
    /// The temple with the same.
    #[strum(to_string = "temple_moving", serialize = "temple-moving")]
    TempleMoving,
    /// The street with the same, and with traffic.
    #[strum(to_string = "street_moving", serialize = "street-moving")]
    StreetMoving,
    /// A mirror floor below asymmetric unlit objects: its reflection is known exactly.
    #[strum(to_string = "mirror_room", serialize = "mirror-room")]
    MirrorRoom,
    /// White spheres of roughness 0 to 1, metal and dielectric, in a uniform white environment.
    Furnace,
    /// Emissive objects of black albedo over metal and dielectric floors of several roughnesses, without any other light.
    #[strum(to_string = "emissive_floor", serialize = "emissive-floor")]
    EmissiveFloor,
    /// Shapes with normals that are hard on reflections, of several roughnesses: dielectrics, metals and clearcoats on a plain ground.
    Shapes,
    /// Windows, bottles and a pool before coloured objects.
    Glass,
    /// The surfaces of [`Self::Glass`], opaque and black.
    #[strum(to_string = "black_glass", serialize = "black-glass")]
    BlackGlass,
    /// A polished stone floor under a row of arches, in the sun.
    Arcade,
    /// Machine parts of brushed and cast metal under the lamps of a workshop.
    Brushed,
    /// Glossy wall tiles, chrome and a mirror.
    Bathroom,
    /// Dark water with waves, opaque, under trees.
    Pond,
    /// Cars with a clear coat under bright panels.
    Showroom,
    /// Many small lamps over a rough, worn floor.
    Corridor,
    /// A metal helmet before a matte wall: about 13 % of the image reflects.
    Pedestal,
}

impl SceneName {
    /// Every scene.
    pub const ALL: [SceneName; 21] = [
        SceneName::Demo,
        SceneName::Atrium,
        SceneName::AtriumSmall,
        SceneName::Temple,
        SceneName::Street,
        SceneName::AtriumMoving,
        SceneName::TempleMoving,
        SceneName::StreetMoving,
        SceneName::MirrorRoom,
        SceneName::Furnace,
        SceneName::EmissiveFloor,
        SceneName::Shapes,
        SceneName::Glass,
        SceneName::BlackGlass,
        SceneName::Arcade,
        SceneName::Brushed,
        SceneName::Bathroom,
        SceneName::Pond,
        SceneName::Showroom,
        SceneName::Corridor,
        SceneName::Pedestal,
    ];

    /// Scenes for judging settings that were tuned on other scenes.
    pub const HELD_OUT: [SceneName; 7] = [
        SceneName::Arcade,
        SceneName::Brushed,
        SceneName::Bathroom,
        SceneName::Pond,
        SceneName::Showroom,
        SceneName::Corridor,
        SceneName::Pedestal,
    ];

    /// The name on the command line.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// The error for an unknown name of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownScene(String);

fn unknown_scene(name: &str) -> UnknownScene {
    UnknownScene(name.to_owned())
}

impl fmt::Display for UnknownScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = SceneName::ALL.map(SceneName::as_str).join(", ");
        write!(f, "there is no scene named '{}'; the scenes are {names}", self.0)
    }
}

impl Error for UnknownScene {}

/// Spawns a scene with everything but the camera. Returns the root, which has [`SceneStatistics`](crate::SceneStatistics).
pub fn spawn(name: SceneName, world: &mut World) -> Entity {
    spawn_with(name, world, &SceneOptions::default())
}

/// Like [`spawn`], with options.
pub fn spawn_with(name: SceneName, world: &mut World, options: &SceneOptions) -> Entity {
    let options = options.clamped();
    let root = match name {
        SceneName::Demo => demo::spawn(world, &options),
        SceneName::Atrium => atrium::spawn(world, &options, Richness::Rich),
        SceneName::AtriumSmall => atrium::spawn(world, &options, Richness::Plain),
        SceneName::Temple => temple::spawn(world, &options),
        SceneName::Street => street::spawn(world, &options),
        SceneName::AtriumMoving | SceneName::TempleMoving | SceneName::StreetMoving => {
            let (place, cast) = match name {
                SceneName::TempleMoving => (SceneName::Temple, &moving::TEMPLE),
                SceneName::StreetMoving => (SceneName::Street, &moving::STREET),
                _ => (SceneName::Atrium, &moving::ATRIUM),
            };
            let root = spawn_with(place, world, &options);
            moving::add(world, root, cast, &options)
        }
        SceneName::MirrorRoom => small::mirror_room(world),
        SceneName::Furnace => small::furnace(world),
        SceneName::EmissiveFloor => small::emissive_floor(world),
        SceneName::Shapes => shapes::spawn(world, &options),
        SceneName::Glass => glass::spawn(world, &options, Finish::Clear),
        SceneName::BlackGlass => glass::spawn(world, &options, Finish::Opaque),
        SceneName::Arcade => arcade::spawn(world, &options),
        SceneName::Brushed => brushed::spawn(world, &options),
        SceneName::Bathroom => bathroom::spawn(world, &options),
        SceneName::Pond => pond::spawn(world, &options),
        SceneName::Showroom => showroom::spawn(world, &options),
        SceneName::Corridor => corridor::spawn(world, &options),
        SceneName::Pedestal => pedestal::spawn(world, &options),
    };
    // Animated objects start at their places for time zero, with or without the animation.
    set_time(world, 0.0);
    root
}

impl CameraPath {
    /// The path of a scene: a walk through the places, a loop in front of the small scenes. It starts at the scene's [`camera`].
    pub const fn of(scene: SceneName) -> Self {
        match scene {
            SceneName::Demo => demo::PATH,
            SceneName::Atrium | SceneName::AtriumSmall | SceneName::AtriumMoving => atrium::PATH,
            SceneName::Temple | SceneName::TempleMoving => temple::PATH,
            SceneName::Street | SceneName::StreetMoving => street::PATH,
            SceneName::MirrorRoom => small::MIRROR_ROOM_PATH,
            SceneName::Furnace => small::FURNACE_PATH,
            SceneName::EmissiveFloor => small::EMISSIVE_FLOOR_PATH,
            SceneName::Shapes => shapes::PATH,
            SceneName::Glass | SceneName::BlackGlass => glass::PATH,
            SceneName::Arcade => arcade::PATH,
            SceneName::Brushed => brushed::PATH,
            SceneName::Bathroom => bathroom::PATH,
            SceneName::Pond => pond::PATH,
            SceneName::Showroom => showroom::PATH,
            SceneName::Corridor => corridor::PATH,
            SceneName::Pedestal => pedestal::PATH,
        }
    }
}

/// Pose of a scene's camera at the start of its path, and its projection; the aspect ratio follows from the target.
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

/// The sky, exposure and tone mapping of a scene.
pub fn environment(name: SceneName, world: &mut World) -> Environment {
    match name {
        SceneName::Demo => demo::environment(world),
        SceneName::Atrium | SceneName::AtriumSmall | SceneName::AtriumMoving => atrium::environment(world),
        SceneName::Temple | SceneName::TempleMoving => temple::environment(world),
        SceneName::Street | SceneName::StreetMoving => street::environment(world),
        SceneName::Shapes => shapes::environment(world),
        SceneName::Glass | SceneName::BlackGlass => glass::environment(world),
        SceneName::Arcade => arcade::environment(world),
        SceneName::Brushed => brushed::environment(world),
        SceneName::Bathroom => bathroom::environment(world),
        SceneName::Pond => pond::environment(world),
        SceneName::Showroom => showroom::environment(world),
        SceneName::Corridor => corridor::environment(world),
        SceneName::Pedestal => pedestal::environment(world),
        SceneName::Furnace => small::environment(world, Some(Sky::White)),
        SceneName::MirrorRoom | SceneName::EmissiveFloor => small::environment(world, None),
    }
}

#[cfg(test)]
mod tests;
