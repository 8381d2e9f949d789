//! Culling of empty views: if a view has no reflective surfaces, only the rate pass runs, in every second frame.
//!
//! A pass takes time even with nothing to do, since it waits for the previous one. The GPU therefore reports the lengths of the lists of
//! the rate pass, and a view with empty lists for some frames skips all other passes. Meanwhile its surfaces keep the specular light of
//! Bevy's environment map. A surface that comes into view therefore shows the environment map for a few frames, until the report arrives.
//! Its reflection then starts without history.
//!
//! No view is culled if reports don't arrive.

use crate::common::{CHANGE_COUNT, RAY_COUNT, word_offset};
use bevy::{
    ecs::prelude::*,
    render::{
        render_resource::{Buffer, BufferDescriptor, BufferUsages, CommandEncoder, MapMode},
        renderer::RenderDevice,
    },
};
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};
use std::sync::Arc;

/// Consecutive reports of empty lists after which a view is culled.
const EMPTY_REPORTS: u32 = 8;
/// Number of frames without any report after which earlier ones no longer count.
const PATIENCE: u32 = 60;
/// Number of buffers of a view; if none is free, the frame isn't reported.
const REPORTS: usize = 4;
/// Bytes of a report's lengths of the three lists, from [`RAY_COUNT`] on.
const LIST_BYTES: u64 = 12;
/// Bytes of a report: these, and the number of rays that hit a change.
const REPORT_BYTES: u64 = 16;

/// Decides by the reports of a view's frames whether it is culled.
#[derive(Clone, Copy, Debug, Default)]
struct CullingState {
    /// Reports of empty lists since the last invalidation.
    empty: u32,
    /// Number of invalidations. Reports of frames before the last one are outdated.
    generation: u32,
    /// Frames since the last report.
    silent: u32,
    /// In this frame.
    culled: bool,
    /// Toggles every frame.
    odd: bool,
}

impl CullingState {
    /// Processes the report of an earlier frame: the generation in that frame, and whether its lists were empty.
    fn note(&mut self, generation: u32, empty: bool) {
        self.silent = 0;
        if !empty {
            self.invalidate();
        } else if generation == self.generation {
            self.empty = self.empty.saturating_add(1);
        }
    }

    /// Ends the culling in the next frame, until as many new reports show empty lists.
    fn invalidate(&mut self) {
        self.empty = 0;
        self.generation = self.generation.wrapping_add(1);
    }

    /// Decides whether the view is culled in this frame, based on the reports that have arrived.
    fn begin_frame(&mut self, invalid: bool) {
        self.silent = self.silent.saturating_add(1);
        if invalid || self.silent > PATIENCE {
            self.invalidate();
        }
        self.culled = self.empty >= EMPTY_REPORTS;
        self.odd = !self.odd;
    }

    /// Returns whether the rate pass runs in this frame.
    fn probes(&self) -> bool {
        !self.culled || self.odd
    }
}

/// The GPU can write to it.
const FREE: u8 = 0;
/// A frame in flight writes to it.
const WAITING: u8 = 1;
/// It is mapped.
const READABLE: u8 = 2;
/// It couldn't be mapped and isn't used any more.
const LOST: u8 = 3;

/// Result of a frame's report.
struct Seen {
    /// Nothing reflective was in view.
    empty: bool,
    /// Rays hit a change.
    change: bool,
}

/// The lengths of one frame's lists, and the number of changes that its rays hit, during readback.
struct Report {
    buffer: Buffer,
    /// [`FREE`] and so on; also set by the mapping callback.
    state: Arc<AtomicU8>,
    /// [`CullingState::generation`] in that frame.
    generation: AtomicU32,
    /// The passes of that frame counted hits on changes.
    watches: AtomicBool,
}

impl Report {
    /// Returns the report once it can be read, and frees the buffer.
    fn take(&self) -> Option<Seen> {
        if self.state.load(Ordering::Acquire) != READABLE {
            return None;
        }
        let words = self.buffer.slice(..).get_mapped_range();
        // The view counts as not empty if the report can't be read.
        let is_zero = words.map(|bytes| {
            let (lengths, changes) = bytes.split_at(LIST_BYTES as usize);
            [lengths, changes].map(|part| part.iter().all(|byte| *byte == 0))
        });
        self.buffer.unmap();
        self.state.store(FREE, Ordering::Release);
        let [empty, unchanged] = is_zero.unwrap_or_default();
        Some(Seen {
            empty,
            change: !unchanged,
        })
    }
}

/// Culling state of a view, and its reports.
#[derive(Component)]
pub struct ViewCulling {
    state: CullingState,
    reports: [Report; REPORTS],
    /// Number of reports with rays that hit a change.
    changes_met: u32,
    /// The last report came from passes that count changes.
    watches: bool,
}

impl ViewCulling {
    /// Label and bytes of the buffers.
    pub(crate) const MEMORY: (&'static str, u64) = ("glint_report", REPORTS as u64 * REPORT_BYTES);

    /// Creates the state of a view that isn't culled.
    pub(crate) fn new(device: &RenderDevice) -> Self {
        let report = |_| Report {
            buffer: device.create_buffer(&BufferDescriptor {
                label: Some(Self::MEMORY.0),
                size: REPORT_BYTES,
                usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
                mapped_at_creation: false,
            }),
            state: Arc::new(AtomicU8::new(FREE)),
            generation: AtomicU32::new(0),
            watches: AtomicBool::new(false),
        };
        Self {
            state: CullingState::default(),
            reports: core::array::from_fn(report),
            changes_met: 0,
            watches: false,
        }
    }

    /// Processes reports and returns whether the view is culled in this frame. If `invalid`, earlier reports are outdated, and it isn't
    /// culled.
    pub(crate) fn begin_frame(&mut self, invalid: bool) -> bool {
        for report in &self.reports {
            if let Some(seen) = report.take() {
                self.state.note(report.generation.load(Ordering::Relaxed), seen.empty);
                self.watches = report.watches.load(Ordering::Relaxed);
                self.changes_met = self.changes_met.wrapping_add(u32::from(self.watches && seen.change));
            }
        }
        self.state.begin_frame(invalid);
        self.state.culled
    }

    /// Ends the culling in the next frame. Reports of frames so far don't count any more.
    pub(crate) fn invalidate(&mut self) {
        self.state.invalidate();
    }

    /// Returns whether nothing is traced in this frame, and Bevy's lighting omits nothing.
    pub(crate) fn is_culled(&self) -> bool {
        self.state.culled
    }

    /// Returns whether the rate pass runs in this frame.
    pub(crate) fn probes(&self) -> bool {
        self.state.probes()
    }

    /// Number of frames, as of a few frames ago, with rays that hit a change; `None` if unknown.
    pub(crate) fn changes_met(&self) -> Option<u32> {
        (self.watches && self.state.silent <= PATIENCE).then_some(self.changes_met)
    }

    /// Reports this frame. `indirect_args` contains the lengths of the lists after the rate pass. `counters` contains the number of rays
    /// that hit a change, if `watches`.
    pub(crate) fn report(
        &self,
        encoder: &mut CommandEncoder,
        indirect_args: &Buffer,
        counters: &Buffer,
        watches: bool,
    ) {
        let free = |report: &&Report| report.state.load(Ordering::Acquire) == FREE;
        let Some(report) = self.reports.iter().find(free) else {
            return;
        };
        report.generation.store(self.state.generation, Ordering::Relaxed);
        report.state.store(WAITING, Ordering::Release);
        let offset = word_offset(RAY_COUNT);
        encoder.copy_buffer_to_buffer(indirect_args, offset, &report.buffer, 0, LIST_BYTES);
        encoder.copy_buffer_to_buffer(counters, word_offset(CHANGE_COUNT), &report.buffer, LIST_BYTES, 4);
        report.watches.store(watches, Ordering::Relaxed);
        // Later submissions of Bevy's renderer run the callback, once the GPU is done with this one.
        let state = report.state.clone();
        encoder.map_buffer_on_submit(&report.buffer, MapMode::Read, .., move |result| {
            let reached = if result.is_ok() { READABLE } else { LOST };
            state.store(reached, Ordering::Release);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// A view with reports that arrive three frames later.
    #[derive(Default)]
    struct View {
        state: CullingState,
        /// The generation of each frame, and whether its lists were empty.
        on_their_way: VecDeque<Option<(u32, bool)>>,
    }

    impl View {
        const LATENCY: usize = 3;

        /// Returns whether the view is culled in a frame with such lists.
        fn frame(&mut self, empty: bool, invalid: bool) -> bool {
            if self.on_their_way.len() == Self::LATENCY
                && let Some((generation, empty)) = self.on_their_way.pop_front().flatten()
            {
                self.state.note(generation, empty);
            }
            self.state.begin_frame(invalid);
            let seen = self.state.probes().then_some((self.state.generation, empty));
            self.on_their_way.push_back(seen);
            self.state.culled
        }

        /// Number of frames with empty lists until the view is culled, including the first culled one.
        fn until_culled(&mut self) -> u32 {
            (1..100).find(|_| self.frame(true, false)).unwrap()
        }

        /// Minimum number of frames that this takes, from the first one that counts.
        fn shortest() -> u32 {
            EMPTY_REPORTS + Self::LATENCY as u32
        }
    }

    #[test]
    fn a_view_is_culled_after_enough_reports_of_nothing() {
        let mut view = View::default();
        assert_eq!(view.until_culled(), View::shortest());
        assert!((0..1000).all(|_| view.frame(true, false)), "and stays so");
        let mut busy = View::default();
        assert!((0..1000).all(|_| !busy.frame(false, false)));
    }

    #[test]
    fn one_report_of_something_starts_the_count_anew() {
        let mut view = View::default();
        for _ in 0..20 {
            for _ in 1..EMPTY_REPORTS {
                assert!(!view.frame(true, false));
            }
            assert!(!view.frame(false, false));
        }
        assert!(view.until_culled() >= View::shortest());
    }

    #[test]
    fn a_report_of_something_ends_the_culling() {
        for wait in 0..4 {
            let mut view = View::default();
            view.until_culled();
            assert!((0..wait).all(|_| view.frame(true, false)));
            let visible = (0..20).find(|_| !view.frame(false, false)).unwrap();
            // The rate pass runs in every second frame.
            assert!(visible as usize <= View::LATENCY + 1, "{visible} frames");
            assert!((0..100).all(|_| !view.frame(false, false)));
        }
    }

    #[test]
    fn an_invalidation_ends_it_at_once_and_outdates_reports_on_their_way() {
        let mut view = View::default();
        view.until_culled();
        assert!(!view.frame(true, true));
        assert_eq!(1 + view.until_culled(), View::shortest());
        // The view isn't culled as long as this continues.
        assert!((0..100).all(|_| !view.frame(true, true)));
        assert_eq!(1 + view.until_culled(), View::shortest());
    }

    #[test]
    fn without_reports_nothing_is_culled() {
        let mut state = CullingState::default();
        for _ in 0..EMPTY_REPORTS {
            state.note(state.generation, true);
        }
        for frame in 0..200 {
            state.begin_frame(false);
            assert_eq!(state.culled, frame < PATIENCE, "frame {frame}");
        }
    }

    #[test]
    fn a_culled_view_is_probed_in_every_second_frame() {
        let mut state = CullingState::default();
        let mut probes = |reports: u32| {
            (0..reports).for_each(|_| state.note(state.generation, true));
            (0..10)
                .filter(|_| {
                    state.begin_frame(false);
                    state.probes()
                })
                .count()
        };
        assert_eq!(probes(0), 10);
        assert_eq!(probes(EMPTY_REPORTS), 5);
    }
}
