//! The viewer and broken files: it must show them or say what is wrong, and neither panic nor hang.

use crate::{
    ingredients::{FileKind, file_bytes},
    messages, pulse,
    random::Random,
};
use std::{
    env,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{self, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

/// A viewer that takes longer hangs; on a CPU it compiles shaders for a while.
const PATIENCE: Duration = Duration::from_secs(300);
/// Time between two looks at a program that runs.
const NAP: Duration = Duration::from_millis(20);

/// What a file came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It was shown, or refused in words.
    Passed,
    /// Bevy fails, with or without reflections.
    Foreign(String),
    /// It was neither.
    Failed(Vec<String>),
}

/// How a program ended.
struct Ended {
    /// `None` if it had to be ended.
    status: Option<ExitStatus>,
    /// What it wrote on standard error.
    said: String,
}

/// The program, and a folder for its files.
pub struct Viewer {
    program: PathBuf,
    folder: PathBuf,
    tracer: &'static str,
}

impl Viewer {
    /// Finds the program: the given one, or one beside this program as cargo builds it.
    ///
    /// # Errors
    ///
    /// If there is none, or no folder can be made.
    pub fn new(given: Option<&Path>, tracer: &'static str) -> Result<Self, String> {
        let name = format!("glint_viewer{}", env::consts::EXE_SUFFIX);
        let own = env::current_exe().map_err(|error| error.to_string())?;
        let beside = own.parent().unwrap_or(Path::new("."));
        let program = given.map_or_else(|| beside.join(&name), Path::to_owned);
        if !program.is_file() {
            return Err("`glint_viewer` isn't built beside this program, nor named by --viewer".to_owned());
        }
        let folder = env::temp_dir().join(format!("glint_stress_{}", process::id()));
        fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        Ok(Self {
            program,
            folder,
            tracer,
        })
    }

    /// What is wrong with the file of a seed.
    #[must_use]
    pub fn kind(seed: u64) -> FileKind {
        // By turns, so that few files already hold all kinds.
        FileKind::ALL[(seed % FileKind::ALL.len() as u64) as usize]
    }

    /// Gives the viewer the file of a seed.
    #[must_use]
    pub fn show(&self, seed: u64) -> Verdict {
        let bytes = file_bytes(Self::kind(seed), &mut Random::new(seed));
        let file = self.folder.join(format!("{seed}.glb"));
        let shown = fs::write(&file, bytes).and_then(|()| self.run(&file, "medium"));
        let ended = match shown {
            Ok(ended) => ended,
            Err(error) => return Verdict::Failed(vec![format!("the viewer can't be started: {error}")]),
        };
        let verdict = judge(&ended);
        // A crash without a word: is it Bevy's?
        let verdict = match (verdict, ended.status) {
            (Verdict::Failed(problems), Some(status)) if status.code().is_none() => match self.run(&file, "off") {
                Ok(plain) if plain.status.is_none_or(|status| status.code().is_none()) => {
                    Verdict::Foreign(problems.join("; "))
                }
                _ => Verdict::Failed(problems),
            },
            (verdict, _) => verdict,
        };
        _ = fs::remove_file(&file);
        verdict
    }

    fn run(&self, file: &Path, technique: &str) -> io::Result<Ended> {
        let (log, picture) = (self.folder.join("viewer.log"), self.folder.join("viewer.png"));
        let mut child = Command::new(&self.program)
            .args(["--headless", "--size", "48x27", "--frames", "2"])
            .args(["--technique", technique, "--tracer", self.tracer])
            .arg("--out")
            .arg(&picture)
            .arg(file)
            .env_remove("RUST_LOG")
            .env("NO_COLOR", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&log)?)
            .spawn()?;
        let start = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break Some(status);
            }
            if start.elapsed() > PATIENCE {
                child.kill()?;
                child.wait()?;
                break None;
            }
            pulse::beat();
            thread::sleep(NAP);
        };
        let said = String::from_utf8_lossy(&fs::read(&log)?).into_owned();
        Ok(Ended { status, said })
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        _ = fs::remove_dir_all(&self.folder);
    }
}

fn judge(ended: &Ended) -> Verdict {
    let said = ended.said.trim();
    let panics = || said.lines().filter(|line| line.contains("panicked at "));
    let own: Vec<String> = panics()
        .filter(|line| messages::is_own(line))
        .map(str::to_owned)
        .collect();
    if !own.is_empty() {
        return Verdict::Failed(own);
    }
    let Some(status) = ended.status else {
        return Verdict::Failed(vec![format!("it didn't end within {} s", PATIENCE.as_secs())]);
    };
    match status.code() {
        Some(0) => Verdict::Passed,
        Some(1) if !said.is_empty() => Verdict::Passed,
        Some(1) => Verdict::Failed(vec!["it failed without a word".to_owned()]),
        _ => match panics().next() {
            Some(panic) => Verdict::Foreign(panic.to_owned()),
            None => Verdict::Failed(vec![format!("it crashed ({status})")]),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_of_our_own_are_told_from_those_of_bevy() {
        let ended = |said: &str| Ended {
            status: None,
            said: said.to_owned(),
        };
        let own = judge(&ended(
            "WARN x\nthread 'main' panicked at tools/viewer/src/gltf.rs:3:4:\nno",
        ));
        assert!(matches!(own, Verdict::Failed(problems) if problems[0].contains("gltf.rs")));
        let hang = judge(&ended(
            "thread panicked at /x/registry/src/y/bevy_gltf/src/lib.rs:1:1:\nno",
        ));
        assert!(matches!(hang, Verdict::Failed(problems) if problems[0].contains("didn't end")));
    }

    #[test]
    fn all_kinds_of_files_have_their_turn() {
        for kind in FileKind::ALL.iter().copied() {
            assert!((0..FileKind::ALL.len() as u64).any(|seed| Viewer::kind(seed) == kind));
        }
    }
}
