//! The demo with the compute shaders of DirectX: a Vulkan layer takes each from SPIR-V to HLSL and back, and gives it to the driver.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::json;

use super::temporary_folder;
use crate::{cargo, progress};

/// The layer's name. Vulkan asks for this form.
const LAYER: &str = "VK_LAYER_GLINT_hlsl";
/// Its library, beside the program of its package.
const LIBRARY: &str = "libglint_layer.so";
/// Options of the demo. Ray queries can't be read from SPIR-V.
const SCENE: &str = "--headless --scene demo --tracer bvh --backend compute --size 640x360 --frames 48";
/// Most of the mean FLIP between both images.
const LIMIT: f32 = 0.002;
/// Least number of shaders that go there and back: 41 of 54 did. The others can't be read from SPIR-V, or need constants that wgpu places.
const LEAST: usize = 40;

/// Renders the demo with both translations and compares the images. `slang` is the compiler's library.
pub fn compare(slang: &Path) -> Result<()> {
    let tool = cargo::program_apart("tools/roundtrip")?;
    let folder = temporary_folder()?.join("layer");
    _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder)?;
    let manifest = json!({
        "file_format_version": "1.2.0",
        "layer": {
            "name": LAYER,
            "type": "GLOBAL",
            "library_path": tool.with_file_name(LIBRARY),
            "api_version": "1.3.0",
            "implementation_version": "1",
            "description": "compute shaders by way of HLSL",
            "functions": {
                "vkGetInstanceProcAddr": "glint_get_instance_proc_addr",
                "vkGetDeviceProcAddr": "glint_get_device_proc_addr",
            },
        },
    });
    fs::write(folder.join("layer.json"), manifest.to_string())?;
    let (native, returned, log) = (folder.join("native.png"), folder.join("hlsl.png"), folder.join("log"));
    for image in [&native, &returned] {
        let mut viewer = cargo::program("glint_viewer")?;
        viewer.args(SCENE.split(' ')).arg("--out").arg(image);
        if image == &returned {
            viewer.env("VK_LAYER_PATH", &folder).env("VK_INSTANCE_LAYERS", LAYER);
            viewer.env("GLINT_LAYER_SLANG", slang).env("GLINT_LAYER_LOG", &log);
        }
        cargo::run(&mut viewer, "the demo")?;
    }
    let output = cargo::command(&tool).arg("flip").args([&native, &returned]).output()?;
    let printed = String::from_utf8_lossy(&output.stdout);
    let flip: f32 = printed.trim().parse().with_context(|| {
        let said = String::from_utf8_lossy(&output.stderr);
        format!("the images can't be compared: {}", said.trim())
    })?;
    let log = fs::read_to_string(&log).context("the layer wrote no log: Vulkan's loader didn't find it")?;
    let count = log.lines().filter(|line| line.starts_with("returned ")).count();
    let kept = log
        .lines()
        .filter(|line| line.starts_with("kept ") && !line.ends_with(": it draws"));
    kept.for_each(progress::note);
    progress::result(format_args!(
        "the demo with {count} compute shaders by way of HLSL: mean FLIP {flip:.5} (at most {LIMIT}); images in {}",
        folder.display()
    ));
    ensure!(
        count >= LEAST,
        "only {count} shaders went there and back, of at least {LEAST}"
    );
    ensure!(flip <= LIMIT, "the image differs by a mean FLIP of {flip:.5}");
    Ok(())
}
