//! A shader of the app that the library's shaders import as a module.
//!
//! A module of a package can't import files of the asset folder. Therefore the app's module and all files that it imports are copied into
//! the library's package, with the same paths relative to each other. A small module at a fixed path passes the app's function on.

use bevy::{
    asset::{AssetEvent, AssetId, Assets, uuid::Uuid},
    ecs::message::MessageReader,
    log::warn,
    platform::collections::HashMap,
    render::render_resource::PipelineCache,
    shader::{Shader, ShaderDefVal, ShaderImport, Source},
};

/// Where the app's module goes.
pub(crate) struct Place {
    /// Name of the folder with the copies.
    pub folder: &'static str,
    /// Path of the module that the library imports.
    pub path: &'static str,
    /// The source of that module; `{app}` is replaced by the path of the app's module.
    pub source: &'static str,
    /// Identifies that module. Copies have the numbers after it.
    pub id: u128,
    /// The resource with the app's shader, for messages.
    pub resource: &'static str,
}

/// The app's shader, as known to the renderer. It must be forgotten with the pipeline cache, so that a new device gets it again.
#[derive(Default)]
pub(crate) struct AppModule {
    /// The shader asset.
    loaded: Option<AssetId<Shader>>,
    /// The last shader that isn't a WESL module.
    refused: Option<AssetId<Shader>>,
    /// Paths of modules that the renderer has: their number, source and definitions.
    modules: HashMap<String, (u128, String, Vec<ShaderDefVal>)>,
}

impl AppModule {
    /// Returns whether the app has a shader.
    pub fn is_there(&self) -> bool {
        self.loaded.is_some()
    }

    /// Passes the wanted shader to the renderer, if it isn't there yet or has changed. Returns whether the module has changed.
    pub fn follow(
        &mut self,
        place: &Place,
        wanted: Option<AssetId<Shader>>,
        shaders: &Assets<Shader>,
        events: &mut MessageReader<AssetEvent<Shader>>,
        cache: &mut PipelineCache,
    ) -> bool {
        if wanted.is_none() && !self.is_there() {
            events.clear();
            return false;
        }
        // A file that is imported can come late. Reads all events, so that none is seen twice.
        let (mut is_new, mut is_edited) = (false, false);
        for event in events.read() {
            if let AssetEvent::Added { id } | AssetEvent::Modified { id } = event {
                is_new = true;
                is_edited |= Some(*id) == wanted;
            }
        }
        let is_late = wanted.is_some_and(|id| !shaders.contains(id));
        // The last module stays until the next one is loaded.
        if self.loaded == wanted && !is_new || is_late && self.is_there() {
            return false;
        }
        let before = self.loaded;
        self.loaded = wanted.filter(|id| {
            let Some(shader) = shaders.get(*id) else { return false };
            if !matches!(shader.source, Source::Wesl(_)) && self.refused.replace(*id) != Some(*id) {
                warn!(
                    "`{}` is left out, since {} is not a WESL module: give its file the extension `wesl`",
                    place.resource, shader.path
                );
            }
            matches!(shader.source, Source::Wesl(_))
        });
        let mut changed = before != self.loaded || is_edited;
        if let Some(shader) = self.loaded.and_then(|id| shaders.get(id)) {
            for (path, module) in copies(place, shader, shaders) {
                changed |= self.set(place, path, module, cache);
            }
        }
        changed
    }

    /// Passes a module to the renderer, if it is new. Returns whether it was.
    fn set(&mut self, place: &Place, path: String, module: Shader, cache: &mut PipelineCache) -> bool {
        let count = self.modules.len() as u128;
        let (number, source, definitions) = self.modules.entry(path).or_insert((count, String::new(), Vec::new()));
        let is_new = source != module.source.as_str() || *definitions != module.shader_defs;
        if is_new {
            module.source.as_str().clone_into(source);
            definitions.clone_from(&module.shader_defs);
            let uuid = Uuid::from_u128(place.id + *number);
            cache.set_shader(AssetId::Uuid { uuid }, module);
        }
        is_new
    }
}

/// The app's module and all files of the asset folder that it imports, as modules of the library, and the module that imports them.
fn copies(place: &Place, main: &Shader, shaders: &Assets<Shader>) -> Vec<(String, Shader)> {
    let files: HashMap<_, _> = shaders
        .iter()
        .filter_map(|(_, shader)| match (&shader.import_path, &shader.source) {
            (ShaderImport::AssetPath(path), Source::Wesl(_)) => Some((path.as_str(), shader)),
            _ => None,
        })
        .collect();
    let mut found = Vec::new();
    let app = match &main.import_path {
        ShaderImport::Custom(path) => path.clone(),
        ShaderImport::AssetPath(path) => {
            found.push((path.as_str(), main));
            let path = identifiers(path).replace('/', "::");
            format!("package::{}{path}", place.folder)
        }
    };
    let mut next = 0;
    while let Some((_, shader)) = found.get(next) {
        for import in &shader.imports {
            if let ShaderImport::AssetPath(path) = import
                && let Some((path, file)) = files.get_key_value(path.as_str())
                && found.iter().all(|(other, _)| other != path)
            {
                found.push((path, file));
            }
        }
        next += 1;
    }
    let copies = found.into_iter().map(|(path, shader)| {
        let path = format!("embedded://bevy_glint/{}{}.wesl", place.folder, identifiers(path));
        let source = shader.source.as_str();
        let source = moved(source, place.folder);
        let mut module = Shader::from_wesl(source, path.clone());
        module.shader_defs.clone_from(&shader.shader_defs);
        (path, module)
    });
    let source = place.source.replace("{app}", &app);
    let module = Shader::from_wesl(source, place.path);
    copies.chain([(place.path.to_owned(), module)]).collect()
}

/// Source of a file of the asset folder that has moved into a folder of the library: paths from the root lead into that folder.
fn moved(source: &str, folder: &str) -> String {
    const ROOT: &str = "package::";
    let mut result = String::with_capacity(source.len());
    let mut rest = source;
    while let Some(at) = rest.find(ROOT) {
        let (before, after) = rest.split_at(at);
        result.push_str(before);
        result.push_str(ROOT);
        let is_end = |c: char| c.is_alphanumeric() || c == '_';
        if !before.ends_with(is_end) {
            result.push_str(folder);
            result.push_str("::");
        }
        rest = &after[ROOT.len()..];
    }
    result + rest
}

/// Turns each part of a file's path into an identifier, since an import can't contain other words.
fn identifiers(path: &str) -> String {
    let is_kept = |c: char| c == '_' || c.is_alphanumeric();
    let part = |part: &str| {
        let digit = if part.starts_with(|c: char| c.is_ascii_digit()) {
            "_"
        } else {
            ""
        };
        let rest: String = part.chars().map(|c| if is_kept(c) { c } else { '_' }).collect();
        format!("/{digit}{rest}")
    };
    path.split('/').filter(|part| !part.is_empty()).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place = Place {
        folder: "app",
        path: "embedded://bevy_glint/fixed.wesl",
        source: "import {app}::f;",
        id: 1 << 64,
        resource: "Resource",
    };

    #[test]
    fn imports_of_the_asset_folder_are_copied_with_their_own() {
        let mut shaders = Assets::<Shader>::default();
        let mut add = |source: &str, path: &str| shaders.add(Shader::from_wesl(source.to_owned(), path.to_owned()));
        let main = add(
            "import super::wind::blow; import bevy_glint::a::b; fn f() { blow(); }",
            "my-shaders/main.wesl",
        );
        add(
            "import package::noise::hash; fn blow() { hash(); }",
            "my-shaders/wind.wesl",
        );
        add("fn hash() {}", "noise.wesl");
        add("fn other() {}", "other.wesl");
        let copies = copies(&PLACE, shaders.get(&main).unwrap(), &shaders);
        let found: Vec<_> = copies
            .iter()
            .map(|(path, module)| (path.as_str(), module.source.as_str()))
            .collect();
        assert_eq!(
            found,
            [
                (
                    "embedded://bevy_glint/app/my_shaders/main.wesl",
                    "import super::wind::blow; import bevy_glint::a::b; fn f() { blow(); }"
                ),
                (
                    "embedded://bevy_glint/app/my_shaders/wind.wesl",
                    "import package::app::noise::hash; fn blow() { hash(); }"
                ),
                ("embedded://bevy_glint/app/noise.wesl", "fn hash() {}"),
                (
                    "embedded://bevy_glint/fixed.wesl",
                    "import package::app::my_shaders::main::f;"
                ),
            ]
        );
    }

    #[test]
    fn only_paths_from_the_root_move() {
        let source = "import package::a::b; import my_package::c; fn f() { package::d::e(); }";
        let expected = "import package::app::a::b; import my_package::c; fn f() { package::app::d::e(); }";
        assert_eq!(moved(source, "app"), expected);
    }

    #[test]
    fn parts_of_paths_become_identifiers() {
        assert_eq!(identifiers("/my-shaders/3d waves"), "/my_shaders/_3d_waves");
        assert_eq!(identifiers("lava"), "/lava");
    }
}
