//! Every variant of every pass in the languages of Vulkan, DirectX 12 and Metal.
//!
//! `tools/translate` does the work, because Bevy is built here without naga's back end for Metal. `cargo xtask test` builds it, and
//! passes its path in the environment.

use crate::{cost::variants, linked::hash, modules::combinations, wesl::Shaders};
use bevy::shader::ShaderDefVal;
use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// Names the program.
const TRANSLATOR: &str = "GLINT_TRANSLATOR";
/// If this variable is set, a test that can't run must fail.
const REQUIRED: &str = "GLINT_REQUIRE_TRANSLATIONS";

/// Reports that a test can't run.
fn skip(reason: &str) {
    assert!(env::var_os(REQUIRED).is_none(), "{reason}");
    println!("skipped: {reason}");
}

/// The WGSL of all variants by name, without duplicates: some definitions make no difference to some passes.
fn sources() -> BTreeMap<String, String> {
    let mut shaders = Shaders::load();
    let modules = shaders.own_modules();
    let combinations = modules
        .into_iter()
        .flat_map(|module| combinations().map(move |defs| (module.clone(), defs)));
    let passes = variants().map(|(pass, defs)| (format!("bevy_glint/{pass}.wesl"), defs));
    let mut names = BTreeMap::new();
    for (module, defs) in passes.chain(combinations) {
        let pass = module.trim_start_matches("bevy_glint/").trim_end_matches(".wesl");
        // Surfaces have alpha only in the front layer.
        if pass.starts_with("front_layer/") && !defs.contains(&"FRONT_LAYER") {
            continue;
        }
        let values: Vec<ShaderDefVal> = defs.iter().map(|def| (*def).into()).collect();
        let source = shaders
            .flatten(&module, &values)
            .unwrap_or_else(|error| panic!("{error}"));
        let is_pass = ["@compute", "@fragment", "@vertex"]
            .iter()
            .any(|stage| source.contains(stage));
        if is_pass {
            let name = [&[pass][..], &defs].concat().join("+").replace('/', "-");
            names.entry(source).or_insert(name);
        }
    }
    names.into_iter().map(|(source, name)| (name, source)).collect()
}

/// The translations of earlier runs, in a folder of the translator with which they were made.
struct Translations {
    folder: PathBuf,
    /// Those of this run, until they are checked.
    new: PathBuf,
}

impl Translations {
    fn open(translator: &Path) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("translations");
        let new = folder.with_extension("new");
        // Without a validator, nothing is known about the SPIR-V.
        let validator = Command::new("spirv-val").arg("--version").output().ok();
        let made_by = hash((fs::read(translator).unwrap(), validator.map(|output| output.stdout)));
        let version = folder.join("translator");
        if fs::read_to_string(&version).ok().as_ref() != Some(&made_by) {
            _ = fs::remove_dir_all(&folder);
            fs::create_dir_all(&folder).unwrap();
            fs::write(version, made_by).unwrap();
        }
        _ = fs::remove_dir_all(&new);
        fs::create_dir_all(&new).unwrap();
        Self { folder, new }
    }

    /// Writes the sources that were not translated before.
    fn write(&self, sources: &BTreeMap<String, String>) {
        for (name, source) in sources {
            let file = format!("{name}.wgsl");
            if fs::read_to_string(self.folder.join(&file)).ok().as_ref() != Some(source) {
                fs::write(self.new.join(file), source).unwrap();
            }
        }
    }

    /// Keeps the translations of this run, and those of earlier runs of the other sources.
    fn keep(&self, sources: &BTreeMap<String, String>) {
        for path in files(&self.folder) {
            let name = path.file_name().unwrap().to_str().unwrap();
            let is_current = name
                .split_once('.')
                .is_none_or(|(name, _)| sources.contains_key(name) && !self.new.join(format!("{name}.wgsl")).exists());
            if !is_current {
                fs::remove_file(path).unwrap();
            }
        }
        // A translation without its source is made anew.
        let mut new: Vec<_> = files(&self.new).collect();
        new.sort_by_key(|path| path.extension().is_some_and(|end| end == "wgsl"));
        for path in new {
            fs::rename(&path, self.folder.join(path.file_name().unwrap())).unwrap();
        }
    }
}

fn files(folder: &Path) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(folder).unwrap().flatten().map(|file| file.path())
}

fn files_of(folder: &Path, language: &str) -> usize {
    let is_of = |path: &PathBuf| path.extension().is_some_and(|end| end == language);
    files(folder).filter(is_of).count()
}

fn text(output: &Output) -> String {
    [&output.stdout[..], &output.stderr]
        .map(String::from_utf8_lossy)
        .concat()
}

#[test]
fn every_variant_is_translated() {
    let Some(translator) = env::var_os(TRANSLATOR) else {
        return skip("`cargo xtask test` builds the program that translates shaders");
    };
    let sources = sources();
    assert!(sources.len() > 100, "only {} variants", sources.len());
    let translations = Translations::open(Path::new(&translator));
    translations.write(&sources);
    let translated = files_of(&translations.new, "wgsl");
    let output = Command::new(translator).arg(&translations.new).output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    check_spirv(&translations.new);
    translations.keep(&sources);
    let [wgsl, spirv, hlsl, msl] = ["wgsl", "spv", "hlsl", "metal"].map(|end| files_of(&translations.folder, end));
    println!("{wgsl} variants, {translated} of them translated anew: SPIR-V {spirv}, HLSL {hlsl}, MSL {msl}");
    assert_eq!(wgsl, sources.len());
    assert!(
        [spirv, hlsl, msl].iter().all(|&count| count >= wgsl),
        "a translation is missing"
    );
}

/// Has Khronos' validator read the SPIR-V.
fn check_spirv(folder: &Path) {
    if Command::new("spirv-val").arg("--version").output().is_err() {
        return skip("spirv-val is missing: Debian has it in the package spirv-tools");
    }
    let mut failures = Vec::new();
    for file in files(folder) {
        if file.extension().is_some_and(|end| end == "spv") {
            let output = Command::new("spirv-val")
                .args(["--target-env", "vulkan1.2"])
                .arg(&file)
                .output();
            let output = output.unwrap();
            if !output.status.success() {
                failures.push(format!("{}: {}", file.display(), text(&output)));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
