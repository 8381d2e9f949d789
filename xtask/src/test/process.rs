//! Processes of test programs.

use std::io::{self, Read};
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use crate::cases::Case;

/// The way a command ended.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    Succeeded,
    Failed,
    Stopped,
}

/// Runs a command, at most until `stop`, and passes its stdout and stderr on.
pub fn capture(command: &mut Command, stop: Option<Instant>, mut receive: impl FnMut(&[u8])) -> io::Result<Ended> {
    let (mut reader, writer) = io::pipe()?;
    let mut child = command
        .stdin(Stdio::null())
        .stdout(writer.try_clone()?)
        .stderr(writer)
        .spawn()?;
    // The command owns the writers, which would keep the pipe open.
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let (sender, chunks) = mpsc::channel();
    thread::spawn(move || {
        let mut chunk = [0; 4096];
        while let Ok(length @ 1..) = reader.read(&mut chunk)
            && sender.send(chunk[..length].to_vec()).is_ok()
        {}
    });
    loop {
        let left = stop.map_or(Duration::MAX, |stop| stop.saturating_duration_since(Instant::now()));
        match chunks.recv_timeout(left) {
            Ok(chunk) => receive(&chunk),
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {
                child.kill()?;
                child.wait()?;
                return Ok(Ended::Stopped);
            }
        }
    }
    let success = child.wait()?.success();
    Ok(if success { Ended::Succeeded } else { Ended::Failed })
}

/// Names of the tests of a stopped command that have no outcome. If the command can't list its tests, one name stands for them.
pub fn unfinished(command: &mut Command, cases: &[Case]) -> Vec<String> {
    let listed = command.arg("--list").stdout(Stdio::piped()).output();
    let text = match &listed {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout),
        _ => return vec!["(an unknown number of tests)".to_owned()],
    };
    text.lines()
        .filter_map(|line| line.strip_suffix(": test"))
        .filter(|name| cases.iter().all(|case| case.name != *name))
        .map(str::to_owned)
        .collect()
}
