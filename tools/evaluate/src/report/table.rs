//! Makes rows from the state of jobs.

use super::{
    decomposition,
    dominance::{mean_error, to_text},
    light_bias::{light_bias, light_floor},
    objects,
    rows::{Outcome, Row, columns, scenes, significant},
    tables::Tables,
};
use crate::{
    compare::{log::ComparisonLog, pool::Problems, score::ViewErrors},
    files::read_json,
    job::{Job, Variant},
    machine::Machine,
    state::{FRAME, LIGHTING, RAYS, Round, SceneFacts, ShownSums, Store, TOTAL, TrueSums},
    stats::{mean, median_interval, paired_ratio, quantile},
};
use std::{collections::BTreeMap, path::Path};

/// Digits of the values in files.
const DIGITS: i32 = 5;

/// The tables of a job. `failure` is the reason why the whole job ended early, if it did, and `problems` lists the images that could not be
/// compared.
pub fn of_job(job: &Job, machine: &Machine, log: &ComparisonLog, failure: Option<&str>, problems: &Problems) -> Tables {
    let store = Store::new(job);
    let rounds: Vec<Round> = (0..job.protocol.rounds())
        .filter_map(|round| read_json(&store.round(round)))
        .collect();
    let facts: SceneFacts = read_json(&store.facts()).unwrap_or_default();
    let failures = store.failures();
    let true_sums = true_sums(job);
    let mut tables = Tables::default();
    for variant in &job.variants {
        let mut row = empty(job, variant, machine);
        if !facts.adapter.is_empty() {
            row.adapter.clone_from(&facts.adapter);
        }
        times(&mut row, variant, &rounds);
        let (name, id) = (job.id(), variant.id());
        let captured = store.load_captured(variant);
        let errors = captured
            .as_ref()
            .and_then(|captured| log.errors(&name, &id, captured.stamp, job.protocol.views));
        let complete = row.frames > 0 && errors.is_some();
        if let Some(captured) = captured {
            row.flicker = mean(&captured.flicker).map(|value| significant(value, DIGITS));
            row.nonfinite = Some(captured.nonfinite);
            light(&mut row, &true_sums, &captured.light);
            let objects = objects::rows(&row, &true_sums, &captured.light);
            tables.objects.extend(objects);
            let splits = decomposition::rows(&row, &captured.splits, job.protocol.runs);
            tables.splits.extend(splits);
        }
        if let Some(errors) = errors {
            scores(&mut row, &errors);
        }
        if let Some(reason) = failures.get(&id) {
            row.outcome = Outcome::Failed;
            row.note.clone_from(reason);
        } else if !complete {
            let problem = problems.get(&(name, id)).map(String::as_str);
            let note = problem.or(failure).unwrap_or("it was not measured to the end");
            row.outcome = Outcome::Failed;
            row.note = note.to_owned();
        }
        tables.rows.push(row);
    }
    tables
}

fn true_sums(job: &Job) -> Vec<TrueSums> {
    let shared = Store::shared(job);
    (0..job.protocol.views)
        .map_while(|view| read_json(&shared.true_sums(view)))
        .collect()
}

/// The row of a technique that this machine can't do.
pub fn skipped(job: &Job, variant: &Variant, machine: &Machine, reason: &str) -> Row {
    Row {
        outcome: Outcome::Skipped,
        note: reason.to_owned(),
        ..empty(job, variant, machine)
    }
}

fn empty(job: &Job, variant: &Variant, machine: &Machine) -> Row {
    let protocol = &job.protocol;
    let backend = match (variant.is_ours(), variant.hardware) {
        (false, _) => "-",
        (true, false) => "compute",
        (true, true) => "hardware",
    };
    let tracer = if variant.traces() { job.tracer.as_str() } else { "-" };
    Row {
        scene: job.scene.name(),
        technique: variant.technique.clone(),
        backend: backend.to_owned(),
        tracer: tracer.to_owned(),
        adapter: machine.adapter.clone(),
        width: protocol.width,
        height: protocol.height,
        views: protocol.views,
        samples: protocol.samples,
        ..Row::default()
    }
}

fn times(row: &mut Row, variant: &Variant, rounds: &[Round]) {
    let id = variant.id();
    let all = |name: &str| -> Vec<f64> {
        let values = rounds.iter().filter_map(|round| round.get(&id)?.get(name));
        values.flatten().copied().collect()
    };
    let digits = |value: f64| significant(value, DIGITS);
    let median = |name: &str| quantile(&all(name), 0.5).map(digits);
    row.frames = all(FRAME).len() as u32;
    row.frame_ms = median(FRAME);
    row.lighting_ms = median(LIGHTING);
    if variant.technique == "off" {
        row.total_ms = (row.frames > 0).then_some(0.0);
        return;
    }
    let total = all(TOTAL);
    row.total_ms = median(TOTAL);
    row.total_p95_ms = quantile(&total, 0.95).map(digits);
    let ends = median_interval(&total).map(|(low, high)| (digits(low), digits(high)));
    (row.total_low_ms, row.total_high_ms) = ends.unzip();
    let by_round = |id: &str| -> Vec<Option<f64>> {
        let rounds = rounds.iter();
        rounds.map(|round| quantile(round.get(id)?.get(TOTAL)?, 0.5)).collect()
    };
    let ratio = paired_ratio(&by_round(&id), &by_round("reference"));
    [row.ratio, row.ratio_low, row.ratio_high] = columns(ratio, DIGITS);
    for (name, value) in [
        ("rate", &mut row.rate_ms),
        ("trace", &mut row.trace_ms),
        ("reconstruct", &mut row.reconstruct_ms),
        ("temporal", &mut row.temporal_ms),
        ("denoise", &mut row.denoise_ms),
        ("composite", &mut row.composite_ms),
    ] {
        *value = median(name);
    }
    row.rays = median(RAYS);
    let pixels = f64::from(row.width) * f64::from(row.height);
    row.rays_per_pixel = row.rays.map(|rays| digits(rays / pixels));
}

fn scores(row: &mut Row, errors: &[ViewErrors]) {
    let digits = |value: f64| significant(value, DIGITS);
    let values = |get: fn(&ViewErrors) -> Option<f64>| errors.iter().filter_map(get).collect::<Vec<f64>>();
    let over_views = |get| mean(&values(get)).map(digits);
    row.flip_reflection_reference = over_views(|view| view.reflection_reference);
    row.flip_final_reference = over_views(|view| view.final_reference);
    row.flip_reflection_converged = over_views(|view| view.reflection_converged);
    let runs: Vec<Vec<f64>> = errors.iter().map(|view| view.reflection_runs.clone()).collect();
    if !runs.is_empty() && runs.iter().all(|runs| !runs.is_empty()) {
        row.flip_reflection_converged = mean_error(&runs).map(|error| digits(error.value));
        row.flip_reflection_runs = to_text(&runs);
    }
    row.flip_final_converged = over_views(|view| view.final_converged);
    let all = values(|view| view.final_converged);
    row.flip_final_converged_min = quantile(&all, 0.0).map(digits);
    row.flip_final_converged_max = quantile(&all, 1.0).map(digits);
    row.psnr_db = over_views(|view| view.psnr_db);
    row.bias = over_views(|view| view.bias);
    // Sums over all views, so that a dark one doesn't weigh more than a bright one.
    let light = mean(&values(|view| view.truth_luminance)).filter(|light| *light > 0.0);
    let bias = mean(&values(|view| view.bias)).zip(light);
    row.bias_percent = bias.map(|(bias, light)| digits(100.0 * bias / light));
    row.recovery_1 = over_views(|view| view.recovery[0]);
    row.recovery_4 = over_views(|view| view.recovery[1]);
    row.recovery_16 = over_views(|view| view.recovery[2]);
}

fn light(row: &mut Row, truth: &[TrueSums], shown: &[ShownSums]) {
    let motion = light_bias(truth, shown, |shown| &shown.motion);
    [row.light_bias_percent, row.light_bias_low, row.light_bias_high] = columns(motion, DIGITS);
    let floor = motion.and_then(|_| light_floor(truth));
    row.truth_halves_percent = floor.map(|percent| significant(percent, DIGITS));
    [
        row.static_light_bias_percent,
        row.static_light_bias_low,
        row.static_light_bias_high,
    ] = columns(light_bias(truth, shown, |shown| &shown.still), DIGITS);
}

/// Facts about each scene that rows are about, by its name.
pub fn facts(out: &Path, rows: &[Row]) -> BTreeMap<String, SceneFacts> {
    let known = scenes(rows)
        .into_iter()
        .filter_map(|scene| Some((scene.to_owned(), read_json(&Store::of_scene(out, scene).facts())?)));
    known.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{compare::log::Entry, files::write_json, state::Captured};

    fn round(values: &[(&str, &[f64])]) -> Round {
        values
            .iter()
            .map(|(id, total)| {
                let measures = [
                    (TOTAL.to_owned(), total.to_vec()),
                    (FRAME.to_owned(), vec![5.0; total.len()]),
                    (RAYS.to_owned(), vec![500.0; total.len()]),
                ];
                ((*id).to_owned(), measures.into_iter().collect())
            })
            .collect()
    }

    fn row() -> Row {
        Row {
            width: 100,
            height: 10,
            ..Row::default()
        }
    }

    #[test]
    fn times_are_medians_over_all_rounds() {
        let rounds = [
            round(&[("reference", &[2.0, 2.0]), ("quarter", &[1.0, 1.1])]),
            round(&[("reference", &[4.0, 4.0]), ("quarter", &[2.0, 2.0])]),
        ];
        let mut quarter = row();
        times(&mut quarter, &Variant::new("quarter"), &rounds);
        assert_eq!((quarter.frames, quarter.total_ms), (4, Some(1.55)));
        assert_eq!((quarter.rays, quarter.rays_per_pixel), (Some(500.0), Some(0.5)));
        let ratio = quarter.ratio.unwrap();
        assert!((0.5..0.53).contains(&ratio), "{ratio}");
        assert!(quarter.ratio_low < quarter.ratio_high);
        let mut reference = row();
        times(&mut reference, &Variant::new("reference"), &rounds);
        assert_eq!((reference.ratio, reference.ratio_low), (Some(1.0), Some(1.0)));
    }

    #[test]
    fn nothing_takes_no_time() {
        let mut off = row();
        times(&mut off, &Variant::new("off"), &[round(&[("off", &[])])]);
        assert_eq!(off.total_ms, None);
        times(&mut off, &Variant::new("off"), &[round(&[("off", &[7.0])])]);
        assert_eq!((off.frames, off.total_ms, off.ratio), (1, Some(0.0), None));
        // Without a clock on the GPU there are frames but no times.
        let mut blind = row();
        let mut only_frames = round(&[("low", &[1.0])]);
        only_frames.get_mut("low").unwrap().remove(TOTAL);
        times(&mut blind, &Variant::new("low"), &[only_frames]);
        assert_eq!((blind.frames, blind.total_ms), (1, None));
    }

    #[test]
    fn errors_are_means_over_views() {
        let view = |error: f64, light: f64| ViewErrors {
            final_converged: Some(error),
            bias: Some(-0.01),
            truth_luminance: Some(light),
            ..ViewErrors::default()
        };
        let mut row = row();
        scores(&mut row, &[view(0.1, 0.1), view(0.3, 0.3), ViewErrors::default()]);
        assert_eq!(row.flip_final_converged, Some(0.2));
        assert_eq!(
            (row.flip_final_converged_min, row.flip_final_converged_max),
            (Some(0.1), Some(0.3))
        );
        assert_eq!(row.recovery_1, None);
        assert_eq!((row.bias, row.bias_percent), (Some(-0.01), Some(-5.0)));
    }

    #[test]
    fn light_is_compared_with_the_truth_of_its_views() {
        let truth = |light: f64| TrueSums {
            halves: [vec![light; 4], vec![1.01 * light; 4]],
            pixels: 4,
            ..TrueSums::default()
        };
        let shown = |light: f64, still: &[f64]| ShownSums {
            motion: vec![vec![light; 4]; 2],
            still: still.iter().map(|light| vec![*light; 4]).collect(),
        };
        let truth = [truth(10.0), truth(30.0)];
        let mut row = row();
        light(&mut row, &truth, &[shown(10.2, &[10.1]), shown(30.6, &[])]);
        // 2 % more than the first half is 1.5 % more than both.
        assert!((row.light_bias_percent.unwrap() - 1.4925).abs() < 1e-3);
        assert!(row.light_bias_low < row.light_bias_percent && row.light_bias_percent < row.light_bias_high);
        assert!((row.truth_halves_percent.unwrap() + 0.995).abs() < 1e-3);
        assert!((row.static_light_bias_percent.unwrap() - 0.4975).abs() < 1e-3);
        assert_eq!(row.static_light_interval(), None, "of one run");
        let mut dark = Row::default();
        light(&mut dark, &truth, &[]);
        assert_eq!((dark.light_bias_percent, dark.truth_halves_percent), (None, None));
    }

    #[test]
    fn a_row_says_what_it_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let job = Job::example(out, &["low", "high"]);
        let store = Store::new(&job);
        write_json(&store.facts(), &SceneFacts::default()).unwrap();
        for variant in &job.variants {
            write_json(&store.captured(variant), &Captured::default()).unwrap();
        }
        write_json(&store.round(0), &round(&[("low", &[1.0]), ("high", &[2.0])])).unwrap();
        let log = ComparisonLog::open(out);
        let key = (job.id(), "low".to_owned(), 0);
        log.append(&key, &Entry::default()).unwrap();
        let problems = BTreeMap::from([(("atrium".to_owned(), "high".to_owned()), "an image is gone".to_owned())]);
        let rows = of_job(&job, &Machine::default(), &log, Some("it was cancelled"), &problems).rows;
        assert!(rows[0].is_ok() && rows[0].nonfinite == Some(0), "{:?}", rows[0]);
        assert_eq!((rows[1].is_ok(), rows[1].note.as_str()), (false, "an image is gone"));
        assert!(facts(out, &rows).contains_key("atrium"));
    }
}
