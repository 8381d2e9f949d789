//! `cargo xtask translations`: foreign compilers judge the languages that shaders are translated to.
//!
//! Tint, Chromium's compiler, reads the WGSL that browsers get. Slang compiles the HLSL back to SPIR-V, and passes of the presets are run
//! in both translations. `cargo xtask isa` has AMD's compiler. Their input comes from the test `every_variant_is_translated`.

mod hlsl;
mod image;
mod packages;
mod tint;

pub use hlsl::RoundTrip;
pub use tint::Tint;

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};

use crate::driver::{self, Need};
use crate::{cargo, progress};

/// Passes of the presets in plain scenes with either tracer, and the passes of the hardware back end.
pub const PRESETS: [&str; 39] = [
    "composite/resolve.resolve",
    "composite/resolve.resolve IN_PLACE TILES",
    "composite/resolve.resolve IN_PLACE TILES BLUR",
    "composite/resolve.resolve IN_PLACE TILES FRONT_LAYER BLUR",
    "composite/resolve.resolve IN_PLACE TILES HALF_RESOLUTION BLUR",
    "denoise/one_pass.denoise",
    "denoise/one_pass.denoise WIDE",
    "denoise/one_pass.denoise WIDE HIT_MOTION",
    "denoise/one_pass.denoise WIDE REST",
    "denoise/reconstruct.reconstruct WIDE",
    "denoise/temporal.temporal",
    "front_layer/find.find FRONT_LAYER",
    "front_layer/find.find FRONT_LAYER RAY_QUERY",
    "rate/adaptive.classify TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE",
    "rate/classify.classify",
    "rate/classify.classify COMBINED TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE",
    "rate/classify.classify ROUGHNESS",
    "scene/pose/pose.pose_vertices",
    "scene/pose/refit.fit_level",
    "scene/pose/refit.pose_triangles",
    "trace/blocks.trace",
    "trace/blocks.trace KEPT_RAYS",
    "trace/blocks.trace KEPT_RAYS RAY_QUERY",
    "trace/blocks.trace MIRRORS",
    "trace/blocks.trace MIRRORS RAY_QUERY",
    "trace/blocks.trace RAY_QUERY",
    "trace/converged.trace",
    "trace/converged.trace RAY_QUERY",
    "trace/inline.fragment",
    "trace/inline.fragment RAY_QUERY",
    "trace/shade.trace",
    "trace/shade.trace KEPT_RAYS",
    "trace/shade.trace MANY_LIGHTS",
    "trace/shade.trace MANY_LIGHTS RAY_QUERY",
    "trace/shade.trace MIRRORS",
    "trace/shade.trace MIRRORS KEPT_RAYS",
    "trace/shade.trace MIRRORS KEPT_RAYS RAY_QUERY",
    "trace/shade.trace MIRRORS RAY_QUERY",
    "trace/vrs.pack",
];
/// Names of the steps.
pub const WGSL: &str = "WGSL by Tint";
pub const HLSL: &str = "HLSL by a round trip";
/// The test that writes the translations.
const TEST: &str = "every_variant_is_translated";
/// The folder of translations, in the output folder of tests.
pub const TRANSLATED: &str = "translations";

/// Arguments of `translations`.
#[derive(clap::Args)]
pub struct Options {
    /// Compile every variant of HLSL, not only those of the presets.
    #[arg(long)]
    all: bool,
    /// Use the shaders from the last run of the tests.
    #[arg(long)]
    translated: bool,
    /// Only render the demo with its compute shaders by way of HLSL, and compare the image.
    #[arg(long, conflicts_with_all = ["all", "translated"])]
    image: bool,
}

/// Translates the shaders and judges them. A compiler that can't be had is skipped.
pub fn run(options: &Options) -> Result<()> {
    driver::prepare(Need::RayQuery)?;
    if options.image {
        return image::compare(&packages::slang()?);
    }
    if !options.translated {
        progress::step("translate the shaders", translate)?;
    }
    let (mut skipped, mut failed) = (0, Vec::new());
    let mut judge = |name, compiler: Result<Result<()>>| match compiler {
        Ok(Ok(())) => {}
        Ok(Err(error)) => {
            progress::say(format_args!("{error:#}"));
            failed.push(name);
        }
        Err(reason) => {
            skipped += 1;
            progress::result(format_args!("skipped: {name}: {reason:#}"));
        }
    };
    judge(WGSL, Tint::prepare().map(|tint| progress::step(WGSL, || tint.judge())));
    let trip = RoundTrip::prepare();
    judge(HLSL, trip.map(|trip| progress::step(HLSL, || trip.judge(options.all))));
    if skipped > 0 {
        progress::result(format_args!("skipped: {skipped} of 2 languages"));
    }
    if !failed.is_empty() {
        bail!("refused: {}", failed.join(", "));
    }
    Ok(())
}

/// Runs the test that writes the translations.
pub fn translate() -> Result<()> {
    let translator = cargo::program_apart("tools/translate")?;
    let mut test = cargo::test_program("shaders")?;
    test.env("GLINT_TRANSLATOR", translator).args([TEST, "--nocapture"]);
    cargo::run(&mut test, TEST)
}

/// From `trace-blocks+MIRRORS.main.spv` to `trace/blocks.main MIRRORS`, and from `trace-blocks+MIRRORS.wgsl` to `trace/blocks MIRRORS`.
pub fn name(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let (module, entry) = stem.split_at(stem.rfind('.').unwrap_or(stem.len()));
    let mut parts = module.split('+');
    let pass = parts.next().unwrap_or_default().replace('-', "/");
    parts.fold(format!("{pass}{entry}"), |name, def| format!("{name} {def}"))
}

/// The output folder of tests.
pub fn temporary_folder() -> Result<PathBuf> {
    let metadata = cargo::metadata()?;
    let target = metadata["target_directory"].as_str().context("no target directory")?;
    Ok(Path::new(target).join("tmp"))
}

/// The files of a language, each with its contents. Many definitions make no difference to a pass, so files with the same contents are
/// there once, by the shortest name.
pub fn unique(folder: &Path, suffix: &str) -> Result<Vec<(PathBuf, Vec<u8>)>> {
    let files = fs::read_dir(folder).with_context(|| format!("{}: run the tests first", folder.display()))?;
    let mut paths: Vec<_> = files.map(|file| Ok(file?.path())).collect::<Result<_>>()?;
    paths.retain(|path| path.extension().is_some_and(|end| end == suffix));
    paths.sort_by_cached_key(|path| (path.as_os_str().len(), path.clone()));
    let (mut unique, mut known) = (Vec::new(), HashSet::new());
    for path in paths {
        let contents = fs::read(&path)?;
        if known.insert(contents.clone()) {
            unique.push((path, contents));
        }
    }
    ensure!(!unique.is_empty(), "{} has no file of {suffix}", folder.display());
    Ok(unique)
}

/// Shaders with faults, for the tests of compilers.
#[cfg(test)]
pub mod planted {
    use super::*;

    pub const GOOD: &str = "
        @group(0) @binding(0) var<storage, read_write> data: array<f32>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {
            data[id.x] += 1.0;
        }";

    /// Writes and translates shaders.
    pub fn translate(folder: &Path, shaders: &[(&str, &str)]) {
        for (name, source) in shaders {
            fs::write(folder.join(format!("{name}.wgsl")), source).unwrap();
        }
        let translator = cargo::program_apart("tools/translate").unwrap();
        cargo::run(cargo::command(translator).arg(folder), "the translation").unwrap();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_other_tables() {
        let name = |file: &str| name(Path::new(file));
        assert_eq!(
            name("a/trace-blocks+MIRRORS+RAY_QUERY.trace.spv"),
            "trace/blocks.trace MIRRORS RAY_QUERY"
        );
        assert_eq!(name("scene-pose-refit.fit_level.spv"), "scene/pose/refit.fit_level");
        assert_eq!(name("a/trace-blocks+MIRRORS+BLUR.wgsl"), "trace/blocks MIRRORS BLUR");
        assert_eq!(name("scene-scatter.wgsl"), "scene/scatter");
    }

    #[test]
    fn equal_files_count_once() {
        let folder = tempfile::tempdir().unwrap();
        for (name, contents) in [("a+B.wgsl", "x"), ("a.wgsl", "x"), ("b.wgsl", "y"), ("c.spv", "z")] {
            fs::write(folder.path().join(name), contents).unwrap();
        }
        let found = unique(folder.path(), "wgsl").unwrap();
        let names: Vec<_> = found.iter().map(|(path, _)| path.file_name().unwrap()).collect();
        assert_eq!(names, ["a.wgsl", "b.wgsl"]);
        assert!(unique(folder.path(), "hlsl").is_err());
    }
}
