//! Ends the browser if the check was killed, since a killed program can't do so itself.

use anyhow::{Context, Result};
use std::process::{Child, Command, Stdio};

/// Waits until one of the processes `needed` is gone, and then ends the remaining ones of `ended`.
const SCRIPT: &str = r#"
gone() { ! kill -0 "$1" 2>/dev/null || grep -q '^State:.*Z' "/proc/$1/status" 2>/dev/null; }
left() { for id; do ! gone "$id" || return 1; done; }
while left $1; do sleep 0.5; done
kill $2 2>/dev/null
"#;

/// Starts a separate process that watches others.
#[cfg(unix)]
pub fn watch(needed: &[u32], ended: &[u32]) -> Result<Child> {
    use std::os::unix::process::CommandExt;
    let list = |ids: &[u32]| ids.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
    Command::new("sh")
        .args(["-c", SCRIPT, "guard", &list(needed), &list(ended)])
        // Survives signals that end this program's group.
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .context("the guard of the browser can't be started")
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::thread;
    use std::time::{Duration, Instant};

    #[test]
    fn when_one_is_gone_the_others_are_ended() {
        let sleep = |seconds: &str| Command::new("sleep").arg(seconds).spawn().unwrap();
        let (mut check, mut browser, mut other) = (sleep("60"), sleep("60"), sleep("60"));
        let mut guard = watch(&[std::process::id(), check.id()], &[check.id(), browser.id()]).unwrap();
        thread::sleep(Duration::from_millis(1200));
        assert!(browser.try_wait().unwrap().is_none(), "everybody is there");
        // Don't wait for its end before the browser's end, which might never come.
        check.kill().unwrap();
        let start = Instant::now();
        while browser.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < Duration::from_secs(20), "the browser is left behind");
            thread::sleep(Duration::from_millis(50));
        }
        guard.wait().unwrap();
        check.wait().unwrap();
        assert!(other.try_wait().unwrap().is_none());
        other.kill().unwrap();
        other.wait().unwrap();
    }
}
