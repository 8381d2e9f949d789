//! The command line, and the jobs that it makes.

use super::*;

fn machine(ray_query: bool, hardware_vrs: bool) -> Machine {
    Machine {
        adapter: "GPU".into(),
        ray_query,
        hardware_vrs,
        ..Machine::default()
    }
}

fn arguments(line: &str) -> Arguments {
    let start = ["glint_evaluate", "--out", "out"];
    Arguments::try_parse_from(start.into_iter().chain(line.split_whitespace())).unwrap()
}

#[test]
fn the_command_line_is_well_formed() {
    use clap::CommandFactory;
    Arguments::command().debug_assert();
    assert!(Arguments::try_parse_from(["glint_evaluate", "--quick"]).is_err());
    assert!(Arguments::try_parse_from(["glint_evaluate", "--out", "a", "--size", "8x16"]).is_err());
    assert!(Arguments::try_parse_from(["glint_evaluate", "--probe"]).is_ok());
}

#[test]
fn everything_is_measured_by_default() {
    let plan = arguments("").plan(&machine(true, true)).unwrap();
    // Three scenes, each with its own job and one for Solari, if that is built in.
    let scenes = plan.jobs.iter().filter(|job| job.first).count();
    assert_eq!(scenes, 3);
    let ids: Vec<String> = plan.jobs[0].variants.iter().map(Variant::id).collect();
    assert!(ids.contains(&"vrs-roughness".into()) && ids.contains(&"vrs-roughness.hardware".into()));
    assert!(!ids.contains(&"reference.hardware".into()) && !ids.contains(&"solari".into()));
    assert_eq!(plan.jobs.len() + plan.skipped.len(), 6);
}

#[test]
fn held_out_scenes_have_their_own_defaults() {
    let plan = arguments("--held-out").plan(&machine(true, false)).unwrap();
    let scenes: Vec<String> = plan.jobs.iter().map(|job| job.scene.name()).collect();
    assert_eq!(scenes, SceneName::HELD_OUT.map(|scene| scene.to_string()));
    assert!(!scenes.iter().any(|scene| SCENES.contains(&scene.as_str())));
    // At least ten views.
    assert_eq!((plan.protocol.views, plan.skipped.len()), (2, 0));
    for job in &plan.jobs {
        assert_eq!(job.variants, HELD_OUT_TECHNIQUES.map(Variant::new));
    }
    let words = "--held-out --scene pond --techniques low --views 3";
    let plan = arguments(words).plan(&machine(true, false)).unwrap();
    assert_eq!((plan.jobs.len(), plan.protocol.views), (1, 3));
    assert_eq!(plan.jobs[0].variants, [Variant::new("low")]);
}

#[test]
fn what_a_machine_lacks_is_skipped_or_refused() {
    let plan = arguments("--scene atrium").plan(&machine(false, false)).unwrap();
    assert_eq!((plan.jobs.len(), plan.skipped.len()), (1, 1));
    assert_eq!(plan.jobs[0].tracer, TracerName::Bvh);
    for missing in ["--tracer ray-query", "--backend hardware"] {
        assert!(arguments(missing).plan(&machine(false, false)).is_err(), "{missing}");
    }
}

#[test]
fn cameras_are_views_of_one_scene() {
    let cameras = "--camera 0,1,2,0,0,0 --camera=-1,1,2,0,0,0";
    let plan = arguments(&format!("{cameras} --scene atrium"))
        .plan(&machine(true, false))
        .unwrap();
    assert_eq!((plan.protocol.views, plan.protocol.still_views), (2, 2));
    assert_eq!(plan.protocol.cameras, ["0,1,2,0,0,0", "-1,1,2,0,0,0"]);
    let fails = |words: &str| arguments(words).plan(&machine(true, false)).unwrap_err();
    assert!(fails(&format!("{cameras} --scene atrium --views 1")).contains("2 cameras are 2 views"));
    assert!(fails(cameras).contains("belong to one scene"));
    assert!(Arguments::try_parse_from(["glint_evaluate", "--out", "a", "--camera", "1,2,3"]).is_err());
    let error = fails("--scene atrium --path /no/such/path.txt");
    assert!(
        error.contains("/no/such/path.txt can't be read") && error.lines().count() == 1,
        "{error}"
    );
}

#[test]
fn decomposing_takes_runs() {
    let plan = |words: &str| arguments(words).plan(&machine(true, false));
    let least = plan("--decompose --quick").unwrap().protocol;
    assert_eq!((least.decompose, least.runs), (true, DECOMPOSING_RUNS));
    assert_eq!(plan("--decompose --runs 8").unwrap().protocol.runs, 8);
    let error = plan("--decompose --runs 2").unwrap_err();
    assert!(error.contains("at least 4 runs"), "{error}");
}

#[test]
fn a_quick_run_on_a_cpu_has_solari_beside_the_bvh() {
    let cpu = Machine {
        is_cpu: true,
        ..machine(true, false)
    };
    let plan = arguments("--quick --scene atrium").plan(&cpu).unwrap();
    assert_eq!(plan.jobs[0].tracer, TracerName::Bvh);
    let names: Vec<String> = plan.jobs[0].variants.iter().map(Variant::id).collect();
    let expected = "off ssr reference quarter vrs-roughness vrs-grazing vrs-combined vrs-adaptive paper medium";
    assert_eq!(names.join(" "), expected);
    assert_eq!(plan.jobs[1].tracer, TracerName::RayQuery);
    assert_eq!(plan.jobs[1].variants, [Variant::new("solari")]);
    let asked = arguments("--quick --tracer ray-query").plan(&cpu).unwrap();
    assert_eq!(asked.jobs[0].tracer, TracerName::RayQuery);
    let full = arguments("").plan(&cpu).unwrap();
    assert_eq!(full.jobs[0].tracer, TracerName::RayQuery);
}

#[test]
fn a_second_tracer_leaves_out_what_does_not_trace() {
    let words = "--tracer all --scene atrium,street --techniques off,ssr,quarter";
    let plan = arguments(words).plan(&machine(true, false)).unwrap();
    let counts: Vec<usize> = plan.jobs.iter().map(|job| job.variants.len()).collect();
    assert_eq!(counts, [3, 1, 3, 1]);
    assert_eq!(plan.jobs[1].id(), "atrium.bvh");
}

#[test]
fn numbers_change_the_protocol() {
    let words = "--quick --size 64x32 --frames 7 --views 1 --samples 3";
    let protocol = arguments(words).plan(&machine(false, false)).unwrap().protocol;
    assert_eq!((protocol.width, protocol.height, protocol.samples), (64, 32, 3));
    assert_eq!((protocol.views, protocol.still_views), (1, 1));
    assert!(protocol.rounds() * protocol.block >= 7 && protocol.rounds() >= 4);
}

#[test]
fn wrong_names_are_named() {
    let error = |words: &str| arguments(words).plan(&machine(true, true)).unwrap_err();
    assert!(error("--techniques magic").contains("magic"));
    assert!(error("--scene atrium,atrium").contains("atrium"));
    assert!(error("--gltf /no/such.glb").contains("/no/such.glb"));
}
