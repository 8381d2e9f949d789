//! Limits of a scene's time and memory, by its content.
//!
//! Time is that of the plugin's systems in the render app, extraction included, on their threads: Bevy's own work, the GPU's, and other
//! programs have little influence. Bytes come from the status. `Content::usual` follows the largest of some hundred scenes.

use crate::{
    generators::EventKind,
    harness::Harness,
    invariants::{Problem, ProblemKind},
    tally::Tally,
};
use bevy::prelude::*;
use bevy_glint::ReflectionViewMemory;

/// Limit as a multiple of the usual cost. A higher value misses waste; a lower one raises alarms on slow or busy machines.
const MARGIN: f64 = 4.0;
/// Limit of a single frame as a multiple of the limit of the average. A higher value misses hitches.
const PEAK: f64 = 2.0;
/// Contents that decide on the cost of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Content {
    cameras: usize,
    /// Pixels of their images.
    pixels: u64,
    instances: usize,
    /// Triangles of their meshes, and of the trees that are merged from them.
    triangles: u64,
    lights: usize,
    /// Objects can change in each frame.
    changes: bool,
    /// Reflecting cameras come or go, and the whole scene is loaded and freed with them.
    restarts: bool,
}

/// Time and memory of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cost {
    /// CPU milliseconds of a frame, on average.
    frame: f64,
    /// CPU milliseconds of the longest frame.
    longest: f64,
    /// Bytes of the scene that rays hit.
    scene: f64,
    /// Bytes of the cameras' targets.
    views: f64,
}

impl Content {
    fn most(&mut self, other: &Self) {
        self.cameras = self.cameras.max(other.cameras);
        self.pixels = self.pixels.max(other.pixels);
        self.instances = self.instances.max(other.instances);
        self.triangles = self.triangles.max(other.triangles);
        self.lights = self.lights.max(other.lights);
    }

    /// The maximum cost of such a scene, measured with both tracers on a busy CPU of 2 cores.
    fn usual(&self) -> Cost {
        let (instances, lights) = (self.instances as f64, self.lights as f64);
        let of_an_instance = if self.changes { 1e-3 } else { 1e-5 };
        let restart = if self.restarts { 3.0 } else { 0.0 };
        let frame = 1.0 + restart + 0.5 * self.cameras as f64 + of_an_instance * instances + 0.01 * lights;
        Cost {
            frame,
            longest: PEAK * frame,
            scene: 650e3 + 290.0 * instances + 110.0 * self.triangles as f64 + 200.0 * lights,
            views: 1e3 * self.cameras as f64 + 160.0 * self.pixels as f64,
        }
    }

    /// Problems of a scene that exceeds its budget, and its fraction of the budget.
    fn check(&self, cost: &Cost) -> (Vec<Problem>, Tally) {
        let usual = self.usual();
        let mut problems = Vec::new();
        let mut share = |kind: ProblemKind, what: &str, cost: f64, usual: f64| {
            let limit = MARGIN * usual;
            if cost > limit {
                let text = format!("{what} {cost:.3}, of {limit:.3} that are allowed to {self:?}");
                problems.push(Problem::new(kind, text));
            }
            if limit > 0.0 { (1e3 * cost / limit) as u64 } else { 0 }
        };
        let time = [
            ("CPU milliseconds of a frame on average", cost.frame, usual.frame),
            ("CPU milliseconds of a frame", cost.longest, usual.longest),
        ]
        .map(|(what, cost, usual)| share(ProblemKind::Time, what, cost, usual));
        let bytes = [
            ("bytes of the scene", cost.scene, usual.scene),
            ("bytes of the cameras", cost.views, usual.views),
        ]
        .map(|(what, cost, usual)| share(ProblemKind::Memory, what, cost, usual));
        let tally = Tally {
            time: time[0].max(time[1]),
            bytes: bytes[0].max(bytes[1]),
            ..Tally::default()
        };
        (problems, tally)
    }
}

/// Measures a scene from frame to frame.
pub struct Meter {
    content: Content,
    cost: Cost,
    frames: u32,
}

impl Meter {
    /// Begins to measure a scene with these events, without its loading time.
    pub fn new(harness: &Harness, events: &[EventKind]) -> Self {
        _ = harness.take_time();
        Self {
            content: Content {
                changes: !events.iter().all(|event| event.is_static()),
                restarts: events.iter().any(|event| event.restarts()),
                ..Content::default()
            },
            cost: Cost::default(),
            frames: 0,
        }
    }

    /// Adds the last frame.
    pub fn frame(&mut self, harness: &mut Harness) {
        let time = harness.take_time();
        let Some(status) = harness.status() else { return };
        let views = &status.view_memory;
        self.content.most(&Content {
            cameras: views.len(),
            pixels: views.iter().map(|view| view.pixels).sum(),
            instances: status.instances,
            triangles: status.triangles + status.merged_triangles,
            lights: lights(harness.world()),
            ..Content::default()
        });
        self.frames += 1;
        self.cost.frame += (time - self.cost.frame) / f64::from(self.frames);
        self.cost.longest = self.cost.longest.max(time);
        self.cost.scene = self.cost.scene.max(status.scene_bytes as f64);
        let bytes: u64 = views.iter().map(ReflectionViewMemory::bytes).sum();
        self.cost.views = self.cost.views.max(bytes as f64);
    }

    /// Compares a scene's cost with its limits.
    pub fn finish(&self, harness: &mut Harness) -> Vec<Problem> {
        let (problems, tally) = self.content.check(&self.cost);
        harness.count(tally);
        problems
    }
}

fn lights(world: &mut World) -> usize {
    let mut lights = world.query_filtered::<(), Or<(With<PointLight>, With<SpotLight>, With<DirectionalLight>)>>();
    lights.iter(world).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_may_take_what_is_in_them_and_no_more() {
        let small = Content {
            cameras: 1,
            pixels: 1536,
            instances: 5,
            triangles: 390,
            ..Content::default()
        };
        // As measured.
        let cost = Cost {
            frame: 0.5,
            longest: 0.6,
            scene: 530e3,
            views: 97e3,
        };
        let (problems, tally) = small.check(&cost);
        assert!(
            problems.is_empty() && tally.time < 300 && tally.bytes < 300,
            "{tally:?}"
        );
        let wasteful = [
            (ProblemKind::Time, Cost { frame: 7.0, ..cost }),
            (ProblemKind::Time, Cost { longest: 13.0, ..cost }),
            (ProblemKind::Memory, Cost { scene: 4e6, ..cost }),
            (ProblemKind::Memory, Cost { views: 1.2e6, ..cost }),
        ];
        for (kind, cost) in wasteful {
            let (problems, tally) = small.check(&cost);
            let kinds: Vec<_> = problems.iter().map(|problem| problem.kind).collect();
            assert_eq!(kinds, [kind], "{cost:?}");
            assert!(tally.time.max(tally.bytes) > 1000);
        }
        // A hundred thousand static objects cost almost no time, but they take memory.
        let crowd = Content {
            instances: 100_000,
            ..small
        };
        assert!(crowd.usual().frame < 2.0 * small.usual().frame);
        assert!(crowd.usual().scene > 20.0 * small.usual().scene);
        let changing = Content { changes: true, ..crowd };
        assert!(changing.usual().frame > 20.0 * small.usual().frame);
    }
}
