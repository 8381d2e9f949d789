//! Marks of light probes that have changed lately.

use crate::scene::{
    change::{Change, RESTLESS_FRAMES},
    gpu_types::GpuLightProbe,
};
use bevy::render::render_resource::TextureViewId;

/// The inputs of a probe's light: its data for shaders, and its images.
pub(super) type Shining = (GpuLightProbe, [TextureViewId; 2]);

/// Marks probes that have changed lately, for hits inside them.
#[derive(Default)]
pub(super) struct Marks {
    /// Number of reflection probes, which come first.
    reflection_probes: usize,
    probes: Vec<Shining>,
    /// By probe, the frames for which it stays marked.
    restless: Vec<u32>,
}

impl Marks {
    /// Compares the probes of a frame with the last frame's, once per frame.
    pub fn follow(&mut self, reflection_probes: usize, probes: Vec<Shining>) -> Change {
        for frames in &mut self.restless {
            *frames = frames.saturating_sub(1);
        }
        if (self.reflection_probes, self.probes.len()) != (reflection_probes, probes.len()) {
            self.reflection_probes = reflection_probes;
            self.restless = vec![0; probes.len()];
            self.probes = probes;
            return Change::Unmarked;
        }
        let mut change = Change::Nothing;
        for ((before, now), restless) in self.probes.iter().zip(&probes).zip(&mut self.restless) {
            if before == now {
                continue;
            }
            let box_of = |probe: &GpuLightProbe| (probe.probe_from_world, probe.falloff);
            // Hits at a probe's old place can't detect that it begins to move.
            let is_marked = *restless > 0 || box_of(&before.0) == box_of(&now.0);
            change = change.max(if is_marked { Change::Marked } else { Change::Unmarked });
            *restless = RESTLESS_FRAMES;
        }
        self.probes = probes;
        change
    }

    /// A bit for each marked probe.
    pub fn bits(&self) -> u32 {
        let restless = (0..).zip(&self.restless).filter(|(_, frames)| **frames > 0);
        restless.fold(0, |bits, (index, _)| bits | 1 << index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_that_meet_no_probe_that_changes_go_on_resting() {
        let id = TextureViewId::new;
        let [maps, others] = [[id(), id()], [id(), id()]];
        let probe = |x: f32, intensity: f32| GpuLightProbe {
            probe_from_world: [[x; 4]; 3],
            intensity,
            ..Default::default()
        };
        let mut marks = Marks::default();
        let mut follow = |probes: &[Shining]| (marks.follow(1, probes.to_vec()), marks.bits());
        let still = (probe(0.0, 1.0), maps);
        assert_eq!(follow(&[still, still]), (Change::Unmarked, 0), "they came");
        assert_eq!(follow(&[still, still]), (Change::Nothing, 0));
        let brighter = (probe(0.0, 2.0), maps);
        assert_eq!(follow(&[still, brighter]), (Change::Marked, 2));
        let moved = (probe(1.0, 2.0), maps);
        assert_eq!(follow(&[still, moved]), (Change::Marked, 2), "it is marked already");
        let repainted = (still.0, others);
        assert_eq!(follow(&[repainted, moved]), (Change::Marked, 3));
        for _ in 1..RESTLESS_FRAMES {
            assert_eq!(follow(&[repainted, moved]).0, Change::Nothing);
        }
        assert_eq!(follow(&[repainted, moved]), (Change::Nothing, 0));
        assert_eq!(follow(&[repainted, still]), (Change::Unmarked, 2), "it begins to move");
        assert_eq!(follow(&[repainted]), (Change::Unmarked, 0), "it goes");
    }
}
