//! When to retry a pass that failed.

/// Number of frames until then, doubled with each further failure up to a maximum.
const FRAMES: u32 = 600;
const MOST_DOUBLINGS: u32 = 6;

/// A failure can be a brief lack of memory, or a lasting driver error: the pass is retried, but after a longer wait each time.
#[derive(Debug, Default)]
pub(super) struct Retry {
    /// Number of failures since the pass was last recorded.
    failures: u32,
    /// Number of frames until the next try; 0 if none is pending.
    frames: u32,
}

impl Retry {
    /// Call if the pass has failed.
    pub fn fail(&mut self) {
        self.frames = FRAMES << self.failures.min(MOST_DOUBLINGS);
        self.failures += 1;
    }

    /// Call if the pass was recorded.
    pub fn succeed(&mut self) {
        *self = Self::default();
    }

    /// Call once per frame. Returns whether to retry the pass now.
    pub fn is_due(&mut self) -> bool {
        let was_waiting = self.frames > 0;
        self.frames = self.frames.saturating_sub(1);
        was_waiting && self.frames == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames_until_due(retry: &mut Retry) -> Option<u32> {
        (1..=FRAMES << (MOST_DOUBLINGS + 1)).find(|_| retry.is_due())
    }

    #[test]
    fn each_failure_is_followed_by_a_later_try() {
        let mut retry = Retry::default();
        assert_eq!(frames_until_due(&mut retry), None, "nothing has failed");
        for doublings in [0, 1, 2, 3, 4, 5, 6, 6] {
            retry.fail();
            assert_eq!(frames_until_due(&mut retry), Some(FRAMES << doublings));
            assert_eq!(frames_until_due(&mut retry), None, "it is tried once");
        }
        retry.succeed();
        retry.fail();
        assert_eq!(frames_until_due(&mut retry), Some(FRAMES), "it worked meanwhile");
    }
}
