//! Installing what is missing on Debian and Ubuntu, and saying what to install everywhere else.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::{Need, RAY_QUERY_MESA, apt_sources};
use crate::cargo;
use crate::failure::{Failure, Result};
use crate::progress::note;
use crate::version::Version;

/// The package of Mesa's Vulkan drivers.
const MESA: &str = "mesa-vulkan-drivers";
/// The package of the Vulkan loader.
const LOADER: &str = "libvulkan1";
/// Where the backports of the release are written down, should they be needed.
const BACKPORTS_FILE: &str = "/etc/apt/sources.list.d/bevy-glint-backports.sources";

/// The version of Mesa that Debian's package manager knows to be installed.
pub fn mesa_version() -> Option<Version> {
    output("dpkg-query", &["-W", "-f=${Version}\\n", MESA])
        .as_deref()
        .and_then(Version::parse)
}

/// Installs the Vulkan loader and Mesa's drivers, with ray queries if the machine's sources have them.
pub fn packages(need: Need) -> Result {
    let system = System::read();
    let wanted = match need {
        Need::Vulkan => "a Vulkan driver",
        Need::RayQuery => "a Vulkan driver with ray queries (Mesa 24.1 or newer)",
    };
    system.require_apt(&format!("{MESA} {LOADER}"), wanted)?;
    note("installing Mesa's Vulkan drivers, among them the CPU's (this can take a minute)");
    apt_get(&["update"])?;
    let mut suite = None;
    if candidate().is_none_or(|mesa| mesa < RAY_QUERY_MESA) && system.id == "debian" {
        match system.enable_backports() {
            Ok(backports) => suite = Some(backports),
            Err(failure) if need == Need::RayQuery => return Err(failure),
            Err(failure) => note(failure),
        }
    }
    let mut arguments = vec!["install", "--yes", "--no-install-recommends"];
    if let Some(suite) = &suite {
        arguments.extend(["--target-release", suite]);
    }
    arguments.extend([MESA, LOADER]);
    apt_get(&arguments)?;
    match mesa_version() {
        Some(mesa) if mesa < RAY_QUERY_MESA && need == Need::RayQuery => Err(Failure::new(format!(
            "the newest Mesa that {} offers is {mesa}, and ray queries on the CPU need {RAY_QUERY_MESA}: use a newer release",
            system.name
        ))),
        _ => Ok(()),
    }
}

/// Installs packages; `what` names them in a failure.
pub fn tools(packages: &[&str], what: &str) -> Result {
    let list = packages.join(" ");
    System::read().require_apt(&list, what)?;
    note(format_args!("installing {list}"));
    apt_get(&["update"])?;
    apt_get(&[&["install", "--yes", "--no-install-recommends"], packages].concat())
}

/// Installs a C++ compiler.
pub fn compiler() -> Result {
    System::read().require_apt("g++", "a C++ compiler")?;
    note("installing g++ (this can take a minute)");
    apt_get(&["update"])?;
    apt_get(&["install", "--yes", "--no-install-recommends", "g++"])
}

/// What `/etc/os-release` tells.
#[derive(Debug, Default, PartialEq, Eq)]
struct System {
    id: String,
    like: String,
    codename: String,
    name: String,
}

impl System {
    fn read() -> Self {
        Self::parse(&fs::read_to_string("/etc/os-release").unwrap_or_default())
    }

    fn parse(text: &str) -> Self {
        let field = |name: &str| {
            let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
            value.unwrap_or_default().trim_matches(['"', '\'']).to_owned()
        };
        let (id, name) = (field("ID"), field("PRETTY_NAME"));
        let name = if name.is_empty() {
            "this system".to_owned()
        } else {
            name
        };
        Self {
            id,
            like: field("ID_LIKE"),
            codename: field("VERSION_CODENAME"),
            name,
        }
    }

    /// Whether this is Debian or one of its children.
    fn has_apt(&self) -> bool {
        [self.id.as_str()]
            .into_iter()
            .chain(self.like.split_whitespace())
            .any(|id| matches!(id, "debian" | "ubuntu"))
    }

    /// Fails with the remedy where packages can't be installed from here.
    fn require_apt(&self, packages: &str, what: &str) -> Result {
        if !self.has_apt() {
            return Err(Failure::new(format!(
                "{what} is missing, and {} is neither Debian nor Ubuntu: install it (what Debian calls {packages}) and try again",
                self.name
            )));
        }
        if output("id", &["-u"]).as_deref().map(str::trim) != Some("0") {
            return Err(Failure::new(format!(
                "{what} is missing: run this command as root, or `sudo apt-get install {packages}`"
            )));
        }
        Ok(())
    }

    /// Makes the backports of this release known to apt, from the mirror in use, and returns the suite's name.
    fn enable_backports(&self) -> Result<String> {
        let suite = format!("{}-backports", self.codename);
        let sources = read_sources();
        if !apt_sources::serves(&sources, &suite) {
            let stanza = apt_sources::backports(&sources, &self.codename)
                .ok_or_else(|| Failure::new(format!("apt has no source for {} to take {suite} from", self.name)))?;
            note(format_args!(
                "adding {suite}, which has a Mesa with ray queries ({BACKPORTS_FILE})"
            ));
            fs::write(BACKPORTS_FILE, stanza)
                .map_err(|error| Failure::new(format!("{BACKPORTS_FILE} can't be written: {error}")))?;
            if let Err(failure) = apt_get(&["update"]) {
                // Leave apt as it was, or every later update on this machine would fail.
                _ = fs::remove_file(BACKPORTS_FILE);
                _ = apt_get(&["update"]);
                return Err(failure);
            }
        }
        Ok(suite)
    }
}

fn read_sources() -> Vec<apt_sources::Source> {
    let folder = fs::read_dir("/etc/apt/sources.list.d")
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let mut files: Vec<PathBuf> = folder.collect();
    files.sort();
    files.insert(0, "/etc/apt/sources.list".into());
    files
        .iter()
        .flat_map(|file| {
            let text = fs::read_to_string(file).unwrap_or_default();
            match file.extension().and_then(|end| end.to_str()) {
                Some("list") => apt_sources::parse_lines(&text),
                Some("sources") => apt_sources::parse_stanzas(&text),
                _ => Vec::new(),
            }
        })
        .collect()
}

/// The version of Mesa that an installation would bring.
fn candidate() -> Option<Version> {
    parse_candidate(&output("apt-cache", &["policy", MESA])?)
}

fn parse_candidate(policy: &str) -> Option<Version> {
    policy
        .lines()
        .find_map(|line| line.trim().strip_prefix("Candidate:"))
        .and_then(Version::parse)
}

/// Runs apt-get quietly; what it said is shown only if it fails.
fn apt_get(arguments: &[&str]) -> Result {
    let mut command = Command::new("apt-get");
    command
        .args(["-qq", "-o", "DPkg::Lock::Timeout=120"])
        .args(arguments)
        .env("DEBIAN_FRONTEND", "noninteractive")
        .current_dir(Path::new("/"))
        .stdin(Stdio::null());
    let result = command.output().map_err(|error| cargo::not_started(&command, &error))?;
    if result.status.success() {
        return Ok(());
    }
    let said = [result.stdout, result.stderr].concat();
    for line in String::from_utf8_lossy(&said).lines() {
        note(line);
    }
    Err(Failure::new(format!(
        "`apt-get {}` failed ({})",
        arguments.join(" "),
        result.status
    )))
}

/// What a program prints, if it succeeds.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program)
        .args(arguments)
        .env("LC_ALL", "C")
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems() {
        let debian = System::parse(
            "PRETTY_NAME=\"Debian GNU/Linux 12 (bookworm)\"\nVERSION_ID=\"12\"\nVERSION_CODENAME=bookworm\nID=debian\n",
        );
        assert_eq!((debian.id.as_str(), debian.codename.as_str()), ("debian", "bookworm"));
        assert!(debian.has_apt());
        assert!(System::parse("ID=linuxmint\nID_LIKE=\"ubuntu debian\"\n").has_apt());
        assert!(!System::parse("ID=fedora\nPRETTY_NAME='Fedora Linux'\n").has_apt());
        assert_eq!(System::parse("").name, "this system");
    }

    #[test]
    fn elsewhere_the_remedy_is_named() {
        let fedora = System::parse("ID=fedora\nPRETTY_NAME=Fedora\n");
        let failure = fedora.require_apt("g++", "a C++ compiler").unwrap_err().to_string();
        assert!(failure.contains("Fedora") && failure.contains("g++"), "{failure}");
    }

    #[test]
    fn candidates() {
        let policy = "mesa-vulkan-drivers:\n  Installed: (none)\n  Candidate: 22.3.6-1+deb12u1\n  Version table:\n";
        assert_eq!(parse_candidate(policy), Some(Version([22, 3, 6])));
        assert_eq!(parse_candidate("x:\n  Candidate: (none)\n"), None);
        assert_eq!(parse_candidate(""), None);
    }
}
