//! Runs jobs in their own processes, so that a driver crash ends one technique and not the whole run.

use crate::{
    files::{read_json, write_json},
    job::Job,
    machine::Machine,
    message::Message,
    progress::Progress,
    state::Store,
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

/// A process without output for this long hangs.
const PATIENCE: Duration = Duration::from_secs(15 * 60);

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

fn this_program() -> Result<Command, String> {
    let program = env::current_exe().map_err(|error| format!("this program can't be found: {error}"))?;
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    Ok(command)
}

fn attempt(job: &Job, file: &Path, progress: &mut Progress, notify: &mut dyn FnMut(Notice)) -> Result<End, String> {
    let log = Store::new(job).folder().join("log.txt");
    let errors = fs::File::options().create(true).append(true).open(&log);
    let errors = errors.map_err(|error| format!("{} can't be written: {error}", log.display()))?;
    let mut child = this_program()?
        .arg("--job")
        .arg(file)
        .stdout(Stdio::piped())
        .stderr(errors)
        .spawn()
        .map_err(|error| format!("the measuring process can't be started: {error}"))?;
    let (refusal, hung) = listen(&mut child, job, progress, notify);
    if hung {
        // Its exit status has the rest.
        _ = child.kill();
    }
    let status = child.wait();
    let status = status.map_err(|error| format!("the measuring process is lost: {error}"))?;
    let log = log.display();
    Ok(match refusal {
        _ if status.success() => End::Done,
        Some(reason) => End::Refused(reason),
        None if hung => End::Died(format!("it hung for {} minutes; see {log}", PATIENCE.as_secs() / 60)),
        None => End::Died(format!("the process died ({status}); see {log}")),
    })
}

/// Follows a process until it closes its output. Returns its reason for giving up, if it reported one, and true if it hangs.
fn listen(
    child: &mut Child,
    job: &Job,
    progress: &mut Progress,
    notify: &mut dyn FnMut(Notice),
) -> (Option<String>, bool) {
    let Some(output) = child.stdout.take() else {
        return (None, false);
    };
    let (sender, messages) = mpsc::channel();
    // Ends with the output, or with the first message after this function has returned.
    thread::spawn(move || {
        let lines = BufReader::new(output).lines().map_while(Result::ok);
        let mut messages = lines.filter_map(|line| Message::parse(&line));
        messages.try_for_each(|message| sender.send(message))
    });
    let mut refusal = None;
    loop {
        match messages.recv_timeout(PATIENCE) {
            Ok(Message::Frames(count)) => progress.advance(count),
            Ok(Message::Skipped(count)) => progress.skip(count),
            Ok(Message::Doing(text)) => progress.label(format!("{}: {text}", job.id())),
            Ok(Message::Captured) => notify(Notice::Captured),
            Ok(Message::Timing) => notify(Notice::Timing),
            Ok(Message::Warning(text)) => progress.note(format_args!("{}: {text}", job.id())),
            Ok(Message::Failed(reason)) => refusal = Some(reason),
            Ok(Message::Machine(_)) => {}
            Err(RecvTimeoutError::Disconnected) => return (refusal, false),
            Err(RecvTimeoutError::Timeout) => return (refusal, true),
        }
    }
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
