//! The names of the scenes, and their options.

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
