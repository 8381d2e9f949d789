//! glTF files, whole and broken.

use super::Builder;
use crate::glb::Parts;
use bevy::{asset::io::embedded::EmbeddedAssetRegistry, prelude::*};
use glint_scenes::Random;
use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

kinds! {
    /// Kinds of damage to a file.
    FileKind, pub fn bytes(random: &mut Random) -> Vec<u8> {
        Intact => damaged(|_| {}, |_| {}),
        Truncated => damaged(|_| {}, |file| file.truncate(random.below(file.len()))),
        FlippedBits => damaged(|_| {}, |file| (0..1 + random.below(8)).for_each(|_| {
            let index = random.below(file.len());
            file[index] ^= 1 << random.below(8);
        })),
        // The version, the length of the file, or the length of the JSON.
        WrongLengths => damaged(|_| {}, |file| {
            let offset = random.pick(&[4, 8, 12]);
            let length = random.pick(&[0, 1, 12, 4096, 0x7fff_ffff, u32::MAX]);
            file[offset..offset + 4].copy_from_slice(&length.to_le_bytes());
        }),
        WildNumbers => damaged(|parts| parts.wild_numbers(random), |_| {}),
        LostNames => damaged(|parts| parts.lost_names(random), |_| {}),
        // Vertices, indices or the image are out of range.
        WildBinary => damaged(|parts| parts.wild_binary(random), |_| {}),
    }
}

/// A file with changed content or bytes.
fn damaged(content: impl FnOnce(&mut Parts), bytes: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut parts = Parts::default();
    content(&mut parts);
    let mut file = parts.file();
    bytes(&mut file);
    file
}

/// Adds the contents of such a file once it is loaded.
pub fn add(kind: FileKind, builder: &mut Builder) {
    /// Bevy loads a name once, so each file needs its own.
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let bytes = bytes(kind, &mut builder.scene.random);
    let spot = builder.spot();
    let name = format!("stress/{}.glb", NEXT.fetch_add(1, Ordering::Relaxed));
    let world = builder.world();
    let registry = world.resource::<EmbeddedAssetRegistry>();
    registry.insert_asset(PathBuf::from(&name), Path::new(&name), bytes);
    let path = GltfAssetLabel::Scene(0).from_asset(format!("embedded://{name}"));
    let file: Handle<WorldAsset> = world.resource::<AssetServer>().load(path);
    builder.scene.files.push(file.id().untyped());
    builder.add((WorldAssetRoot(file), spot));
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

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
