//! Short measurements of a small scene and of a small crowd.

use std::{collections::HashMap, env, path::Path, process::Command};

#[test]
fn a_small_scene_is_measured() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench.csv");
    let output = Command::new(env!("CARGO_BIN_EXE_glint_bench"))
        .args([
            "--scene",
            "mirror_room",
            "--tracer",
            "bvh",
            "--techniques",
            "vrs-combined",
        ])
        .args(["--size", "64x36", "--frames", "2", "--skip-build", "--csv"])
        .arg(&file)
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains("no graphics device was found") {
        assert!(
            env::var_os("GLINT_REQUIRE_GPU").is_none(),
            "a GPU is required, but: {said}"
        );
        println!("skipped");
        return;
    }
    assert!(output.status.success(), "{}:\n{said}", output.status);

    let mut values = HashMap::new();
    for record in csv::Reader::from_path(&file).expect("there is a table").records() {
        let record = record.expect("it is well-formed");
        assert_eq!((&record[1], &record[2]), ("64x36", "mirror_room"));
        let value: f64 = record[5].parse().expect("values are numbers");
        values.insert(record[4].to_owned(), value);
    }
    // A ray for each pixel; the mirror below fills part of the image.
    let primary = values["primary_rays"];
    assert!((primary - 64.0 * 36.0).abs() < 0.5, "{primary} rays");
    let hits = values["primary_hits"];
    assert!(hits > 0.2 * primary && hits <= primary, "{hits} hits");
    // An exact mirror, which has a ray for each pixel.
    assert!(values["vrs-combined_mirror_rays"] > 0.1 * primary, "{values:?}");
    assert!(values["vrs-combined_memory"] > 30.0, "{values:?}");
    for time in [
        "primary_median",
        "reflection_median",
        "vrs-combined_trace_median",
        "vrs-combined_total_median",
    ] {
        assert!(values[time] > 0.0, "{time}: {values:?}");
    }
}

#[test]
fn a_small_crowd_is_measured() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("crowd.csv");
    let output = Command::new(env!("CARGO_BIN_EXE_glint_bench"))
        .args([
            "--crowds",
            "--characters",
            "1",
            "--only",
            "characters",
            "--tracer",
            "bvh",
        ])
        .args(["--size", "32x18", "--frames", "2", "--csv"])
        .arg(&file)
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains("no graphics device was found") {
        assert!(
            env::var_os("GLINT_REQUIRE_GPU").is_none(),
            "a GPU is required, but: {said}"
        );
        println!("skipped");
        return;
    }
    assert!(output.status.success(), "{}:\n{said}", output.status);
    let mut values = HashMap::new();
    for record in csv::Reader::from_path(&file).expect("there is a table").records() {
        let record = record.expect("it is well-formed");
        let value: f64 = record[5].parse().expect("values are numbers");
        values.insert(format!("{} {}", &record[2], &record[4]), value);
    }
    // Static characters are posed once, before.
    assert!(values["1 characters, walking crowds_pose_gpu"] > 0.0, "{values:?}");
    assert!(
        !values.contains_key("1 characters, standing crowds_pose_gpu"),
        "{values:?}"
    );
    assert!(values["1 characters, rigid crowds_plugin_cpu"] > 0.0, "{values:?}");
}

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
    let small = [
        "--tracer",
        "bvh",
        "--techniques",
        "quarter",
        "--size",
        "32x18",
        "--frames",
        "1",
        "--skip-build",
    ];
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
