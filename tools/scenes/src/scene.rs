//! The scenes by name.

use crate::{
    animation::set_time,
    atrium::{self, Richness},
    builder::SceneBuilder,
    camera_path::CameraPath,
    demo,
    environment::{Environment, SceneOptions},
    glass::{self, Finish},
    held_out::{arcade, bathroom, brushed, corridor, pedestal, pond, showroom},
    moving, shapes, small, street, temple,
};
use bevy::prelude::*;
use std::{error::Error, fmt};
use strum::{Display, EnumString, IntoStaticStr, VariantArray};

/// A scene that can be spawned. Its name is the variant's in lower case, with underscores or hyphens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Display, EnumString, IntoStaticStr, VariantArray)]
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
    pub const ALL: [SceneName; SceneName::VARIANTS.len()] = {
        let mut all = [SceneName::Demo; SceneName::VARIANTS.len()];
        all.copy_from_slice(SceneName::VARIANTS);
        all
    };

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
    let mut scene = SceneBuilder::new(world);
    (Recipe::of(name).spawn)(&mut scene, &options.clamped());
    let root = scene.finish();
    // Animated objects start at their places for time zero, with or without the animation.
    set_time(world, 0.0);
    root
}

/// Everything that makes a scene.
struct Recipe {
    path: CameraPath,
    environment: fn(&mut World) -> Environment,
    /// Spawns everything but the camera.
    spawn: fn(&mut SceneBuilder, &SceneOptions),
}

impl Recipe {
    const fn new(
        path: CameraPath,
        environment: fn(&mut World) -> Environment,
        spawn: fn(&mut SceneBuilder, &SceneOptions),
    ) -> Self {
        Self {
            path,
            environment,
            spawn,
        }
    }

    const fn of(scene: SceneName) -> Self {
        match scene {
            SceneName::Demo => Self::new(demo::PATH, demo::environment, demo::spawn),
            SceneName::Atrium => Self::new(atrium::PATH, atrium::environment, |scene, options| {
                atrium::spawn(scene, options, Richness::Rich);
            }),
            SceneName::AtriumSmall => Self::new(atrium::PATH, atrium::environment, |scene, options| {
                atrium::spawn(scene, options, Richness::Plain);
            }),
            SceneName::Temple => Self::new(temple::PATH, temple::environment, temple::spawn),
            SceneName::Street => Self::new(street::PATH, street::environment, street::spawn),
            SceneName::AtriumMoving => Self::new(atrium::PATH, atrium::environment, |scene, options| {
                atrium::spawn(scene, options, Richness::Rich);
                moving::add(scene, &moving::ATRIUM, options);
            }),
            SceneName::TempleMoving => Self::new(temple::PATH, temple::environment, |scene, options| {
                temple::spawn(scene, options);
                moving::add(scene, &moving::TEMPLE, options);
            }),
            SceneName::StreetMoving => Self::new(street::PATH, street::environment, |scene, options| {
                street::spawn(scene, options);
                moving::add(scene, &moving::STREET, options);
            }),
            SceneName::MirrorRoom => Self::new(small::MIRROR_ROOM_PATH, small::dark, small::mirror_room),
            SceneName::Furnace => Self::new(small::FURNACE_PATH, small::white, small::furnace),
            SceneName::EmissiveFloor => Self::new(small::EMISSIVE_FLOOR_PATH, small::dark, small::emissive_floor),
            SceneName::Shapes => Self::new(shapes::PATH, shapes::environment, shapes::spawn),
            SceneName::Glass => Self::new(glass::PATH, glass::environment, |scene, options| {
                glass::spawn(scene, options, Finish::Clear);
            }),
            SceneName::BlackGlass => Self::new(glass::PATH, glass::environment, |scene, options| {
                glass::spawn(scene, options, Finish::Opaque);
            }),
            SceneName::Arcade => Self::new(arcade::PATH, arcade::environment, arcade::spawn),
            SceneName::Brushed => Self::new(brushed::PATH, brushed::environment, brushed::spawn),
            SceneName::Bathroom => Self::new(bathroom::PATH, bathroom::environment, bathroom::spawn),
            SceneName::Pond => Self::new(pond::PATH, pond::environment, pond::spawn),
            SceneName::Showroom => Self::new(showroom::PATH, showroom::environment, showroom::spawn),
            SceneName::Corridor => Self::new(corridor::PATH, corridor::environment, corridor::spawn),
            SceneName::Pedestal => Self::new(pedestal::PATH, pedestal::environment, pedestal::spawn),
        }
    }
}

impl CameraPath {
    /// The path of a scene: a walk through the places, a loop in front of the small scenes. It starts at the scene's [`camera`].
    pub const fn of(scene: SceneName) -> Self {
        Recipe::of(scene).path
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
    (Recipe::of(name).environment)(world)
}

#[cfg(test)]
mod tests;
