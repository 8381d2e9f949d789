//! Arrows between the Rust files of a crate.

use crate::{
    graph::Arrows,
    tokens::{Token, after_group, is_name, path_tree, tokens},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// A path of modules from the root of the crate.
type ModulePath = Vec<String>;

/// A name that a file imports, or a path in its code.
struct Import {
    path: Vec<String>,
    name: String,
    /// Re-exported.
    is_public: bool,
}

/// Contents of a file without its tests.
#[derive(Default)]
struct Contents {
    /// Child modules, each with the file name from its attribute.
    children: Vec<(String, Option<String>)>,
    imports: Vec<Import>,
    /// Items at the top of the file.
    items: BTreeSet<String>,
}

struct Source {
    /// From the root folder of the crate.
    file: String,
    contents: Contents,
}

/// A module can be one of several files, by the platform.
type Modules = BTreeMap<ModulePath, Vec<Source>>;

/// Arrows of the library and the programs of a crate.
pub fn arrows(folder: &Path) -> Arrows {
    let mut arrows = Arrows::new();
    let mut roots: Vec<PathBuf> = ["src/lib.rs", "src/main.rs"].map(|name| folder.join(name)).into();
    roots.extend(
        fs::read_dir(folder.join("src/bin"))
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path()),
    );
    for root in roots.into_iter().filter(|root| root.is_file()) {
        let mut modules = Modules::new();
        load(folder, &root, Vec::new(), &mut modules);
        for (path, sources) in &modules {
            for source in sources {
                for import in &source.contents.imports {
                    for target in targets(&modules, path, import) {
                        if target != source.file {
                            arrows.insert((source.file.clone(), target));
                        }
                    }
                }
            }
        }
    }
    arrows
}

fn load(folder: &Path, file: &Path, path: ModulePath, modules: &mut Modules) {
    let source = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let contents = read(&tokens(&source), &source);
    let parent = file.parent().unwrap();
    let is_root = path.is_empty() || file.file_name().is_some_and(|name| name == "mod.rs");
    let below = if is_root {
        parent.to_owned()
    } else {
        file.with_extension("")
    };
    for (name, named_file) in &contents.children {
        let candidates = match named_file {
            Some(named) => vec![parent.join(named)],
            None => vec![below.join(format!("{name}.rs")), below.join(name).join("mod.rs")],
        };
        let found = candidates.iter().find(|candidate| candidate.is_file());
        let found = found.unwrap_or_else(|| panic!("{}: no file for `mod {name}`", file.display()));
        let mut child = path.clone();
        child.push(name.clone());
        load(folder, found, child, modules);
    }
    let file = file.strip_prefix(folder).unwrap().to_string_lossy().replace('\\', "/");
    modules.entry(path).or_default().push(Source { file, contents });
}

/// Reads a file. The attribute `#[path = ".."]` is looked up in the source, since tokens contain no text.
fn read(tokens: &[Token], source: &str) -> Contents {
    let at = |i: usize| tokens.get(i).map_or("", String::as_str);
    let mut contents = Contents::default();
    let mut named_files = source
        .lines()
        .filter_map(|line| line.trim().strip_prefix("#[path = \"")?.strip_suffix("\"]"));
    let (mut i, mut depth, mut is_public, mut named) = (0, 0, false, None);
    while i < tokens.len() {
        match at(i) {
            "#" if at(i + 1) == "[" => {
                let end = after_group(tokens, i + 1);
                let attribute: String = tokens[i..end].concat();
                if attribute.starts_with("#[path=") {
                    named = named_files.next().map(str::to_owned);
                }
                i = if attribute == "#[cfg(test)]" {
                    after_item(tokens, end)
                } else {
                    end
                };
                continue;
            }
            "pub" => {
                is_public = true;
                i += 1;
                if at(i) == "(" {
                    i = after_group(tokens, i);
                }
                continue;
            }
            "use" => {
                let (paths, end) = path_tree(tokens, i + 1);
                let import = |(path, name)| Import { path, name, is_public };
                contents.imports.extend(paths.into_iter().map(import));
                i = end;
            }
            "mod" if at(i + 2) == ";" => {
                contents.children.push((at(i + 1).to_owned(), named.take()));
                i += 2;
            }
            "crate" | "super" | "self" if at(i + 1) == "::" => {
                let (paths, end) = path_tree(tokens, i);
                let import = |(path, name)| Import {
                    path,
                    name,
                    is_public: false,
                };
                contents.imports.extend(paths.into_iter().map(import));
                i = end;
                continue;
            }
            "struct" | "enum" | "fn" | "const" | "static" | "type" | "trait" if depth == 0 && is_name(at(i + 1)) => {
                let name = if at(i + 1) == "fn" { at(i + 2) } else { at(i + 1) };
                contents.items.insert(name.to_owned());
            }
            "{" => depth += 1,
            "}" => depth -= 1,
            _ => {}
        }
        is_public = false;
        i += 1;
    }
    contents
}

/// The position after the item that begins here, with its attributes.
fn after_item(tokens: &[Token], start: usize) -> usize {
    let at = |i: usize| tokens.get(i).map_or("", String::as_str);
    let mut i = start;
    let mut ends_with_semicolon = false;
    while i < tokens.len() {
        match at(i) {
            "#" if at(i + 1) == "[" => i = after_group(tokens, i + 1),
            "use" | "const" | "static" | "type" => {
                ends_with_semicolon = true;
                i += 1;
            }
            "fn" => {
                ends_with_semicolon = false;
                i += 1;
            }
            ";" => return i + 1,
            "{" => {
                i = after_group(tokens, i);
                if !ends_with_semicolon {
                    return i;
                }
            }
            "(" | "[" => i = after_group(tokens, i),
            _ => i += 1,
        }
    }
    i
}

/// The files that an import leads to.
fn targets(modules: &Modules, from: &ModulePath, import: &Import) -> BTreeSet<String> {
    let ends = resolve(modules, from, &import.path, 0).into_iter();
    // Re-exporting an item of a child doesn't count as use.
    let is_child = |module: &ModulePath| module.len() > from.len() && module.starts_with(from);
    ends.filter(|end| !(import.is_public && is_child(&end.module)))
        .map(|end| end.file)
        .collect()
}

/// The end of a path: a module, or a file of a module that has an item.
#[derive(Clone)]
struct End {
    module: ModulePath,
    file: String,
    is_module: bool,
}

fn ends_of_module(modules: &Modules, module: &ModulePath) -> Vec<End> {
    let sources = modules[module].iter();
    let end = |source: &Source| End {
        module: module.clone(),
        file: source.file.clone(),
        is_module: true,
    };
    sources.map(end).collect()
}

/// The ends of a path in a module; none for paths to other crates.
fn resolve(modules: &Modules, from: &ModulePath, path: &[String], depth: usize) -> Vec<End> {
    let mut module = from.clone();
    let ups = path.iter().take_while(|segment| *segment == "super").count();
    let mut rest = &path[ups..];
    match path.first().map(String::as_str) {
        Some("crate") => {
            module.clear();
            rest = &path[1..];
        }
        Some("self") => rest = &path[1..],
        Some("super") => module.truncate(module.len().saturating_sub(ups)),
        Some(first) if modules.contains_key(&child(&module, first)) => {}
        _ => return Vec::new(),
    }
    while let Some((segment, below)) = rest.split_first() {
        let child = child(&module, segment);
        if modules.contains_key(&child) {
            module = child;
            rest = below;
            continue;
        }
        if segment == "*" {
            break;
        }
        let ends = modules[&module]
            .iter()
            .flat_map(|source| item(modules, &module, source, segment, depth));
        return ends
            .flat_map(|end| {
                if end.is_module {
                    resolve_below(modules, end, below, depth)
                } else {
                    vec![end]
                }
            })
            .collect();
    }
    ends_of_module(modules, &module)
}

fn resolve_below(modules: &Modules, end: End, below: &[String], depth: usize) -> Vec<End> {
    if below.is_empty() {
        return vec![end];
    }
    let mut path = vec!["self".to_owned()];
    path.extend_from_slice(below);
    resolve(modules, &end.module, &path, depth + 1)
}

fn child(module: &ModulePath, name: &str) -> ModulePath {
    let mut child = module.clone();
    child.push(name.to_owned());
    child
}

/// The original files of an item, its own or another one that re-exports it. An item of unknown origin counts as its own.
fn item(modules: &Modules, module: &ModulePath, source: &Source, name: &str, depth: usize) -> Vec<End> {
    let own = End {
        module: module.clone(),
        file: source.file.clone(),
        is_module: false,
    };
    if source.contents.items.contains(name) || depth > 16 {
        return vec![own];
    }
    let imports = || source.contents.imports.iter();
    let has_item = |end: &End| {
        let sources = modules[&end.module].iter();
        sources
            .filter(|source| source.file == end.file)
            .any(|source| source.contents.items.contains(name))
    };
    let named = imports().filter(|import| import.name == name && import.path.len() > 1);
    let named = named.flat_map(|import| resolve(modules, module, &import.path, depth + 1));
    let all = imports().filter(|import| import.name == "*");
    let all = all
        .flat_map(|import| resolve(modules, module, &import.path, depth + 1))
        .filter(has_item);
    let found: Vec<End> = named
        .chain(all.map(|end| End {
            is_module: false,
            ..end
        }))
        .collect();
    if found.is_empty() { vec![own] } else { found }
}
