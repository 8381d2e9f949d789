//! GPU times: techniques take turns in rounds, each on the same stretch of the camera's path.

use super::runner::{Runner, TIME_STEP};
use crate::{
    files::{read_json, write_json},
    job::{Variant, order},
    message::Message,
    state::{FRAME, LIGHTING, RAYS, Round, TOTAL},
    techniques::{self, STAGES, total_spans},
};
use bevy::{
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
};
use std::collections::BTreeMap;

/// The values of one frame: the sum of some diagnostics.
struct Probe {
    name: &'static str,
    spans: Vec<(DiagnosticPath, Option<Instant>)>,
}

impl Probe {
    fn new(name: &'static str, spans: &[&'static str]) -> Self {
        Self {
            name,
            spans: spans
                .iter()
                .map(|&span| (DiagnosticPath::const_new(span), None))
                .collect(),
        }
    }

    /// The sum of new values since the last call; `None` if there are none.
    fn take(&mut self, store: &DiagnosticsStore) -> Option<f64> {
        let mut sum = None;
        for (path, last) in &mut self.spans {
            let latest = store.get(path).and_then(|diagnostic| diagnostic.measurement());
            if let Some(latest) = latest.filter(|latest| *last != Some(latest.time)) {
                *last = Some(latest.time);
                sum = Some(sum.unwrap_or(0.0) + latest.value);
            }
        }
        sum
    }
}

fn probes(variant: &Variant) -> Vec<Probe> {
    let mut probes = vec![
        Probe::new(TOTAL, total_spans(variant)),
        Probe::new(LIGHTING, &[techniques::LIGHTING]),
    ];
    if variant.is_ours() {
        probes.extend(STAGES.iter().map(|&(name, span)| Probe::new(name, &[span])));
        probes.push(Probe::new(RAYS, &techniques::RAYS));
    }
    probes
}

impl Runner<'_> {
    /// Times all techniques.
    pub fn timing(&mut self) -> Result<(), String> {
        let job = self.job;
        Message::Timing.send();
        let rounds = job.protocol.rounds();
        let turn = job.protocol.turn_frames();
        for round in 0..rounds {
            let file = self.store.round(round);
            let mut times: Round = read_json(&file).unwrap_or_default();
            let mut changed = false;
            for index in order(job.variants.len(), round) {
                let variant = &job.variants[index];
                if times.contains_key(&variant.id()) || self.store.failures().contains_key(&variant.id()) {
                    Message::Skipped(turn).send();
                    continue;
                }
                self.begin(variant, format!("times of {variant}, round {} of {rounds}", round + 1))?;
                // Each round has its own stretch, spread over the path.
                let length = turn as f32 * TIME_STEP;
                let way = (self.scene.seconds() - length).max(0.0) * (round as f32 / rounds as f32);
                let start = self.scene.start() + way;
                match self.turn(variant, start) {
                    Ok(values) => {
                        times.insert(variant.id(), values);
                        changed = true;
                    }
                    Err(reason) => self.store.fail(&variant.id(), &reason)?,
                }
            }
            if changed {
                write_json(&file, &times)?;
            }
        }
        self.end();
        Ok(())
    }

    /// Times one technique on one stretch.
    fn turn(&mut self, variant: &Variant, start: f32) -> Result<BTreeMap<String, Vec<f64>>, String> {
        let (discard, block) = (self.job.protocol.discard, self.job.protocol.block);
        self.switch(variant)?;
        let mut probes = probes(variant);
        let mut values: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        // Measurements arrive a frame late.
        for frame in 0..=discard + block {
            self.pose(start + frame as f32 * TIME_STEP);
            let clock = Instant::now();
            self.step(1);
            self.app.wait_until_idle().map_err(|error| error.to_string())?;
            let elapsed = clock.elapsed().as_secs_f64() * 1e3;
            if frame >= discard && frame < discard + block {
                values.entry(FRAME.to_owned()).or_default().push(elapsed);
            }
            let store = self.app.world().resource::<DiagnosticsStore>();
            for probe in &mut probes {
                let value = probe.take(store);
                if let Some(value) = value.filter(|_| frame > discard) {
                    values.entry(probe.name.to_owned()).or_default().push(value);
                }
            }
        }
        Ok(values)
    }
}
