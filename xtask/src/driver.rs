//! A C++ compiler and a Vulkan driver for the commands that build and render: finds them, or installs them if possible.
//!
//! `driver.sh` does the work; a machine without a GPU gets Mesa's CPU driver. `GLINT_SKIP_DRIVER_CHECK=1` turns all of this off.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Result, ensure};

use crate::{environment, progress};

/// A command's needs of the driver.
#[derive(Clone, Copy)]
pub enum Need {
    /// Any Vulkan driver.
    Vulkan,
    /// Ray queries, if the driver is the CPU's. Without them tests of that tracer skip, which is a failure in CI.
    RayQuery,
    /// Any Vulkan driver, and Chromium.
    Browser,
}

/// Makes sure that there is a compiler and a driver.
pub fn prepare(need: Need) -> Result<()> {
    // Other systems include their graphics interfaces.
    if !cfg!(target_os = "linux") || environment::is_on("GLINT_SKIP_DRIVER_CHECK") {
        return Ok(());
    }
    progress::step("look for a C++ compiler and a Vulkan driver", || {
        run(&mut script(need, environment::is_ci(), Path::new("")))
    })
}

fn script(need: Need, strict: bool, root: &Path) -> Command {
    let (need, programs) = match need {
        Need::Vulkan => ("vulkan", ""),
        // Without the validator one test skips.
        Need::RayQuery => ("ray-query", if strict { "spirv-val:spirv-tools" } else { "" }),
        Need::Browser => ("vulkan", "chromium:chromium"),
    };
    let mut command = Command::new("sh");
    command.args(["-c", include_str!("driver.sh"), "driver.sh", need]);
    command.args([if strict { "1" } else { "" }, programs]).arg(root);
    command.stdin(Stdio::null()).stderr(Stdio::inherit());
    command
}

fn run(command: &mut Command) -> Result<()> {
    let output = command.output()?;
    let reason = String::from_utf8_lossy(&output.stdout);
    ensure!(output.status.success(), "{}", reason.trim());
    Ok(())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::fs;

    /// Debian 12 as root, without a GPU or a driver. Its programs write their arguments to a log.
    const MACHINE: &str = r#"
mkdir -p bin dev etc/apt/sources.list.d usr/share/vulkan/icd.d
echo 'Trusted: yes' >etc/apt/sources.list.d/mirror.sources
echo 'ID=debian PRETTY_NAME=Debian VERSION_CODENAME=bookworm' >etc/os-release
echo 22.3.6-1+deb12u1 >release
driver() { echo $1 >mesa; touch usr/share/vulkan/icd.d/lvp_icd.json; }
cat >program <<'END'
#!/bin/sh
root=${0%/bin/*}
echo "${0##*/} $*" >>$root/log
case "${0##*/} $*" in
  id*) cat $root/id 2>/dev/null || echo 0 ;;
  ldconfig*) echo ' libvulkan.so.1 (libc6,x86-64)' ;;
  dpkg-query*) cat $root/mesa ;;
  dpkg*) [ $2 != $4 ] && printf '%s\n' $2 $4 | sort -VC ;;
  apt-cache*) echo " Candidate: $(cat $root/release)" ;;
  *indextargets*) echo https://mirror.invalid/ ;;
  *SourceParts=*update) cat ${5#*=}/glint-backports.sources >>$root/log; [ ! -e $root/offline ] ;;
  *bookworm-backports*) echo 25.0.7-2~bpo12+1 >$root/mesa ;;
  *install*) cp $root/release $root/mesa ;;
esac
END
for name in c++ id ldconfig dpkg-query dpkg apt-cache apt-get spirv-val chromium; do install program bin/$name; done
"#;

    /// Runs the script after `change` was made to the machine. Returns its outcome, and the log of the programs.
    fn outcome(need: Need, strict: bool, change: &str) -> (Result<(), String>, String) {
        let machine = tempfile::tempdir().unwrap();
        let root = machine.path();
        let mut shell = Command::new("sh");
        shell.args(["-euc", &[MACHINE, change].concat()]).current_dir(root);
        assert!(shell.status().unwrap().success());
        let mut command = script(need, strict, root);
        let path = format!("{}/bin:/usr/bin:/bin", root.display());
        command.env_clear().env("PATH", path).stderr(Stdio::null());
        let result = run(&mut command).map_err(|error| error.to_string());
        let sources = fs::read_dir(root.join("etc/apt/sources.list.d")).unwrap();
        assert_eq!(sources.count(), 1, "a source was left behind");
        (result, fs::read_to_string(root.join("log")).unwrap())
    }

    #[test]
    fn nothing_is_installed_twice() {
        let gpu = "touch dev/nvidiactl usr/share/vulkan/icd.d/nvidia_icd.json";
        let (old, new) = ((Need::Vulkan, "driver 22.3"), (Need::RayQuery, "driver 24.1"));
        for (need, change) in [old, new, (Need::RayQuery, gpu)] {
            let (result, log) = outcome(need, true, change);
            assert!(result.is_ok() && !log.contains("apt-get"), "{log}");
        }
    }

    #[test]
    fn backports_are_a_source_of_one_installation() {
        for change in ["", "driver 22.3"] {
            let (result, log) = outcome(Need::RayQuery, true, change);
            assert_eq!(result, Ok(()), "{log}");
            let source = "URIs: https://mirror.invalid/\nSuites: bookworm-backports\nComponents: main\nSigned-By: ";
            let installs = "--target-release bookworm-backports mesa-vulkan-drivers";
            assert!(log.contains(source) && log.contains(installs), "{log}");
            assert!(!log.contains("Trusted"), "{log}");
        }
        let (result, log) = outcome(Need::RayQuery, true, "echo 25.2 >release");
        assert_eq!(result, Ok(()), "{log}");
        assert!(log.contains("install") && !log.contains("backports"), "{log}");
    }

    #[test]
    fn reasons_are_named() {
        for (change, reason) in [
            ("echo 1000 >id", "run this as root"),
            ("echo ID=fedora PRETTY_NAME=Fedora >etc/os-release", "Fedora is neither"),
            ("echo ID=ubuntu >etc/os-release", "this system has Mesa 22.3"),
            ("touch offline", "update` failed"),
        ] {
            let (result, _) = outcome(Need::RayQuery, true, change);
            assert!(result.clone().unwrap_err().contains(reason), "{result:?}");
            // A driver without ray queries is better than none.
            let (result, _) = outcome(Need::RayQuery, false, &format!("driver 22.3; {change}"));
            assert_eq!(result, Ok(()));
        }
        let (result, _) = outcome(Need::Vulkan, true, "touch offline");
        assert_eq!(result, Ok(()), "the release has a driver");
    }
}
