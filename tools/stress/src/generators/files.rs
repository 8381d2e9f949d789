//! glTF files, whole and broken.

use super::Builder;
use crate::glb::Parts;
use bevy::{asset::io::embedded::EmbeddedAssetRegistry, prelude::*};
use clap::ValueEnum;
use glint_scenes::Random;
use serde::{Deserialize, Serialize};
use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

/// Kinds of damage to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum FileKind {
    /// None.
    Intact,
    /// The file ends early.
    Truncated,
    /// Some bits are flipped.
    FlippedBits,
    /// The version or a length in the header is wrong.
    WrongLengths,
    /// Numbers in the JSON are out of range.
    WildNumbers,
    /// Names in the JSON are missing.
    LostNames,
    /// Vertices, indices or the image are out of range.
    WildBinary,
}

/// The bytes of a file with this damage.
#[must_use]
pub fn bytes(kind: FileKind, random: &mut Random) -> Vec<u8> {
    let mut parts = Parts::default();
    match kind {
        FileKind::WildNumbers => parts.wild_numbers(random),
        FileKind::LostNames => parts.lost_names(random),
        FileKind::WildBinary => parts.wild_binary(random),
        _ => {}
    }
    let mut file = parts.file();
    match kind {
        FileKind::Truncated => file.truncate(random.below(file.len())),
        FileKind::FlippedBits => {
            for _ in 0..1 + random.below(8) {
                let index = random.below(file.len());
                file[index] ^= 1 << random.below(8);
            }
        }
        FileKind::WrongLengths => {
            // The version, the length of the file, and the length of the JSON.
            let offset = random.pick(&[4, 8, 12]);
            let length = random.pick(&[0, 1, 12, 4096, 0x7fff_ffff, u32::MAX]);
            file[offset..offset + 4].copy_from_slice(&length.to_le_bytes());
        }
        _ => {}
    }
    file
}

/// Adds the contents of such a file once it is loaded.
pub fn add(kind: FileKind, builder: &mut Builder) {
    /// Bevy loads a name once, so each file needs its own.
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let bytes = bytes(kind, &mut builder.random);
    let spot = builder.spot();
    let name = format!("stress/{}.glb", NEXT.fetch_add(1, Ordering::Relaxed));
    let world = builder.world();
    let registry = world.resource::<EmbeddedAssetRegistry>();
    registry.insert_asset(PathBuf::from(&name), Path::new(&name), bytes);
    let path = GltfAssetLabel::Scene(0).from_asset(format!("embedded://{name}"));
    let file: Handle<WorldAsset> = world.resource::<AssetServer>().load(path);
    builder.files.push(file.id().untyped());
    builder.add((WorldAssetRoot(file), spot));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_but_the_intact_one_are_damaged() {
        let intact = Parts::default().file();
        for kind in FileKind::value_variants().iter().copied() {
            for seed in 0..50 {
                let file = bytes(kind, &mut Random::new(seed));
                assert_eq!(file, bytes(kind, &mut Random::new(seed)));
                if kind == FileKind::Intact {
                    assert_eq!(file, intact);
                }
            }
            let differs = |seed: u64| bytes(kind, &mut Random::new(seed)) != intact;
            assert_eq!((0..50).any(differs), kind != FileKind::Intact, "{kind:?}");
        }
    }
}
