//! The README as a new user follows it: an empty folder with the dependencies and the code from the README, and nothing else.
//!
//! Two differences from a real user make it a test. Bevy has the features of this workspace instead of its default ones, since all of it
//! would be compiled again otherwise; and `DefaultPlugins` becomes the same plugins without a window, with a mirror in front of the
//! camera and a red cube behind it. Only traced reflections can show that cube.

use crate::common::app;
use bevy::math::UVec2;
use bevy_glint::ReflectionTracerChoice;
use glint_scenes::Output;
use std::{
    env,
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

const README: &str = include_str!("../../README.md");
const MANIFEST: &str = include_str!("../../Cargo.toml");
const UNIFY: &str = include_str!("../../tools/unify/Cargo.toml");
/// The checkout.
const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Names the folder of the library as it is published, instead of the checkout.
const PACKAGE: &str = "GLINT_PACKAGE";
/// The new crate.
const NAME: &str = "my_game";
/// A CPU that renders compiles shaders for a while.
const PATIENCE: Duration = Duration::from_secs(1200);

/// The plugins that replace `DefaultPlugins`, and the scene for the check.
const CHECK: &str = r#"//! Bevy's plugins without a window, and a picture of a mirror.

use bevy::{
    app::{PluginGroupBuilder, ScheduleRunnerPlugin},
    camera::RenderTarget,
    prelude::*,
    render::{
        RenderPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        render_resource::TextureFormat,
        view::screenshot::{Screenshot, ScreenshotCaptured},
    },
    window::ExitCondition,
    winit::WinitPlugin,
};
use bevy_glint::ReflectionStatus;

pub fn plugins() -> PluginGroupBuilder {
    DefaultPlugins
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .set(RenderPlugin {
            synchronous_pipeline_compilation: true,
            ..default()
        })
        .disable::<PipelinedRenderingPlugin>()
        .disable::<WinitPlugin>()
        .add(ScheduleRunnerPlugin::default())
        .add(Check)
}

struct Check;

#[derive(Resource)]
struct Picture(Handle<Image>);

impl Plugin for Check {
    fn build(&self, app: &mut App) {
        app.add_systems(PostStartup, place_mirror)
            .add_systems(Update, take_picture);
    }
}

fn place_mirror(
    cameras: Query<(Entity, &Transform), With<Camera3d>>,
    mut images: ResMut<Assets<Image>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut commands: Commands,
) {
    let picture = images.add(Image::new_target_texture(
        320,
        180,
        TextureFormat::Rgba8UnormSrgb,
        None,
    ));
    for (camera, transform) in &cameras {
        commands
            .entity(camera)
            .insert(RenderTarget::from(picture.clone()));
        commands.spawn((
            Mesh3d(meshes.add(Rectangle::new(0.3, 0.3))),
            MeshMaterial3d(materials.add(StandardMaterial {
                metallic: 1.0,
                perceptual_roughness: 0.0,
                ..default()
            })),
            *transform * Transform::from_xyz(0.0, 0.0, -0.5),
        ));
        commands.spawn((
            Mesh3d(meshes.add(Cuboid::new(0.6, 0.6, 0.6))),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: Color::srgb(1.0, 0.0, 0.0),
                unlit: true,
                ..default()
            })),
            *transform * Transform::from_xyz(0.0, 0.0, 1.0),
        ));
    }
    commands.insert_resource(Picture(picture));
}

fn take_picture(
    status: Res<ReflectionStatus>,
    picture: Res<Picture>,
    mut frames: Local<u32>,
    mut commands: Commands,
) {
    let report = status.report();
    if report.tracer.is_none() && !report.reasons.is_empty() {
        eprintln!("no reflections: {:?}", report.reasons);
        std::process::exit(1);
    }
    if !report.ready || report.meshes_pending > 0 || report.instances < 2 {
        return;
    }
    *frames += 1;
    if *frames == 40 {
        commands
            .spawn(Screenshot::image(picture.0.clone()))
            .observe(save);
    }
}

fn save(
    captured: On<ScreenshotCaptured>,
    status: Res<ReflectionStatus>,
    mut exit: MessageWriter<AppExit>,
) {
    let picture = captured.image.clone().try_into_dynamic();
    let picture = picture.expect("the picture has 8 bits").to_rgb8();
    picture.save("picture.png").expect("the picture can be written");
    println!("reflections are on: {:?}", status.report().tracer);
    exit.write(AppExit::Success);
}
"#;

/// The first block of the README in a language that contains `part`.
fn block(language: &str, part: &str) -> String {
    let mut lines = README.lines();
    while let Some(line) = lines.next() {
        let Some(info) = line.strip_prefix("```") else { continue };
        let text: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
        if info.split(',').next() == Some(language) && text.iter().any(|line| line.contains(part)) {
            return text.join("\n") + "\n";
        }
    }
    panic!("the README lacks a step: it has no block of `{language}` with `{part}`");
}

/// The lines of a section of a manifest.
fn section(manifest: &str, header: &str) -> String {
    let lines = manifest.lines().skip_while(|line| *line != header).skip(1);
    let lines: Vec<&str> = lines.take_while(|line| !line.starts_with('[')).collect();
    assert!(!lines.is_empty(), "Cargo.toml has no {header}");
    lines.join("\n")
}

/// The folder of the library.
fn library() -> String {
    env::var(PACKAGE).unwrap_or_else(|_| ROOT.to_owned())
}

/// A line of the README's dependencies, with this checkout in the place of a release, and without Bevy's default features.
fn dependency(line: &str) -> String {
    let named = line.split_once('=').map(|(name, rest)| (name.trim(), rest.trim()));
    match named {
        Some(("bevy_glint", _)) => format!("bevy_glint = {{ path = {:?} }}", library()),
        Some(("bevy", rest)) if rest.starts_with('{') => line.replacen('{', "{ default-features = false,", 1),
        Some(("bevy", rest)) => format!("bevy = {{ version = {rest}, default-features = false }}"),
        _ => line.to_owned(),
    }
}

/// The README's code, with the word that opens a window replaced.
fn main_file() -> String {
    let code = block("rust", "fn main()");
    assert!(
        code.contains("DefaultPlugins"),
        "the README's code has no DefaultPlugins"
    );
    code.replace("DefaultPlugins", "check::plugins()") + "\nmod check;\n"
}

fn manifest_of(name: &str, dependencies: &str) -> String {
    format!("[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n{dependencies}\n")
}

fn write(file: PathBuf, text: &str) {
    let folder = file.parent().expect("a file lies in a folder");
    fs::create_dir_all(folder).expect("a folder can be made");
    fs::write(&file, text).unwrap_or_else(|error| panic!("{} can't be written: {error}", file.display()));
}

/// The README's code without the library.
fn plain_file() -> String {
    let code = block("rust", "fn main()");
    let plain: Vec<_> = code
        .lines()
        .filter(|line| !line.contains("bevy_glint") && !line.contains("ReflectionQuality"))
        .map(|line| {
            line.replace(
                "(DefaultPlugins, RayTracedReflectionsPlugin::default())",
                "DefaultPlugins",
            )
        })
        .collect();
    let plain = plain.join("\n") + "\n";
    assert!(!plain.contains("Reflect"), "{plain}");
    plain
}

/// Creates a crate as `cargo new` does, with the README's dependencies and code. Next to it is a crate that requests the features of this
/// test: cargo unites the features of a workspace, and finds all of Bevy built already.
fn make(folder: &Path) {
    _ = fs::remove_dir_all(folder);
    let dependencies: Vec<_> = block("toml", "[dependencies]").lines().map(dependency).collect();
    write(
        folder.join(NAME).join("Cargo.toml"),
        &manifest_of(NAME, &dependencies.join("\n")),
    );
    write(folder.join(NAME).join("src/main.rs"), &main_file());
    write(folder.join(NAME).join("src/check.rs"), CHECK);

    let features: Vec<_> = [
        (cfg!(feature = "egui"), "egui"),
        (cfg!(feature = "hardware-vrs"), "hardware-vrs"),
        (cfg!(feature = "internals"), "internals"),
        (cfg!(feature = "serde"), "serde"),
    ]
    .into_iter()
    .filter_map(|(on, name)| on.then_some(name))
    .collect();
    // Both lists can request features of the same crate. That crate then needs two names.
    let rename = |line: &str| match line.split_once(" = { ") {
        Some((name, rest)) => format!("unified_{name} = {{ package = {name:?}, {rest}"),
        None => line.to_owned(),
    };
    let own = section(MANIFEST, "[dev-dependencies]");
    let unified = section(UNIFY, "[dependencies]");
    let others = own.lines().map(str::to_owned).chain(unified.lines().map(rename));
    let others: Vec<_> = others.filter(|line| !line.contains("path =")).collect();
    let dependencies = format!(
        "[dependencies]\nbevy_glint = {{ path = {:?}, features = {features:?} }}\n{}",
        library(),
        others.join("\n")
    );
    write(
        folder.join("like_here/Cargo.toml"),
        &manifest_of("like_here", &dependencies),
    );
    write(folder.join("like_here/src/lib.rs"), "");
    let workspace = format!(
        "[workspace]\nmembers = [\"{NAME}\", \"like_here\"]\nresolver = \"3\"\n\n[workspace.dependencies]\n{}\n\
         [profile.release]\n{}\n",
        section(MANIFEST, "[workspace.dependencies]"),
        section(MANIFEST, "[profile.release]")
    );
    write(folder.join("Cargo.toml"), &workspace);
    let lock = fs::read_to_string(Path::new(ROOT).join("Cargo.lock")).expect("the workspace is locked");
    write(folder.join("Cargo.lock"), &lock);
}

/// Builds an app with the objects of this workspace; returns its program, and the seconds of CPU time that the build took.
fn build(folder: &Path, name: &str) -> (PathBuf, f64) {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .parent()
        .expect("the folder for tests lies in that of builds");
    let this_program = env::current_exe().expect("this program lies in a folder");
    let is_release = this_program.iter().any(|part| part == "release");
    let program = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut cargo = Command::new(if cfg!(unix) { "sh".into() } else { program.clone() });
    if cfg!(unix) {
        // The shell measures the time of its child.
        cargo.args(["-c", "\"$@\" && times", "sh"]).arg(program);
    }
    // Bevy builds with older compilers than its manifest requires.
    cargo
        .args([
            "build",
            "--workspace",
            "--bin",
            name,
            "--offline",
            "--ignore-rust-version",
        ])
        .args(is_release.then_some("--release"))
        .arg("--target-dir")
        .arg(target)
        .current_dir(folder);
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_"]
            .iter()
            .any(|start| text.starts_with(start))
        {
            cargo.env_remove(&name);
        }
    }
    let output = cargo.stderr(Stdio::inherit()).output().expect("cargo starts");
    let status = output.status;
    assert!(status.success(), "{name} doesn't build ({status})");
    let profile = if is_release { "release" } else { "debug" };
    let program = target.join(profile).join(format!("{name}{}", env::consts::EXE_SUFFIX));
    (program, cpu_seconds(&String::from_utf8_lossy(&output.stdout)))
}

/// User and system time of children from the shell's `times`. Its first line is for the shell itself (`0m0.01s 0m0.00s`), and the second
/// one for its children (`1m2.50s 0m3.25s`).
fn cpu_seconds(times: &str) -> f64 {
    let seconds = |word: &str| {
        let (minutes, seconds) = word.trim_end_matches('s').split_once('m')?;
        Some(60.0 * minutes.parse::<f64>().ok()? + seconds.parse::<f64>().ok()?)
    };
    let last = times.lines().last().unwrap_or_default();
    last.split_whitespace().filter_map(seconds).sum()
}

/// Runs a program to its end, with its output in the file `log`, and returns the output. The test fails if the program fails or takes too
/// long. `what` begins the failure message.
#[track_caller]
fn run(what: &str, command: &mut Command, log: &Path) -> String {
    let output = File::create(log).expect("a log can be written");
    let errors = output.try_clone().expect("a log can be shared");
    let mut child = command
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .stdin(Stdio::null())
        .stdout(output)
        .stderr(errors)
        .spawn()
        .unwrap_or_else(|error| panic!("{what} doesn't start: {error}"));
    let start = Instant::now();
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) if start.elapsed() <= PATIENCE => thread::sleep(Duration::from_millis(50)),
            outcome => {
                _ = child.kill();
                _ = child.wait();
                panic!("{what} doesn't end ({outcome:?}); see {}", log.display());
            }
        }
    };
    let said = fs::read_to_string(log).expect("the log is text");
    assert!(status.success(), "{what} ended with {status}:\n{said}");
    said
}

#[test]
fn the_readme_has_every_step() {
    let dependencies = block("toml", "[dependencies]");
    for name in ["bevy", "bevy_glint"] {
        let has_line = |line: &str| line.split_once('=').is_some_and(|(start, _)| start.trim() == name);
        assert!(dependencies.lines().any(has_line), "no line for {name}");
    }
    let code = main_file();
    assert!(code.contains("check::plugins()") && !code.contains("DefaultPlugins"));
    // The plugin and one component are enough: the plugin does the rest.
    for word in ["DefaultOpaqueRendererMethod", "Prepass", "Msaa", "Hdr"] {
        assert!(
            !code.contains(&format!("{word}::")),
            "the README's code needs no {word}"
        );
    }
    assert_eq!(
        dependency("bevy = \"0.20\""),
        "bevy = { version = \"0.20\", default-features = false }"
    );
    assert_eq!(
        dependency("bevy = { version = \"0.20\", features = [\"png\"] }"),
        "bevy = { default-features = false, version = \"0.20\", features = [\"png\"] }"
    );
}

#[test]
fn the_time_of_children_is_the_last_line() {
    assert_eq!(cpu_seconds("0m9.00s 0m9.00s\n1m2.50s 0m3.25s\n"), 65.75);
    assert_eq!(cpu_seconds(""), 0.0);
}

/// Prints the library's share of an app: compile time of only the library, with all its features, after Bevy; and the size of the program.
#[test]
#[ignore = "builds crates; run by cargo xtask new-user --measure"]
fn a_new_app_grows() {
    const PLAIN: &str = "my_plain_game";
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new_user_size");
    make(&folder);
    write(folder.join(NAME).join("src/main.rs"), &block("rust", "fn main()"));
    let dependencies: Vec<_> = block("toml", "[dependencies]").lines().map(dependency).collect();
    let bevy: Vec<_> = dependencies
        .into_iter()
        .filter(|line| !line.contains("bevy_glint"))
        .collect();
    write(
        folder.join(PLAIN).join("Cargo.toml"),
        &manifest_of(PLAIN, &bevy.join("\n")),
    );
    write(folder.join(PLAIN).join("src/main.rs"), &plain_file());
    let workspace = folder.join("Cargo.toml");
    let members = fs::read_to_string(&workspace).expect("it was written");
    write(
        workspace,
        &members.replace("members = [", &format!("members = [\"{PLAIN}\", ")),
    );

    let touch = |file: PathBuf| {
        let file = File::options().append(true).open(&file).expect("there is such a file");
        file.set_modified(std::time::SystemTime::now())
            .expect("its time can be set");
    };
    let size = |program: PathBuf| fs::metadata(program).expect("it was built").len() as f64 / 1e6;
    let (plain, _) = build(&folder, PLAIN);
    build(&folder, NAME);
    touch(folder.join(NAME).join("src/main.rs"));
    let (_, app) = build(&folder, NAME);
    touch(Path::new(&library()).join("src/lib.rs"));
    let (program, all) = build(&folder, NAME);
    let (plain, program) = (size(plain), size(program));
    println!(
        "compilation: {:.0} s of CPU time for the library, {app:.0} s for the app",
        all - app
    );
    println!(
        "program: {program:.1} MB, {plain:.1} MB without the library: {:.1} MB more",
        program - plain
    );
    assert!(program > plain && all > app);
}

/// The two tests that build crates are ignored, so no other test notices a manifest that Cargo rejects.
#[test]
fn cargo_takes_the_manifests_of_a_new_app() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new_user_manifests");
    make(&folder);
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .args(["metadata", "--no-deps", "--offline", "--format-version=1"])
        .current_dir(&folder);
    let output = cargo.output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
#[ignore = "builds a crate; run by cargo xtask new-user"]
fn a_new_app_reflects() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new_user");
    make(&folder);
    let (program, _) = build(&folder, NAME);
    if app(UVec2::ONE, Output::Picture, ReflectionTracerChoice::Auto).is_none() {
        return;
    }
    let game = folder.join(NAME);
    // It exits once it has saved its image.
    let said = run(
        "the app",
        Command::new(program).current_dir(&game),
        &game.join("log.txt"),
    );
    assert!(said.contains("reflections are on: Some("), "{said}");
    for problem in ["ERROR bevy_glint", "WARN bevy_glint"] {
        assert!(!said.contains(problem), "{said}");
    }
    let picture = image::open(game.join("picture.png"))
        .expect("a picture was written")
        .to_rgb8();
    assert_eq!(picture.dimensions(), (320, 180));
    let [red, green, blue] = picture.get_pixel(160, 90).0.map(u32::from);
    assert!(
        red > 80 && 2 * red > 3 * green.max(blue),
        "the mirror doesn't show the cube behind the camera, but ({red}, {green}, {blue}); see {}",
        game.display()
    );
}
