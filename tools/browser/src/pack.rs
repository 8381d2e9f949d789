//! Puts the page together.

use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::Path;
use std::process::Command;
use wasm_bindgen_cli_support::Bindgen;

/// Name of the program's files on the page.
const NAME: &str = "demo";
/// Stands for the size of the program in the page.
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
            // Pictures are no text.
            Err(_) => drop(fs::copy(entry.path(), target)?),
        }
    }
    println!("wrote {}: {:.1} MB", out.display(), bytes as f64 / 1e6);
    Ok(())
}

fn optimize(program: &Path) -> Result<()> {
    let before = fs::metadata(program)?.len();
    println!("wasm-opt, if it is on the path, takes minutes");
    let status = Command::new("wasm-opt")
        .args(["-Os", "--all-features", "-o"])
        .args([program, program])
        .status();
    let Ok(status) = status else {
        println!("note: with Binaryen's `wasm-opt` on the path the page would be smaller");
        return Ok(());
    };
    ensure!(status.success(), "wasm-opt failed");
    let after = fs::metadata(program)?.len();
    println!(
        "wasm-opt: {:.1} MB became {:.1} MB",
        before as f64 / 1e6,
        after as f64 / 1e6
    );
    Ok(())
}
