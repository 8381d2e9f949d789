//! Which Vulkan drivers this Linux machine has, told from files alone.
//!
//! A manifest is no proof: Mesa installs those of every GPU maker at once. A hardware driver counts when its library is
//! there and a device that it drives is too.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What was found.
#[derive(Debug, Default)]
pub struct Survey {
    /// Whether the Vulkan loader is installed.
    pub has_loader: bool,
    /// Manifest of a driver for a GPU of this machine.
    pub hardware: Option<PathBuf>,
    /// Manifest of a driver that renders on the CPU.
    pub cpu: Option<PathBuf>,
}

impl Survey {
    /// Looks around.
    pub fn take() -> Self {
        let libraries = Libraries::list();
        let devices = devices();
        let mut survey = Self {
            has_loader: libraries.has("libvulkan.so.1"),
            ..Self::default()
        };
        for manifest in manifests() {
            let Some(library) = fs::read_to_string(&manifest).ok().as_deref().and_then(library_path) else {
                continue;
            };
            if !libraries.has_for(&library, &manifest) {
                continue;
            }
            let maker = Maker::of_driver(&library);
            if maker == Maker::Cpu {
                survey.cpu.get_or_insert(manifest);
            } else if devices.iter().any(|device| maker.drives(*device)) {
                survey.hardware.get_or_insert(manifest);
            }
        }
        survey
    }

    /// Whether something can render.
    pub fn is_usable(&self) -> bool {
        self.has_loader && (self.hardware.is_some() || self.cpu.is_some())
    }

    /// What is missing, in words.
    pub fn missing(&self) -> &'static str {
        match (self.has_loader, self.hardware.is_some() || self.cpu.is_some()) {
            (false, false) => "neither the loader libvulkan.so.1 nor a driver is installed",
            (false, true) => "the loader libvulkan.so.1 is not installed",
            (true, _) => "no driver fits a device of this machine, and the CPU's is not installed",
        }
    }
}

/// Who makes a driver or a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Maker {
    Cpu,
    Amd,
    Intel,
    Nvidia,
    /// The graphics bridge of Windows' Linux subsystem.
    Windows,
    /// A device of a virtual machine, which seldom has Vulkan.
    Virtual,
    /// Phones, boards, and whatever comes next.
    Other,
}

impl Maker {
    fn of_driver(library: &str) -> Self {
        let name = library.rsplit('/').next().unwrap_or(library);
        let contains = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
        if contains(&["lvp", "swiftshader"]) {
            Self::Cpu
        } else if contains(&["nvidia", "nouveau", "GLX_nvidia", "EGL_nvidia"]) {
            Self::Nvidia
        } else if contains(&["radeon", "amdvlk"]) {
            Self::Amd
        } else if contains(&["intel"]) {
            Self::Intel
        } else if contains(&["dzn"]) {
            Self::Windows
        } else if contains(&["virtio", "gfxstream"]) {
            Self::Virtual
        } else {
            Self::Other
        }
    }

    /// The maker of a PCI device, from the `vendor` file of its folder; `None` for devices that aren't on PCI.
    fn of_device(vendor: Option<&str>) -> Self {
        match vendor.map(str::trim) {
            Some("0x1002" | "0x1022") => Self::Amd,
            Some("0x8086") => Self::Intel,
            Some("0x10de") => Self::Nvidia,
            // virtio, VMware, QEMU, VirtualBox, Parallels
            Some("0x1af4" | "0x15ad" | "0x1234" | "0x80ee" | "0x1ab8") => Self::Virtual,
            _ => Self::Other,
        }
    }

    /// Whether this driver makes that device render without doubt.
    fn drives(self, device: Self) -> bool {
        self == device && !matches!(self, Self::Cpu | Self::Virtual)
    }
}

/// The makers of the GPUs that programs may use here.
fn devices() -> Vec<Maker> {
    let mut devices = Vec::new();
    if Path::new("/dev/nvidiactl").exists() {
        devices.push(Maker::Nvidia);
    }
    if Path::new("/dev/dxg").exists() {
        devices.push(Maker::Windows);
    }
    for entry in fs::read_dir("/dev/dri").into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with("renderD") {
            let vendor = fs::read_to_string(format!("/sys/class/drm/{name}/device/vendor")).ok();
            devices.push(Maker::of_device(vendor.as_deref()));
        }
    }
    devices
}

/// Every driver manifest in the places where the loader looks, in a fixed order.
fn manifests() -> Vec<PathBuf> {
    let home = |name: &str, fallback: &str| {
        env::var_os(name)
            .map(PathBuf::from)
            .or_else(|| env::var_os("HOME").map(|home| Path::new(&home).join(fallback)))
    };
    let data = env::var("XDG_DATA_DIRS").ok().filter(|list| !list.is_empty());
    let data = data.unwrap_or_else(|| "/usr/local/share:/usr/share".into());
    let folders = home("XDG_CONFIG_HOME", ".config")
        .into_iter()
        .chain(["/etc/xdg", "/usr/local/etc", "/etc"].map(PathBuf::from))
        .chain(home("XDG_DATA_HOME", ".local/share"))
        .chain(data.split(':').map(PathBuf::from));
    let mut manifests = Vec::new();
    for folder in folders {
        let entries = fs::read_dir(folder.join("vulkan/icd.d"))
            .into_iter()
            .flatten()
            .flatten();
        let mut found: Vec<_> = entries.map(|entry| entry.path()).collect();
        found.retain(|path| path.extension().is_some_and(|end| end == "json"));
        found.sort();
        manifests.extend(found);
    }
    manifests
}

/// The value of `library_path` in a manifest.
fn library_path(manifest: &str) -> Option<String> {
    let (_, rest) = manifest.split_once("\"library_path\"")?;
    let rest = rest.trim_start().strip_prefix(':')?.trim_start().strip_prefix('"')?;
    rest.split_once('"').map(|(path, _)| path.to_owned())
}

/// The shared libraries that the dynamic linker knows.
struct Libraries {
    /// What the linker's cache lists; `None` where it can't be asked.
    cache: Option<String>,
    folders: Vec<PathBuf>,
}

impl Libraries {
    fn list() -> Self {
        let cache = ["/sbin/ldconfig", "/usr/sbin/ldconfig", "ldconfig"]
            .into_iter()
            .find_map(|program| {
                let output = Command::new(program).arg("-p").output().ok()?;
                output
                    .status
                    .success()
                    .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
            });
        let path = env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
        Self {
            cache,
            folders: env::split_paths(&path).collect(),
        }
    }

    /// Whether a library can be loaded by its name.
    fn has(&self, name: &str) -> bool {
        let Some(cache) = &self.cache else {
            // Nothing to ask: better to try and see than to refuse.
            return true;
        };
        let architecture = if cfg!(target_arch = "x86_64") { "x86-64" } else { "" };
        cache.lines().any(|line| {
            line.trim_start()
                .strip_prefix(name)
                .is_some_and(|rest| rest.starts_with(" (") && rest.contains(architecture))
        }) || self.folders.iter().any(|folder| folder.join(name).exists())
    }

    /// Whether the library of a manifest can be loaded: it is a name, an absolute path, or one relative to the manifest.
    fn has_for(&self, library: &str, manifest: &Path) -> bool {
        if library.contains('/') {
            manifest.parent().is_some_and(|folder| folder.join(library).exists())
        } else {
            self.has(library)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manifests_name_their_library() {
        let manifest = "{ \"ICD\": { \"api_version\": \"1.4.305\",\n \"library_path\" : \"libvulkan_lvp.so\" } }";
        assert_eq!(library_path(manifest).as_deref(), Some("libvulkan_lvp.so"));
        assert_eq!(library_path("{}"), None);
        assert_eq!(library_path("{\"library_path\": 3}"), None);
    }

    #[test]
    fn a_driver_counts_only_with_its_device() {
        let driver = Maker::of_driver;
        assert_eq!(driver("/usr/lib/x86_64-linux-gnu/libvulkan_lvp.so"), Maker::Cpu);
        assert!(driver("libvulkan_radeon.so").drives(Maker::of_device(Some("0x1002\n"))));
        assert!(driver("libvulkan_intel_hasvk.so").drives(Maker::of_device(Some("0x8086\n"))));
        assert!(driver("libGLX_nvidia.so.0").drives(Maker::Nvidia));
        assert!(driver("libvulkan_broadcom.so").drives(Maker::of_device(None)));
        assert!(!driver("libvulkan_radeon.so").drives(Maker::of_device(Some("0x8086\n"))));
        assert!(!driver("libvulkan_virtio.so").drives(Maker::of_device(Some("0x1af4\n"))));
        assert!(!driver("libvulkan_lvp.so").drives(Maker::Cpu));
    }

    #[test]
    fn the_linker_cache_is_read_by_whole_names() {
        let cache =
            "\tlibvulkan.so.1 (libc6,x86-64,AArch64) => /usr/lib/libvulkan.so.1\n\tlibfoo.so.12 (libc6,x86-64) => /x\n";
        let libraries = Libraries {
            cache: Some(cache.into()),
            folders: Vec::new(),
        };
        assert!(libraries.has("libvulkan.so.1"));
        assert!(!libraries.has("libvulkan.so"));
        assert!(!libraries.has("libfoo.so.1"));
    }
}
