//! Shared with `tools/roundtrip`: a Vulkan device, a reader of SPIR-V, and the form of the results.

pub mod device;
pub mod spirv;

use anyhow::Result;
use std::io::{self, Write};

/// Prints `header`, and then a line for each argument: the argument, `ok` and figures, or `failed` and the reason, separated by tabs. If
/// the program crashes, the argument after the last line is the cause.
pub fn report(header: &str, arguments: &[String], work: impl Fn(&str) -> Result<String>) -> Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{header}")?;
    for argument in arguments {
        let outcome = match work(argument) {
            Ok(figures) => format!("ok\t{figures}"),
            Err(error) => format!("failed\t{error:#}").replace('\n', " "),
        };
        writeln!(out, "{argument}\t{outcome}")?;
        out.flush()?;
    }
    Ok(())
}
