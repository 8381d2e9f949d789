//! glTF files, whole and broken.

use super::{Builder, kinds};
use crate::{glb::Parts, random::Random};
use bevy::{asset::io::embedded::EmbeddedAssetRegistry, prelude::*};
use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

kinds! {
    /// What is wrong with a file.
    FileKind {
        /// Nothing.
        Intact,
        /// It ends early.
        Truncated,
        /// Some bits are turned over.
        FlippedBits,
        /// Lengths of its parts are those of others.
        WrongLengths,
        /// Numbers of its description are out of every range.
        WildNumbers,
        /// Names of its description are missing.
        LostNames,
        /// Vertices, indices or the picture are out of every range.
        WildBinary,
    }
}

/// The bytes of such a file.
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
                let place = random.below(file.len());
                file[place] ^= 1 << random.below(8);
            }
        }
        FileKind::WrongLengths => {
            // Version, length of all, and length of the description.
            let place = random.pick(&[4, 8, 12]);
            let length = random.pick(&[0, 1, 12, 4096, 0x7fff_ffff, u32::MAX]);
            file[place..place + 4].copy_from_slice(&length.to_le_bytes());
        }
        _ => {}
    }
    file
}

/// Adds what such a file holds, as soon as it is loaded.
pub fn add(kind: FileKind, builder: &mut Builder) {
    /// The same name would stand for the same file.
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
    fn all_but_the_intact_file_are_broken() {
        let intact = Parts::default().file();
        for kind in FileKind::ALL.iter().copied() {
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
