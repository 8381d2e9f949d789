//! Work of one frame on several cores.

use bevy::tasks::{ComputeTaskPool, TaskPool};

/// Runs a function on each part, on several cores if there are several parts, and returns the results in order.
pub(super) fn in_parallel<T: Send, R: Send + 'static>(parts: Vec<T>, run: impl Fn(T) -> R + Sync) -> Vec<R> {
    if parts.len() < 2 {
        return parts.into_iter().map(run).collect();
    }
    let run = &run;
    ComputeTaskPool::get_or_init(TaskPool::default).scope(|scope| {
        for part in parts {
            scope.spawn(async move { run(part) });
        }
    })
}
