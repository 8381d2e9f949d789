//! Waiting for what comes about in the background: pipelines, meshes, merged trees, files.

use crate::stage::Stage;
use bevy::{asset::UntypedAssetId, prelude::*, render::render_resource::PipelineCache};
use std::{thread, time::Duration};

/// Frames in a row without anything to wait for, after which nothing more is expected.
const QUIET_FRAMES: u32 = 4;
/// The same where no camera can reflect.
const PATIENT_FRAMES: u32 = 10;
/// Leaves other threads something of the processor.
const NAP: Duration = Duration::from_millis(1);

impl Stage {
    /// Renders until pipelines are compiled and meshes are built; false if that takes more than so many frames.
    pub fn settle(&mut self, limit: u32) -> bool {
        let mut quiet = 0;
        for _ in 0..limit {
            self.step(1);
            let (ready, pending) = self
                .status()
                .map_or((true, 0), |status| (status.ready, status.meshes_pending));
            if pending > 0 || self.waits_for_pipelines() {
                quiet = 0;
                thread::sleep(NAP);
                continue;
            }
            quiet += 1;
            let enough = if ready { QUIET_FRAMES } else { PATIENT_FRAMES };
            if quiet >= enough {
                return true;
            }
        }
        false
    }

    fn waits_for_pipelines(&self) -> bool {
        let cache = self
            .render_world()
            .and_then(|world| world.get_resource::<PipelineCache>());
        cache.is_some_and(|cache| cache.waiting_pipelines().next().is_some())
    }

    /// Renders until objects at rest are merged, as far as they will be; false if that takes more than so many frames.
    pub fn settle_merges(&mut self, limit: u32) -> bool {
        // Before, nobody knows that they are at rest.
        self.step(QUIET_FRAMES);
        for _ in 0..limit {
            if self
                .status()
                .is_none_or(|status| !(status.merges_pending || status.micromaps_pending))
            {
                return true;
            }
            self.step(1);
            thread::sleep(NAP);
        }
        false
    }

    /// Renders until files and all that they refer to are loaded, or can't be; false if that takes more than so many frames.
    pub fn settle_files(&mut self, files: &[UntypedAssetId], limit: u32) -> bool {
        for _ in 0..limit {
            let server = self.world().resource::<AssetServer>();
            let is_loading = |file: &UntypedAssetId| {
                server.get_load_states(*file).is_some_and(|(own, _, others)| {
                    let failed = own.is_failed() || others.is_failed();
                    let loaded = own.is_loaded() && others.is_loaded();
                    !failed && !loaded
                })
            };
            if !files.iter().any(is_loading) {
                return true;
            }
            self.step(1);
            thread::sleep(NAP);
        }
        false
    }
}
