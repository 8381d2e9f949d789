//! The kinds of reflections that a camera can have.

use bevy::{pbr::ScreenSpaceReflections, prelude::*};
use bevy_glint::{
    RayTracedReflections, ReflectionBackend, ReflectionTechnique, ShadingRateHeuristic, TECHNIQUE_NAMES, named_settings,
};
use std::{fmt, str::FromStr};

/// Source of a camera's reflections.
#[derive(Clone, Debug, PartialEq)]
pub enum Method {
    /// Only the environment map.
    Off,
    /// Bevy's screen-space reflections.
    ScreenSpace,
    /// Ray-traced reflections with settings that have a name.
    Traced {
        /// Name of a technique or preset.
        name: String,
        /// Components of the camera.
        settings: Box<(RayTracedReflections, ShadingRateHeuristic)>,
    },
}

impl Method {
    const OFF: &str = "off";
    const SCREEN_SPACE: &str = "screen-space";

    /// The ground truth of a static scene: every surface reflects, and frames are averaged.
    pub fn ground_truth() -> Self {
        let reflections = RayTracedReflections {
            technique: ReflectionTechnique::Converged,
            roughness_cutoff: 1.0,
            roughness_fade: 0.0,
            ..default()
        };
        Self::Traced {
            name: "ground truth".to_owned(),
            settings: Box::new((reflections, default())),
        }
    }

    /// Frames are averaged as long as nothing changes.
    pub fn is_converged(&self) -> bool {
        matches!(self, Self::Traced { settings, .. } if settings.0.technique == ReflectionTechnique::Converged)
    }

    /// Replaces the reflections of the camera by these.
    pub fn apply(&self, camera: &mut EntityWorldMut, backend: ReflectionBackend) {
        // A camera can't have both at a time.
        camera.remove::<(RayTracedReflections, ScreenSpaceReflections)>();
        match self {
            Self::Off => {}
            Self::ScreenSpace => {
                camera.insert(ScreenSpaceReflections::default());
            }
            Self::Traced { settings, .. } => {
                let (mut reflections, heuristic) = (**settings).clone();
                reflections.backend = backend;
                camera.insert((reflections, heuristic));
            }
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Off => Self::OFF,
            Self::ScreenSpace => Self::SCREEN_SPACE,
            Self::Traced { name, .. } => name,
        })
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            Self::OFF => Ok(Self::Off),
            Self::SCREEN_SPACE => Ok(Self::ScreenSpace),
            _ => named_settings(word)
                .map(|settings| Self::Traced {
                    name: word.to_owned(),
                    settings: Box::new(settings),
                })
                .map_err(|_| {
                    format!(
                        "choose one of: {}, {}, {TECHNIQUE_NAMES}",
                        Self::OFF,
                        Self::SCREEN_SPACE
                    )
                }),
        }
    }
}
