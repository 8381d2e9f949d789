//! `cargo xtask validate`: each technique and the raw Vulkan pass under Vulkan's validation layers, with synchronisation validation.
//!
//! CPU drivers execute commands one after the other, so their images don't show a missing barrier.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Result, bail, ensure};

use crate::driver::{self, Need};
use crate::test::TRACER;
use crate::{cargo, progress};

const LAYER: &str = "VK_LAYER_KHRONOS_validation";
const MANIFEST: &str = "vulkan/explicit_layer.d/VkLayer_khronos_validation.json";

/// Settings of the layer. Messages go to stdout, since each Vulkan instance would start a new file.
const SETTINGS: &str = "khronos_validation.debug_action = VK_DBG_LAYER_ACTION_LOG_MSG
khronos_validation.report_flags = error,warn
khronos_validation.log_filename = stdout
khronos_validation.enables = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT
khronos_validation.enable_message_limit = true
khronos_validation.duplicate_message_limit = 4
";

/// Tests of the library that compare all ways to trace the same rays: the fragment shader, the compute shader and the raw Vulkan pass.
const TESTS: &str = "back_ends::";
/// Techniques that the bench renders in addition.
const BENCH: &str = "--skip-build --scene=atrium --detail=0.25 --size=64x64 --frames=1 --tracer=all --csv=/dev/null --triangles=100 \
    --rounds=2 \
    --techniques=reference,quarter,quarter-inline,vrs-roughness,vrs-grazing,vrs-combined,vrs-adaptive,paper,converged";

/// Messages that this crate doesn't cause: their names, a part of their text, and the reason.
const EXPLAINED: [(&str, &str, &str); 2] = [
    (
        "VUID-VkDeviceCreateInfo-pNext-pNext",
        "unknown VkStructureType",
        "wgpu asks for features that are younger than the layer",
    ),
    (
        "VUID_Undefined",
        "is not supported by this layer",
        "wgpu asks for extensions that are younger than the layer",
    ),
];

/// Renders under the layer, and fails if the layer reports an unexplained message.
pub fn run() -> Result<()> {
    driver::prepare(Need::RayQuery)?;
    let mut folders = ["/usr/share", "/usr/local/share", "/etc"].iter();
    ensure!(
        folders.any(|folder| Path::new(folder).join(MANIFEST).exists()),
        "the validation layer isn't installed: on Debian and Ubuntu, `apt-get install vulkan-validationlayers`"
    );
    let folder = tempfile::tempdir()?;
    let settings = folder.path().join("vk_layer_settings.txt");
    fs::write(&settings, SETTINGS)?;
    let mut tests = progress::step("build of the tests", || cargo::test_program("app"))?;
    tests
        .args([TESTS, "--nocapture", "--test-threads=1"])
        .env(TRACER, "all");
    let mut bench = progress::step("build glint_bench", || cargo::program("glint_bench"))?;
    bench.args(BENCH.split(' '));
    let mut messages = Messages::default();
    for (name, command) in [("tests of all back ends", &mut tests), ("techniques", &mut bench)] {
        progress::step(name, || messages.collect(command, &settings))?;
    }
    messages.judge()
}

/// Messages of the layer: the number of each, by name and beginning.
#[derive(Default)]
struct Messages(BTreeMap<String, u32>);

impl Messages {
    fn collect(&mut self, command: &mut Command, settings: &Path) -> Result<()> {
        let output = command
            .env("VK_INSTANCE_LAYERS", LAYER)
            .env("VK_LAYER_SETTINGS_PATH", settings)
            .env("VK_LOADER_DEBUG", "layer")
            .output()?;
        let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        if !output.status.success() {
            let program = command.get_program().display();
            bail!("{program} failed ({})\n{}", output.status, said.join("\n"));
        }
        ensure!(
            said.iter().any(|said| said.contains(&format!("\"{LAYER}\""))),
            "the Vulkan loader didn't load the layer"
        );
        said.iter().for_each(|said| self.read(said));
        Ok(())
    }

    /// Lines such as `UNASSIGNED-x(ERROR / SPEC): msgNum: 1 - Validation Error: [ UNASSIGNED-x ] Object 0: ... | MessageID = 0x1 | text`.
    /// The first one of a test follows the test's name.
    fn read(&mut self, said: &str) {
        for line in said.lines().filter(|line| line.contains(" msgNum: ")) {
            let name = line.split('(').next().and_then(|before| before.rfind(' '));
            let message = &line[name.map_or(0, |space| space + 1)..];
            *self.0.entry(message.to_owned()).or_default() += 1;
        }
    }

    fn judge(&self) -> Result<()> {
        let mut faults = 0;
        for (line, count) in &self.0 {
            let explained = EXPLAINED
                .iter()
                .find(|(name, words, _)| line.starts_with(name) && line.contains(words));
            if let Some((name, _, reason)) = explained {
                progress::note(format_args!("{count} x {name}: {reason}"));
            } else {
                faults += 1;
                progress::say(format_args!("{count} x {line}"));
            }
        }
        ensure!(faults == 0, "the validation layer found {faults} kind(s) of faults");
        progress::result("the validation layer found no fault");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_explained_messages_pass() {
        let explained = "VUID_Undefined(WARN / SPEC): msgNum: 2044605652 - Validation Warning: [ VUID_Undefined ] Object 0: \
            handle = 0x1 | MessageID = 0x79de34d4 | Device Extension VK_KHR_x is not supported by this layer.  Using this";
        let hazard = "SYNC-HAZARD-READ-AFTER-WRITE(ERROR / SPEC): msgNum: -455515022 - Validation Error: \
            [ SYNC-HAZARD-READ-AFTER-WRITE ] Object 0: handle = 0x1 | MessageID = 0xe4d96472 | vkCmdDispatch: Hazard";
        let judge = |said: &str| {
            let mut messages = Messages::default();
            messages.read(said);
            messages.judge().map_err(|error| error.to_string())
        };
        assert_eq!(judge("test a ... ok\n    Objects: 1\n"), Ok(()));
        assert_eq!(judge(&format!("{explained}\n    Objects: 1\n{explained}")), Ok(()));
        assert_eq!(judge(&format!("test a ... {explained}")), Ok(()));
        assert!(judge(&format!("{explained}\n{hazard}\n{hazard}")).is_err_and(|error| error.contains("1 kind")));
        // One name with different texts.
        assert!(judge(&explained.replace("supported", "allowed")).is_err());
    }
}
