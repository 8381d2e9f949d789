//! Compilers from package registries, each in a fixed version with its hash, by the machine's own npm and pip.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

/// npm's files of Dawn for Node, which carries Tint.
const DAWN: (&str, &str) = (include_str!("package.json"), include_str!("package-lock.json"));
/// Requirement of pip for the Python package that carries Slang. Only its libraries are used.
const SLANG: &str = include_str!("requirements.txt");
/// The only platform of [`SLANG`]'s hash.
const PLATFORM: &str = "--python-version=3.11 --implementation=cp --platform=manylinux_2_34_x86_64 --only-binary=:all: \
    --require-hashes --no-deps";

/// Returns the folder of Dawn's package, after it was downloaded once.
pub fn dawn() -> Result<PathBuf> {
    let version = Command::new("node").arg("--version").output();
    ensure!(
        version.is_ok_and(|output| output.status.success()),
        "Node isn't installed"
    );
    let folder = cached("dawn", DAWN.1, |folder| {
        fs::write(folder.join("package.json"), DAWN.0)?;
        fs::write(folder.join("package-lock.json"), DAWN.1)?;
        let mut npm = Command::new("npm");
        npm.args(["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"]);
        download(npm.current_dir(folder), "npm")
    })?;
    Ok(folder.join("node_modules/webgpu"))
}

/// Returns Slang's library, after it was downloaded once.
pub fn slang() -> Result<PathBuf> {
    ensure!(
        cfg!(all(target_os = "linux", target_arch = "x86_64", target_env = "gnu")),
        "the version of Slang is known for Linux on x86-64 alone"
    );
    let folder = cached("slang", SLANG, |folder| {
        let (requirements, package) = (folder.join("requirements.txt"), folder.join("package"));
        fs::write(&requirements, SLANG)?;
        let mut pip = Command::new("python3");
        pip.args(["-m", "pip", "install", "--quiet", "--no-compile", "--target"])
            .arg(&package)
            .args(PLATFORM.split(' '))
            .arg("--requirement")
            .arg(requirements)
            .env("PIP_ROOT_USER_ACTION", "ignore");
        download(&mut pip, "pip")?;
        for file in fs::read_dir(package.join("slangpy"))?.flatten() {
            let name = file.file_name();
            let name = name.to_string_lossy();
            if name.starts_with("libslang-") && name.contains(".so") {
                fs::rename(file.path(), folder.join(&*name))?;
            }
        }
        // The rest is six times as large.
        Ok(fs::remove_dir_all(package)?)
    })?;
    let mut files = fs::read_dir(&folder)?.flatten().map(|file| file.path());
    let is_compiler = |path: &PathBuf| path.display().to_string().contains("/libslang-compiler.so");
    files.find(is_compiler).context("the package has no compiler")
}

/// A folder outside of the clone that `fill` has filled completely, once for each text of a requirement.
fn cached(name: &str, requirement: &str, fill: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
    let home = env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
    let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or(home);
    let cache = cache.context("neither XDG_CACHE_HOME nor HOME is set")?;
    let cache = cache.join("bevy_glint/compilers");
    fill_once(&cache, &folder_name(name, requirement), fill)
}

/// The folder's name depends on the whole requirement, so that another version gets another folder.
fn folder_name(name: &str, requirement: &str) -> String {
    // FNV-1a: the same in each version of Rust.
    let hash = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let hash = requirement.bytes().fold(0xcbf2_9ce4_8422_2325, hash);
    format!("{name}-{hash:016x}")
}

fn fill_once(cache: &Path, name: &str, fill: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
    let folder = cache.join(name);
    if folder.is_dir() {
        return Ok(folder);
    }
    fs::create_dir_all(cache).with_context(|| format!("{} can't be written", cache.display()))?;
    let incomplete = tempfile::tempdir_in(cache)?;
    fill(incomplete.path())?;
    // Another process can have been faster.
    if fs::rename(incomplete.path(), &folder).is_err() && !folder.is_dir() {
        bail!("{} can't be written", folder.display());
    }
    Ok(folder)
}

fn download(command: &mut Command, tool: &str) -> Result<()> {
    let output = command.stdin(Stdio::null()).output();
    let output = output.with_context(|| format!("{tool} can't be started"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        // Both begin with the cause, perhaps after warnings.
        let is_error = |line: &&str| line.to_lowercase().contains("error");
        let reason = said.lines().find(is_error).or_else(|| said.lines().next());
        let reason = reason.unwrap_or("no reason given");
        bail!("{tool} can't download the compiler: {reason}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_filled_once_and_completely() {
        let cache = tempfile::tempdir().unwrap();
        let fill = |fill: fn(&Path) -> Result<()>| fill_once(cache.path(), "a", fill);
        let incomplete = fill(|folder| {
            fs::write(folder.join("part"), "")?;
            bail!("offline")
        });
        assert_eq!(incomplete.unwrap_err().to_string(), "offline");
        assert_eq!(fs::read_dir(cache.path()).unwrap().count(), 0);
        let folder = fill(|folder| Ok(fs::write(folder.join("all"), "")?)).unwrap();
        assert!(folder.join("all").is_file());
        assert_eq!(fill(|_| bail!("twice")).unwrap(), folder);
    }

    #[test]
    fn versions_have_hashes_and_no_addresses() {
        assert!(SLANG.contains("--hash=sha256:"));
        assert!(DAWN.1.contains("sha512-"));
        for text in [DAWN.0, DAWN.1, SLANG] {
            assert!(!text.contains("://"), "{text}");
        }
        assert_ne!(folder_name("a", "1"), folder_name("a", "2"));
    }

    #[cfg(unix)]
    #[test]
    fn failed_downloads_have_a_reason() {
        let error = download(Command::new("sh").args(["-c", "echo 'no network' >&2; exit 1"]), "npm");
        assert_eq!(
            error.unwrap_err().to_string(),
            "npm can't download the compiler: no network"
        );
        assert!(download(&mut Command::new("/no/such/program"), "npm").is_err());
    }
}
