//! The sections of a stress run, and the selection of a single part of it.

use crate::{faults::Fault, generators::Generator, word::word};
use clap::ValueEnum;
use core::{fmt, str::FromStr};
use serde::{Deserialize, Serialize};

kinds! {
    /// A section of a stress run, with its fraction of the time in percent. Sections run in this order, and those after one share its unused
    /// time.
    Section, pub fn weight() -> u32 {
        // Limited and lost devices, broken shaders.
        Faults => 18,
        // White furnaces, and every technique against the ground truth.
        Energy => 18,
        // Flicker of static scenes.
        Stability => 14,
        // Ten thousand frames.
        LongRun => 25,
        // Shaders with and without runtime checks.
        Bounds => 5,
        // Broken files.
        Viewer => 4,
        // Hostile ones.
        Scenes => 16,
    }
}

/// A section, a fault, or scenes with a generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Selection {
    Section(Section),
    Fault(Fault),
    /// Scenes that all use one generator.
    With(Generator),
}

impl Selection {
    pub fn section(self) -> Section {
        match self {
            Self::Section(section) => section,
            Self::Fault(_) => Section::Faults,
            Self::With(_) => Section::Scenes,
        }
    }
}

/// The word for command lines.
impl fmt::Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&match self {
            Self::Section(section) => word(section),
            Self::Fault(fault) => word(fault),
            Self::With(generator) => generator.name(),
        })
    }
}

impl FromStr for Selection {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let section = Section::from_str(name, false).map(Self::Section);
        let found = section.or_else(|_| Fault::from_str(name, false).map(Self::Fault)).ok();
        let found = found.or_else(|| Generator::named(name).map(Self::With));
        found.ok_or_else(|| {
            let sections: Vec<_> = Section::value_variants().iter().map(word).collect();
            let faults: Vec<_> = Fault::value_variants().iter().map(word).collect();
            format!(
                "choose a section ({}), a fault ({}) or a generator of scenes, such as mesh-nan-positions or event-resize",
                sections.join(", "),
                faults.join(", ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_read_back() {
        let sections = Section::value_variants().iter().copied().map(Selection::Section);
        let faults = Fault::value_variants().iter().copied().map(Selection::Fault);
        let generators = Generator::all().into_iter().map(Selection::With);
        for selection in sections.chain(faults).chain(generators) {
            assert_eq!(selection.to_string().parse(), Ok(selection));
        }
        let section = |name: &str| name.parse().map(Selection::section);
        assert_eq!(section("device-lost"), Ok(Section::Faults));
        assert_eq!(section("webgpu-minimum"), Ok(Section::Faults));
        assert_eq!(section("mesh-needles"), Ok(Section::Scenes));
        let error = section("flood").unwrap_err();
        assert!(
            error.contains("long-run") && error.contains("no-ray-queries"),
            "{error}"
        );
    }
}
