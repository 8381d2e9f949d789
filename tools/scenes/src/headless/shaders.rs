//! Replaces shader modules of a crate while an app runs, so that versions of shaders can be compared without rebuilding.

use super::{HeadlessApp, HeadlessError};
use bevy::prelude::*;
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Maximum number of frames for loading a module.
const FRAME_LIMIT: u32 = 4000;

/// A shader module, and the module that it replaced.
pub struct ReplacedShader {
    handle: Handle<Shader>,
    original: Shader,
}

impl HeadlessApp {
    /// Replaces a crate's embedded shader modules by the files of a folder with the same path. Returns the replaced modules.
    pub fn replace_shaders(&mut self, of_crate: &str, folder: &Path) -> Result<Vec<ReplacedShader>, HeadlessError> {
        let fail =
            |path: &Path, error: &dyn std::fmt::Display| HeadlessError::Asset(format!("{}: {error}", path.display()));
        let mut paths = Vec::new();
        list_files(folder, &mut paths).map_err(|error| fail(folder, &error))?;
        let mut replaced = Vec::new();
        for path in paths {
            let source = fs::read_to_string(&path).map_err(|error| fail(&path, &error))?;
            let relative = path.strip_prefix(folder).unwrap_or(&path);
            let module = format!("embedded://{of_crate}/{}", relative.display());
            let handle: Handle<Shader> = self.world().resource::<AssetServer>().load(&module);
            let original = (0..FRAME_LIMIT).find_map(|_| {
                self.step(1);
                self.world().resource::<Assets<Shader>>().get(&handle).cloned()
            });
            let original = original.ok_or_else(|| fail(&path, &format_args!("{module} was not loaded")))?;
            self.insert_shader(&handle, Shader::from_wesl(source, module));
            replaced.push(ReplacedShader { handle, original });
        }
        Ok(replaced)
    }

    /// Puts shader modules back.
    pub fn restore_shaders(&mut self, replaced: Vec<ReplacedShader>) {
        for ReplacedShader { handle, original } in replaced {
            self.insert_shader(&handle, original);
        }
    }

    fn insert_shader(&mut self, handle: &Handle<Shader>, shader: Shader) {
        // An asset with a live handle still exists.
        _ = self
            .world()
            .resource_mut::<Assets<Shader>>()
            .insert(handle.id(), shader);
    }
}

fn list_files(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            list_files(&path, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}
