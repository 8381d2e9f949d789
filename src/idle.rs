//! Views that see nothing to reflect on rest: only their rate pass runs, in every second frame.
//!
//! A pass takes time even where it has nothing to do, since it waits for the one before it. So the GPU reports how long the lists are
//! that the rate pass makes, and a view whose lists were empty for some frames leaves out all other passes. Its surfaces keep the
//! specular light of Bevy's environment map meanwhile. What comes into view thus shows that map for a few frames, until the report of
//! it has arrived; then the traced reflection begins without a past.
//!
//! Where reports don't arrive nothing rests.

use crate::targets::BLOCK_COUNT;
use bevy::{
    ecs::prelude::*,
    render::{
        render_resource::{Buffer, BufferDescriptor, BufferUsages, CommandEncoder, MapMode},
        renderer::RenderDevice,
    },
};
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use std::sync::Arc;

/// Reports of empty lists, one after the other, that put a view to rest.
const EMPTY_REPORTS: u32 = 8;
/// Frames without any report after which the last ones count no more.
const PATIENCE: u32 = 60;
/// Buffers of a view; a frame that finds none free isn't reported.
const REPORTS: usize = 4;
/// Bytes of a report: the lengths of the three lists, from [`BLOCK_COUNT`] on.
const REPORT_BYTES: u64 = 12;

/// Whether a view rests, from what its frames reported.
#[derive(Clone, Copy, Debug, Default)]
struct Activity {
    /// Reports of empty lists since the last disturbance.
    empty: u32,
    /// Number of disturbances. Reports of frames before the last one say nothing about what is seen now.
    generation: u32,
    /// Frames since the last report.
    silent: u32,
    /// In this frame.
    resting: bool,
    /// Changes from frame to frame.
    odd: bool,
}

impl Activity {
    /// Takes in the report of an earlier frame: the generation in that frame, and whether its lists were empty.
    fn note(&mut self, generation: u32, empty: bool) {
        self.silent = 0;
        if !empty {
            self.disturb();
        } else if generation == self.generation {
            self.empty = self.empty.saturating_add(1);
        }
    }

    /// From the next frame on the view is awake, until as many new reports say that it can rest.
    fn disturb(&mut self) {
        self.empty = 0;
        self.generation = self.generation.wrapping_add(1);
    }

    /// Decides whether the view rests in this frame, after the reports that have arrived.
    fn begin_frame(&mut self, disturbed: bool) {
        self.silent = self.silent.saturating_add(1);
        if disturbed || self.silent > PATIENCE {
            self.disturb();
        }
        self.resting = self.empty >= EMPTY_REPORTS;
        self.odd = !self.odd;
    }

    fn looks(&self) -> bool {
        !self.resting || self.odd
    }
}

/// The GPU may write to it.
const FREE: u8 = 0;
/// A frame on its way writes to it.
const WAITING: u8 = 1;
/// It is mapped.
const READABLE: u8 = 2;
/// It couldn't be mapped and is used no more.
const LOST: u8 = 3;

/// The lengths of one frame's lists on their way to the CPU.
struct Report {
    buffer: Buffer,
    /// [`FREE`] and so on; set by the callback of the mapping, too.
    state: Arc<AtomicU8>,
    /// [`Activity::generation`] in that frame.
    generation: AtomicU32,
}

impl Report {
    /// Whether the lists were empty, once that can be read; the buffer is free again then.
    fn take(&self) -> Option<bool> {
        if self.state.load(Ordering::Acquire) != READABLE {
            return None;
        }
        let lengths = self.buffer.slice(..).get_mapped_range();
        // Where nothing can be read, anything may have been there.
        let empty = lengths.is_ok_and(|bytes| bytes.iter().all(|byte| *byte == 0));
        self.buffer.unmap();
        self.state.store(FREE, Ordering::Release);
        Some(empty)
    }
}

/// Whether a view rests, and its reports.
#[derive(Component)]
pub struct ViewActivity {
    activity: Activity,
    reports: [Report; REPORTS],
}

impl ViewActivity {
    /// Label and bytes of the buffers.
    pub(crate) const MEMORY: (&'static str, u64) = ("glint_report", REPORTS as u64 * REPORT_BYTES);

    /// Of a view that is awake.
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
        };
        Self {
            activity: Activity::default(),
            reports: core::array::from_fn(report),
        }
    }

    /// Takes in what was reported and tells whether the view rests in this frame. A disturbed one doesn't.
    pub(crate) fn begin_frame(&mut self, disturbed: bool) -> bool {
        for report in &self.reports {
            if let Some(empty) = report.take() {
                self.activity.note(report.generation.load(Ordering::Relaxed), empty);
            }
        }
        self.activity.begin_frame(disturbed);
        self.activity.resting
    }

    /// Wakes the view in the next frame. Reports of frames so far don't count any more.
    pub(crate) fn disturb(&mut self) {
        self.activity.disturb();
    }

    /// Nothing is traced in this frame, and Bevy's lighting leaves nothing out.
    pub(crate) fn is_resting(&self) -> bool {
        self.activity.resting
    }

    /// The rate pass runs in this frame.
    pub(crate) fn looks(&self) -> bool {
        self.activity.looks()
    }

    /// Reports this frame, of which `arguments` are [`Targets::arguments`](crate::targets::Targets::arguments) after the rate pass.
    pub(crate) fn report(&self, encoder: &mut CommandEncoder, arguments: &Buffer) {
        let free = |report: &&Report| report.state.load(Ordering::Acquire) == FREE;
        let Some(report) = self.reports.iter().find(free) else {
            return;
        };
        report.generation.store(self.activity.generation, Ordering::Relaxed);
        report.state.store(WAITING, Ordering::Release);
        encoder.copy_buffer_to_buffer(arguments, BLOCK_COUNT, &report.buffer, 0, REPORT_BYTES);
        // Later submissions of Bevy's renderer call back, once the GPU is done with this one.
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

    /// A view whose reports arrive three frames later.
    #[derive(Default)]
    struct View {
        activity: Activity,
        /// Of each frame: its generation, and whether its lists were empty.
        on_their_way: VecDeque<Option<(u32, bool)>>,
    }

    impl View {
        const LATENCY: usize = 3;

        /// Whether the view rests in a frame with such lists.
        fn frame(&mut self, empty: bool, disturbed: bool) -> bool {
            if self.on_their_way.len() == Self::LATENCY
                && let Some((generation, empty)) = self.on_their_way.pop_front().flatten()
            {
                self.activity.note(generation, empty);
            }
            self.activity.begin_frame(disturbed);
            let seen = self.activity.looks().then_some((self.activity.generation, empty));
            self.on_their_way.push_back(seen);
            self.activity.resting
        }

        /// Frames with empty lists until the view rests; the last of them is the first at rest.
        fn until_rest(&mut self) -> u32 {
            (1..100).find(|_| self.frame(true, false)).unwrap()
        }

        /// What it takes from the first frame that counts on.
        fn shortest() -> u32 {
            EMPTY_REPORTS + Self::LATENCY as u32
        }
    }

    #[test]
    fn a_view_rests_after_enough_reports_of_nothing() {
        let mut view = View::default();
        assert_eq!(view.until_rest(), View::shortest());
        assert!((0..1000).all(|_| view.frame(true, false)), "and goes on resting");
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
        assert!(view.until_rest() >= View::shortest());
    }

    #[test]
    fn what_is_reported_at_rest_wakes() {
        for wait in 0..4 {
            let mut view = View::default();
            view.until_rest();
            assert!((0..wait).all(|_| view.frame(true, false)));
            let awake = (0..20).find(|_| !view.frame(false, false)).unwrap();
            // The rate pass runs in every second frame.
            assert!(awake as usize <= View::LATENCY + 1, "{awake} frames");
            assert!((0..100).all(|_| !view.frame(false, false)));
        }
    }

    #[test]
    fn a_disturbance_wakes_at_once_and_outdates_what_is_on_its_way() {
        let mut view = View::default();
        view.until_rest();
        assert!(!view.frame(true, true));
        assert_eq!(1 + view.until_rest(), View::shortest());
        // As long as it goes on, so does the view.
        assert!((0..100).all(|_| !view.frame(true, true)));
        assert_eq!(1 + view.until_rest(), View::shortest());
    }

    #[test]
    fn without_reports_nothing_rests() {
        let mut activity = Activity::default();
        for _ in 0..EMPTY_REPORTS {
            activity.note(activity.generation, true);
        }
        for frame in 0..200 {
            activity.begin_frame(false);
            assert_eq!(activity.resting, frame < PATIENCE, "frame {frame}");
        }
    }

    #[test]
    fn at_rest_every_second_frame_is_looked_at() {
        let mut activity = Activity::default();
        let mut looks = |reports: u32| {
            (0..reports).for_each(|_| activity.note(activity.generation, true));
            (0..10)
                .filter(|_| {
                    activity.begin_frame(false);
                    activity.looks()
                })
                .count()
        };
        assert_eq!(looks(0), 10);
        assert_eq!(looks(EMPTY_REPORTS), 5);
    }
}
