//! `cargo xtask window --out DIR`: the settings panel in a real window, worked by a scripted pointer and keyboard on a display that
//! nobody sees.
//!
//! The scene stands still and starts without reflections, so that every difference between two pictures is an effect of the script.

mod display;
mod picture;

use std::env;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use crate::cargo::Program;
use crate::driver::{self, Need};
use crate::failure::{Failure, Result};
use crate::{cargo, progress};
use display::{Display, Running};
use picture::{Picture, Region};

/// What `window` accepts.
#[derive(clap::Args)]
pub struct Options {
    /// The folder of the screenshots.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// The viewer shows the panel.
const PROGRAM: Program = Program::Binary("glint_viewer");
/// What the title of its window begins with.
const TITLE: &str = "bevy_glint: ";
const PROGRAMS: [&str; 3] = ["Xvfb", "xdotool", "import"];
/// On Debian: these programs, and the libraries that windows load when they open.
const PACKAGES: [&str; 8] = [
    "xvfb",
    "xdotool",
    "imagemagick",
    "libx11-xcb1",
    "libxcursor1",
    "libxi6",
    "libxrandr2",
    "libxkbcommon-x11-0",
];
/// For shaders that a CPU compiles.
const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_secs(60);
/// For what happens in one of the next frames.
const SOON: Duration = Duration::from_secs(15);

/// Where the panel is when it opens: its window begins at (8, 8) and is 620x640 large.
const PANEL: Region = Region { x: 20..600, y: 60..600 };
/// The middle of its title bar.
const BAR: Region = Region { x: 200..440, y: 16..36 };
/// Its rows below the switch, which are grey while reflections are off.
const ROWS: Region = Region {
    x: 20..350,
    y: 100..600,
};
/// What the dragged panel leaves behind.
const LEFT: Region = Region { x: 12..230, y: 60..600 };
/// The scene beside it.
const SCENE: Region = Region {
    x: 660..1270,
    y: 10..710,
};
/// The switch: its column, and rows where it may be, depending on the font.
const SWITCH: (i32, [i32; 5]) = (23, [62, 57, 67, 72, 52]);
/// Where the pointer holds the title bar, and how far it goes.
const GRIP: (i32, i32) = (158, 26);
const DRAG: (i32, i32) = (250, 40);
/// A place where the pointer touches nothing.
const AWAY: (i32, i32) = (1000, 700);

/// Builds the viewer and works it.
pub fn run(options: &Options) -> Result {
    if !cfg!(target_os = "linux") {
        return Err(Failure::new("a virtual X11 display is needed: run this on Linux"));
    }
    let out = &options.out;
    fs::create_dir_all(out).map_err(|error| Failure::new(format!("{} can't be made: {error}", out.display())))?;
    let driver = driver::prepare(Need::Vulkan)?;
    let path = env::var_os("PATH").unwrap_or_default();
    let is_installed = |program: &&str| env::split_paths(&path).any(|folder| folder.join(program).is_file());
    if !PROGRAMS.iter().all(is_installed) {
        driver::tools(&PACKAGES, "a virtual display (Xvfb, xdotool, ImageMagick)")?;
    }
    let mut program = progress::step("build the viewer", || cargo::program(PROGRAM))?;
    progress::step("work its window", || Session::start(out, driver, &mut program)?.work())
}

/// The viewer on its display.
struct Session<'a> {
    out: &'a Path,
    program: Running,
    display: Display,
}

impl<'a> Session<'a> {
    fn start(out: &'a Path, driver: Vec<(&'static str, String)>, program: &mut Command) -> Result<Self> {
        let display = Display::open()?;
        let log = File::create(out.join("log.txt")).and_then(|file| Ok((file.try_clone()?, file)));
        let (log, errors) = log.map_err(|error| Failure::new(format!("no log can be written: {error}")))?;
        program
            .args(["--panel", "--scene", "mirror_room", "--technique", "off"])
            .args(["--size", "1280x720"])
            .envs(driver)
            .env("DISPLAY", &display.name)
            .env("WINIT_X11_SCALE_FACTOR", "1")
            .env_remove("WAYLAND_DISPLAY")
            .stdout(log)
            .stderr(errors);
        let program = Running::start(program)?;
        Ok(Self { out, program, display })
    }

    fn work(&mut self) -> Result {
        let window = self.window()?;
        self.display.xdotool(&["windowfocus", &window])?;
        self.display.point(AWAY)?;
        self.wait("the panel is there", LONG, |now| now.lit(&PANEL) > 0.9)?;
        let start = self.rest()?;
        self.save("1-start")?;

        self.display.xdotool(&["key", "F2"])?;
        self.wait("F2 closes the panel", SHORT, |now| now.changed(&start, &PANEL) > 0.5)?;
        self.save("2-closed")?;
        self.display.xdotool(&["key", "F2"])?;
        self.wait("F2 opens it again", SHORT, |now| now.changed(&start, &BAR) < 0.02)?;

        let switch = self.switch_on(&start)?;
        self.wait("a click shows reflections", LONG, |now| {
            now.changed(&start, &SCENE) > 0.003
        })?;
        self.save("3-reflections")?;
        self.click(switch)?;
        self.wait("another hides them", SHORT, |now| now.changed(&start, &SCENE) < 0.0005)?;
        self.save("4-off")?;

        let before = self.look()?;
        self.drag(&before)?;
        self.wait("the panel has left its place", SHORT, |now| {
            now.changed(&before, &LEFT) > 0.5
        })?;
        self.save("5-dragged")
    }

    /// The id of the viewer's window, once it is there.
    fn window(&mut self) -> Result<String> {
        let begin = Instant::now();
        while begin.elapsed() < LONG {
            self.check()?;
            // It fails while nothing is found.
            let found = self.display.xdotool(&["search", "--onlyvisible", "--name", TITLE]);
            if let Some(window) = found.unwrap_or_default().lines().next() {
                return Ok(window.to_owned());
            }
            thread::sleep(Duration::from_millis(250));
        }
        Err(self.failure("the viewer opens no window"))
    }

    /// Finds the switch by trying: its click changes the rows below.
    fn switch_on(&mut self, before: &Picture) -> Result<(i32, i32)> {
        for row in SWITCH.1 {
            let place = (SWITCH.0, row);
            self.click(place)?;
            if self.watch(SOON, |now| now.changed(before, &ROWS) > 0.01)? {
                return Ok(place);
            }
        }
        Err(self.failure("a click on the switch has no effect"))
    }

    fn click(&self, place: (i32, i32)) -> Result {
        self.display.click(place)?;
        self.display.point(AWAY)
    }

    /// Drags the panel by its title bar. Between two events a frame must pass, and nobody knows how long frames take: if nothing
    /// moves, the same is done more slowly.
    fn drag(&mut self, before: &Picture) -> Result {
        for seconds in [1, 4, 12] {
            let pause = || thread::sleep(Duration::from_secs(seconds));
            self.display.point(GRIP)?;
            pause();
            self.display.xdotool(&["mousedown", "1"])?;
            pause();
            self.display.point((GRIP.0 + DRAG.0, GRIP.1 + DRAG.1))?;
            pause();
            self.display.xdotool(&["mouseup", "1"])?;
            pause();
            self.display.point(AWAY)?;
            if self.watch(SOON, |now| now.moved(before, &BAR, DRAG))? {
                progress::note("the panel goes where its title bar is dragged");
                return Ok(());
            }
            if self.look()?.changed(before, &BAR) > 0.02 {
                return Err(self.failure("the panel doesn't go where its title bar is dragged"));
            }
        }
        Err(self.failure("dragging the panel has no effect"))
    }

    fn look(&mut self) -> Result<Picture> {
        self.check()?;
        self.display.look()
    }

    /// What is shown once the scene is there and the same for a while.
    fn rest(&mut self) -> Result<Picture> {
        let begin = Instant::now();
        let mut last = self.look()?;
        let mut quiet = 0;
        while begin.elapsed() < LONG {
            thread::sleep(Duration::from_secs(2));
            let now = self.look()?;
            let is_same = now.lit(&SCENE) > 0.005 && now.changed(&last, &SCENE) == 0.0;
            quiet = if is_same { quiet + 1 } else { 0 };
            if quiet == 3 {
                return Ok(now);
            }
            last = now;
        }
        Err(self.failure("the scene doesn't come to rest"))
    }

    fn watch(&mut self, patience: Duration, holds: impl Fn(&Picture) -> bool) -> Result<bool> {
        let begin = Instant::now();
        loop {
            if holds(&self.look()?) {
                return Ok(true);
            }
            if begin.elapsed() > patience {
                return Ok(false);
            }
            thread::sleep(Duration::from_millis(500));
        }
    }

    fn wait(&mut self, what: &str, patience: Duration, holds: impl Fn(&Picture) -> bool) -> Result {
        if self.watch(patience, holds)? {
            progress::note(what);
            return Ok(());
        }
        let seconds = patience.as_secs();
        Err(self.failure(&format!("this doesn't happen within {seconds} s: {what}")))
    }

    fn save(&self, name: &str) -> Result {
        let file = self.out.join(format!("{name}.png"));
        self.display.save(&file)?;
        progress::result(file.display());
        Ok(())
    }

    /// A failure with a screenshot.
    fn failure(&self, sentence: &str) -> Failure {
        _ = self.save("failed");
        Failure::new(format!("{sentence} (see {})", self.out.display()))
    }

    fn check(&mut self) -> Result {
        if self.program.is_alive() {
            return Ok(());
        }
        let log = self.out.join("log.txt");
        Err(Failure::new(format!("the viewer has ended; see {}", log.display())))
    }
}
