//! A pass as the row of a table, and the variants that its shader is compiled in.

use crate::{
    gbuffer::Binding,
    scene::{Features, Passes},
};
use bevy::{
    asset::Handle,
    render::render_resource::{ShaderStages, TextureFormat},
    shader::Shader,
};
use bitflags::bitflags;
use core::{
    fmt::{Debug, Formatter, Result},
    hash::{Hash, Hasher},
};

/// A pass over the G-buffer. The label identifies it.
pub(crate) struct Pass {
    /// Label of the pass, its bind group and its pipelines.
    pub label: &'static str,
    /// Path of the module below `src/`.
    pub shader: &'static str,
    pub entry_point: &'static str,
    pub kind: Kind,
    /// Bindings of group 0, after the ones of `gbuffer.wesl`.
    pub bindings: fn() -> Vec<Binding>,
    pub groups: Groups,
    /// The features of the scene that it sees are those of these passes.
    pub sees: Passes,
    /// Definitions of all variants.
    pub options: Options,
    /// Messages for shaders that fail.
    pub failure: Failure,
}

/// The stage that a pass runs in.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Compute,
    /// Fragments that write these targets. The vertex stage is the module's entry point `vertex`.
    Fragments(&'static [TextureFormat]),
    /// Fragments that are added to a target of [`Variant::format`]. Their group 0 doesn't start with the bindings of `gbuffer.wesl`.
    Addition,
}

impl Kind {
    pub fn stages(self) -> ShaderStages {
        match self {
            Self::Compute => ShaderStages::COMPUTE,
            Self::Fragments(_) | Self::Addition => ShaderStages::FRAGMENT,
        }
    }
}

/// Bind groups of a pass besides group 0.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Groups {
    None,
    /// The environment as group 2. Group 1 is the scene in variants with light probes, and otherwise empty.
    Environment,
    /// The scene as group 1, and the environment as group 2.
    Scene,
}

/// Messages for the log if a shader can't be compiled, followed by the error. Nothing is logged for empty ones.
#[derive(Clone, Copy)]
pub(crate) struct Failure {
    /// The library's shader fails.
    pub library: &'static str,
    /// The app's shader fails, or the library's shader with a module of the app. `{shader}` is replaced by the handle.
    pub own: &'static str,
}

impl Failure {
    pub const RATES: Self = Self {
        library: "a shading-rate shader of ray-traced reflections failed; cameras that need it get simpler rates, or no reflections",
        own: "the shading-rate heuristic {shader} failed, so that every trace pixel gets its ray",
    };
    pub const RAYS: Self = Self {
        library: "ray-traced reflections stay off, since their shader failed",
        own: "the shader of `ReflectedSurfaceShader` failed, so that reflections show materials without it",
    };
    pub const KEPT_RAYS: Self = Self {
        library: "reflected light that changes lags behind, since the shader for `follow_light_changes` failed",
        // The passes that trace all rays say so.
        own: "",
    };
    pub const DENOISER: Self = Self {
        library: "a denoiser of ray-traced reflections failed; cameras that need it get simpler reflections, or none",
        own: "",
    };
    pub const COMPOSITE: Self = Self {
        library: "a composite of ray-traced reflections failed; cameras that need it get simpler reflections, or none",
        own: "",
    };
    pub const FRONT_LAYER: Self = Self {
        library: "transparent and forward surfaces show no ray-traced reflections, since the shader that finds them failed",
        own: "the shader of `FrontLayerShader` failed, so that reflections follow normal maps alone",
    };
    pub const GUIDES: Self = Self {
        library: "`ReflectionGuides` get no textures, since their shader failed",
        own: "",
    };
    /// Only Bevy's own message is logged.
    pub const SILENT: Self = Self { library: "", own: "" };
}

bitflags! {
    /// Definitions of variants that don't depend on the scene.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub(crate) struct Options: u32 {
        /// Processes 16x16 texels at a time instead of 8x8.
        const WIDE = 1;
        /// For static views. Views in motion use a faster variant without it.
        const REST = 1 << 1;
        /// Follows the images of moving objects. Other frames use a faster variant without it.
        const HIT_MOTION = 1 << 2;
        /// Includes the last filter of the denoiser.
        const BLUR = 1 << 3;
        /// Reads and writes the frame.
        const IN_PLACE = 1 << 4;
        /// Visits only active tiles.
        const TILES = 1 << 5;
        /// The surfaces are in the front layer.
        const FRONT_LAYER = 1 << 6;
        /// Traces the rays of mirrors.
        const MIRRORS = 1 << 7;
        /// Shows the light that the composite adds.
        const REFLECTION = 1 << 8;
        /// Trace pixels of a tile in each direction are 8 instead of 16.
        const TILES_8 = 1 << 9;
        /// Starts at a tile given by the view, so that a part of the tiles can be visited.
        const PART = 1 << 10;
        const ROUGHNESS = 1 << 11;
        const GRAZING = 1 << 12;
        const COMBINED = 1 << 13;
        const IMAGE = 1 << 14;
        const TILE_ANGLES = 1 << 15;
        const TILE_SHAPE = 1 << 16;
        const TILE_REFLECTANCE = 1 << 17;
        const TILE_DEPTH = 1 << 18;
        /// The address of an acceleration structure replaces a binding.
        const ONE_TLAS = 1 << 19;
        /// The denoiser stores one pixel of each quad of 2x2 pixels.
        const HALF_RESOLUTION = 1 << 20;
        /// Traces rays of earlier frames with their random numbers ...
        const KEPT_RAYS = 1 << 21;
        /// ... and shortens histories where their light has changed.
        const LIGHT_CHANGES = 1 << 22;
    }
}

/// A variant of a pass.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Variant {
    pub pass: &'static Pass,
    pub features: Features,
    pub options: Options,
    /// The app's shader, instead of the pass's one.
    pub own: Option<Handle<Shader>>,
    /// Format of the frame for [`Kind::Addition`].
    pub format: Option<TextureFormat>,
}

impl Pass {
    /// The fields that most rows have: a compute pass without other bind groups than group 0.
    pub const fn new(failure: Failure) -> Self {
        Self {
            label: "",
            shader: "",
            entry_point: "",
            kind: Kind::Compute,
            bindings: Vec::new,
            groups: Groups::None,
            sees: Passes::empty(),
            options: Options::empty(),
            failure,
        }
    }

    /// The variant with these features of the scene, and these definitions besides the ones of the pass.
    pub fn variant(&'static self, features: Features, options: Options) -> Variant {
        Variant {
            pass: self,
            features,
            options: self.options | options,
            own: None,
            format: None,
        }
    }
}

impl Variant {
    /// Bind groups besides group 0.
    pub fn groups(&self) -> Groups {
        match self.pass.groups {
            Groups::Environment if self.features.contains(Features::LIGHT_PROBES) => Groups::Scene,
            groups => groups,
        }
    }

    /// Group 0 contains the frame that rays reuse.
    pub fn has_screen(&self) -> bool {
        self.features.contains(Features::SCREEN_TRACES)
    }

    /// Whether the app's code is compiled with it.
    pub fn has_own_code(&self) -> bool {
        self.own.is_some() || self.features.contains(Features::SURFACE_SHADER)
    }
}

impl PartialEq for Pass {
    fn eq(&self, other: &Self) -> bool {
        self.label == other.label
    }
}

impl Eq for Pass {}

impl Hash for Pass {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.label.hash(state);
    }
}

impl Debug for Pass {
    fn fmt(&self, formatter: &mut Formatter) -> Result {
        formatter.write_str(self.label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHOWN: &Pass = &Pass {
        label: "shown",
        groups: Groups::Environment,
        options: Options::FRONT_LAYER,
        ..Pass::new(Failure::SILENT)
    };

    #[test]
    fn variants_with_light_probes_bind_the_scene() {
        let groups = |pass: &'static Pass, features| pass.variant(features, Options::empty()).groups();
        assert!(groups(SHOWN, Features::FORWARD_SURFACES) == Groups::Environment);
        assert!(groups(SHOWN, Features::LIGHT_PROBES) == Groups::Scene);
        const OTHER: &Pass = &Pass::new(Failure::SILENT);
        assert!(groups(OTHER, Features::LIGHT_PROBES) == Groups::None);
    }

    #[test]
    fn variants_have_the_definitions_of_their_pass() {
        let variant = SHOWN.variant(Features::empty(), Options::BLUR);
        let names: Vec<_> = variant.options.iter_names().map(|(name, _)| name).collect();
        assert_eq!(names, ["BLUR", "FRONT_LAYER"]);
    }

    #[test]
    fn the_apps_code_is_a_shader_of_its_own_or_a_module_of_the_librarys_shader() {
        let has_own_code = |own, features| {
            let variant = SHOWN.variant(features, Options::empty());
            Variant { own, ..variant }.has_own_code()
        };
        assert!(!has_own_code(None, Features::all() - Features::SURFACE_SHADER));
        assert!(has_own_code(None, Features::SURFACE_SHADER));
        assert!(has_own_code(Some(Handle::default()), Features::empty()));
    }
}
