//! Time of the plugin on the render thread and in extraction, in worlds that are large or that change.
//!
//! Each system of the plugin is timed separately, so neither Bevy's own work nor the GPU's is counted. Images are tiny, and the GPU is
//! idle when a frame begins, so that a CPU driver doesn't render during the measurement.

mod setup;

use crate::table::{Csv, number};
use bevy_glint::{ReflectionTracer, ReflectionTracerChoice};
pub use setup::SIZE;
use setup::{COARSE, Change, FINE, Round, Setup, World};
use std::collections::BTreeMap;

const INSTANCES: usize = 100_000;
const MOVERS: usize = 10_000;
const MOVING_LIGHTS: usize = 100;
const MATERIALS: usize = 10_000;
const IN_A_CHUNK: usize = 13_100;
/// Spheres of 20 triangles each, all of which share one merged tree.
const MERGED: usize = 40_000;
const TINY: u32 = 0;
/// Objects with a level of detail.
const RANGED: usize = 50_000;
const SEE_THROUGH: usize = 20_000;
const FLICKERING_LIGHTS: usize = 10;

/// One row of the table.
struct Case {
    name: &'static str,
    world: World,
    change: Change,
    /// Milliseconds.
    limit: Option<f64>,
}

const CASES: [Case; 20] = [
    Case {
        name: "one static instance",
        world: World::Spheres(1, FINE),
        change: Change::Nothing,
        limit: None,
    },
    Case {
        name: "100,000 static instances",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Nothing,
        limit: Some(0.1),
    },
    Case {
        name: "one of 100,000 moves",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Objects(1),
        limit: Some(0.3),
    },
    Case {
        name: "10,000 of 100,000 move",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Objects(MOVERS),
        limit: Some(2.5),
    },
    Case {
        name: "the material of 6,250 of 100,000 changes",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Material,
        limit: None,
    },
    Case {
        name: "one of 10,000 materials changes",
        world: World::Materials(MATERIALS),
        change: Change::Material,
        limit: None,
    },
    Case {
        name: "one of 10,000 materials changes beside one with a shader",
        world: World::Stylised(MATERIALS),
        change: Change::Material,
        limit: None,
    },
    Case {
        name: "first touch of an object in a chunk of 1 M triangles",
        world: World::Spheres(IN_A_CHUNK, COARSE),
        change: Change::Touch,
        limit: Some(1.0),
    },
    Case {
        name: "1,000 lights, 100 of them moving",
        world: World::Lights,
        change: Change::Lights(MOVING_LIGHTS),
        limit: Some(0.3),
    },
    Case {
        name: "1,000 lights, 10 of them flickering",
        world: World::Lights,
        change: Change::Flicker(FLICKERING_LIGHTS),
        limit: Some(0.3),
    },
    Case {
        name: "a light with layers comes or goes among 100,000",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Flash,
        limit: Some(0.3),
    },
    Case {
        name: "one blended material of 100,000 fades",
        world: World::Haunted(INSTANCES),
        change: Change::Fade,
        limit: Some(0.3),
    },
    Case {
        name: "one mesh of 100,000 is edited",
        world: World::Haunted(INSTANCES),
        change: Change::Edit,
        limit: Some(0.3),
    },
    Case {
        name: "the camera moves among 50,000 levels of detail",
        world: World::Ranged(RANGED),
        change: Change::Camera,
        limit: Some(0.3),
    },
    Case {
        name: "20,000 see-through objects out of sight",
        world: World::SeeThrough(SEE_THROUGH),
        change: Change::Nothing,
        limit: Some(0.3),
    },
    Case {
        name: "10,000 merged objects are shifted by one vector",
        world: World::Spheres(MERGED / 4, TINY),
        change: Change::Shift,
        limit: Some(5.0),
    },
    Case {
        name: "20,000 merged objects are shifted by one vector",
        world: World::Spheres(MERGED / 2, TINY),
        change: Change::Shift,
        limit: Some(2.0),
    },
    Case {
        name: "40,000 merged objects are shifted by one vector",
        world: World::Spheres(MERGED, TINY),
        change: Change::Shift,
        limit: Some(5.0),
    },
    Case {
        name: "40,000 merged objects are merged anew",
        world: World::Spheres(MERGED, TINY),
        change: Change::Merge,
        limit: Some(5.0),
    },
    Case {
        name: "an explosion moves 10,000 of 40,000 merged objects",
        world: World::Spheres(MERGED, TINY),
        change: Change::Explosion(MERGED / 4),
        limit: Some(5.0),
    },
];

/// Measures and prints the cases with `only` in their names.
///
/// # Errors
///
/// If rays can't be traced, or a world doesn't become static.
pub fn measure(
    tracers: &[ReflectionTracerChoice],
    rounds: u32,
    only: Option<&str>,
    csv: &mut Csv,
) -> Result<(), String> {
    for &tracer in tracers {
        // Several cases use a world one after the other, since large ones take long to load.
        let mut last: Option<(World, Setup)> = None;
        let mut heading = false;
        for case in CASES
            .iter()
            .filter(|case| only.is_none_or(|word| case.name.contains(word)))
        {
            let mut setup = match last.take() {
                Some((world, setup)) if world == case.world => setup,
                _ => Setup::new(tracer, case.world)?,
            };
            let word = match setup.report().tracer {
                Some(ReflectionTracer::RayQuery) => "ray-query",
                Some(ReflectionTracer::Bvh) => "bvh",
                None => return Err(format!("rays can't be traced: {}", setup.report().reasons.join(". "))),
            };
            if tracer == ReflectionTracerChoice::RayQuery && word != "ray-query" {
                println!("{}.", setup.report().reasons.join(". "));
                break;
            }
            if !heading {
                heading = true;
                let adapter = setup.report().adapter;
                println!("\nTracer {word} on {adapter}: CPU time of the plugin's systems, mean of {rounds} rounds.\n");
                println!(
                    "| case | scene ms | 95 % interval | all ms | 95 % interval | worst frame | at most | most of it |"
                );
                println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |");
            }
            let measured = setup.measure(case.change, rounds)?;
            print_row(case, word, &measured, csv);
            last = Some((case.world, setup));
        }
    }
    Ok(())
}

fn print_row(case: &Case, tracer: &str, rounds: &[Round], csv: &mut Csv) {
    let measures: [(&str, fn(&Round) -> f64); 2] = [("scene", |round| round.scene), ("all", |round| round.all)];
    let mut cells = Vec::new();
    for (word, of) in measures {
        let (mean, half) = interval(&rounds.iter().map(of).collect::<Vec<_>>());
        cells.push(format!("{mean:.3} | {:.3} to {:.3}", mean - half, mean + half));
        csv.add(case.name, tracer, &format!("worlds_{word}"), mean, "ms");
        csv.add(case.name, tracer, &format!("worlds_{word}_half_interval"), half, "ms");
    }
    let worst = rounds.iter().fold(0.0, |worst: f64, round| worst.max(round.worst));
    csv.add(case.name, tracer, "worlds_worst_frame", worst, "ms");
    let mut systems = BTreeMap::<&str, f64>::new();
    for (name, milliseconds) in rounds.iter().flat_map(|round| &round.systems) {
        *systems.entry(name).or_default() += milliseconds / rounds.len() as f64;
    }
    let mut systems: Vec<_> = systems.into_iter().collect();
    systems.sort_by(|a, b| b.1.total_cmp(&a.1));
    let short = |name: &str| name.rsplit("::").next().unwrap_or(name).to_owned();
    let most: Vec<String> = systems
        .iter()
        .take(4)
        .map(|(name, milliseconds)| format!("{} {milliseconds:.3}", short(name)))
        .collect();
    println!(
        "| {} | {} | {worst:.3} | {} | {} |",
        case.name,
        cells.join(" | "),
        number(case.limit, 1),
        most.join(", "),
    );
    for (name, milliseconds) in systems {
        csv.add(
            case.name,
            tracer,
            &format!("worlds_{}", short(name)),
            milliseconds,
            "ms",
        );
    }
}

/// Mean, and half of its 95 % interval by Student's distribution.
pub fn interval(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let freedom = count - 1.0;
    if freedom < 1.0 {
        return (mean, f64::INFINITY);
    }
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / freedom;
    // The quantile of the normal distribution, and the first terms of its expansion for few degrees of freedom.
    let z: f64 = 1.959_964;
    let t = z
        + (z.powi(3) + z) / (4.0 * freedom)
        + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * freedom * freedom);
    (mean, t * (variance / count).sqrt())
}
