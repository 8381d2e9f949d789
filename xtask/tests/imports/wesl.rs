//! Arrows between shader modules.

use crate::{
    graph::Arrows,
    tokens::{path_tree, tokens},
};
use std::{fs, path::Path};

/// Arrows between the modules below a folder, by paths that begin with its name.
pub fn arrows(folder: &Path) -> Arrows {
    let mut files = Vec::new();
    collect(folder, String::new(), &mut files);
    let mut arrows = Arrows::new();
    for file in &files {
        let source = fs::read_to_string(folder.join(file)).unwrap();
        let tokens = tokens(&source);
        for (i, _) in tokens.iter().enumerate().filter(|(_, token)| *token == "import") {
            for (path, _) in path_tree(&tokens, i + 1).0 {
                if let Some(target) = module(&path, &files).filter(|target| target != file) {
                    arrows.insert((format!("src/{file}"), format!("src/{target}")));
                }
            }
        }
    }
    arrows
}

fn collect(folder: &Path, prefix: String, files: &mut Vec<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            collect(&entry.path(), format!("{prefix}{name}/"), files);
        } else if name.ends_with(".wesl") {
            files.push(format!("{prefix}{name}"));
        }
    }
}

/// The file for the longest part of a path that is a module.
fn module(path: &[String], files: &[String]) -> Option<String> {
    if !matches!(path.first()?.as_str(), "package" | "bevy_glint") {
        return None;
    }
    let longest_first = (2..=path.len()).rev();
    let mut names = longest_first.map(|end| format!("{}.wesl", path[1..end].join("/")));
    names.find(|name| files.contains(name))
}
