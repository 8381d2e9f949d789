//! Hashes all sources that the ground truth depends on, so that a cached one is used only while it is true.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Folders with code that the ground truth doesn't use: it has no variable rate and no denoiser.
const NO_PART: [&str; 2] = ["denoise", "rate"];

fn main() {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut add = |bytes: &[u8]| {
        for &byte in bytes {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    for folder in ["../../src", "../scenes/src"] {
        println!("cargo::rerun-if-changed={folder}");
        let mut files = Vec::new();
        collect(Path::new(folder), &mut files);
        files.sort();
        for file in files {
            add(file.to_string_lossy().replace('\\', "/").as_bytes());
            add(&fs::read(&file).unwrap_or_default());
        }
    }
    // The engine draws everything but the reflections.
    println!("cargo::rerun-if-changed=../../Cargo.lock");
    let lock = fs::read_to_string("../../Cargo.lock").unwrap_or_default();
    let engine = lock
        .split("[[package]]")
        .find(|package| package.contains("name = \"bevy_pbr\""))
        .and_then(|package| package.lines().find(|line| line.starts_with("version")));
    add(engine.unwrap_or_default().as_bytes());
    println!("cargo::rustc-env=GLINT_SOURCE_HASH={hash:016x}");
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        if path.is_dir() {
            if !NO_PART.iter().any(|name| path.ends_with(name)) {
                collect(&path, files);
            }
        } else if path.extension().is_some_and(|end| end == "rs" || end == "wesl") {
            files.push(path);
        }
    }
}
