//! The scenes by name.

use crate::{
    animation::Motion,
    atrium::{self, Richness},
    camera_path::{self, CameraPath},
    demo,
    environment::Environment,
    scene_name::{SceneName, SceneOptions},
    small, street, temple,
};
use bevy::{
    camera::PerspectiveProjection,
    ecs::{entity::Entity, world::World},
    transform::components::Transform,
};

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

impl CameraPath {
    /// The path of a scene: a way through the places, a loop in front of the little scenes. It starts where the scene's
    /// [`camera`] stands.
    pub const fn of(scene: SceneName) -> Self {
        match scene {
            SceneName::Demo => camera_path::DEMO,
            SceneName::Atrium | SceneName::AtriumSmall => atrium::PATH,
            SceneName::Temple => temple::PATH,
            SceneName::Street => street::PATH,
            SceneName::MirrorRoom => camera_path::MIRROR_ROOM,
            SceneName::Furnace => camera_path::FURNACE,
            SceneName::EmissiveFloor => camera_path::EMISSIVE_FLOOR,
        }
    }
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
