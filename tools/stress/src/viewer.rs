//! The viewer with broken files: it must show them or report an error, and neither panic nor hang.

use crate::{
    generators::{FileKind, file_bytes},
    heartbeat, log_capture,
    verdict::Verdict,
};
use clap::ValueEnum;
use glint_scenes::Random;
use std::{
    env,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;
use wait_timeout::ChildExt;

/// Maximum time for one file. On a CPU the viewer compiles shaders for a while.
const PATIENCE: Duration = Duration::from_secs(300);
/// Time between two signs of life.
const INTERVAL: Duration = Duration::from_secs(1);

/// The end of a program.
struct Ended {
    /// `None` if it was killed.
    status: Option<ExitStatus>,
    /// Its standard error.
    log: String,
}

/// The program, and a folder for its files.
pub struct Viewer {
    program: PathBuf,
    folder: TempDir,
    tracer: String,
}

impl Viewer {
    /// Finds the program: the given one, or one beside this program as cargo builds it.
    /// Fails if the program doesn't exist, or no folder can be created.
    pub fn new(given: Option<&Path>, tracer: String) -> Result<Self, String> {
        let name = format!("glint_viewer{}", env::consts::EXE_SUFFIX);
        let own = env::current_exe().map_err(|error| error.to_string())?;
        let program = given.map_or_else(|| own.with_file_name(name), Path::to_owned);
        if !program.is_file() {
            return Err("`glint_viewer` isn't built beside this program, nor named by --viewer".to_owned());
        }
        let folder = tempfile::tempdir().map_err(|error| format!("no temporary folder can be created: {error}"))?;
        Ok(Self {
            program,
            folder,
            tracer,
        })
    }

    /// The kind of damage for a seed. Kinds take turns, so that few files cover all of them.
    pub fn kind(seed: u64) -> FileKind {
        let kinds = FileKind::value_variants();
        kinds[(seed % kinds.len() as u64) as usize]
    }

    /// Opens the file of a seed in the viewer.
    pub fn show(&self, seed: u64) -> Verdict {
        let bytes = file_bytes(Self::kind(seed), &mut Random::new(seed));
        let file = self.folder.path().join(format!("{seed}.glb"));
        let shown = fs::write(&file, bytes).and_then(|()| self.run(&file, "medium"));
        let ended = match shown {
            Ok(ended) => ended,
            Err(error) => return Verdict::Failed(vec![format!("the viewer can't be started: {error}")]),
        };
        let is_crash = |status: Option<ExitStatus>| status.is_some_and(|status| status.code().is_none());
        match evaluate(&ended) {
            // A crash without a message can be Bevy's own.
            Verdict::Failed(problems) if is_crash(ended.status) => match self.run(&file, "off") {
                Ok(plain) if plain.status.is_none() || is_crash(plain.status) => Verdict::Upstream(problems),
                _ => Verdict::Failed(problems),
            },
            verdict => verdict,
        }
    }

    fn run(&self, file: &Path, technique: &str) -> io::Result<Ended> {
        let [log, image] = ["viewer.log", "viewer.png"].map(|name| self.folder.path().join(name));
        let mut child = Command::new(&self.program)
            .args(["--headless", "--size", "48x27", "--frames", "2"])
            .args(["--technique", technique, "--tracer", &self.tracer])
            .arg("--out")
            .arg(&image)
            .arg(file)
            .env_remove("RUST_LOG")
            .env("NO_COLOR", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&log)?)
            .spawn()?;
        let start = Instant::now();
        let mut status = None;
        while status.is_none() && start.elapsed() < PATIENCE {
            status = child.wait_timeout(INTERVAL)?;
            heartbeat::beat();
        }
        if status.is_none() {
            child.kill()?;
            child.wait()?;
        }
        let log = String::from_utf8_lossy(&fs::read(&log)?).into_owned();
        Ok(Ended { status, log })
    }
}

fn evaluate(ended: &Ended) -> Verdict {
    let log = ended.log.trim();
    let panics = || log.lines().filter(|line| line.contains("panicked at "));
    let own: Vec<String> = panics()
        .filter(|line| log_capture::is_own(line))
        .map(str::to_owned)
        .collect();
    if !own.is_empty() {
        return Verdict::Failed(own);
    }
    let Some(status) = ended.status else {
        return Verdict::Failed(vec![format!("it didn't end within {} s", PATIENCE.as_secs())]);
    };
    match status.code() {
        Some(0) => Verdict::Passed(String::new()),
        Some(1) if !log.is_empty() => Verdict::Passed(String::new()),
        Some(1) => Verdict::Failed(vec!["it failed without a message".to_owned()]),
        _ => match panics().next() {
            Some(panic) => Verdict::Upstream(vec![panic.to_owned()]),
            None => Verdict::Failed(vec![format!("it crashed ({status})")]),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_panics_are_told_from_those_of_bevy() {
        let ended = |log: &str| Ended {
            status: None,
            log: log.to_owned(),
        };
        let own = evaluate(&ended(
            "WARN x\nthread 'main' panicked at tools/viewer/src/gltf.rs:3:4:\nno",
        ));
        assert!(matches!(own, Verdict::Failed(problems) if problems[0].contains("gltf.rs")));
        let hang = evaluate(&ended(
            "thread panicked at /x/registry/src/y/bevy_gltf/src/lib.rs:1:1:\nno",
        ));
        assert!(matches!(hang, Verdict::Failed(problems) if problems[0].contains("didn't end")));
    }

    #[test]
    fn all_kinds_of_files_have_their_turn() {
        let kinds = FileKind::value_variants();
        let used: Vec<_> = (0..kinds.len() as u64).map(Viewer::kind).collect();
        assert!(kinds.iter().all(|kind| used.contains(kind)));
    }
}
