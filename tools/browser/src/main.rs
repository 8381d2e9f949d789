//! The page of the demo for browsers: packs it, serves it, and checks it in headless Chromium. `cargo xtask web` calls this program.

mod check;
mod guard;
mod pack;
mod serve;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::path::PathBuf;

#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Write the page into a folder that any static server can serve.
    Pack {
        /// The demo as cargo built it
        wasm: PathBuf,
        /// The files around it
        page: PathBuf,
        /// The folder to write to
        out: PathBuf,
    },
    /// Serve the folder only on this machine.
    Serve {
        /// The folder that `pack` wrote
        folder: PathBuf,
        #[arg(long, default_value_t = 8080)]
        port: u16,
    },
    /// Open the page in headless Chromium, compare it with an image, and click its panel.
    Check {
        /// The folder that `pack` wrote
        folder: PathBuf,
        /// The expected image of the page, by `glint_viewer` with the settings of the page
        expected: PathBuf,
        /// Folder for images of the page
        out: PathBuf,
    },
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Pack { wasm, page, out } => pack::pack(&wasm, &page, &out),
        Command::Serve { folder, port } => serve::serve(&folder, port),
        Command::Check { folder, expected, out } => check::check(&folder, &expected, &out),
    }
}
