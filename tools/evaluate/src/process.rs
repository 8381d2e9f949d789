//! Runs jobs in their own processes, so that a driver crash ends one technique and not the whole run.

use crate::{
    files::{read_json, write_json},
    job::Job,
    machine::Machine,
    message::Message,
    progress::Progress,
    state::Store,
};
use glint_scenes::{WorkerLimits, run_worker, this_program};
use std::{fs, path::Path, process::Stdio, time::Duration};

/// A process without output for 15 minutes hangs.
const LIMITS: WorkerLimits = WorkerLimits {
    silence: Duration::from_secs(15 * 60),
    total: Duration::MAX,
};

/// Events of a job for its callers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The images of one more technique are complete.
    Captured,
    /// Timing is in progress and should not be disturbed.
    Timing,
    /// Timing is over.
    Ended,
}

/// How a process ended.
enum End {
    Done,
    /// It reported why it can't continue.
    Refused(String),
    /// It died or hung.
    Died(String),
}

/// Runs a job to its end, if any of it remains. Techniques that fail are recorded in the job's state. Fails with the reason if nothing
/// of the scene could be measured.
pub fn run(job: &Job, progress: &mut Progress, notify: &mut dyn FnMut(Notice)) -> Result<(), String> {
    let store = Store::new(job);
    store.clear_failures();
    if store.is_complete(job) {
        progress.skip(job.frames());
        return Ok(());
    }
    let planned = progress.handled() + job.frames();
    let file = store.folder().join("job.json");
    write_json(&file, job)?;
    // Each crash is blamed on one technique, which the next attempt skips.
    let mut result = Err("it was not tried".to_owned());
    for _ in 0..=job.variants.len() {
        _ = fs::remove_file(store.current());
        let end = attempt(job, &file, progress, notify);
        notify(Notice::Ended);
        let reason = match end? {
            End::Done => {
                result = Ok(());
                break;
            }
            End::Refused(reason) => {
                result = Err(reason);
                break;
            }
            End::Died(reason) => reason,
        };
        let blamed = read_json::<String>(&store.current());
        result = Err(reason.clone());
        let Some(id) = blamed else { break };
        progress.note(format_args!("{}: {id} failed: {reason}", job.id()));
        store.fail(&id, &reason)?;
    }
    // The next job starts at its planned position.
    progress.skip(planned.saturating_sub(progress.handled()));
    result
}

fn attempt(job: &Job, file: &Path, progress: &mut Progress, notify: &mut dyn FnMut(Notice)) -> Result<End, String> {
    let log = Store::new(job).folder().join("log.txt");
    let errors = fs::File::options().create(true).append(true).open(&log);
    let log = log.display();
    let errors = errors.map_err(|error| format!("{log} can't be written: {error}"))?;
    let mut refusal = None;
    let mut receive = |line: &str| match Message::parse(line) {
        Some(Message::Frames(count)) => progress.advance(count),
        Some(Message::Skipped(count)) => progress.skip(count),
        Some(Message::Doing(text)) => progress.label(format!("{}: {text}", job.id())),
        Some(Message::Captured) => notify(Notice::Captured),
        Some(Message::Timing) => notify(Notice::Timing),
        Some(Message::Warning(text)) => progress.note(format_args!("{}: {text}", job.id())),
        Some(Message::Failed(reason)) => refusal = Some(reason),
        Some(Message::Machine(_)) | None => {}
    };
    let ended = run_worker(
        this_program()?.arg("--job").arg(file).stderr(errors),
        LIMITS,
        &mut receive,
    );
    Ok(match (ended, refusal) {
        (Ok(status), _) if status.success() => End::Done,
        (_, Some(reason)) => End::Refused(reason),
        (Ok(status), None) => End::Died(format!("the process died ({status}); see {log}")),
        (Err(how), None) => End::Died(format!("{how}; see {log}")),
    })
}

/// Queries this machine's capabilities in a separate process, since a driver can crash; fails without a GPU that can trace.
pub fn probe() -> Result<Machine, String> {
    let output = this_program()?.arg("--probe").stderr(Stdio::piped()).output();
    let output = output.map_err(|error| format!("the GPU can't be looked at: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines()
        .find_map(|line| match Message::parse(line)? {
            Message::Machine(machine) => Some(Ok(machine)),
            Message::Failed(reason) => Some(Err(reason)),
            _ => None,
        })
        .unwrap_or_else(|| {
            let errors = String::from_utf8_lossy(&output.stderr);
            let last = errors.lines().last().unwrap_or_default();
            Err(format!("the GPU can't be looked at ({}): {last}", output.status))
        })
}
