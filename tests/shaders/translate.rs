//! Every variant of every pass in the languages of Vulkan, DirectX 12 and Metal.
//!
//! `tools/translate` does the work, because Bevy is built here without naga's back end for Metal. `cargo xtask test` builds it, and
//! passes its path in the environment.

use crate::{cost::variants, modules::COMBINATIONS, wesl::Shaders};
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
        .flat_map(|module| COMBINATIONS.map(|defs| (module.clone(), defs.to_vec())));
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

/// Writes the sources into an empty folder.
fn write(sources: &BTreeMap<String, String>) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("translations");
    _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    for (name, source) in sources {
        fs::write(folder.join(format!("{name}.wgsl")), source).unwrap();
    }
    folder
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
    let folder = write(&sources);
    let output = Command::new(translator).arg(&folder).output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    let count = |end: &str| {
        let files = fs::read_dir(&folder).unwrap().flatten().map(|file| file.path());
        files
            .filter(|path| path.extension().is_some_and(|found| found == end))
            .count()
    };
    let counts = ["wgsl", "spv", "hlsl", "metal"].map(count);
    println!(
        "{} variants: SPIR-V {}, HLSL {}, MSL {}",
        counts[0], counts[1], counts[2], counts[3]
    );
    assert!(counts.iter().all(|count| *count >= sources.len()), "{counts:?}");
    check_spirv(&folder);
}

/// Has Khronos' validator read the SPIR-V.
fn check_spirv(folder: &Path) {
    if Command::new("spirv-val").arg("--version").output().is_err() {
        return skip("spirv-val is missing: Debian has it in the package spirv-tools");
    }
    let mut failures = Vec::new();
    for file in fs::read_dir(folder).unwrap().flatten().map(|file| file.path()) {
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
