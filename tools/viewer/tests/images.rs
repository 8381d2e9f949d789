//! The program as its users start it. On machines that can render, images with traced reflections must be closer to the
//! ground truth than images without.

use glint_scenes::SceneName;
use image::{RgbImage, imageops};
use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

const FOLDER: &str = env!("CARGO_TARGET_TMPDIR");
/// Two rows of two images.
const COMPARISON: [&str; 3] = ["--compare", "--size", "128x72"];
const FRAMES: [&str; 3] = ["--truth-frames", "24", "--frames=6"];
/// For scenes with small highlights: with fewer frames, noise hides the difference.
const MORE_FRAMES: [&str; 3] = ["--truth-frames", "96", "--frames=16"];

fn viewer(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_glint_viewer"))
        .args(arguments)
        .current_dir(FOLDER)
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .expect("the program starts")
}

/// Renders an image. Returns `None` (with the reason printed) if this machine can't.
#[track_caller]
fn render(name: &str, arguments: &[&str]) -> Option<RgbImage> {
    let file = format!("viewer-{name}.png");
    let path = Path::new(FOLDER).join(&file);
    _ = fs::remove_file(&path);
    let output = viewer(&[&["--headless", "--out", &file], arguments].concat());
    let said = String::from_utf8_lossy(&output.stderr) + String::from_utf8_lossy(&output.stdout);
    if said.contains("no graphics device was found") {
        assert!(
            env::var_os("GLINT_REQUIRE_GPU").is_none(),
            "a GPU is required, but: {said}"
        );
        println!("skipped: {name}");
        return None;
    }
    assert!(output.status.success(), "{name} ended with {}:\n{said}", output.status);
    assert!(!said.contains("ERROR bevy_glint"), "{name} logged an error:\n{said}");
    Some(image::open(&path).expect("the image can be read").to_rgb8())
}

/// Mean absolute difference of two images in steps of 8 bits.
fn difference(a: &RgbImage, b: &RgbImage) -> f32 {
    assert_eq!(a.dimensions(), b.dimensions());
    let differences = a.iter().zip(b.iter()).map(|(a, b)| f32::from(a.abs_diff(*b)));
    differences.sum::<f32>() / a.len() as f32
}

#[track_caller]
fn compare(name: &str, arguments: &[&str], error_off: f32) {
    compare_with(name, &[&FRAMES, arguments].concat(), error_off);
}

/// Compares the methods in four images; without reflections the error is `error_off` at least.
#[track_caller]
fn compare_with(name: &str, arguments: &[&str], error_off: f32) {
    let Some(image) = render(name, &[&COMPARISON, arguments].concat()) else {
        return;
    };
    let size = (image.width() / 2, image.height() / 2);
    let [off, screen_space, traced, truth] = [(0, 0), (1, 0), (0, 1), (1, 1)]
        .map(|(x, y)| imageops::crop_imm(&image, x * size.0, y * size.1, size.0, size.1).to_image());
    let [off, screen_space, traced] = [off, screen_space, traced].map(|image| difference(&image, &truth));
    println!("{name}: errors {off:.2} off, {screen_space:.2} screen space, {traced:.2} traced");
    assert!(off >= error_off, "{name}: without reflections the error is {off}");
    assert!(traced < 0.6 * off, "{name}: {traced} traced, {off} without reflections");
}

#[test]
fn demo() {
    compare("demo", &["--scene", "demo", "--detail", "0.25"], 2.0);
}

#[test]
#[ignore = "long: a large scene"]
fn atrium() {
    compare("atrium", &["--scene", "atrium", "--detail", "0.25"], 0.5);
}

#[test]
#[ignore = "long: a large scene"]
fn temple() {
    compare("temple", &["--scene", "temple", "--detail", "0.25"], 2.0);
}

#[test]
#[ignore = "long: a large scene"]
fn street() {
    compare("street", &["--scene", "street", "--detail", "0.25"], 2.0);
}

#[test]
fn shapes() {
    compare("shapes", &["--scene", "shapes", "--path", "0.25"], 2.0);
}

#[test]
#[ignore = "long: seven scenes"]
fn held_out() {
    for name in SceneName::HELD_OUT.map(SceneName::as_str) {
        let view = ["--scene", name, "--path", "0.25", "--detail", "0.25"];
        compare_with(name, &[&view[..], &MORE_FRAMES].concat(), 0.5);
    }
}

#[test]
fn file() {
    let file = write_gltf("viewer-file", None);
    compare("file", &[file.to_str().expect("the path is text")], 2.0);
}

/// A file with a missing or truncated image is shown without it; a file without its buffer is declined.
#[test]
fn incomplete_files() {
    let folder = Path::new(FOLDER);
    fs::write(folder.join("cut.png"), b"\x89PNG\r\n\x1a\n").expect("the image can be written");
    for (name, image) in [("viewer-missing", "nowhere.png"), ("viewer-cut", "cut.png")] {
        let file = write_gltf(name, Some(image));
        let arguments = [
            "--size",
            "96x54",
            "--frames",
            "2",
            file.to_str().expect("the path is text"),
        ];
        let Some(shown) = render(name, &arguments) else { return };
        let red = shown.pixels().filter(|pixel| pixel[0] > 2 * pixel[1].max(8)).count();
        assert!(red > 100, "{name}: {red} pixels show the wall");
    }
    let file = write_gltf("viewer-empty", None);
    fs::remove_file(folder.join("viewer-empty.bin")).expect("the buffer can be removed");
    let output = viewer(&[
        "--headless",
        "--out",
        "viewer-empty.png",
        file.to_str().expect("the path is text"),
    ]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success() && said.contains("error: an asset failed to load"),
        "{said}"
    );
}

#[test]
fn panel_and_debug_view() {
    let arguments = ["--scene", "mirror_room", "--size", "192x108", "--frames", "4"];
    let Some(plain) = render("plain", &arguments) else {
        return;
    };
    for (name, argument) in [("panel", "--panel"), ("view", "--view=shading-rates")] {
        let image = render(name, &[&arguments[..], &[argument]].concat()).expect("this machine renders");
        let found = difference(&plain, &image);
        println!("{name}: {found:.2}");
        assert!(found > 5.0, "{argument} changes the image by {found} alone");
    }
}

#[cfg(feature = "film")]
#[test]
#[ignore = "long: two apps, twelve frames each"]
fn films_show_both_sides() {
    const FRAMES: usize = 3;
    const SIZE: [usize; 2] = [64, 36];
    const GAP: usize = 4;
    let path = Path::new(FOLDER).join("viewer-film.webp");
    _ = fs::remove_file(&path);
    let output = viewer(&[
        "--headless",
        "--film",
        "3",
        "--size",
        "64x36",
        "--out",
        "viewer-film.webp",
    ]);
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains("no graphics device was found") {
        assert!(
            env::var_os("GLINT_REQUIRE_GPU").is_none(),
            "a GPU is required, but: {said}"
        );
        println!("skipped: film");
        return;
    }
    assert!(output.status.success(), "{said}");
    let bytes = fs::read(&path).expect("the film is written");
    let frames: Vec<_> = webp_animation::Decoder::new(&bytes)
        .expect("it is a film")
        .into_iter()
        .collect();
    assert_eq!(frames.len(), FRAMES);
    assert!(frames.is_sorted_by(|a, b| a.timestamp() < b.timestamp()));
    let width = 2 * SIZE[0] + GAP;
    for frame in &frames {
        assert_eq!(frame.dimensions(), (width as u32, SIZE[1] as u32));
    }
    // Left side, gap and right side of an image, as luminance.
    let sides = |frame: usize| {
        let mut sides = [const { Vec::new() }; 3];
        for (index, pixel) in frames[frame].data().chunks_exact(4).enumerate() {
            let column = index % width;
            let side = usize::from(column >= SIZE[0]) + usize::from(column >= SIZE[0] + GAP);
            sides[side].push((f32::from(pixel[0]) + f32::from(pixel[1]) + f32::from(pixel[2])) / 3.0);
        }
        sides
    };
    let mean = |a: &[f32]| a.iter().sum::<f32>() / a.len() as f32;
    let apart = |a: &[f32], b: &[f32]| mean(&a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>());
    let [first, last] = [sides(0), sides(FRAMES - 1)];
    println!(
        "both sides {:.2} apart, gap {:.1}",
        apart(&first[0], &first[2]),
        mean(&first[1])
    );
    assert!(mean(&first[1]) > 230.0, "the gap is white");
    assert!(apart(&first[0], &first[2]) > 5.0, "the right side has reflections");
    assert!(apart(&first[2], &last[2]) > 2.0, "the camera moves");
}

#[test]
fn wrong_arguments_are_named() {
    let folder = FOLDER;
    for (arguments, reason) in [
        (&["--scene", "nowhere"][..], "there is no scene named 'nowhere'"),
        (&["--technique", "best"], "choose one of: off, screen-space, reference"),
        (&["--size", "0x5"], "is not a size such as 1280x720"),
        (&["--frames", "0"], "0 is not in 1.."),
        (&["--compare"], "--headless"),
        (&["--scene", "demo", "a.glb"], "cannot be used with"),
        (&["missing.glb"], "cannot open 'missing.glb'"),
        (&["scene.obj"], "is not a .gltf or .glb file"),
        (&["--headless", "--out", "image.jpg"], "must end in .png"),
        #[cfg(target_os = "linux")]
        (&[], "there is no display"),
    ] {
        let output = viewer(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{arguments:?} in {folder}");
        assert!(
            said.starts_with("error: ") && said.contains(reason),
            "{arguments:?}: {said}"
        );
    }
}

/// A mirror on the ground and a red wall behind it, which can have a texture.
fn write_gltf(name: &str, image: Option<&str>) -> PathBuf {
    const CORNERS: [[f32; 3]; 8] = [
        [-2.0, 0.0, 2.0],
        [2.0, 0.0, 2.0],
        [2.0, 0.0, -2.0],
        [-2.0, 0.0, -2.0],
        [-2.0, 0.0, -2.0],
        [2.0, 0.0, -2.0],
        [2.0, 2.0, -2.0],
        [-2.0, 2.0, -2.0],
    ];
    const NORMALS: [[f32; 3]; 2] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    const INDICES: [u32; 6] = [0, 1, 2, 0, 2, 3];
    const GLTF: &str = r#"{
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [
            { "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 4, "material": 0 },
            { "attributes": { "POSITION": 2, "NORMAL": 3 }, "indices": 4, "material": 1 }
        ] }],
        "materials": [
            { "pbrMetallicRoughness": { "metallicFactor": 1.0, "roughnessFactor": 0.0 } },
            { "pbrMetallicRoughness": { TEXTURE "baseColorFactor": [0.8, 0.05, 0.05, 1.0], "metallicFactor": 0.0 } }
        ],
        IMAGES
        "accessors": [
            { "bufferView": 0, "byteOffset": 0, "componentType": 5126, "count": 4, "type": "VEC3",
              "min": [-2.0, 0.0, -2.0], "max": [2.0, 0.0, 2.0] },
            { "bufferView": 0, "byteOffset": 96, "componentType": 5126, "count": 4, "type": "VEC3" },
            { "bufferView": 0, "byteOffset": 48, "componentType": 5126, "count": 4, "type": "VEC3",
              "min": [-2.0, 0.0, -2.0], "max": [2.0, 2.0, -2.0] },
            { "bufferView": 0, "byteOffset": 144, "componentType": 5126, "count": 4, "type": "VEC3" },
            { "bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR" }
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 192 },
            { "buffer": 0, "byteOffset": 192, "byteLength": 24 }
        ],
        "buffers": [{ "byteLength": 216, "uri": "NAME.bin" }]
    }"#;
    let normals = NORMALS.iter().flat_map(|normal| [*normal; 4]);
    let floats = CORNERS.into_iter().chain(normals).flatten().flat_map(f32::to_le_bytes);
    let bytes: Vec<u8> = floats.chain(INDICES.into_iter().flat_map(u32::to_le_bytes)).collect();
    let folder = Path::new(FOLDER);
    fs::write(folder.join(format!("{name}.bin")), bytes).expect("the buffer can be written");
    let file = folder.join(format!("{name}.gltf"));
    let (texture, images) = image.map_or_else(Default::default, |image| {
        (
            r#""baseColorTexture": { "index": 0 },"#.to_owned(),
            format!(r#""textures": [{{ "source": 0 }}], "images": [{{ "uri": "{image}" }}],"#),
        )
    });
    let text = GLTF
        .replace("TEXTURE", &texture)
        .replace("IMAGES", &images)
        .replace("NAME", name);
    fs::write(&file, text).expect("the file can be written");
    file
}
