//! Textures and uniform of one reflecting view, and its state from frame to frame.

use super::{
    kept_groups::KeptGroups,
    static_view::{MOST_FRAMES, StaticView, ViewFingerprint},
    uniform::{Frame, FrameState, GpuReflectionView, PreviousFrame, is_at_rest},
};
use crate::{
    scene::RESTLESS_FRAMES,
    settings::{ReflectionTechnique, ReflectionView},
    targets::{HistoryHalf, Needs, Sizes, Targets},
};
use bevy::{
    ecs::component::Component,
    math::{DVec3, UVec2},
    render::{render_resource::UniformBuffer, renderer::RenderDevice},
};

/// Frames for which histories stay short after a change, so that nothing of the former light is left. A higher number costs time; with a
/// lower one, the last frames of a change stay for as long as a history is.
const LIGHT_FRAMES: u32 = 4;

/// A view's textures, uniform and state from the last frame.
#[derive(Component)]
pub struct ReflectionTextures {
    /// First pixel in the target.
    pub(crate) origin: UVec2,
    pub(crate) targets: Targets,
    pub(crate) uniform: UniformBuffer<GpuReflectionView>,
    /// Bind groups of the view's passes.
    pub(crate) groups: KeptGroups,
    /// The index in ping-pong pairs that this frame writes.
    pub(crate) write_index: usize,
    accumulated: u32,
    sample_index: u32,
    /// Version of the scene in the accumulation.
    scene: u32,
    /// Frames in which a ray hit a changed object, plus changes whose visibility is unknown.
    met: [u32; 2],
    previous: Option<PreviousFrame>,
    /// Own textures, while this frame reads another history in their place.
    replaced: Option<HistoryHalf>,
    /// That history is another camera's.
    is_borrowed: bool,
    /// [`Frame::number`] of the last frame ...
    drawn: u32,
    /// ... and its [`Frame::world_origin`].
    world_origin: DVec3,
    /// Frames in which rays of earlier frames are traced again, counting this one: the scene changed lately.
    light_frames: u32,
    /// [`Frame::world_origin`] of the last of them.
    light_origin: DVec3,
    /// ... and the version of the scene.
    light_scene: u32,
    /// This view is static in this frame, at least partly.
    pub(crate) is_at_rest: bool,
    static_view: StaticView<ViewFingerprint>,
}

impl ReflectionTextures {
    /// `capacity` is their maximum size. `old` are the textures of the view in another size or for other settings. Their history is kept if
    /// the first frame can read it, and the sample sequence continues from theirs: otherwise, a view that is resized in each frame would use
    /// the same sample forever.
    pub(crate) fn new(
        device: &RenderDevice,
        (sizes, capacity): (Sizes, UVec2),
        needs: Needs,
        old: Option<&Self>,
    ) -> Self {
        let mut textures = Self {
            origin: UVec2::ZERO,
            targets: Targets::new(device, sizes, capacity, needs),
            uniform: UniformBuffer::default(),
            groups: KeptGroups::default(),
            write_index: 0,
            accumulated: 0,
            sample_index: old.map_or(0, |old| old.sample_index),
            scene: 0,
            met: [0; 2],
            previous: None,
            replaced: None,
            is_borrowed: false,
            drawn: 0,
            world_origin: DVec3::ZERO,
            light_frames: 0,
            light_origin: DVec3::ZERO,
            light_scene: 0,
            is_at_rest: false,
            static_view: StaticView::default(),
        };
        if let Some(old) = old {
            textures.continue_from(old);
        }
        textures
    }

    /// In the next frame, reads the history of the same view's former textures in place of the own one.
    fn continue_from(&mut self, old: &Self) {
        let Some(replaced) = (self.targets).read_history(self.write_index, &old.targets, old.write_index) else {
            return;
        };
        self.replaced = Some(replaced);
        (self.previous, self.accumulated) = (old.previous, old.accumulated);
        (self.scene, self.met) = (old.scene, old.met);
        (self.drawn, self.world_origin) = (old.drawn, old.world_origin);
        // New rays must be traced once before a change of their light is seen.
        self.light_frames = LIGHT_FRAMES + 1;
    }

    /// Switches to another size of the view if it fits into the textures, which keeps the history. Returns whether it fits.
    pub(crate) fn fit(&mut self, sizes: Sizes, needs: Needs) -> bool {
        if self.targets.needs != needs || !self.targets.can_hold(sizes) {
            return false;
        }
        if self.targets.sizes != sizes {
            self.targets.sizes = sizes;
            self.static_view = StaticView::default();
        }
        true
    }

    /// Bytes of all textures and buffers.
    pub(crate) fn bytes(&self) -> u64 {
        self.targets.memory.iter().map(|(_, bytes)| bytes).sum()
    }

    /// Pixels of the view.
    pub(crate) fn size(&self) -> UVec2 {
        self.targets.sizes.full
    }

    /// Moves the last frame with the world, so that history and static views survive a shift of the origin.
    fn shift(&mut self, before: DVec3, frame: &Frame) {
        let is_same = self
            .previous
            .as_mut()
            .is_some_and(|previous| previous.shift(before, frame));
        match self.static_view.last_mut() {
            Some(last) if is_same => last.shift(frame),
            _ => self.static_view = StaticView::default(),
        }
    }

    /// Returns whether rays of earlier frames are traced again in this frame. A view at rest doesn't see the change.
    pub(crate) fn follows_light(&self) -> bool {
        self.light_frames > 0 && !self.is_at_rest
    }

    /// Returns whether the frame before this one was drawn.
    pub(crate) fn is_of_last_frame(&self, frame: &Frame) -> bool {
        self.drawn.wrapping_add(1) == frame.number
    }

    /// The camera of the history, in the coordinates of a frame.
    fn previous_in(&self, frame: &Frame) -> Option<PreviousFrame> {
        let by = (frame.world_origin - self.world_origin).as_vec3();
        let previous = self.previous.filter(|_| self.accumulated > 0);
        previous.map(|previous| previous.translated(by))
    }

    /// Part of a frame's surfaces that the history shows, by the two cameras.
    pub(crate) fn coverage(&self, frame: &Frame) -> f32 {
        let previous = self.previous_in(frame);
        previous.map_or(0.0, |previous| previous.covers(frame.clip_from_world))
    }

    /// In the next frame, reads the history of another view in place of its own one, and changes nothing of the other view.
    pub(crate) fn borrow(&mut self, other: &Self, frame: &Frame) {
        let own = self.targets.pipeline.as_mut();
        let (Some(own), Some(theirs)) = (own, &other.targets.pipeline) else {
            return;
        };
        // A frame reads the textures that the last one wrote.
        let replaced = own.replace_half(self.write_index, theirs.half(other.write_index));
        // New textures might already read the history of the former ones.
        self.replaced.get_or_insert(replaced);
        self.is_borrowed = true;
        self.previous = other.previous_in(frame);
        self.accumulated = other.accumulated;
        self.world_origin = frame.world_origin;
        self.static_view = StaticView::default();
    }

    /// Begins the sample sequence anew.
    #[cfg(feature = "internals")]
    pub(crate) fn restart_noise(&mut self) {
        self.sample_index = 0;
    }

    /// Records that no pass writes this frame, so that the next one begins a history.
    pub(crate) fn miss_frame(&mut self) {
        self.accumulated = 0;
    }

    /// Call after each frame.
    pub(crate) fn end_frame(&mut self) {
        self.groups.drop_unused();
        if let (Some(replaced), Some(own)) = (self.replaced.take(), &mut self.targets.pipeline) {
            own.replace_half(1 - self.write_index, replaced);
        }
        self.is_borrowed = false;
    }

    /// Advances the state by one frame and sets the uniform, which must still be written to the GPU.
    pub(crate) fn begin_frame(&mut self, view: &ReflectionView, frame: &Frame) {
        let converged = view.settings.technique == ReflectionTechnique::Converged;
        let scene_changed = core::mem::replace(&mut self.scene, frame.scene) != frame.scene;
        match frame.changes_met {
            Some(met) => self.met[0] = met,
            None => self.met[1] = self.met[1].wrapping_add(u32::from(scene_changed)),
        }
        let before = core::mem::replace(&mut self.world_origin, frame.world_origin);
        if before != frame.world_origin {
            self.shift(before, frame);
        }
        let mut fingerprint = if converged {
            Some(ViewFingerprint::of_truth(view, frame))
        } else {
            ViewFingerprint::new(view, frame, self.met)
        };
        if scene_changed && frame.number.wrapping_sub(self.drawn) > RESTLESS_FRAMES {
            // The marks of what changed in the pause have expired, so no ray can meet the change.
            self.static_view = StaticView::default();
        }
        if let (Some(now), Some(last)) = (&mut fingerprint, self.static_view.last_mut()) {
            now.keep_environment(last);
        }
        let static_frames = self.static_view.count(fingerprint);
        if view.reset || (converged && (scene_changed || static_frames == 0)) {
            self.accumulated = 0;
            if converged {
                self.sample_index = 0;
            }
        }
        let now = PreviousFrame {
            clip_from_world: frame.clip_from_world,
            world_position: frame.world_position,
            exposure: frame.exposure,
            size: self.targets.sizes.full,
            tile_log2: self.targets.sizes.tile_texels().ilog2(),
        };
        let is_of_last_frame = self.is_of_last_frame(frame);
        let is_elsewhere = !is_of_last_frame && self.previous.as_ref().is_some_and(|last| last.is_elsewhere(frame));
        let static_frames = if converged { 0 } else { static_frames };
        // A view at rest traces no kept rays, and learns only later of the change that wakes it.
        let wakes = self.is_at_rest && !is_at_rest(static_frames, self.accumulated) && self.light_scene != frame.scene;
        self.light_frames = if !self.targets.needs.light_changes {
            0
        } else if scene_changed || wakes {
            LIGHT_FRAMES
        } else {
            self.light_frames.saturating_sub(1)
        };
        let is_shifted = self.light_origin != frame.world_origin;
        let state = FrameState {
            sample_index: self.sample_index,
            accumulated: self.accumulated,
            static_frames,
            is_shifted,
            follows_light: self.light_frames > 0,
            is_cut: self.accumulated > 0 && !frame.follows_own_motion && (self.is_borrowed || is_elsewhere),
            has_screen: self.replaced.is_none() && (is_of_last_frame || !scene_changed),
            previous: self.previous.replace(now).unwrap_or(now),
        };
        self.drawn = frame.number;
        self.is_at_rest = state.is_at_rest();
        if self.follows_light() {
            (self.light_origin, self.light_scene) = (frame.world_origin, frame.scene);
        }
        let (sizes, rate) = (self.targets.sizes, &view.rate.thresholds);
        self.origin = frame.origin;
        self.uniform
            .set(GpuReflectionView::new(&view.settings, rate, sizes, frame, &state));
        self.accumulated = if frame.culled {
            0
        } else {
            (self.accumulated + 1).min(MOST_FRAMES)
        };
        self.sample_index = self.sample_index.wrapping_add(1);
        self.write_index ^= 1;
    }
}
