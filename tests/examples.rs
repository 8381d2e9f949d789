//! Every example renders a picture without a window, as its users start it: the program that cargo built, with its options.
//!
//! `minimal` has no such mode: its code runs in this program, with Bevy's plugins but without a window.

mod common;
#[path = "../examples/minimal.rs"]
#[expect(dead_code, reason = "its `main` opens a window")]
mod minimal;
#[path = "common/pictures.rs"]
mod pictures;

use bevy::{camera::ShadowLodOrigin, math::UVec2, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionStatus};
use common::{child, gpu::Gpu, wesl::Shaders};
use glint_scenes::{HeadlessApp, HeadlessSettings};
use std::{
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
    time::Instant,
};

const SIZE: (u32, u32) = (160, 90);

/// Without a GPU, and without a driver that takes its place, nothing can be rendered.
fn has_gpu() -> bool {
    static FOUND: OnceLock<bool> = OnceLock::new();
    *FOUND.get_or_init(|| Gpu::new().is_some())
}

/// The program of an example, which cargo puts beside the folder of this one; `None` if it wasn't built.
fn program(example: &str) -> Option<PathBuf> {
    let own = std::env::current_exe().expect("this program has a path");
    let profile = own.ancestors().nth(2).expect("tests lie in a folder");
    let file = format!("{example}{}", std::env::consts::EXE_SUFFIX);
    let program = profile.join("examples").join(file);
    program.is_file().then_some(program)
}

#[track_caller]
fn built(example: &str) -> PathBuf {
    program(example).unwrap_or_else(|| {
        panic!(
            "the example `{example}` wasn't built together with this test: run `cargo xtask test`, or `cargo build --examples` \
             with the profile and features of the test"
        )
    })
}

/// Runs an example and looks at its picture; `name` is that of the picture. Returns what it logged, or `None` (with the reason
/// printed) where this machine can't render.
#[track_caller]
fn render(name: &str, example: &str, arguments: &[&str]) -> Option<String> {
    let program = built(example);
    if !has_gpu() {
        println!("skipped: {name}");
        return None;
    }
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let picture = folder.join(format!("example-{name}.png"));
    let log = folder.join(format!("example-{name}.log"));
    _ = fs::remove_file(&picture);
    let mut command = Command::new(program);
    command
        .args(["--headless", "--size", &format!("{}x{}", SIZE.0, SIZE.1)])
        .args(["--frames", "4", "--out"])
        .arg(&picture)
        .args(arguments);
    let start = Instant::now();
    let said = child::run(name, &mut command, &log);
    assert!(!said.contains("ERROR bevy_glint"), "{name} logged an error:\n{said}");
    check(name, &picture);
    println!("{name}: {:.1} s", start.elapsed().as_secs_f32());
    Some(said)
}

/// The picture has the right size and shows something.
#[track_caller]
fn check(name: &str, picture: &Path) {
    let image = image::open(picture)
        .unwrap_or_else(|error| panic!("{name}: {} can't be read: {error}", picture.display()))
        .to_rgb8();
    assert_eq!(image.dimensions(), SIZE, "{name}");
    let lit = image
        .pixels()
        .filter(|pixel| pixel.0.into_iter().any(|value| value > 16))
        .count();
    let colours: HashSet<[u8; 3]> = image.pixels().map(|pixel| pixel.0).collect();
    println!("{name}: {lit} pixels that aren't black, {} colours", colours.len());
    assert!(lit * 10 > (SIZE.0 * SIZE.1) as usize, "{name} is black");
    assert!(colours.len() > 32, "{name} is uniform");
}

/// An example that exists only with the crate feature `egui`.
#[track_caller]
fn render_panel(example: &str) {
    if program(example).is_none() && !cfg!(feature = "egui") {
        println!("skipped: {example} needs the crate feature `egui`");
        return;
    }
    render(example, example, &[]);
}

/// A scene of the demo, coarse.
#[track_caller]
fn render_scene(scene: &str) {
    let name = format!("demo-{scene}");
    render(&name, "demo", &["--scene", scene, "--detail", "0.25"]);
}

#[test]
fn minimal() {
    built("minimal");
    if !has_gpu() {
        println!("skipped: minimal");
        return;
    }
    let settings = HeadlessSettings {
        size: UVec2::from(SIZE),
        ..default()
    };
    let mut app = HeadlessApp::new(settings, |app| {
        app.add_plugins(minimal::game);
    })
    .unwrap_or_else(|error| panic!("{error}"));
    // The scene is spawned in the first frame; its camera would draw into a window. Bevy looks at a target that was replaced only
    // where the projection changed, too.
    app.step(1);
    let target = app.target();
    let world = app.world();
    let mut cameras = world.query_filtered::<Entity, With<RayTracedReflections>>();
    let camera = cameras.single(world).expect("there is one camera that reflects");
    let headless = (target, Projection::default(), ShadowLodOrigin);
    world.entity_mut(camera).insert(headless);
    pictures::warm_up(&mut app);
    app.step(4);
    let report = app.world().resource::<ReflectionStatus>().report();
    assert!(report.tracer.is_some() && report.instances == 3, "{report:?}");
    let picture = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("example-minimal.png");
    app.save(&picture).unwrap_or_else(|error| panic!("{error}"));
    check("minimal", &picture);
}

#[test]
fn demo() {
    render_scene("demo");
}

#[test]
fn demo_atrium() {
    render_scene("atrium");
}

#[test]
fn demo_temple() {
    render_scene("temple");
}

#[test]
fn demo_street() {
    render_scene("street");
}

#[test]
fn viewer() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("example-viewer");
    let [_, quads] = glint_scenes::write_test_assets(&folder).expect("test files can be written");
    let quads = quads.to_str().expect("the path is text");
    render("viewer", "viewer", &[quads]);
}

#[test]
fn settings_panel() {
    render_panel("settings_panel");
}

#[test]
fn options_menu() {
    render_panel("options_menu");
}

#[test]
fn heuristics() {
    render("heuristics", "heuristics", &[]);
    render("heuristics-rates", "heuristics", &["--rates", "--left", "grazing"]);
}

#[test]
fn dynamic() {
    render("dynamic", "dynamic", &[]);
}

#[test]
fn compare() {
    render("compare-all", "compare", &["--all", "--truth-frames", "8"]);
    render("compare-ssr", "compare", &["--method", "ssr"]);
}

#[test]
fn split_screen() {
    render("split_screen", "split_screen", &["--right", "off"]);
}

#[test]
fn custom_heuristic() {
    for heuristic in ["shader", "image"] {
        let name = format!("custom_heuristic-{heuristic}");
        let said = render(&name, "custom_heuristic", &["--rates", "--heuristic", heuristic]);
        if let Some(said) = said {
            assert!(!said.contains("can't be used"), "{said}");
        }
    }
}

/// Of `custom_heuristic`, without a GPU: with the definitions that such a shader gets for either size of tiles.
#[test]
fn the_shader_of_custom_heuristic_is_valid() {
    const NAME: &str = "custom_heuristic/foveated.wesl";
    let mut shaders = Shaders::load();
    shaders.add(NAME, include_str!("../assets/shaders/foveated.wesl").to_owned());
    let large = ["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"];
    let small = ["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH", "TILES_8"];
    for defs in [&large[..], &small[..]] {
        shaders.compile(NAME, defs).unwrap_or_else(|error| panic!("{error}"));
    }
}
