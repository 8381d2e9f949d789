//! Generators of everything that a hostile scene can contain.
//!
//! Each scene begins with an ordinary one: a mirror for a floor, some boxes, a ball, a white sky. Generators add to it, or change the
//! camera that renders it.

mod builder;
mod cameras;
mod events;
mod files;
mod lights;
mod materials;
mod meshes;
mod placements;
mod settings;
mod surroundings;
mod textures;
mod views;

pub use builder::{Builder, HostileScene, plain_image};
pub use cameras::CameraSetup;
pub use events::EventKind;
pub use files::{FileKind, bytes as file_bytes};

use crate::word::word;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Declares the enum of all generators. Each variant has a kind and the function that adds it to a scene.
macro_rules! generators {
    ($($variant:ident($kind:ty) = $add:path;)+) => {
        /// Adds one ingredient to a scene.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Generator { $($variant($kind)),+ }

        impl Generator {
            /// All generators, grouped by variant.
            pub fn all() -> Vec<Self> {
                let mut all = Vec::new();
                $(all.extend(<$kind>::value_variants().iter().copied().map(Self::$variant));)+
                all
            }

            /// The kind of the ingredient, such as `Mesh`.
            pub fn kind(self) -> &'static str {
                match self { $(Self::$variant(_) => stringify!($variant)),+ }
            }

            /// The word for command lines, such as `mesh-nan-positions`.
            pub fn name(self) -> String {
                let (variant, kind) = match self { $(Self::$variant(kind) => (stringify!($variant), word(&kind))),+ };
                format!("{}-{kind}", variant.to_ascii_lowercase())
            }

            pub fn add(self, builder: &mut Builder) {
                match self { $(Self::$variant(kind) => $add(kind, builder)),+ }
            }
        }
    };
}

generators! {
    Mesh(meshes::MeshKind) = meshes::add;
    Placement(placements::PlacementKind) = placements::add;
    Material(materials::MaterialKind) = materials::add;
    Texture(textures::TextureKind) = textures::add;
    File(FileKind) = files::add;
    Light(lights::LightKind) = lights::add;
    Surroundings(surroundings::SurroundingsKind) = surroundings::add;
    View(views::ViewKind) = views::add;
    Settings(settings::SettingsKind) = settings::add;
    Event(EventKind) = add_event;
}

fn add_event(kind: EventKind, builder: &mut Builder) {
    builder.scene.events.push(kind);
}

impl Generator {
    /// Returns whether it takes very much memory or time.
    pub fn is_heavy(self) -> bool {
        matches!(
            self,
            Self::Placement(placements::PlacementKind::HundredThousand)
                | Self::Texture(textures::TextureKind::SixteenThousand)
                | Self::View(views::ViewKind::EightThousand)
        )
    }

    /// Returns whether the image can be brighter than the white sky with it.
    pub fn adds_light(self) -> bool {
        !matches!(
            self,
            Self::Mesh(_) | Self::Placement(_) | Self::Settings(_) | Self::Event(_)
        )
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|generator| generator.name() == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn generators_have_names() {
        let needles = Generator::Mesh(meshes::MeshKind::Needles);
        assert_eq!(needles.name(), "mesh-needles");
        assert_eq!(Generator::named("mesh-needles"), Some(needles));
        assert_eq!(Generator::named("mesh"), None);
        assert!(Generator::all().len() > 150);
    }
}
