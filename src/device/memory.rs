//! Allocations that the device may refuse.

use bevy::{
    render::renderer::RenderDevice,
    tasks::{block_on, poll_once},
};
use wgpu::ErrorFilter;

#[cfg(test)]
thread_local! {
    /// Tests have all that this thread asks for refused.
    pub(crate) static REFUSES: core::cell::Cell<bool> = const { core::cell::Cell::new(false) };
}

/// Makes something that takes memory of the device; `None` where there isn't enough. Otherwise the error would end most apps.
///
/// Browsers answer later than this function: there, too little memory is an error of the device as ever.
pub(crate) fn try_allocate<T>(device: &RenderDevice, create: impl FnOnce() -> T) -> Option<T> {
    #[cfg(test)]
    if REFUSES.get() {
        return None;
    }
    let scope = device.wgpu_device().push_error_scope(ErrorFilter::OutOfMemory);
    let created = create();
    let error = block_on(poll_once(scope.pop())).flatten();
    error.is_none().then_some(created)
}
