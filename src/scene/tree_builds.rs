//! Threads on which trees and micromaps are built.
//!
//! They are the crate's own. Bevy compiles pipelines and loads assets on its `AsyncComputeTaskPool`, which has one thread on
//! small machines, and a build can't be interrupted: a level's meshes would keep new materials from appearing for seconds.

use bevy::tasks::{Task, TaskPool, TaskPoolBuilder, available_parallelism};
use std::sync::OnceLock;

static POOL: OnceLock<TaskPool> = OnceLock::new();

/// Starts a build. On platforms without threads it runs between frames.
pub(super) fn spawn<T: Send + 'static>(build: impl Future<Output = T> + Send + 'static) -> Task<T> {
    let new_pool = || {
        TaskPoolBuilder::new()
            // As many as Bevy takes for work of several frames.
            .num_threads((available_parallelism() / 4).clamp(1, 4))
            .thread_name("Glint Builds".to_owned())
            .build()
    };
    POOL.get_or_init(new_pool).spawn(build)
}

/// Drops something large on one of these threads: giving many pages back takes milliseconds.
pub(super) fn discard<T: Send + 'static>(value: T) {
    spawn(async move { drop(value) }).detach();
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::tasks::{AsyncComputeTaskPool, block_on};
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
        assert!(block_on(build));
        assert!(compiled.is_ok(), "a build holds up what is compiled");
    }
}
