//! Limits for the size of source files: above a soft limit a file is reported, above a hard limit the check fails.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

use crate::{cargo, progress};

/// Number of lines above which a file is worth splitting.
const SOFT_LIMIT: usize = 450;
/// Number of lines above which a file must be split.
const HARD_LIMIT: usize = 700;
/// Extensions of the checked files.
const EXTENSIONS: [&str; 2] = ["rs", "wesl"];

/// Checks every source file of the workspace.
pub fn check() -> Result<()> {
    let root = cargo::workspace_root();
    let count = |file: &PathBuf| fs::read_to_string(file).map_or(0, |text| text.lines().count());
    let mut files: Vec<_> = sources(&root).into_iter().map(|file| (count(&file), file)).collect();
    files.sort_unstable_by(|a, b| b.cmp(a));
    for (lines, file) in files.iter().take_while(|(lines, _)| *lines > SOFT_LIMIT) {
        let file = file.strip_prefix(&root).unwrap_or(file).display();
        progress::note(format_args!("{file} has {lines} lines; aim at {SOFT_LIMIT} or fewer"));
    }
    let too_long = files.iter().filter(|(lines, _)| *lines > HARD_LIMIT).count();
    if too_long > 0 {
        bail!("{too_long} source file(s) have more than {HARD_LIMIT} lines; split them");
    }
    Ok(())
}

/// The source files of a folder, in order, without hidden folders and cargo's caches.
pub fn sources(folder: &Path) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
            let is_source = path
                .extension()
                .is_some_and(|end| EXTENSIONS.iter().any(|kind| end == *kind));
            match entry.file_type() {
                Ok(kind) if kind.is_dir() && !is_hidden && !path.join("CACHEDIR.TAG").exists() => folders.push(path),
                Ok(kind) if kind.is_file() && is_source => files.push(path),
                _ => {}
            }
        }
    }
    files.sort_unstable();
    files
}
