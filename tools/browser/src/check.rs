//! Opens the page in headless Chromium, on its software adapter for WebGPU.

use crate::{guard, serve};
use anyhow::{Context, Result, anyhow, bail, ensure};
use headless_chrome::browser::tab::point::Point;
use headless_chrome::protocol::cdp::types::Event;
use headless_chrome::protocol::cdp::{Emulation, Input, Page, Runtime};
use headless_chrome::{Browser, LaunchOptions, Tab};
use image::RgbImage;
use std::ffi::OsStr;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// The page and the native image must agree; the native program draws small images with small shadow maps.
const QUERY: &str = "still=true&trilinear=true&panel=false&bar=false&technique=ultra&shadows=512";
/// Limit of the mean FLIP between the page and the native program: two runs had 0.0290 and 0.0295. The adapters filter textures differently.
const LIMIT: f32 = 0.035;
/// Minimum mean difference that reflections make, in steps of 8 bits.
const CHANGE: f32 = 1.0;
/// Share of this difference that can remain between two images without reflections: the clock is stopped.
const REST: f32 = 0.4;
/// Place of the panel's first check box, which switches reflections off.
const SWITCH: Point = Point { x: 14.0, y: 49.0 };
/// Keys of the page.
const COMPARE: &str = "c";
const PANEL: &str = "F2";
/// The adapter of a CPU compiles shaders for minutes.
const PATIENCE: Duration = Duration::from_secs(15 * 60);
const PAUSE: Duration = Duration::from_millis(500);
/// Frames until the page shows the effect of an event: frames are drawn ahead of presentation.
const FRAMES: u32 = 4;
const BROWSERS: [&str; 4] = [
    "/usr/bin/chromium",
    "/usr/bin/chromium-browser",
    "/usr/bin/google-chrome",
    "/usr/bin/google-chrome-stable",
];
/// The last four have Chromium's software adapter draw into canvases, too.
const FLAGS: [&str; 10] = [
    "--hide-scrollbars",
    "--disable-quic",
    "--disable-component-update",
    // Shaders are compiled for longer than it likes.
    "--disable-gpu-watchdog",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--enable-features=NetworkService,NetworkServiceInProcess,Vulkan",
    "--ignore-gpu-blocklist",
    "--use-vulkan=swiftshader",
    "--use-angle=swiftshader",
];

/// Compares the static page with the image, splits it into one half with reflections and one without, and clicks its panel to switch them
/// off.
///
/// # Errors
///
/// Fails if an image differs, or the page writes an error to the console.
pub fn check(folder: &Path, expected: &Path, out: &Path) -> Result<()> {
    fs::create_dir_all(out)?;
    let expected = image::open(expected)
        .with_context(|| format!("cannot read {}", expected.display()))?
        .to_rgb8();
    let server = Arc::new(serve::listen(0)?);
    let port = serve::port_of(&server)?;
    let (answering, folder) = (server.clone(), folder.to_owned());
    thread::spawn(move || serve::answer(&answering, &folder));
    let visit = Visit::new(port, out, expected.dimensions())?;

    visit.open(QUERY)?;
    let shown = visit.picture("page")?;
    let error = flip(&expected, &shown);
    println!("FLIP against the native picture: {error:.4} (at most {LIMIT})");
    ensure!(error <= LIMIT, "the page doesn't show what the native program shows");

    visit.press(COMPARE)?;
    let (left, right) = (0..shown.width() / 2, shown.width() / 2..shown.width());
    // The half with reflections restarts, and converges again.
    let is_split = |picture: &RgbImage| {
        let change = difference(&shown, picture, left.clone());
        change >= CHANGE && difference(&shown, picture, right.clone()) <= REST * change
    };
    let split = visit.changed("split", is_split)?;
    let change = difference(&shown, &split, left.clone());
    println!("without reflections {change:.2} of 255 differ (at least {CHANGE})");

    visit.press(COMPARE)?;
    visit.press(PANEL)?;
    visit.changed("panel", |picture| {
        difference(&shown, picture, left.clone()) >= 4.0 * CHANGE
    })?;
    visit.click(SWITCH)?;
    visit.press(PANEL)?;
    let is_off = |picture: &RgbImage| difference(&split, picture, left.clone()) <= REST * change;
    visit.changed("switched", is_off)?;
    println!("a click in the panel switches reflections off");
    visit.ensure_quiet()
}

/// A browser with the page.
struct Visit {
    address: String,
    /// Folder for images.
    out: PathBuf,
    /// Keeps the browser open.
    _browser: Browser,
    tab: Arc<Tab>,
    /// Errors in the console of the page.
    errors: Arc<Mutex<Vec<String>>>,
}

impl Visit {
    fn new(port: u16, out: &Path, (width, height): (u32, u32)) -> Result<Self> {
        let program = BROWSERS.iter().map(PathBuf::from).find(|path| path.exists());
        let program = program.context("no Chromium was found: on Debian, `apt-get install chromium`")?;
        let browser = Browser::new(LaunchOptions {
            path: Some(program),
            sandbox: false,
            enable_gpu: true,
            idle_browser_timeout: PATIENCE,
            args: FLAGS.iter().map(OsStr::new).collect(),
            ..LaunchOptions::default()
        })?;
        #[cfg(unix)]
        if let Some(id) = browser.get_process_id() {
            let check = std::process::id();
            guard::watch(&[std::os::unix::process::parent_id(), check], &[check, id])?;
        }
        let tab = browser.new_tab()?;
        // Pages in the background draw no frames.
        tab.bring_to_front()?;
        tab.set_default_timeout(Duration::from_secs(120));
        tab.call_method(Emulation::SetDeviceMetricsOverride {
            width,
            height,
            device_scale_factor: 1.0,
            mobile: false,
            scale: None,
            screen_width: None,
            screen_height: None,
            position_x: None,
            position_y: None,
            dont_set_visible_size: None,
            screen_orientation: None,
            viewport: None,
            display_feature: None,
            device_posture: None,
        })?;
        let errors = Arc::new(Mutex::new(Vec::new()));
        let listener = errors.clone();
        tab.enable_log()?;
        tab.enable_runtime()?;
        tab.add_event_listener(Arc::new(move |event: &Event| {
            if let (Some(error), Ok(mut errors)) = (console_error(event), listener.lock()) {
                errors.push(error);
            }
        }))?;
        Ok(Self {
            address: format!("http://127.0.0.1:{port}/"),
            out: out.to_owned(),
            _browser: browser,
            tab,
            errors,
        })
    }

    /// Opens the page and waits until its image is static.
    fn open(&self, query: &str) -> Result<()> {
        let start = Instant::now();
        let mut known = String::new();
        self.tab.navigate_to(&format!("{}?{query}", self.address))?;
        while start.elapsed() < PATIENCE {
            thread::sleep(PAUSE);
            self.ensure_quiet()?;
            let state = self.state()?;
            if state != known {
                println!("{state} after {:.0} s", start.elapsed().as_secs_f32());
                known.clone_from(&state);
            }
            match state.as_str() {
                "rest" => return Ok(()),
                "declined" => bail!("the page declines: {}", self.evaluate("document.body.dataset.reason")?),
                _ => {}
            }
        }
        self.picture("failed")?;
        bail!(
            "the page didn't come to rest in {PATIENCE:?}; {} shows it",
            self.path("failed").display()
        )
    }

    fn state(&self) -> Result<String> {
        self.evaluate("document.body?.dataset.state ?? ''")
    }

    fn evaluate(&self, expression: &str) -> Result<String> {
        let value = self.tab.evaluate(expression, false)?.value;
        Ok(value
            .and_then(|value| value.as_str().map(str::to_owned))
            .unwrap_or_default())
    }

    /// Waits until the page has drawn some frames.
    fn wait_for_frames(&self) -> Result<()> {
        let script = format!(
            "new Promise(done => {{
                let left = {FRAMES};
                const step = () => left-- > 0 ? requestAnimationFrame(step) : done();
                step();
            }})"
        );
        self.tab.evaluate(&script, true)?;
        Ok(())
    }

    /// Presses and releases a key.
    fn press(&self, key: &str) -> Result<()> {
        self.tab.evaluate("document.getElementById('demo').focus()", false)?;
        self.tab.press_key(key)?;
        self.wait_for_frames()
    }

    /// Presses and releases a button, with frames between both.
    fn click(&self, point: Point) -> Result<()> {
        use Input::DispatchMouseEventTypeOption::{MouseMoved, MousePressed, MouseReleased};
        for (kind, button) in [
            (MouseMoved, None),
            (MousePressed, Some(Input::MouseButton::Left)),
            (MouseReleased, Some(Input::MouseButton::Left)),
        ] {
            self.tab.call_method(Input::DispatchMouseEvent {
                Type: kind.clone(),
                x: point.x,
                y: point.y,
                click_count: button.as_ref().map(|_| 1),
                button,
                modifiers: None,
                timestamp: None,
                buttons: Some(u32::from(matches!(kind, MousePressed))),
                force: None,
                tangential_pressure: None,
                tilt_x: None,
                tilt_y: None,
                twist: None,
                delta_x: None,
                delta_y: None,
                pointer_Type: None,
            })?;
            self.wait_for_frames()?;
        }
        Ok(())
    }

    /// The image of the page, once it meets the condition.
    fn changed(&self, name: &str, is_expected: impl Fn(&RgbImage) -> bool) -> Result<RgbImage> {
        let start = Instant::now();
        loop {
            let picture = self.picture(name)?;
            if is_expected(&picture) {
                return Ok(picture);
            }
            self.ensure_quiet()?;
            let path = self.path(name);
            ensure!(
                start.elapsed() < PATIENCE,
                "the page isn't as expected: see {}",
                path.display()
            );
            self.wait_for_frames()?;
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.out.join(name).with_extension("png")
    }

    /// Takes and stores an image of the page.
    fn picture(&self, name: &str) -> Result<RgbImage> {
        let format = Page::CaptureScreenshotFormatOption::Png;
        let png = self.tab.capture_screenshot(format, None, None, true)?;
        fs::write(self.path(name), &png)?;
        Ok(image::load_from_memory(&png)?.to_rgb8())
    }

    fn ensure_quiet(&self) -> Result<()> {
        let errors = self.errors.lock().map_err(|_| anyhow!("the listener failed"))?;
        ensure!(errors.is_empty(), "errors in the console:\n{}", errors.join("\n"));
        Ok(())
    }
}

/// The text of an error in the console.
fn console_error(event: &Event) -> Option<String> {
    match event {
        Event::RuntimeConsoleAPICalled(call) => {
            let words = call.params.args.iter().filter_map(|argument| {
                let value = argument.value.as_ref();
                value.map(ToString::to_string).or_else(|| argument.description.clone())
            });
            let text = words.collect::<Vec<_>>().join(" ");
            // Bevy's log has its levels in the text.
            let is_error =
                call.params.Type == Runtime::ConsoleAPICalledEventTypeOption::Error || text.contains("ERROR");
            is_error.then_some(text)
        }
        Event::RuntimeExceptionThrown(thrown) => {
            let details = &thrown.params.exception_details;
            let description = details
                .exception
                .as_ref()
                .and_then(|exception| exception.description.clone());
            Some(description.unwrap_or_else(|| details.text.clone()))
        }
        Event::LogEntryAdded(entry) => {
            let entry = &entry.params.entry;
            let is_error = matches!(entry.level, headless_chrome::protocol::cdp::Log::LogEntryLevel::Error);
            is_error.then(|| entry.text.clone())
        }
        _ => None,
    }
}

fn flip(expected: &RgbImage, actual: &RgbImage) -> f32 {
    if expected.dimensions() != actual.dimensions() {
        return f32::INFINITY;
    }
    let image = |image: &RgbImage| nv_flip::FlipImageRgb8::with_data(image.width(), image.height(), image);
    let map = nv_flip::flip(image(expected), image(actual), nv_flip::DEFAULT_PIXELS_PER_DEGREE);
    nv_flip::FlipPool::from_image(&map).mean()
}

/// Mean difference of two images in some columns, in steps of 8 bits.
fn difference(a: &RgbImage, b: &RgbImage, columns: Range<u32>) -> f32 {
    if a.dimensions() != b.dimensions() {
        return f32::INFINITY;
    }
    let pixels = || (0..a.height()).flat_map(|y| columns.clone().map(move |x| (x, y)));
    let channels = pixels().flat_map(|(x, y)| std::iter::zip(a.get_pixel(x, y).0, b.get_pixel(x, y).0));
    let sum: f32 = channels.map(|(a, b)| f32::from(a.abs_diff(b))).sum();
    sum / (3 * pixels().count()).max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_those_of_columns() {
        let black = RgbImage::new(4, 2);
        let mut other = black.clone();
        other.put_pixel(0, 0, image::Rgb([6, 0, 0]));
        assert_eq!(difference(&black, &other, 0..2), 0.5);
        assert_eq!(difference(&black, &other, 2..4), 0.0);
    }
}
