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
    let mut files: Vec<(PathBuf, usize)> = sources(&root)
        .into_iter()
        .map(|file| {
            let lines = fs::read(&file).map_or(0, |bytes| bytes.iter().filter(|byte| **byte == b'\n').count());
            (file, lines)
        })
        .collect();
    files.sort_unstable_by_key(|(_, lines)| std::cmp::Reverse(*lines));
    for (file, lines) in files.iter().take_while(|(_, lines)| *lines > SOFT_LIMIT) {
        let file = file.strip_prefix(&root).unwrap_or(file).display();
        progress::note(format_args!("{file} has {lines} lines; aim at {SOFT_LIMIT} or fewer"));
    }
    let too_long = files.iter().filter(|(_, lines)| *lines > HARD_LIMIT).count();
    if too_long > 0 {
        bail!("{too_long} source file(s) have more than {HARD_LIMIT} lines; split them");
    }
    Ok(())
}

/// The source files of a folder, in order, without hidden folders and cargo's caches.
pub fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    collect(folder, &mut files);
    files.sort_unstable();
    files
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
        let Ok(kind) = entry.file_type() else {
            continue;
        };
        if kind.is_dir() && !is_hidden && !path.join("CACHEDIR.TAG").exists() {
            collect(&path, files);
        } else if kind.is_file()
            && path
                .extension()
                .is_some_and(|end| EXTENSIONS.iter().any(|kind| end == *kind))
        {
            files.push(path);
        }
    }
}
