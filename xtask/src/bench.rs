//! `cargo xtask bench`: rays per second and build times.

use std::ffi::OsString;

use crate::cargo::Program;
use crate::driver::{self, Need};
use crate::failure::Result;
use crate::{cargo, progress};

/// What `bench` accepts.
#[derive(clap::Args)]
pub struct Options {
    /// Options of the benchmark itself; `cargo xtask bench -- --help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
    arguments: Vec<OsString>,
}

/// Builds and runs the benchmark.
pub fn run(options: &Options) -> Result {
    let driver = driver::prepare(Need::Vulkan)?;
    progress::step("build and run the benchmark", || {
        let mut command = cargo::program(Program::Binary("glint_bench"))?;
        command.args(&options.arguments).envs(driver);
        cargo::run(&mut command, "the benchmark")
    })
}
