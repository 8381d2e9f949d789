//! Reads and writes files. Each file appears whole or not at all, and all errors contain its name.

use serde::{Serialize, de::DeserializeOwned};
use std::{
    fs,
    io::{BufWriter, Error, Write},
    path::Path,
};
use tempfile::Builder;

/// Writes a file; folders on the way are created.
pub fn write_file(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<(), Error>) -> Result<(), String> {
    let attempt = || {
        let folder = path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        let mut builder = Builder::new();
        // Like any other file: temporary ones belong to their owner only.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = BufWriter::new(builder.tempfile_in(folder)?);
        write(&mut file)?;
        file.into_inner()?.persist(path)?;
        Ok(())
    };
    attempt().map_err(|error: Error| format!("{} can't be written: {error}", path.display()))
}

/// Writes a text.
pub fn write_text(path: &Path, text: &str) -> Result<(), String> {
    write_file(path, |file| file.write_all(text.as_bytes()))
}

/// Writes a value as JSON.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), String> {
    write_file(path, |file| Ok(serde_json::to_writer_pretty(file, value)?))
}

/// Reads a value from JSON. Returns `None` if the file is missing or invalid: in both cases it must be made again.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
}
