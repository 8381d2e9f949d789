//! Shows a built-in scene or a glTF file with ray-traced reflections, in a window or as an image.
//!
//! `cargo xtask demo` builds and starts this program; `--help` lists its options.

mod arguments;
#[cfg(feature = "film")]
mod film;
mod gltf;
mod image;
mod method;
mod plugins;
mod record;
mod source;
mod window;

use arguments::Arguments;
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("error: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    #[cfg(feature = "film")]
    if let Some(frames) = arguments.film {
        return film::write(arguments, frames);
    }
    if arguments.headless {
        image::write(arguments)
    } else {
        window::open(arguments)
    }
}
