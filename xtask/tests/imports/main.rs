//! Imports run one way: no circle between files or folders, and no import from a lower floor to a higher one.
//!
//! The arrows are read from the code's own paths: `crate::..`, `super::..` and `use` in Rust, `import package::..` in WESL. Test modules
//! don't count, and neither do re-exports of a module's own children. The floors come from `docs/architecture.md`.

mod floors;
mod graph;
mod rust;
mod tokens;
mod wesl;

use floors::Floors;
use graph::{Arrows, circles};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// The workspace.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// Arrows between the files of a crate, by paths from its root folder.
fn arrows(folder: &Path) -> Arrows {
    let mut arrows = rust::arrows(folder);
    arrows.extend(wesl::arrows(&folder.join("src")));
    arrows
}

/// Folders of the checked crates, from the workspace's root.
const CRATES: [&str; 7] = [
    ".",
    "tools/bench",
    "tools/evaluate",
    "tools/scenes",
    "tools/stress",
    "tools/viewer",
    "xtask",
];

fn crates() -> impl Iterator<Item = PathBuf> {
    CRATES.into_iter().map(|folder| root().join(folder))
}

#[test]
fn no_circle_between_files() {
    let mut found = Vec::new();
    for folder in crates() {
        let circles = circles(&arrows(&folder)).into_iter();
        found.extend(circles.map(|circle| format!("{}: {circle}", folder.display())));
    }
    assert!(found.is_empty(), "files that import each other:\n{}", found.join("\n"));
}

#[test]
fn no_circle_between_folders() {
    let mut found = Vec::new();
    for folder in crates() {
        for (within, arrows) in graph::between_children(&arrows(&folder)) {
            let circles = circles(&arrows).into_iter();
            found.extend(circles.map(|circle| format!("{}/{within}: {circle}", folder.display())));
        }
    }
    assert!(
        found.is_empty(),
        "folders that import each other:\n{}",
        found.join("\n")
    );
}

#[test]
fn imports_run_down() {
    let floors = Floors::read(&root().join("docs/architecture.md"));
    let wrong = floors.wrong_arrows(&arrows(&root()));
    assert!(
        wrong.is_empty(),
        "imports that don't run to a lower floor of docs/architecture.md:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn the_document_shows_all_modules() {
    let floors = Floors::read(&root().join("docs/architecture.md"));
    let entries = fs::read_dir(root().join("src")).unwrap();
    let modules: BTreeSet<String> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir() || path.extension().is_some_and(|end| end == "rs" || end == "wesl"))
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    assert_eq!(floors.modules(), modules);
}

#[test]
fn the_code_is_read() {
    let arrows = arrows(&root());
    for known in [
        // A module's own name, one that a folder re-exports, and a shader.
        ("src/passes.rs", "src/gbuffer.rs"),
        ("src/passes.rs", "src/rate/classify.rs"),
        ("src/trace/rays.wesl", "src/scene/shading.wesl"),
    ] {
        let (from, to) = (known.0.to_owned(), known.1.to_owned());
        assert!(arrows.contains(&(from, to)), "{known:?} is missing");
    }
    assert!(arrows.len() > 300, "only {} arrows", arrows.len());
}
