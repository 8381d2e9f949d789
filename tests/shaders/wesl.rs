//! Flattens our shader modules without a GPU, as Bevy does at run time, and validates the result with naga.
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use crate::linked::{Linked, hash};
use bevy::{
    asset::{AssetId, uuid::Uuid},
    shader::{Shader, ShaderCache, ShaderCacheSource, ShaderDefVal},
};

/// Bevy crates with shaders that ours can import.
const BEVY_CRATES: [&str; 3] = ["bevy_render", "bevy_pbr", "bevy_core_pipeline"];

/// An app's module in the place where the renderer puts it.
const APP_SURFACE: &str = "
    import package::scene::surface::Surface;
    import package::trace::surface_point::SurfacePoint;

    fn reflected_surface(surface: Surface, at: SurfacePoint) -> Surface {
        var changed = surface;
        changed.base_color *= fract(at.uv.x + at.seconds) * at.to_viewer.y * f32(at.material_type);
        return changed;
    }
";

/// Another.
const APP_VERTEX: &str = "
    import package::scene::pose::vertex::{app_uniform, VertexPoint, WorldVertex};

    fn reflected_vertex(vertex: WorldVertex, at: VertexPoint) -> WorldVertex {
        var moved = vertex;
        moved.position += at.color.rgb * sin(at.seconds + at.uv.x + at.parameters.x) + app_uniform(at.index).xyz;
        return moved;
    }
";

/// All shader modules of this crate and of Bevy.
pub struct Shaders {
    cache: ShaderCache<String, ()>,
    ids: BTreeMap<String, AssetId<Shader>>,
    /// By module.
    mentions: BTreeMap<String, Mentions>,
    /// By source.
    validated: BTreeMap<String, Result<Arc<naga::Module>, String>>,
    /// The versions of Bevy's modules and of the linker.
    versions: String,
}

/// Names in a module.
#[derive(Default)]
struct Mentions {
    /// All words: definitions are among them.
    words: BTreeSet<String>,
    /// Paths of modules or of their items, in use or not.
    paths: BTreeSet<Vec<String>>,
    /// Of the source.
    hash: String,
}

impl Mentions {
    fn of(package: &str, source: &str) -> Self {
        // Paths of nested imports wouldn't be found.
        let mut imports = source
            .split("import ")
            .skip(1)
            .filter_map(|import| import.split(';').next());
        let is_nested = imports.any(|import| import.matches('{').count() > 1);
        assert!(package != "bevy_glint" || !is_nested, "a nested import");
        let paths = words(source).filter(|word| word.contains("::")).map(|path| {
            let segments = path.split("::").filter(|segment| !segment.is_empty());
            let named = segments.map(|segment| if segment == "package" { package } else { segment });
            named.map(str::to_owned).collect()
        });
        Self {
            words: words(source).map(str::to_owned).collect(),
            paths: paths.collect(),
            hash: hash(source),
        }
    }
}

/// Definitions that the pipeline cache of a device with storage buffers adds.
fn device_defs() -> [ShaderDefVal; 3] {
    [
        ShaderDefVal::UInt("AVAILABLE_STORAGE_BUFFER_BINDINGS".into(), 8),
        "AVAILABLE_STORAGE_BUFFER_BINDINGS__GE_3".into(),
        "AVAILABLE_STORAGE_BUFFER_BINDINGS__GE_6".into(),
    ]
}

/// Identifiers and paths.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':')
        .filter(|word| !word.is_empty())
}

impl Shaders {
    /// Loads `src/**/*.wesl` and Bevy's modules.
    pub fn load() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut shaders = Self {
            cache: ShaderCache::new((), |_, source, _| match source {
                ShaderCacheSource::Wgsl(source) => Ok(source),
                ShaderCacheSource::SpirV(_) => unreachable!("only WESL modules are loaded"),
            }),
            ids: BTreeMap::new(),
            mentions: BTreeMap::new(),
            validated: BTreeMap::new(),
            versions: hash(fs::read(root.join("Cargo.lock")).expect("the tests need Cargo.lock")),
        };
        shaders.add_folder("bevy_glint", &root.join("src"));
        shaders.add("bevy_glint/trace/app_surface.wesl", APP_SURFACE.to_owned());
        shaders.add("bevy_glint/scene/pose/app_vertex.wesl", APP_VERTEX.to_owned());
        for name in BEVY_CRATES {
            shaders.add_folder(name, &bevy_source(root, name));
        }
        shaders
    }

    fn add_folder(&mut self, package: &str, folder: &Path) {
        let mut folders = vec![folder.to_path_buf()];
        while let Some(current) = folders.pop() {
            for entry in fs::read_dir(&current).into_iter().flatten().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "wesl") {
                    let relative = path.strip_prefix(folder).unwrap().to_string_lossy().replace('\\', "/");
                    let name = format!("{package}/{relative}");
                    self.add(&name, fs::read_to_string(&path).unwrap());
                }
            }
        }
    }

    /// Adds or replaces a module; `name` is like `bevy_glint/scene/types.wesl`.
    pub fn add(&mut self, name: &str, source: String) {
        let next = AssetId::Uuid {
            uuid: Uuid::from_u128(self.ids.len() as u128 + 1),
        };
        let id = *self.ids.entry(name.to_string()).or_insert(next);
        let package = name.split('/').next().unwrap_or_default();
        self.mentions.insert(name.to_owned(), Mentions::of(package, &source));
        self.cache
            .set_shader(id, Shader::from_wesl(source, format!("embedded://{name}")));
    }

    /// Names of our own modules.
    pub fn own_modules(&self) -> Vec<String> {
        self.ids
            .keys()
            .filter(|name| name.starts_with("bevy_glint/"))
            .cloned()
            .collect()
    }

    /// The WGSL of a module with all that it imports.
    pub fn flatten(&mut self, name: &str, defs: &[ShaderDefVal]) -> Result<String, String> {
        // Linking costs more than anything else here, and the cache knows sources by their definitions.
        let modules = self.modules(name);
        let known: BTreeSet<_> = modules
            .values()
            .flat_map(|module| &module.words)
            .map(String::as_str)
            .collect();
        let is_known = |def: &&ShaderDefVal| !matches!(def, ShaderDefVal::Bool(name, _) if !known.contains(&**name));
        let mut defs: Vec<_> = defs.iter().filter(is_known).cloned().collect();
        defs.sort_by_cached_key(|def| format!("{def:?}"));
        let hashes: Vec<_> = modules.iter().map(|(name, module)| (name, &module.hash)).collect();
        let linked = Linked::new(
            (name, format!("{defs:?}")),
            (hashes, &self.versions, format!("{:?}", device_defs())),
        );
        if let Some(wgsl) = linked.read() {
            return Ok(wgsl);
        }
        self.link(name, defs).inspect(|wgsl| linked.write(wgsl))
    }

    fn link(&mut self, name: &str, mut defs: Vec<ShaderDefVal>) -> Result<String, String> {
        let id = *self.ids.get(name).ok_or_else(|| format!("no module {name}"))?;
        defs.extend(device_defs());
        self.cache
            .get(0, id, &defs)
            .map(|source| (*source).clone())
            .map_err(|error| format!("{name}: {error}"))
    }

    /// A module and all modules that it names. No other sources and definitions affect it.
    fn modules(&self, name: &str) -> BTreeMap<String, &Mentions> {
        let mut found = BTreeMap::new();
        let mut open = vec![name.to_owned()];
        while let Some(name) = open.pop() {
            let Some(mentions) = self.mentions.get(&name) else {
                continue;
            };
            if found.insert(name, mentions).is_none() {
                open.extend(mentions.paths.iter().flat_map(|path| {
                    let lengths = 2..=path.len();
                    lengths.map(|length| format!("{}.wesl", path[..length].join("/")))
                }));
            }
        }
        found
    }

    /// Flattens and validates a module, which must compile.
    pub fn expect(&mut self, name: &str, defs: &[ShaderDefVal]) -> (String, Arc<naga::Module>) {
        self.parse(name, defs).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Flattens and validates a module.
    pub fn compile(&mut self, name: &str, defs: &[&'static str]) -> Result<Arc<naga::Module>, String> {
        let flags: Vec<ShaderDefVal> = defs.iter().map(|def| ShaderDefVal::from(*def)).collect();
        let parsed = self.parse(name, &flags);
        parsed
            .map(|(_, module)| module)
            .map_err(|error| format!("{name} with {defs:?}: {error}"))
    }

    /// Parses each source once.
    fn parse(&mut self, name: &str, defs: &[ShaderDefVal]) -> Result<(String, Arc<naga::Module>), String> {
        let wgsl = self.flatten(name, defs)?;
        let parsed = self.validated.entry(wgsl.clone());
        let parsed = parsed.or_insert_with_key(|wgsl| validate(wgsl).map(Arc::new));
        parsed.clone().map(|module| (wgsl, module))
    }
}

/// Parses and validates WGSL.
pub fn validate(source: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))?;
    let flags = naga::valid::ValidationFlags::all();
    naga::valid::Validator::new(flags, naga::valid::Capabilities::all())
        .validate(&module)
        .map_err(|error| error.emit_to_string(source))?;
    Ok(module)
}

/// Size of a struct of a shader and offsets of its members, or `None` if the shader doesn't use it.
pub fn struct_layout(module: &naga::Module, name: &str) -> Option<(u32, Vec<(String, u32)>)> {
    let suffix = format!("_{name}");
    let is_it = |linked: &str| linked == name || linked.ends_with(&suffix);
    module.types.iter().find_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span } if ty.name.as_deref().is_some_and(is_it) => {
            let member = |member: &naga::StructMember| (member.name.clone().unwrap_or_default(), member.offset);
            Some((*span, members.iter().map(member).collect()))
        }
        _ => None,
    })
}

/// Folder of the sources of a Bevy crate, at the version of our lock file.
fn bevy_source(root: &Path, name: &str) -> PathBuf {
    let lock = fs::read_to_string(root.join("Cargo.lock")).expect("the tests need Cargo.lock");
    let line = format!("name = \"{name}\"");
    let mut lines = lock.lines().skip_while(|candidate| *candidate != line).skip(1);
    let version = lines
        .next()
        .and_then(|line| line.strip_prefix("version = \""))
        .map(|line| line.trim_end_matches('"'));
    let folder = format!(
        "{name}-{}",
        version.unwrap_or_else(|| panic!("{name} is not in Cargo.lock"))
    );
    let home = std::env::var("CARGO_HOME").map(PathBuf::from).unwrap_or_else(|_| {
        PathBuf::from(
            std::env::var("HOME")
                .or_else(|_| std::env::var("USERPROFILE"))
                .unwrap_or_default(),
        )
        .join(".cargo")
    });
    let registries = fs::read_dir(home.join("registry/src")).expect("the tests need cargo's registry sources");
    registries
        .flatten()
        .map(|registry| registry.path().join(&folder).join("src"))
        .find(|path| path.is_dir())
        .unwrap_or_else(|| panic!("the sources of {folder} are not in cargo's registry"))
}

/// The WGSL of `entry`, a module that can import `package::...`. `replaced` replaces files of the crate, by path under `src`:
/// `("scene/alpha_mask.wesl", "...")`. Errors end the test with the compiler's message.
pub fn flatten(entry: &str, replaced: &[(&str, &str)], defs: &[ShaderDefVal]) -> String {
    let mut shaders = Shaders::load();
    for (path, source) in replaced {
        shaders.add(&format!("bevy_glint/{path}"), (*source).to_string());
    }
    shaders.add("bevy_glint/test_entry.wesl", entry.to_string());
    shaders
        .flatten("bevy_glint/test_entry.wesl", defs)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Like [`flatten`], of a module with `fn output(i: Input) -> Output`, for any types: `main` is a kernel for `Gpu::run`, which calls the
/// function for each input.
pub fn flatten_function(module: &str, replaced: &[(&str, &str)], defs: &[ShaderDefVal]) -> String {
    let types = module.split_once("fn output(i: ").and_then(|(_, rest)| {
        let (input, rest) = rest.split_once(") -> ")?;
        Some((input, rest.split_once(" {")?.0))
    });
    let (input, output) = types.expect("the module has a function from an input to an output");
    let entry = format!(
        "{module}
@group(0) @binding(0) var<storage, read> inputs: array<{input}>;
@group(0) @binding(1) var<storage, read_write> outputs: array<{output}>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    if id.x < arrayLength(&outputs) {{
        outputs[id.x] = output(inputs[id.x]);
    }}
}}
"
    );
    flatten(&entry, replaced, defs)
}

#[test]
#[ignore = "long: links every variant twice"]
fn definitions_that_no_module_names_change_nothing() {
    let mut shaders = Shaders::load();
    let mut different = 0;
    for (pass, defs) in crate::cost::variants() {
        let name = format!("bevy_glint/{pass}.wesl");
        let other = [
            "TINTED_GLASS",
            "LAYERED_RAYS",
            "FORWARD_SURFACES",
            "COPLANAR",
            "REST",
            "TILES_8",
        ];
        for defs in [defs.clone(), [defs, other.to_vec()].concat()] {
            let defs: Vec<ShaderDefVal> = defs.iter().map(|def| (*def).into()).collect();
            let (filtered, all) = (shaders.flatten(&name, &defs), shaders.link(&name, defs));
            // Declarations can be in another order.
            let lines = |source: Result<String, String>| {
                let mut lines: Vec<_> = source.unwrap_or_default().lines().map(str::to_owned).collect();
                lines.sort();
                lines
            };
            let (filtered, all) = (lines(filtered), lines(all));
            different += usize::from(filtered != all);
        }
    }
    assert_eq!(different, 0);
}
