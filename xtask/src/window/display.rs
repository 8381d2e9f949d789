//! A display that nobody sees, and hands for what it shows.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use super::picture::Picture;
use crate::cargo;
use crate::failure::{Failure, Result};

/// A program that ends with this value.
pub struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

impl Running {
    /// Starts a program.
    pub fn start(command: &mut Command) -> Result<Self> {
        let child = command.stdin(Stdio::null()).spawn();
        child.map(Self).map_err(|error| cargo::not_started(command, &error))
    }

    /// It hasn't ended by itself.
    pub fn is_alive(&mut self) -> bool {
        matches!(self.0.try_wait(), Ok(None))
    }
}

/// An X server without a screen; it ends with this value.
pub struct Display {
    /// For the environment variable `DISPLAY`.
    pub name: String,
    _server: Running,
}

impl Display {
    /// Opens a display of 1280x720 under a number that is free.
    pub fn open() -> Result<Self> {
        let mut server = Running::start(
            Command::new("Xvfb")
                .args(["-displayfd", "1", "-screen", "0", "1280x720x24"])
                .args(["-nolisten", "tcp", "-noreset", "-ac"])
                .stdout(Stdio::piped())
                .stderr(Stdio::null()),
        )?;
        let mut number = String::new();
        if let Some(output) = server.0.stdout.take() {
            _ = BufReader::new(output).read_line(&mut number);
        }
        if number.trim().is_empty() {
            return Err(Failure::new("Xvfb opens no display"));
        }
        Ok(Self {
            name: format!(":{}", number.trim()),
            _server: server,
        })
    }

    /// Does something with the keyboard, the pointer or windows; returns what is said of it.
    pub fn xdotool(&self, arguments: &[&str]) -> Result<String> {
        let output = self.output(Command::new("xdotool").args(arguments))?;
        Ok(String::from_utf8_lossy(&output).into_owned())
    }

    /// Moves the pointer.
    pub fn point(&self, (x, y): (i32, i32)) -> Result {
        self.xdotool(&["mousemove", &x.to_string(), &y.to_string()]).map(drop)
    }

    /// Clicks somewhere, and waits for a frame before and after.
    pub fn click(&self, place: (i32, i32)) -> Result {
        self.point(place)?;
        thread::sleep(Duration::from_secs(1));
        self.xdotool(&["click", "1"])?;
        thread::sleep(Duration::from_secs(1));
        Ok(())
    }

    /// What is shown.
    pub fn look(&self) -> Result<Picture> {
        let arguments = ["-silent", "-window", "root", "-depth", "8", "ppm:-"];
        let bytes = self.output(Command::new("import").args(arguments))?;
        Picture::parse(&bytes).ok_or_else(|| Failure::new("import writes no picture"))
    }

    /// Writes what is shown as PNG.
    pub fn save(&self, file: &Path) -> Result {
        let arguments = ["-silent", "-window", "root"];
        self.output(Command::new("import").args(arguments).arg(file)).map(drop)
    }

    fn output(&self, command: &mut Command) -> Result<Vec<u8>> {
        let result = command.env("DISPLAY", &self.name).stderr(Stdio::null()).output();
        let result = result.map_err(|error| cargo::not_started(command, &error))?;
        if result.status.success() {
            Ok(result.stdout)
        } else {
            Err(Failure::new(format!("{command:?} failed ({})", result.status)))
        }
    }
}
