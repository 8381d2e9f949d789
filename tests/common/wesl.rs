//! Flattens WESL to WGSL as Bevy does, with all shaders of the crate at hand.

use bevy::asset::{AssetId, uuid::Uuid};
use bevy::shader::{Shader, ShaderCache, ShaderCacheSource, ShaderDefVal};
use std::path::{Path, PathBuf};

/// Flattens a module that may import `package::...`. `replaced` puts other sources in the place of files of the crate, by
/// path under `src`: `("scene/alpha.wesl", "...")`. Errors end the test with the compiler's message.
pub fn flatten(entry: &str, replaced: &[(&str, &str)], defs: &[ShaderDefVal]) -> String {
    let mut cache = ShaderCache::<String, ()>::new((), |_, source, _| match source {
        ShaderCacheSource::Wgsl(wgsl) => Ok(wgsl),
        ShaderCacheSource::SpirV(_) => unreachable!("only WESL is registered"),
    });
    let mut number = 0;
    let mut register = |path: &str, source: String| {
        number += 1;
        let id = AssetId::Uuid {
            uuid: Uuid::from_u128(number),
        };
        cache.set_shader(id, Shader::from_wesl(source, format!("embedded://bevy_glint/{path}")));
        id
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for path in wesl_files(&root) {
        let name = path
            .strip_prefix(&root)
            .expect("below src")
            .to_string_lossy()
            .replace('\\', "/");
        let source = match replaced.iter().find(|(replaced, _)| *replaced == name) {
            Some((_, source)) => (*source).to_string(),
            None => std::fs::read_to_string(&path).expect("shader is readable"),
        };
        register(&name, source);
    }
    let id = register("test_entry.wesl", entry.to_string());
    let flat = cache.get(0, id, defs).unwrap_or_else(|error| panic!("{error}"));
    flat.to_string()
}

fn wesl_files(directory: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(directory).expect("directory is readable").flatten() {
        let path = entry.path();
        if path.is_dir() {
            files.extend(wesl_files(&path));
        } else if path.extension().is_some_and(|e| e == "wesl") {
            files.push(path);
        }
    }
    files
}
