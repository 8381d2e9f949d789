//! The parts of a stress run, and their words on command lines.

use crate::{faults::Fault, ingredients::Ingredient};
use std::str::FromStr;

/// A part of a stress run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// White furnaces, and every technique against the ground truth.
    Energy,
    /// Flicker of still pictures.
    Stability,
    /// Lesser and lost devices, broken shaders.
    Faults,
    /// Ten thousand frames.
    LongRun,
    /// Shaders with and without runtime checks.
    Bounds,
    /// Broken files, and the viewer that is to show them.
    Viewer,
    /// Hostile scenes.
    Scenes,
}

impl Section {
    /// All sections, in the order in which they run.
    pub const ALL: [Self; 7] = [
        Self::Faults,
        Self::Energy,
        Self::Stability,
        Self::LongRun,
        Self::Bounds,
        Self::Viewer,
        Self::Scenes,
    ];

    /// Its part of the time, relative to the other sections. What one leaves over goes to those after it.
    #[must_use]
    pub fn weight(self) -> u32 {
        match self {
            Self::Faults | Self::Energy => 18,
            Self::Stability => 14,
            Self::LongRun => 25,
            Self::Bounds => 5,
            Self::Viewer => 4,
            Self::Scenes => 16,
        }
    }

    /// The word for command lines.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Energy => "energy",
            Self::Stability => "stability",
            Self::Faults => "faults",
            Self::LongRun => "long-run",
            Self::Bounds => "bounds",
            Self::Viewer => "viewer",
            Self::Scenes => "scenes",
        }
    }
}

/// What to run: a section, a fault, or scenes with an ingredient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Only {
    /// A section.
    Section(Section),
    /// One fault.
    Fault(Fault),
    /// Scenes, all of which hold something.
    With(Ingredient),
}

impl Only {
    /// The section that it is a part of.
    #[must_use]
    pub fn section(self) -> Section {
        match self {
            Self::Section(section) => section,
            Self::Fault(_) => Section::Faults,
            Self::With(_) => Section::Scenes,
        }
    }

    /// The word for command lines.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Section(section) => section.name().to_owned(),
            Self::Fault(fault) => fault.name().to_owned(),
            Self::With(ingredient) => ingredient.name(),
        }
    }
}

impl FromStr for Only {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let section = Section::ALL.into_iter().find(|section| section.name() == name);
        let found = section.map(Self::Section);
        let found = found.or_else(|| Fault::named(name).map(Self::Fault));
        let found = found.or_else(|| Ingredient::named(name).map(Self::With));
        found.ok_or_else(|| {
            let sections = Section::ALL.map(Section::name).join(", ");
            let faults = Fault::ALL.map(Fault::name).join(", ");
            format!(
                "`{name}` is unknown; choose a section ({sections}), a fault ({faults}) or an ingredient of scenes, such as \
                 mesh-nan-positions or event-resize"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stand_for_what_they_say() {
        for section in Section::ALL {
            assert_eq!(section.name().parse(), Ok(Only::Section(section)));
        }
        let fault: Only = "device-lost".parse().unwrap();
        assert_eq!(
            (fault.section(), fault.name().as_str()),
            (Section::Faults, "device-lost")
        );
        let with: Only = "mesh-needles".parse().unwrap();
        assert_eq!(
            (with.section(), with.name().as_str()),
            (Section::Scenes, "mesh-needles")
        );
        let error = "flood".parse::<Only>().unwrap_err();
        assert!(
            error.contains("long-run") && error.contains("no-ray-queries"),
            "{error}"
        );
    }
}
