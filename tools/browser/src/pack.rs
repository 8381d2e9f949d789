//! Puts the page together.

use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::Command;
use wasm_bindgen_cli_support::Bindgen;

/// Name of the program's files on the page.
const NAME: &str = "demo";
/// Lowest supported version of `wasm-opt`. With version 108, which Debian 12 has, the page stops with an error: this version confuses the
/// function table with the table of JavaScript's objects.
const OLDEST: u32 = 117;
/// Placeholder for the size of the program in the page.
const BYTES: &str = "{{bytes}}";

/// Writes the bindings and the files around them; makes the program smaller if Binaryen's `wasm-opt` is installed.
pub fn pack(wasm: &Path, page: &Path, out: &Path) -> Result<()> {
    fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    Bindgen::new()
        .input_path(wasm)
        .web(true)?
        .typescript(false)
        .remove_name_section(true)
        .remove_producers_section(true)
        .out_name(NAME)
        .generate(out)
        .context("wasm-bindgen failed: `tools/browser/Cargo.toml` must name the version in Cargo.lock")?;
    let program = out.join(format!("{NAME}_bg.wasm"));
    optimize(&program)?;
    let bytes = fs::metadata(&program)?.len();
    for entry in fs::read_dir(page)? {
        let entry = entry?;
        let target = out.join(entry.file_name());
        match fs::read_to_string(entry.path()) {
            Ok(text) => fs::write(target, text.replace(BYTES, &bytes.to_string()))?,
            // Images are not text.
            Err(_) => drop(fs::copy(entry.path(), target)?),
        }
    }
    println!("wrote {}: {:.1} MB", out.display(), bytes as f64 / 1e6);
    Ok(())
}

fn optimize(program: &Path) -> Result<()> {
    let Ok(output) = Command::new("wasm-opt").arg("--version").output() else {
        println!("note: with Binaryen's `wasm-opt` on the path the page would be smaller");
        return Ok(());
    };
    let version = version(&String::from_utf8_lossy(&output.stdout));
    if version.is_none_or(|version| version < OLDEST) {
        println!("note: `wasm-opt` is not used, since it is older than version {OLDEST}");
        return Ok(());
    }
    println!("wasm-opt makes the page smaller, which takes minutes");
    let before = fs::metadata(program)?.len();
    let status = Command::new("wasm-opt")
        .args(["-Os", "--all-features", "-o"])
        .args([program, program])
        .status()?;
    ensure!(status.success(), "wasm-opt failed");
    let after = fs::metadata(program)?.len();
    println!(
        "wasm-opt: {:.1} MB became {:.1} MB",
        before as f64 / 1e6,
        after as f64 / 1e6
    );
    Ok(())
}

/// The number in `wasm-opt version 117 (version_117)`.
fn version(text: &str) -> Option<u32> {
    text.split_whitespace().find_map(|word| word.parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_numbers() {
        assert_eq!(version("wasm-opt version 108 (version_108)\n"), Some(108));
        assert_eq!(version("wasm-opt version 117\n"), Some(117));
        assert_eq!(version("wasm-opt"), None);
    }
}
