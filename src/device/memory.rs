//! Allocations that the device can refuse, and when to retry them.

#[cfg(not(test))]
use super::real_time::LONGEST_FRAME;
use bevy::{
    platform::time::Instant,
    render::renderer::RenderDevice,
    tasks::{block_on, poll_once},
};
use core::time::Duration;
use wgpu::ErrorFilter;

/// Time until refused memory is requested again. A shorter time retries on a full device again and again; with a longer one,
/// reflections come back later.
const REFUSED: Duration = Duration::from_secs(5);

/// Number of frames of that time in tests.
#[cfg(test)]
pub(crate) const REFUSED_FRAMES: u32 = 300;

#[cfg(test)]
thread_local! {
    /// In tests, all memory requests of this thread are refused.
    pub(crate) static REFUSES: core::cell::Cell<bool> = const { core::cell::Cell::new(false) };
}

/// Devices that refuse all memory requests of reflections.
#[cfg(feature = "internals")]
static REFUSING: std::sync::Mutex<Vec<wgpu::Device>> = std::sync::Mutex::new(Vec::new());

/// Makes a device refuse all memory requests of reflections, or accept them again. The identity of a device is not unique across
/// instances of wgpu.
#[cfg(feature = "internals")]
pub fn refuse_memory(device: &RenderDevice, refuses: bool) {
    let mut refusing = REFUSING.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    refusing.retain(|other| other != device.wgpu_device());
    if refuses {
        refusing.push(device.wgpu_device().clone());
    }
}

/// Returns whether a test makes the device refuse.
fn refuses(_device: &RenderDevice) -> bool {
    #[cfg(test)]
    if REFUSES.get() {
        return true;
    }
    #[cfg(feature = "internals")]
    if let Ok(refusing) = REFUSING.lock()
        && refusing.contains(_device.wgpu_device())
    {
        return true;
    }
    false
}

/// Creates an object in device memory; `None` if there isn't enough. Otherwise, the error would end most apps.
///
/// Browsers report errors later than this function returns: there, lack of memory remains an error of the device.
pub(crate) fn try_allocate<T>(device: &RenderDevice, create: impl FnOnce() -> T) -> Option<T> {
    if refuses(device) {
        return None;
    }
    let scope = device.wgpu_device().push_error_scope(ErrorFilter::OutOfMemory);
    let created = create();
    let error = block_on(poll_once(scope.pop())).flatten();
    error.is_none().then_some(created)
}

/// When to retry memory requests that the device refused. Other programs might have allocated the memory, so our own counts can't tell
/// when it is free.
#[derive(Debug, Default)]
pub(crate) struct MemoryRetry {
    /// Remaining time, and when it was last updated; `None` if nothing was refused.
    waits: Option<(Duration, Instant)>,
}

impl MemoryRetry {
    /// Records a refusal. Later refusals don't delay requests that already wait.
    pub fn begin(&mut self) {
        self.waits.get_or_insert_with(|| (REFUSED, Instant::now()));
    }

    /// Call once per frame. Returns whether to retry now.
    pub fn is_due(&mut self) -> bool {
        let Some((time, last)) = &mut self.waits else {
            return false;
        };
        let now = Instant::now();
        // Rounded up, so that the frames add up to the whole time.
        #[cfg(test)]
        let frame = REFUSED / REFUSED_FRAMES + Duration::from_nanos(1);
        #[cfg(not(test))]
        let frame = now.saturating_duration_since(*last).min(LONGEST_FRAME);
        (*time, *last) = (time.saturating_sub(frame), now);
        let is_due = time.is_zero();
        if is_due {
            self.waits = None;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_device_is_asked_again_once_and_refusals_do_not_put_it_off() {
        let mut retry = MemoryRetry::default();
        assert!(!retry.is_due(), "nothing was refused");
        retry.begin();
        assert!((1..REFUSED_FRAMES).all(|_| {
            retry.begin();
            !retry.is_due()
        }));
        assert!(retry.is_due() && !retry.is_due());
        retry.begin();
        assert_eq!((1..=REFUSED_FRAMES).find(|_| retry.is_due()), Some(REFUSED_FRAMES));
    }
}
