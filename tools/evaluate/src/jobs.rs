//! Runs jobs in processes of their own, so that a driver that crashes takes one technique with it and not the whole run.

use crate::{
    plan::Job,
    progress::Progress,
    report::Event,
    state::{Store, read_json, write_json},
};
use std::{
    env, fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::Duration,
};

/// The option that makes this program measure a job. It isn't for people.
pub const JOB_OPTION: &str = "--job";
/// The option that makes this program describe the machine. It isn't for people.
pub const PROBE_OPTION: &str = "--probe";

/// A process that says nothing for so long hangs.
const PATIENCE: Duration = Duration::from_secs(15 * 60);

/// What the one who runs a job may want to act on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The pictures of one more technique are complete.
    Captured,
    /// Times are taken, which should not be disturbed.
    Timing,
    /// They are not taken any more.
    Ended,
}

/// How a process ended.
enum End {
    Done,
    /// It said why it can't go on.
    Refused(String),
    /// It died or hung.
    Died(String),
}

/// Runs a job to its end, if anything of it is left. Techniques that fail are written down in the job's state.
///
/// # Errors
///
/// If nothing of the scene could be measured, with the reason.
pub fn run(job: &Job, progress: &mut Progress, told: &mut dyn FnMut(Notice)) -> Result<(), String> {
    let store = Store::new(job);
    store.forgive();
    if store.is_complete(job) {
        progress.skip(job.frames());
        return Ok(());
    }
    let start = progress.position();
    let file = store.folder().join("job.json");
    write_json(&file, job)?;
    // Each death is blamed on one technique, which is left out of the next attempt.
    let mut result = Err("it was not tried".to_owned());
    for _ in 0..=job.variants.len() {
        _ = fs::remove_file(store.current());
        let end = attempt(job, &file, progress, told);
        told(Notice::Ended);
        match end? {
            End::Done => {
                result = Ok(());
                break;
            }
            End::Refused(reason) => {
                result = Err(reason);
                break;
            }
            End::Died(reason) => {
                let blamed = read_json::<String>(&store.current());
                if let Some(id) = &blamed {
                    progress.note(format_args!("{}: {id} failed: {reason}", job.id()));
                    store.fail(id, &reason)?;
                }
                result = Err(reason);
                if blamed.is_none() {
                    break;
                }
            }
        }
    }
    // The next job starts where it was planned to.
    let planned = start + job.frames();
    progress.skip(planned.saturating_sub(progress.position()));
    result
}

fn attempt(job: &Job, file: &Path, progress: &mut Progress, told: &mut dyn FnMut(Notice)) -> Result<End, String> {
    let log = Store::new(job).folder().join("log.txt");
    let errors = fs::File::options()
        .create(true)
        .append(true)
        .open(&log)
        .map_err(|error| format!("{} can't be written: {error}", log.display()))?;
    let program = env::current_exe().map_err(|error| format!("this program can't be found: {error}"))?;
    let mut child = Command::new(program)
        .arg(JOB_OPTION)
        .arg(file)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(errors)
        .spawn()
        .map_err(|error| format!("the measuring process can't be started: {error}"))?;
    let (refusal, hung) = listen(&mut child, job, progress, told);
    if hung {
        // Its exit status tells the rest.
        _ = child.kill();
    }
    let status = child
        .wait()
        .map_err(|error| format!("the measuring process is lost: {error}"))?;
    Ok(match refusal {
        _ if status.success() => End::Done,
        Some(reason) => End::Refused(reason),
        None if hung => End::Died(format!(
            "it hung for {} minutes; see {}",
            PATIENCE.as_secs() / 60,
            log.display()
        )),
        None => End::Died(format!("the process died ({status}); see {}", log.display())),
    })
}

/// Follows a process until it closes its output. Returns why it gave up, if it said so, and whether it hangs.
fn listen(
    child: &mut Child,
    job: &Job,
    progress: &mut Progress,
    told: &mut dyn FnMut(Notice),
) -> (Option<String>, bool) {
    let Some(output) = child.stdout.take() else {
        return (None, false);
    };
    let (sender, events) = mpsc::channel();
    let reader = thread::spawn(move || {
        for line in BufReader::new(output).lines() {
            let Ok(line) = line else { break };
            if let Some(event) = Event::parse(&line)
                && sender.send(event).is_err()
            {
                break;
            }
        }
    });
    let mut refusal = None;
    let hung = loop {
        match events.recv_timeout(PATIENCE) {
            Ok(Event::Frames(count)) => progress.advance(count),
            Ok(Event::Skipped(count)) => progress.skip(count),
            Ok(Event::Doing(text)) => progress.label(&format!("{}: {text}", job.id())),
            Ok(Event::Captured(_)) => told(Notice::Captured),
            Ok(Event::Timing) => told(Notice::Timing),
            Ok(Event::Failed(reason)) => refusal = Some(reason),
            Err(RecvTimeoutError::Disconnected) => break false,
            Err(RecvTimeoutError::Timeout) => break true,
        }
    };
    if !hung {
        // It has reached the end of the output.
        _ = reader.join();
    }
    (refusal, hung)
}

/// Asks a process of its own what this machine can do: a driver that crashes must not take this one with it.
///
/// # Errors
///
/// If there is no GPU that can trace.
pub fn probe<T: serde::de::DeserializeOwned>() -> Result<T, String> {
    let program = env::current_exe().map_err(|error| format!("this program can't be found: {error}"))?;
    let output = Command::new(program)
        .arg(PROBE_OPTION)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .output()
        .map_err(|error| format!("the GPU can't be looked at: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let told = text.lines().find_map(Event::parse);
    if let Some(Event::Failed(reason)) = told {
        return Err(reason);
    }
    let json = text.lines().find(|line| line.starts_with('{'));
    json.and_then(|line| serde_json::from_str(line).ok()).ok_or_else(|| {
        let errors = String::from_utf8_lossy(&output.stderr);
        let last = errors.lines().last().unwrap_or_default();
        format!("the GPU can't be looked at ({}): {last}", output.status)
    })
}
