//! Threads that build trees and micromaps.
//!
//! They belong to the crate. Bevy compiles pipelines and loads assets on its `AsyncComputeTaskPool`, which has one thread on small
//! machines, and a build can't be interrupted: a level's meshes would delay new materials for seconds.

use bevy::{
    log::error,
    tasks::{Task, TaskPool, TaskPoolBuilder, available_parallelism, block_on, futures_lite::FutureExt, poll_once},
};
use core::panic::AssertUnwindSafe;
use std::sync::OnceLock;

static POOL: OnceLock<TaskPool> = OnceLock::new();

/// A build in the background.
pub(super) struct Build<T>(Task<Option<T>>);

impl<T> Build<T> {
    pub fn is_finished(&self) -> bool {
        self.0.is_finished()
    }

    /// Takes the result; `None` if the build isn't finished, or has panicked.
    pub fn take(&mut self) -> Option<T> {
        block_on(poll_once(&mut self.0)).flatten()
    }
}

/// Starts a build. On platforms without threads it runs between frames. If it panics, it has no result: an odd mesh then only lacks
/// a reflection, instead of crashing the app.
pub(super) fn spawn<T: Send + 'static>(build: impl Future<Output = T> + Send + 'static) -> Build<T> {
    let build = async {
        let built = AssertUnwindSafe(build).catch_unwind().await;
        if built.is_err() {
            error!("a build for reflections has failed, so that an object is missing from them or slower to trace");
        }
        built.ok()
    };
    let new_pool = || {
        TaskPoolBuilder::new()
            // Same number as Bevy's threads for work of several frames.
            .num_threads((available_parallelism() / 4).clamp(1, 4))
            .thread_name("Glint Builds".to_owned())
            .build()
    };
    Build(POOL.get_or_init(new_pool).spawn(build))
}

/// Drops a large value on one of these threads: freeing many pages takes milliseconds.
pub(super) fn discard<T: Send + 'static>(value: T) {
    spawn(async move { drop(value) }).0.detach();
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::tasks::AsyncComputeTaskPool;
    use std::{sync::mpsc, time::Duration};

    #[test]
    fn builds_keep_nothing_from_being_compiled() {
        let (finish, finished) = mpsc::channel::<()>();
        let (tell, told) = mpsc::channel();
        let build = spawn(async move { finished.recv_timeout(Duration::from_secs(20)).is_ok() });
        let compile = AsyncComputeTaskPool::get_or_init(|| TaskPoolBuilder::new().num_threads(1).build());
        compile.spawn(async move { tell.send(()).is_ok() }).detach();
        let compiled = told.recv_timeout(Duration::from_secs(10));
        // The build would wait for longer.
        finish.send(()).unwrap();
        assert_eq!(block_on(build.0), Some(true));
        assert!(compiled.is_ok(), "a build holds up what is compiled");
    }

    #[test]
    fn a_build_that_panics_ends_without_a_result() {
        let mut build = spawn(async { [0_u32; 3][core::hint::black_box(3)] });
        while !build.is_finished() {
            std::thread::yield_now();
        }
        assert_eq!(build.take(), None);
    }
}
