//! Reasons why a camera shows no reflections, and their log messages.

use bevy::{
    ecs::{
        entity::{Entity, EntityHashSet},
        name::NameOrEntityItem,
    },
    log::warn,
    platform::collections::HashSet,
};

/// A reason why a camera shows no reflections, or few.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Problem {
    ScreenSpace,
    Prepass,
    LowRange,
    Multisampling,
    TooLarge,
    NoMemory,
    Forward,
    ShortRays,
}

impl Problem {
    /// Returns whether nothing can be traced with this problem. With the others, something is missing in reflections.
    pub fn is_fatal(self) -> bool {
        !matches!(self, Self::Forward | Self::ShortRays)
    }

    /// The problem and its remedy, in half a sentence.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::ScreenSpace => {
                "it shows no ray-traced reflections, since it also has `ScreenSpaceReflections`, which use the same hook in \
                 Bevy's lighting: remove one of the two"
            }
            Self::Prepass => {
                "it shows no ray-traced reflections, since it lacks the `DepthPrepass`, the `DeferredPrepass` or the \
                 `NormalPrepass`: insert them"
            }
            Self::LowRange => {
                "it shows no ray-traced reflections, since without `Hdr` colours are tone-mapped before anything can be \
                 added: insert `Hdr`"
            }
            Self::Multisampling => {
                "it shows no ray-traced reflections, since deferred rendering can't do multisampling: set `Msaa::Off`"
            }
            Self::TooLarge => {
                "it shows no ray-traced reflections, since it has more pixels in one direction than its technique can trace on \
                 this device: choose one with a ray for four pixels, such as `ReflectionTechnique::Quarter`, or a smaller image"
            }
            Self::NoMemory => {
                "it shows no ray-traced reflections for some seconds, since the device has no memory for their textures: use a \
                 smaller image, or a technique with a ray for four pixels, such as `ReflectionTechnique::Quarter`"
            }
            Self::Forward => {
                "only opaque materials whose `opaque_render_method` is `Deferred` reflect: for all of them, leave the plugin's \
                 `deferred_by_default` on and the resource `DefaultOpaqueRendererMethod` alone, or switch \
                 `RayTracedReflections::forward` on"
            }
            Self::ShortRays => {
                "it sees farther than its reflection rays reach: set `RayTracedReflections::max_ray_length` to the `far` of its \
                 projection, for example where a unit is a centimetre"
            }
        }
    }
}

/// Problems that were logged.
#[derive(Default)]
pub(super) struct Warnings(HashSet<(Entity, Problem)>);

impl Warnings {
    /// Warns of new problems. `problems` are all problems, each with whether it is present.
    pub fn note(&mut self, camera: &NameOrEntityItem, problems: &[(Problem, bool)]) {
        for &(problem, is_present) in problems {
            if !is_present {
                self.0.remove(&(camera.entity, problem));
            } else if self.0.insert((camera.entity, problem)) {
                warn!("camera {camera}: {}", problem.remedy());
            }
        }
    }

    /// Forgets all other cameras.
    pub fn retain(&mut self, cameras: &EntityHashSet) {
        self.0.retain(|(camera, _)| cameras.contains(camera));
    }
}
