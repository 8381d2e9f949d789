//! Names of settings on command lines and in files.

/// A name that no setting has. Its message lists the valid names.
#[derive(thiserror::Error, Debug, Clone, PartialEq, Eq)]
#[error("`{word}` is unknown; choose one of: {}", .choices.join(", "))]
pub struct UnknownName {
    word: String,
    choices: Vec<&'static str>,
}

impl UnknownName {
    pub(crate) fn new(word: &str, choices: impl IntoIterator<Item = &'static str>) -> Self {
        Self {
            word: word.into(),
            choices: choices.into_iter().collect(),
        }
    }
}

/// Gives each variant of an enum without fields a name: `ALL`, `name`, `Display` and `FromStr`.
///
/// Fails to compile if a variant is missing here.
macro_rules! words {
    ($name:ident { $($variant:ident = $word:literal),+ $(,)? }) => {
        impl $name {
            /// All variants, in the order of their declaration.
            pub const ALL: [Self; [$($word),+].len()] = [$(Self::$variant),+];

            /// The name for command lines and files.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $word),+
                }
            }
        }

        impl ::core::fmt::Display for $name {
            fn fmt(&self, f: &mut ::core::fmt::Formatter<'_>) -> ::core::fmt::Result {
                f.pad(self.name())
            }
        }

        impl ::core::str::FromStr for $name {
            type Err = $crate::settings::UnknownName;

            fn from_str(word: &str) -> Result<Self, Self::Err> {
                let known = Self::ALL.into_iter().find(|variant| variant.name() == word);
                known.ok_or_else(|| Self::Err::new(word, Self::ALL.map(Self::name)))
            }
        }
    };
}

pub(crate) use words;

#[cfg(test)]
mod tests {
    use crate::settings::{
        ReflectionBackend, ReflectionDebugView, ReflectionPreset, ReflectionQuality, ReflectionSampling,
        ReflectionTechnique, ReflectionTracerChoice, ScreenTraces, ShadingRate, ShadingRateTileSize,
    };
    use core::{
        fmt::{Debug, Display},
        str::FromStr,
    };

    fn all_are_read_back<T>(all: &[T])
    where
        T: Copy + Debug + Display + FromStr<Err = super::UnknownName> + PartialEq,
    {
        let error = "no such word".parse::<T>().unwrap_err().to_string();
        for variant in all {
            assert_eq!(variant.to_string().parse(), Ok(*variant));
            assert!(error.contains(&variant.to_string()), "{error}");
        }
    }

    #[test]
    fn words_are_read_back_and_errors_list_them() {
        all_are_read_back(&ReflectionTechnique::ALL);
        all_are_read_back(&ReflectionBackend::ALL);
        all_are_read_back(&ReflectionSampling::ALL);
        all_are_read_back(&ReflectionTracerChoice::ALL);
        all_are_read_back(&ScreenTraces::ALL);
        all_are_read_back(&ReflectionPreset::ALL);
        all_are_read_back(&ReflectionQuality::ALL);
        all_are_read_back(&ReflectionDebugView::ALL);
        all_are_read_back(&ShadingRateTileSize::ALL);
        all_are_read_back(&ShadingRate::ALL);
        let error = "rays".parse::<ReflectionTracerChoice>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "`rays` is unknown; choose one of: auto, ray-query, bvh"
        );
    }
}
