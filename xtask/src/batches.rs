//! Runs programs over lists of items, some at a time. Such a program can crash, and it can run forever.
//!
//! It prints a line about itself, and then one for each item: the item, `ok` and figures as `name=value`, or `failed` and the reason,
//! separated by tabs.

use std::io::{BufRead, BufReader};
use std::num::NonZeroUsize;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};

/// The result for an item: figures by name, or the reason for their absence.
pub type Outcome = Result<Vec<(String, String)>, String>;

/// Limits of a program.
#[derive(Clone, Copy)]
pub struct Limits {
    /// The program's name in reasons.
    pub what: &'static str,
    /// Time of one item.
    pub time: Duration,
    /// Maximum number of consecutive processes that crash at the same item.
    pub tries: usize,
}

/// Runs processes that `command` makes for some of the items, and returns the outcome of each item. After a crash the item gets more
/// tries in fresh processes.
pub fn run(command: impl Fn(&[&str]) -> Command, items: &[&str], limits: Limits) -> Result<Vec<Outcome>> {
    let (mut outcomes, mut crashes) = (Vec::new(), 0);
    while outcomes.len() < items.len() {
        let (done, end) = process(command(&items[outcomes.len()..]), limits.time)?;
        crashes = if done.is_empty() { crashes + 1 } else { 1 };
        outcomes.extend(done);
        let is_incomplete = outcomes.len() < items.len();
        if is_incomplete && (crashes >= limits.tries || matches!(end, End::TooLate)) {
            outcomes.push(Err(end.reason(limits)));
            crashes = 0;
        }
    }
    Ok(outcomes)
}

/// Works on batches, one at a time for each core. Returns all outcomes in the order of the batches.
pub fn parallel<T: Sync>(batches: &[T], work: impl Fn(&T) -> Result<Vec<Outcome>> + Sync) -> Result<Vec<Outcome>> {
    let next = AtomicUsize::new(0);
    let work = || -> Result<Vec<(usize, Vec<Outcome>)>> {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(batch) = batches.get(index) else {
                return Ok(done);
            };
            done.push((index, work(batch)?));
        }
    };
    let workers = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut done = thread::scope(|scope| {
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let done = threads.into_iter().map(|thread| match thread.join() {
            Ok(result) => result,
            Err(_) => bail!("a thread panicked"),
        });
        done.collect::<Result<Vec<_>>>()
    })?
    .concat();
    done.sort_by_key(|(index, _)| *index);
    Ok(done.into_iter().flat_map(|(_, outcomes)| outcomes).collect())
}

/// Outcomes until the process ends, and the way it ended.
fn process(mut command: Command, limit: Duration) -> Result<(Vec<Outcome>, End)> {
    let program = command.get_program().display().to_string();
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("{program} can't be started"))?;
    let output = child.stdout.take().context("no output")?;
    let (sender, lines) = mpsc::channel();
    thread::spawn(move || {
        let lines = BufReader::new(output).lines().map_while(Result::ok);
        // The first line is about the program.
        lines.skip(1).try_for_each(|line| sender.send(line))
    });
    let mut outcomes = Vec::new();
    let end = loop {
        match lines.recv_timeout(limit) {
            Ok(line) => outcomes.push(parse(&line)),
            Err(RecvTimeoutError::Timeout) => {
                child.kill()?;
                break End::TooLate;
            }
            Err(RecvTimeoutError::Disconnected) => break End::Crashed,
        }
    };
    let status = child.wait()?;
    Ok((outcomes, if status.success() { End::Done } else { end }))
}

/// The end of a process.
#[derive(Clone, Copy)]
enum End {
    Done,
    Crashed,
    TooLate,
}

impl End {
    fn reason(self, limits: Limits) -> String {
        match self {
            Self::TooLate => format!("{} isn't done after {} s", limits.what, limits.time.as_secs()),
            Self::Done | Self::Crashed => format!("{} crashed", limits.what),
        }
    }
}

fn parse(line: &str) -> Outcome {
    let mut parts = line.split('\t').skip(1);
    if parts.next() == Some("ok") {
        let figures = parts.filter_map(|part| part.split_once('='));
        Ok(figures
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect())
    } else {
        Err(parts.next().unwrap_or("no reason given").to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_are_read() {
        let figures = vec![("a".to_owned(), "1".to_owned()), ("b c".to_owned(), "2".to_owned())];
        assert_eq!(parse("item\tok\ta=1\tb c=2"), Ok(figures));
        assert_eq!(parse("item\tok\t"), Ok(Vec::new()));
        assert_eq!(parse("item\tfailed\twrong: a=1"), Err("wrong: a=1".to_owned()));
        assert_eq!(parse("item"), Err("no reason given".to_owned()));
    }

    #[test]
    fn batches_keep_their_order() {
        let batches: Vec<usize> = (0..20).collect();
        let work = |batch: &usize| Ok(vec![Err(batch.to_string()); 2]);
        let outcomes = parallel(&batches, work).unwrap();
        let expected: Vec<Outcome> = (0..40).map(|item| Err((item / 2).to_string())).collect();
        assert_eq!(outcomes, expected);
        assert!(
            parallel(&batches, |batch| if *batch == 7 {
                bail!("seven")
            } else {
                Ok(Vec::new())
            })
            .is_err()
        );
    }
}
