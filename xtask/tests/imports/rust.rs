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
    module: ModulePath,
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
    let programs = fs::read_dir(folder.join("src/bin")).into_iter().flatten().flatten();
    roots.extend(programs.map(|entry| entry.path()));
    for root in roots.into_iter().filter(|root| root.is_file()) {
        let mut modules = Modules::new();
        load(folder, &root, Vec::new(), &mut modules);
        for source in modules.values().flatten() {
            let imports = source.contents.imports.iter();
            let targets = imports.flat_map(|import| targets(&modules, &source.module, import));
            let others = targets.filter(|target| *target != source.file);
            arrows.extend(others.map(|target| (source.file.clone(), target)));
        }
    }
    arrows
}

fn load(folder: &Path, file: &Path, path: ModulePath, modules: &mut Modules) {
    let source = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let contents = read(&tokens(&source), &source);
    let parent = file.parent().unwrap();
    let is_root = path.is_empty() || file.file_name().is_some_and(|name| name == "mod.rs");
    let below = if is_root { parent } else { &file.with_extension("") };
    for (name, named_file) in &contents.children {
        let candidates = match named_file {
            Some(named) => vec![parent.join(named)],
            None => vec![below.join(format!("{name}.rs")), below.join(name).join("mod.rs")],
        };
        let found = candidates.iter().find(|candidate| candidate.is_file());
        let found = found.unwrap_or_else(|| panic!("{}: no file for `mod {name}`", file.display()));
        load(folder, found, child(&path, name), modules);
    }
    let file = file.strip_prefix(folder).unwrap().to_string_lossy().replace('\\', "/");
    let module = path.clone();
    modules.entry(path).or_default().push(Source { module, file, contents });
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
                is_public = false;
                let import = |(path, name)| Import { path, name, is_public };
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
    ends.filter(|(source, _)| !(import.is_public && is_child(&source.module)))
        .map(|(source, _)| source.file.clone())
        .collect()
}

/// The end of a path: a file, and whether the path leads to its module or to an item in it.
type End<'a> = (&'a Source, bool);

/// The ends of a path in a module; none for paths to other crates.
fn resolve<'a>(modules: &'a Modules, from: &ModulePath, path: &[String], depth: usize) -> Vec<End<'a>> {
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
    while let Some((segment, below)) = rest.split_first().filter(|(segment, _)| *segment != "*") {
        let child = child(&module, segment);
        if !modules.contains_key(&child) {
            let sources = modules[&module].iter();
            let ends = sources.flat_map(|source| item(modules, source, segment, depth));
            return ends
                .flat_map(|(source, is_module)| {
                    if is_module && !below.is_empty() {
                        let path = [&["self".to_owned()], below].concat();
                        resolve(modules, &source.module, &path, depth + 1)
                    } else {
                        vec![(source, is_module)]
                    }
                })
                .collect();
        }
        (module, rest) = (child, below);
    }
    modules[&module].iter().map(|source| (source, true)).collect()
}

fn child(module: &ModulePath, name: &str) -> ModulePath {
    module.iter().cloned().chain([name.to_owned()]).collect()
}

/// The original files of an item, its own or another one that re-exports it. An item of unknown origin counts as its own.
fn item<'a>(modules: &'a Modules, source: &'a Source, name: &str, depth: usize) -> Vec<End<'a>> {
    let has_item = |(source, _): &End| source.contents.items.contains(name);
    let own = (source, false);
    if has_item(&own) || depth > 16 {
        return vec![own];
    }
    let resolve = |import: &Import| resolve(modules, &source.module, &import.path, depth + 1);
    let imports = || source.contents.imports.iter();
    let named = imports().filter(|import| import.name == name && import.path.len() > 1);
    let all = imports().filter(|import| import.name == "*").flat_map(resolve);
    let all = all.filter(has_item).map(|(source, _)| (source, false));
    let found: Vec<End> = named.flat_map(resolve).chain(all).collect();
    if found.is_empty() { vec![own] } else { found }
}
