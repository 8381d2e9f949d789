//! The search for a quality: a guess from the adapter, then one trial after the other.

use crate::{
    device::ReflectionTracer,
    settings::{ReflectionAutoQuality, ReflectionQuality},
};
use core::time::Duration;
use wgpu::DeviceType;

/// Number of complete frames before times count: until then, times of the previous quality arrive. A lower number mixes both; a
/// higher one makes trials longer.
const LATENCY: u32 = 12;
/// Number of measurements for a median. A lower number follows noise; a higher one makes trials longer.
const WINDOW: usize = 24;
/// Fraction of the target up to which the next better quality is tried. With a lower value, a machine that could do more stays below
/// it; with a higher one, players see failed trials.
const ROOM: f32 = 0.75;
/// Multiple of the target beyond which even `Low` is too slow: the minimum effort of a budget is a quarter by default. A lower value
/// switches reflections off on machines for which a budget would suffice; a higher one leaves slow machines slow.
const TOO_SLOW: f32 = 4.0;
/// Number of complete frames without times after which none are expected. A lower number gives up on a device that is only busy; a
/// higher one delays the answer.
const NO_TIMES: u32 = 120;
/// Maximum time of a trial, including compilation, loading meshes and measurements. With a lower value, slow machines keep the first
/// guess; with a higher one, a camera that shows nothing delays the answer.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time after which pending meshes no longer delay measurements: in a world that streams, or with a mesh that changes in each frame,
/// some are always pending. A lower value measures a loading level too early; a higher one delays the answer there.
const ARRIVAL: Duration = Duration::from_secs(5);
/// Maximum time that a frame counts. Longer frames belong to an app in the background, or a machine that slept.
const LONGEST_FRAME: Duration = Duration::from_secs(5);

/// The first quality. A guess that is too low costs a trial, and one that is too high costs slow frames.
pub(super) fn guess(adapter: Option<DeviceType>, tracer: Option<ReflectionTracer>) -> ReflectionQuality {
    match (adapter, tracer) {
        (Some(DeviceType::DiscreteGpu), Some(ReflectionTracer::RayQuery)) => ReflectionQuality::High,
        (Some(DeviceType::DiscreteGpu), _) => ReflectionQuality::Medium,
        // Browsers don't report the kind of their adapter.
        _ => ReflectionQuality::Low,
    }
}

/// A frame of a search.
pub(super) struct Frame {
    /// The camera's frame contains its reflections.
    pub reflects: bool,
    /// No meshes are pending.
    pub has_meshes: bool,
    /// A new measurement in milliseconds.
    pub time: Option<f32>,
    /// Time since the last frame.
    pub delta: Duration,
}

/// A decision about a camera's quality.
#[derive(Debug, PartialEq)]
pub(super) enum Decision {
    Wait,
    Try(ReflectionQuality),
    /// The search ends, with the time of the quality.
    Choose(ReflectionQuality, Option<f32>),
}

/// The search for the quality of one camera. Its trials go in one direction, better or worse, and turn back at most once.
pub(super) struct Search {
    settings: ReflectionAutoQuality,
    /// The quality being tried.
    pub quality: ReflectionQuality,
    /// The best measured quality that is fast enough.
    fits: Option<(ReflectionQuality, f32)>,
    /// A better quality was too slow.
    has_fallen: bool,
    times: Vec<f32>,
    /// Frames to ignore.
    skip: u32,
    /// Frames without a time.
    without_time: u32,
    /// Duration of the trial.
    elapsed: Duration,
    /// Total time with pending meshes.
    arriving: Duration,
}

impl Search {
    pub fn new(settings: ReflectionAutoQuality, guess: ReflectionQuality) -> Self {
        let settings = settings.clamped();
        Self {
            settings,
            quality: guess.clamp(
                settings.worst.max(ReflectionQuality::Low).min(settings.best),
                settings.best,
            ),
            fits: None,
            has_fallen: false,
            times: Vec::with_capacity(WINDOW),
            skip: LATENCY,
            without_time: 0,
            elapsed: Duration::ZERO,
            arriving: Duration::ZERO,
        }
    }

    pub fn step(&mut self, frame: &Frame) -> Decision {
        // Without rays there is nothing to measure.
        if self.quality == ReflectionQuality::Off {
            return Decision::Choose(self.quality, None);
        }
        let delta = frame.delta.min(LONGEST_FRAME);
        self.elapsed += delta;
        if !frame.has_meshes {
            self.arriving += delta;
        }
        if !frame.reflects || (!frame.has_meshes && self.arriving < ARRIVAL) {
            self.skip = LATENCY;
            self.times.clear();
        } else if self.skip > 0 {
            self.skip -= 1;
        } else if let Some(time) = frame.time.filter(|time| time.is_finite()) {
            self.without_time = 0;
            self.times.push(time);
        } else {
            self.without_time += 1;
        }
        let ends = self.elapsed >= PATIENCE || self.lacks_times();
        if self.times.len() < WINDOW && !ends {
            return Decision::Wait;
        }
        match self.median() {
            Some(time) => self.judge(time),
            None => match self.fits {
                Some((quality, time)) => Decision::Choose(quality, Some(time)),
                None => Decision::Choose(self.quality, None),
            },
        }
    }

    /// Returns whether times are missing for frames that should have them.
    pub fn lacks_times(&self) -> bool {
        self.without_time >= NO_TIMES
    }

    fn median(&mut self) -> Option<f32> {
        self.times.sort_by(f32::total_cmp);
        self.times.get(self.times.len() / 2).copied()
    }

    /// Decides by the time of the quality being tried.
    fn judge(&mut self, time: f32) -> Decision {
        let target = self.settings.milliseconds;
        let neighbour = |step: isize| {
            let index = (self.quality as usize).checked_add_signed(step)?;
            ReflectionQuality::ALL.get(index).copied()
        };
        if time <= target {
            let better = neighbour(1).filter(|better| *better <= self.settings.best);
            match better {
                Some(better) if !self.has_fallen && time <= ROOM * target => {
                    self.fits = Some((self.quality, time));
                    self.begin(better)
                }
                _ => Decision::Choose(self.quality, Some(time)),
            }
        } else if let Some((quality, time)) = self.fits {
            Decision::Choose(quality, Some(time))
        } else {
            let worse = neighbour(-1).filter(|worse| *worse >= self.settings.worst);
            match worse {
                Some(ReflectionQuality::Off) if time > TOO_SLOW * target => {
                    Decision::Choose(ReflectionQuality::Off, Some(time))
                }
                None | Some(ReflectionQuality::Off) => Decision::Choose(self.quality, Some(time)),
                Some(worse) => {
                    self.has_fallen = true;
                    self.begin(worse)
                }
            }
        }
    }

    fn begin(&mut self, quality: ReflectionQuality) -> Decision {
        self.quality = quality;
        self.times.clear();
        self.skip = LATENCY;
        self.without_time = 0;
        self.elapsed = Duration::ZERO;
        Decision::Try(quality)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ReflectionQuality::{High, Low, Medium, Off, Ultra};

    /// A machine on which each quality takes a time, from `Low` to `Ultra`. Returns the qualities that were tried, and the choice.
    fn search(
        settings: ReflectionAutoQuality,
        guess: ReflectionQuality,
        times: [f32; 4],
    ) -> (Vec<ReflectionQuality>, ReflectionQuality, Option<f32>) {
        let mut search = Search::new(settings, guess);
        let mut tried = vec![search.quality];
        // Enough frames for trials of four qualities, including the latency of their times.
        for frame in 0..4 * (2 * LATENCY as usize + WINDOW) {
            let noise = if frame.is_multiple_of(5) { 8.0 } else { 1.0 };
            let time = times[(search.quality as usize).saturating_sub(1)] * noise;
            match search.step(&Frame {
                reflects: true,
                has_meshes: true,
                time: Some(time),
                delta: Duration::from_millis(16),
            }) {
                Decision::Wait => {}
                Decision::Try(quality) => tried.push(quality),
                Decision::Choose(quality, time) => return (tried, quality, time),
            }
        }
        panic!("the search doesn't end: {tried:?}");
    }

    fn within(worst: ReflectionQuality, best: ReflectionQuality) -> ReflectionAutoQuality {
        ReflectionAutoQuality {
            worst,
            best,
            ..Default::default()
        }
    }

    #[test]
    fn the_adapter_gives_the_first_guess() {
        let (ray_query, bvh) = (Some(ReflectionTracer::RayQuery), Some(ReflectionTracer::Bvh));
        for (adapter, tracer, expected) in [
            (Some(DeviceType::DiscreteGpu), ray_query, High),
            (Some(DeviceType::DiscreteGpu), bvh, Medium),
            (Some(DeviceType::IntegratedGpu), ray_query, Low),
            (Some(DeviceType::Cpu), bvh, Low),
            (Some(DeviceType::Other), bvh, Low),
            (None, None, Low),
        ] {
            assert_eq!(guess(adapter, tracer), expected, "{adapter:?}, {tracer:?}");
        }
    }

    #[test]
    fn times_move_the_guess() {
        let auto = ReflectionAutoQuality::default();
        // Everything is fast: the best allowed quality.
        assert_eq!(
            search(auto, Low, [0.4, 0.6, 0.8, 2.4]),
            (vec![Low, Medium, High], High, Some(0.8))
        );
        let ultra = within(Off, Ultra);
        assert_eq!(
            search(ultra, High, [0.4, 0.6, 0.8, 1.9]),
            (vec![High, Ultra], Ultra, Some(1.9))
        );
        // A failed trial is reverted, and qualities beyond the limit are not tried.
        assert_eq!(
            search(ultra, High, [0.4, 0.6, 0.8, 2.4]),
            (vec![High, Ultra], High, Some(0.8))
        );
        assert_eq!(
            search(auto, Medium, [1.4, 1.8, 1.9, 5.0]),
            (vec![Medium], Medium, Some(1.8))
        );
        // Too slow: the best quality within the target, without going up again.
        assert_eq!(
            search(auto, High, [1.2, 2.1, 2.3, 5.0]),
            (vec![High, Medium, Low], Low, Some(1.2))
        );
    }

    #[test]
    fn reflections_are_off_where_no_budget_helps() {
        let auto = ReflectionAutoQuality::default();
        assert_eq!(search(auto, Low, [7.9, 9.0, 9.0, 9.0]), (vec![Low], Low, Some(7.9)));
        assert_eq!(search(auto, Low, [8.1, 9.0, 9.0, 9.0]), (vec![Low], Off, Some(8.1)));
        assert_eq!(search(within(Low, High), Low, [8.1; 4]), (vec![Low], Low, Some(8.1)));
        assert_eq!(
            search(within(Medium, High), High, [8.1; 4]),
            (vec![High, Medium], Medium, Some(8.1))
        );
    }

    #[test]
    fn bounds_hold_for_the_guess() {
        assert_eq!(
            search(within(Off, Medium), High, [0.1; 4]),
            (vec![Medium], Medium, Some(0.1))
        );
        assert_eq!(
            search(within(High, Ultra), Low, [1.9; 4]),
            (vec![High], High, Some(1.9))
        );
        // `best` wins if the limits contradict each other.
        assert_eq!(search(within(Ultra, Low), High, [9.0; 4]), (vec![Low], Low, Some(9.0)));
        assert_eq!(search(within(Off, Off), High, [0.1; 4]), (vec![Off], Off, None));
        let odd = ReflectionAutoQuality {
            milliseconds: f32::NAN,
            ..Default::default()
        };
        assert_eq!(search(odd, Medium, [0.5, 1.9, 5.0, 5.0]).1, Medium);
    }

    /// The decision after a number of identical frames.
    fn after(frames: u32, frame: &Frame) -> Decision {
        let mut search = Search::new(ReflectionAutoQuality::default(), Medium);
        for _ in 1..frames {
            assert_eq!(search.step(frame), Decision::Wait);
        }
        search.step(frame)
    }

    #[test]
    fn without_times_the_guess_stays() {
        let mut frame = Frame {
            reflects: true,
            has_meshes: true,
            time: None,
            delta: Duration::from_millis(1),
        };
        assert_eq!(after(LATENCY + NO_TIMES, &frame), Decision::Choose(Medium, None));
        // The camera never becomes ready.
        frame.reflects = false;
        frame.time = Some(0.1);
        frame.delta = PATIENCE / 100;
        assert_eq!(after(100, &frame), Decision::Choose(Medium, None));
        // A laptop that slept wasn't searching meanwhile.
        frame.delta = Duration::from_secs(3600);
        assert_eq!(after(1, &frame), Decision::Wait);
        // A slow machine gets by with fewer measurements.
        frame.reflects = true;
        frame.time = Some(1.8);
        frame.delta = PATIENCE / 20;
        assert_eq!(after(20, &frame), Decision::Choose(Medium, Some(1.8)));
    }

    #[test]
    fn times_of_the_quality_before_do_not_count() {
        let mut search = Search::new(ReflectionAutoQuality::default(), Medium);
        let frame = |reflects, time| Frame {
            reflects,
            has_meshes: true,
            time: Some(time),
            delta: Duration::ZERO,
        };
        for _ in 0..WINDOW {
            assert_eq!(search.step(&frame(false, 0.1)), Decision::Wait);
        }
        for _ in 0..LATENCY {
            assert_eq!(search.step(&frame(true, 0.1)), Decision::Wait);
        }
        for _ in 1..WINDOW {
            assert_eq!(search.step(&frame(true, 1.9)), Decision::Wait);
        }
        assert_eq!(search.step(&frame(true, 1.9)), Decision::Choose(Medium, Some(1.9)));
    }

    #[test]
    fn meshes_that_never_end_to_arrive_put_nothing_off_for_long() {
        let mut search = Search::new(ReflectionAutoQuality::default(), Medium);
        let frame = Frame {
            reflects: true,
            has_meshes: false,
            time: Some(1.8),
            delta: Duration::from_millis(20),
        };
        let mut frames = 0;
        while search.step(&frame) == Decision::Wait {
            frames += 1;
        }
        let waited = Duration::from_millis(20) * frames;
        assert!(waited >= ARRIVAL && waited < 2 * ARRIVAL, "{waited:?}");
    }
}
