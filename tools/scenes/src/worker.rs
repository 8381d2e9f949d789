//! Worker processes: this program once more, with a job that can crash or hang. They report in lines on their standard output.

use std::{
    env,
    io::{BufRead, BufReader},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};
use wait_timeout::ChildExt;

/// Time limits of a worker process.
#[derive(Clone, Copy, Debug)]
pub struct WorkerLimits {
    /// A process that writes nothing for this long hangs.
    pub silence: Duration,
    /// Time limit of the whole process.
    pub total: Duration,
}

/// This program, to be started once more.
pub fn this_program() -> Result<Command, String> {
    let program = env::current_exe().map_err(|error| format!("this program can't be found: {error}"))?;
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    Ok(command)
}

/// Runs a worker process and passes the lines of its output to `receive`. Fails with the reason if it can't be started, or if it exceeds a
/// limit and is killed.
pub fn run_worker(
    command: &mut Command,
    limits: WorkerLimits,
    receive: &mut dyn FnMut(&str),
) -> Result<ExitStatus, String> {
    let child = command.stdout(Stdio::piped()).spawn();
    let mut child = child.map_err(|error| format!("a worker process can't be started: {error}"))?;
    let ended = watch(&mut child, limits, receive);
    if ended.is_err() {
        // If it has ended in the meantime, there is nothing to kill.
        _ = child.kill();
        _ = child.wait();
    }
    ended
}

/// Reads lines until the process ends or exceeds a limit.
fn watch(child: &mut Child, limits: WorkerLimits, receive: &mut dyn FnMut(&str)) -> Result<ExitStatus, String> {
    let (lines, start) = (read_lines(child), Instant::now());
    loop {
        let left = limits.total.saturating_sub(start.elapsed());
        match lines.recv_timeout(limits.silence.min(left)) {
            Ok(line) if !left.is_zero() => receive(&line),
            Err(RecvTimeoutError::Disconnected) => break,
            _ if left <= limits.silence => {
                let seconds = start.elapsed().as_secs();
                return Err(format!("it did not finish within {seconds} s and was killed"));
            }
            _ => {
                let seconds = limits.silence.as_secs();
                return Err(format!("it was silent for {seconds} s and was killed"));
            }
        }
    }
    match child.wait_timeout(limits.silence) {
        Ok(Some(status)) => Ok(status),
        Ok(None) => Err("its process doesn't end".to_owned()),
        Err(error) => Err(format!("its process is lost: {error}")),
    }
}

/// Reads the lines of a process in the background, so that silence can be noticed.
fn read_lines(child: &mut Child) -> Receiver<String> {
    let (sender, receiver) = channel();
    if let Some(output) = child.stdout.take() {
        thread::spawn(move || {
            let lines = BufReader::new(output).split(b'\n').map_while(Result::ok);
            let mut lines = lines.map(|line| String::from_utf8_lossy(&line).trim_end().to_owned());
            lines.try_for_each(|line| sender.send(line))
        });
    }
    receiver
}
