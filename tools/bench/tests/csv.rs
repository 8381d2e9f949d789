//! Short measurements of a small scene and of a small crowd.

use std::{collections::HashMap, env, path::Path, process::Command};

/// Runs the program. Returns `None` without a graphics device, if that is allowed.
fn bench(arguments: &[&str]) -> Option<(bool, String)> {
    let output = Command::new(env!("CARGO_BIN_EXE_glint_bench"))
        .args(arguments)
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if said.contains("no graphics device was found") {
        let is_required = env::var_os("GLINT_REQUIRE_GPU").is_some();
        assert!(!is_required, "a GPU is required, but: {said}");
        println!("skipped");
        return None;
    }
    Some((output.status.success(), said))
}

/// Runs the program and reads its table: for each line the size, the subject, the measure and the value.
fn measured(name: &str, arguments: &str) -> Option<Vec<(String, String, String, f64)>> {
    let file = format!("{}/{name}.csv", env!("CARGO_TARGET_TMPDIR"));
    let (succeeded, said) = bench(&[&arguments.split(' ').collect::<Vec<_>>()[..], &["--csv", &file]].concat())?;
    assert!(succeeded, "{said}");
    let mut table = csv::Reader::from_path(&file).expect("there is a table");
    let lines = table.deserialize().map(|line| {
        let (_adapter, size, subject, _variant, measure, value, _unit): (String, _, _, String, _, _, String) =
            line.expect("it is well-formed, and values are numbers");
        (size, subject, measure, value)
    });
    Some(lines.collect())
}

#[test]
fn a_small_scene_is_measured() {
    let options = "--scene mirror_room --tracer bvh --techniques vrs-combined --size 64x36 --frames 2 --skip-build";
    let Some(lines) = measured("bench", options) else {
        return;
    };
    let mut values = HashMap::new();
    for (size, subject, measure, value) in lines {
        assert_eq!((&*size, &*subject), ("64x36", "mirror_room"));
        values.insert(measure, value);
    }
    // A ray for each pixel; the mirror below fills part of the image.
    let primary = values["primary_rays"];
    assert!((primary - 64.0 * 36.0).abs() < 0.5, "{primary} rays");
    let hits = values["primary_hits"];
    assert!(hits > 0.2 * primary && hits <= primary, "{hits} hits");
    // An exact mirror, which has a ray for each pixel.
    assert!(values["vrs-combined_mirror_rays"] > 0.1 * primary, "{values:?}");
    assert!(values["vrs-combined_memory"] > 30.0, "{values:?}");
    for pass in ["primary", "reflection", "vrs-combined_trace", "vrs-combined_total"] {
        assert!(values[&format!("{pass}_median")] > 0.0, "{pass}: {values:?}");
    }
}

#[test]
fn a_small_crowd_is_measured() {
    let options = "--crowds --characters 1 --only characters --tracer bvh --size 32x18 --frames 2";
    let Some(lines) = measured("crowd", options) else {
        return;
    };
    let values: HashMap<_, _> = lines
        .into_iter()
        .map(|(_, subject, measure, value)| (format!("{subject} {measure}"), value))
        .collect();
    // Static characters are posed once, before.
    assert!(values["1 characters, walking crowds_pose_gpu"] > 0.0, "{values:?}");
    assert!(
        !values.contains_key("1 characters, standing crowds_pose_gpu"),
        "{values:?}"
    );
    assert!(values["1 characters, rigid crowds_plugin_cpu"] > 0.0, "{values:?}");
}

#[test]
fn options_that_leave_nothing_to_measure_are_refused() {
    let combinations: [&[&str]; 4] = [
        &["--skip-rays", "--skip-build"],
        &["--skip-rays", "--growth"],
        &["--skip-rays", "--budget"],
        &["--worlds", "--only", "no such case"],
    ];
    for arguments in combinations {
        let Some((succeeded, said)) = bench(arguments) else {
            return;
        };
        let names_it = said.contains("cannot be used with") || said.contains("`no such case`");
        assert!(!succeeded && names_it, "{arguments:?}: {said}");
    }
}

#[test]
fn a_file_is_measured_from_a_place() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench_files");
    std::fs::create_dir_all(&folder).expect("a folder can be made");
    let [_, file] = glint_scenes::write_test_assets(&folder).expect("files can be written");
    let csv = folder.join("bench.csv");
    let (file, csv) = (file.to_string_lossy(), csv.to_string_lossy());
    let small = "--tracer bvh --techniques quarter --size 32x18 --frames 1 --skip-build";
    let small: Vec<_> = small.split(' ').collect();
    let of = |camera| [&small[..], &["--gltf", &file, "--csv", &csv, "--camera", camera]].concat();
    let Some((succeeded, said)) = bench(&of("0,2,4,0,0,0")) else {
        return;
    };
    assert!(succeeded, "{said}");
    let table = std::fs::read_to_string(&*csv).expect("there is a table");
    assert!(table.lines().any(|line| line.contains("quarter_rays")), "{table}");
    for wrong in [
        "",
        "1,2,3",
        "1,2,3,4,5,6,7",
        "1,2,3,a,5,6",
        "1,2,3,NaN,5,6",
        "1,2,3,1,2,3",
    ] {
        let (succeeded, said) = bench(&of(wrong)).expect("there is a device");
        assert!(!succeeded && said.contains("--camera"), "{wrong}: {said}");
    }
}
