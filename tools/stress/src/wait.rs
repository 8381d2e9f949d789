//! Waits for work in the background: pipelines, meshes, merged trees, files.

use crate::harness::Harness;
use bevy::{asset::UntypedAssetId, prelude::*, render::render_resource::PipelineCache};
use std::{thread, time::Duration};

/// Consecutive frames without pending work after which the work is done.
const QUIET_FRAMES: u32 = 4;
/// The number of these frames if no camera can reflect.
const PATIENT_FRAMES: u32 = 10;
/// Leaves processor time to other threads.
const NAP: Duration = Duration::from_millis(1);

impl Harness {
    /// Renders until pipelines are compiled and meshes are built; false if that takes more than `limit` frames.
    pub fn wait_until_idle(&mut self, limit: u32) -> bool {
        let mut quiet = 0;
        for _ in 0..limit {
            self.step(1);
            let status = self.status();
            let (ready, pending) = status.map_or((true, 0), |status| (status.ready, status.meshes_pending));
            if pending > 0 || self.waits_for_pipelines() {
                quiet = 0;
                thread::sleep(NAP);
                continue;
            }
            quiet += 1;
            if quiet >= if ready { QUIET_FRAMES } else { PATIENT_FRAMES } {
                return true;
            }
        }
        false
    }

    fn waits_for_pipelines(&self) -> bool {
        let cache = self.render_resource::<PipelineCache>();
        cache.is_some_and(|cache| cache.waiting_pipelines().next().is_some())
    }

    /// Renders until static objects are merged; false if that takes more than `limit` frames.
    pub fn wait_for_merges(&mut self, limit: u32) -> bool {
        // The library needs these frames to detect static objects.
        self.step(QUIET_FRAMES);
        self.step_while(limit, |harness| {
            let status = harness.status();
            status.is_some_and(|status| status.merges_pending || status.micromaps_pending)
        })
    }

    /// Renders until files and their dependencies are loaded or have failed; false if that takes more than `limit` frames.
    pub fn wait_for_files(&mut self, files: &[UntypedAssetId], limit: u32) -> bool {
        self.step_while(limit, |harness| {
            let server = harness.world().resource::<AssetServer>();
            files.iter().any(|file| {
                server.get_load_states(*file).is_some_and(|(own, _, dependencies)| {
                    let failed = own.is_failed() || dependencies.is_failed();
                    let loaded = own.is_loaded() && dependencies.is_loaded();
                    !failed && !loaded
                })
            })
        })
    }

    /// Renders while something is pending; false if that takes more than `limit` frames.
    pub fn step_while(&mut self, limit: u32, mut is_pending: impl FnMut(&mut Self) -> bool) -> bool {
        for _ in 0..limit {
            if !is_pending(self) {
                return true;
            }
            self.step(1);
            thread::sleep(NAP);
        }
        false
    }
}
