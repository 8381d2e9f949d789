//! Runs programs over lists of items, some at a time. Such a program can crash, and it can run forever.
//!
//! It prints a line about itself, and then one for each item: the item, `ok` and figures as `name=value`, or `failed` and the reason,
//! separated by tabs.

use std::io::{BufRead, BufReader};
use std::iter;
use std::num::NonZeroUsize;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};

/// The result for an item: figures by name, or the reason for their absence.
pub type Outcome = Result<Vec<(String, String)>, String>;

/// Limits of a program.
#[derive(Clone, Copy)]
pub struct Limits {
    /// The program's name in reasons.
    pub what: &'static str,
    /// Maximum number of items of one process.
    pub batch: usize,
    /// Time of one item.
    pub time: Duration,
    /// Maximum number of consecutive processes that crash at the same item.
    pub tries: usize,
}

/// Runs processes that `command` makes for some of the items, one at a time for each core, and returns the outcome of each item. After a
/// crash the item gets more tries in fresh processes.
pub fn run(items: &[&str], limits: Limits, command: impl Fn(&[&str]) -> Command + Sync) -> Result<Vec<Outcome>> {
    let cores = thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    let batches = items.chunks(limits.batch);
    let outcomes = parallel(cores, batches, |batch| run_batch(batch, limits, &command));
    Ok(outcomes.into_iter().collect::<Result<Vec<_>>>()?.concat())
}

fn run_batch(items: &[&str], limits: Limits, command: impl Fn(&[&str]) -> Command) -> Result<Vec<Outcome>> {
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

/// Works on items, some at a time. Returns the results in the order of the items.
pub fn parallel<T, R: Send>(
    jobs: NonZeroUsize,
    items: impl Iterator<Item = T> + Send,
    work: impl Fn(T) -> R + Sync,
) -> Vec<R> {
    let (queue, done) = (Mutex::new(items.enumerate()), Mutex::new(Vec::new()));
    let next = || queue.lock().ok()?.next();
    let work = || {
        for (index, item) in iter::from_fn(next) {
            let result = work(item);
            if let Ok(mut done) = done.lock() {
                done.push((index, result));
            }
        }
    };
    // A panic of one thread is one of the scope.
    thread::scope(|scope| (0..jobs.get()).for_each(|_| _ = scope.spawn(work)));
    let mut done = done.into_inner().unwrap_or_default();
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
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
    fn results_keep_the_order_of_items() {
        let jobs = NonZeroUsize::new(3).unwrap();
        let results = parallel(jobs, 0..20, |item| item + 1);
        assert_eq!(results, (1..21).collect::<Vec<_>>());
    }
}
