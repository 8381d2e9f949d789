//! The work of each test, for the tables of `cargo xtask test`: a line for each app that ends, in the file that [`FILE`] names.

use super::{HeadlessApp, readback};
use bevy::render::render_resource::{CachedPipelineState, PipelineCache};
use std::{env, fmt, fs::OpenOptions, io::Write, thread};

/// Environment variable with the path of the file. Without it apps write nothing.
const FILE: &str = "GLINT_TEST_PROFILE";

/// Notes that this test skipped a variant, which the long tests run instead.
pub fn note_left_out(variant: &str) {
    write(format_args!("left out\t{variant}"));
}

/// Adds a line that begins with the name of the test: the test harness names each thread after it.
fn write(what: fmt::Arguments) {
    let Some(path) = env::var_os(FILE) else {
        return;
    };
    let thread = thread::current();
    let line = format!("{}\t{what}\n", thread.name().unwrap_or("main"));
    // One write, since tests share the file.
    if let Ok(mut file) = OpenOptions::new().create(true).append(true).open(path) {
        _ = file.write_all(line.as_bytes());
    }
}

impl Drop for HeadlessApp {
    fn drop(&mut self) {
        if env::var_os(FILE).is_none() {
            return;
        }
        let is_compiled = |state: &CachedPipelineState| matches!(state, CachedPipelineState::Ok(_));
        let cache = self.render_world().and_then(readback::resource::<PipelineCache>);
        let pipelines = cache.map_or(0, |cache| {
            cache.pipelines().filter(|one| is_compiled(&one.state)).count()
        });
        write(format_args!("{}\t{pipelines}", self.frames));
    }
}
