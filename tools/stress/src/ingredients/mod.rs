//! Everything that a hostile scene may hold, and how a scene is built of it.
//!
//! Each scene begins with an ordinary one: a mirror for a floor, some boxes, a ball, a lamp, a white sky. Ingredients add to it, or
//! change the camera that looks at it.

mod builder;
mod cameras;
pub mod events;
mod files;
mod lights;
mod materials;
mod meshes;
mod placements;
mod settings;
mod surroundings;
mod textures;
mod views;

pub use builder::{Builder, HostileScene, build};
pub use cameras::CameraPlan;
pub use events::EventKind;
pub use files::{FileKind, bytes as file_bytes};
pub use lights::LightKind;
pub use materials::MaterialKind;
pub use meshes::MeshKind;
pub use placements::PlacementKind;
pub use settings::SettingsKind;
pub use surroundings::SurroundingsKind;
pub use textures::TextureKind;
pub use views::ViewKind;

/// Declares an enum of kinds with a list of them all.
macro_rules! kinds {
    ($(#[$doc:meta])* $name:ident { $($(#[$kind_doc:meta])* $kind:ident),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name { $($(#[$kind_doc])* $kind),+ }

        impl $name {
            /// All kinds.
            pub const ALL: &'static [Self] = &[$(Self::$kind),+];
        }
    };
}
pub(crate) use kinds;

/// One thing that a scene may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ingredient {
    /// An object of an odd mesh.
    Mesh(MeshKind),
    /// Objects in odd places, or in odd numbers.
    Placement(PlacementKind),
    /// An object of an odd material.
    Material(MaterialKind),
    /// An object with odd textures.
    Texture(TextureKind),
    /// What a glTF file holds.
    File(FileKind),
    /// An odd light.
    Light(LightKind),
    /// Odd surroundings.
    Surroundings(SurroundingsKind),
    /// An odd camera.
    View(ViewKind),
    /// Odd settings.
    Settings(SettingsKind),
    /// Something that happens between frames.
    Event(EventKind),
}

impl Ingredient {
    /// All ingredients.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        all.extend(MeshKind::ALL.iter().copied().map(Self::Mesh));
        all.extend(PlacementKind::ALL.iter().copied().map(Self::Placement));
        all.extend(MaterialKind::ALL.iter().copied().map(Self::Material));
        all.extend(TextureKind::ALL.iter().copied().map(Self::Texture));
        all.extend(FileKind::ALL.iter().copied().map(Self::File));
        all.extend(LightKind::ALL.iter().copied().map(Self::Light));
        all.extend(SurroundingsKind::ALL.iter().copied().map(Self::Surroundings));
        all.extend(ViewKind::ALL.iter().copied().map(Self::View));
        all.extend(SettingsKind::ALL.iter().copied().map(Self::Settings));
        all.extend(EventKind::ALL.iter().copied().map(Self::Event));
        all
    }

    /// It takes very much memory or time.
    #[must_use]
    pub fn is_heavy(self) -> bool {
        matches!(
            self,
            Self::Placement(PlacementKind::HundredThousand)
                | Self::Texture(TextureKind::SixteenThousand)
                | Self::View(ViewKind::EightThousand)
        )
    }

    /// With it, the brightness of the picture isn't that of the white sky any more.
    #[must_use]
    pub fn adds_light(self) -> bool {
        matches!(
            self,
            Self::Material(_)
                | Self::Texture(_)
                | Self::File(_)
                | Self::Light(_)
                | Self::Surroundings(_)
                | Self::View(_)
        )
    }

    /// The word for command lines, such as `mesh-nan-positions`.
    #[must_use]
    pub fn name(self) -> String {
        let mut name = String::new();
        for letter in format!("{self:?}").chars() {
            match letter {
                '(' => name.push('-'),
                ')' => {}
                _ => {
                    if letter.is_ascii_uppercase() && !name.is_empty() && !name.ends_with('-') {
                        name.push('-');
                    }
                    name.push(letter.to_ascii_lowercase());
                }
            }
        }
        name
    }

    /// The ingredient of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|ingredient| ingredient.name() == name)
    }

    fn add(self, builder: &mut Builder) {
        match self {
            Self::Mesh(kind) => meshes::add(kind, builder),
            Self::Placement(kind) => placements::add(kind, builder),
            Self::Material(kind) => materials::add(kind, builder),
            Self::Texture(kind) => textures::add(kind, builder),
            Self::File(kind) => files::add(kind, builder),
            Self::Light(kind) => lights::add(kind, builder),
            Self::Surroundings(kind) => surroundings::add(kind, builder),
            Self::View(kind) => views::add(kind, builder),
            Self::Settings(kind) => settings::add(kind, builder),
            Self::Event(kind) => builder.events.push(kind),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unlike_and_read_back() {
        let all = Ingredient::all();
        for ingredient in &all {
            assert_eq!(Ingredient::named(&ingredient.name()), Some(*ingredient));
        }
        assert_eq!(Ingredient::Mesh(MeshKind::NanPositions).name(), "mesh-nan-positions");
        assert_eq!(Ingredient::named("mesh"), None);
        assert!(all.len() > 150);
    }
}
