//! Work of one frame on several cores.

use bevy::tasks::{ComputeTaskPool, TaskPool};

/// Number of objects that a task takes. With more, fewer cores share the work; with fewer, starting tasks takes longer. Not tuned.
pub(super) const OBJECTS_OF_A_TASK: usize = 1024;

/// Runs a function on each part, on several cores if there are several parts, and returns the results in order.
pub(super) fn in_parallel<T: Send, R: Send + 'static>(parts: Vec<T>, run: impl Fn(T) -> R + Sync) -> Vec<R> {
    in_parallel_beside(parts, run, || {})
}

/// The same, with other work on this thread meanwhile. While it waits for the rest, this thread can also run systems of the app, as in any
/// scope of Bevy's.
pub(super) fn in_parallel_beside<T: Send, R: Send + 'static>(
    parts: Vec<T>,
    run: impl Fn(T) -> R + Sync,
    meanwhile: impl FnOnce() + Send,
) -> Vec<R> {
    if parts.len() < 2 {
        meanwhile();
        return parts.into_iter().map(run).collect();
    }
    let run = &run;
    ComputeTaskPool::get_or_init(TaskPool::default).scope(|scope| {
        for part in parts {
            scope.spawn(async move { run(part) });
        }
        meanwhile();
    })
}

/// Joins the lists of all parts.
pub(super) fn joined<T: Clone>(mut lists: Vec<Vec<T>>) -> Vec<T> {
    if lists.len() == 1 {
        lists.swap_remove(0)
    } else {
        lists.concat()
    }
}
