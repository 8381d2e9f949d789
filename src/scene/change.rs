//! Changes of the scene, by their effect on views that converge while nothing changes.

/// Frames for which a changed object stays marked: only some pixels trace rays each frame, and objects can move in some frames
/// only. A higher number keeps views from converging for longer after a change; a lower one misses changes that few rays hit.
pub const RESTLESS_FRAMES: u32 = 16;

/// A change of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Change {
    /// No change.
    #[default]
    Nothing,
    /// An instance, a material or a light is marked, so that rays detect the change. It affects the views in which they do.
    Marked,
    /// The change affects all views: an object appeared, disappeared or began to move, and rays that no longer hit it can't detect that.
    Unmarked,
}

/// Counts changes of the scene that rays can see.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneVersion {
    /// All changes.
    pub all: u32,
    /// Changes that affect all views.
    pub unmarked: u32,
}

impl SceneVersion {
    /// Counts a change.
    pub fn note(&mut self, change: Change) {
        self.all = self.all.wrapping_add(u32::from(change > Change::Nothing));
        self.unmarked = self.unmarked.wrapping_add(u32::from(change == Change::Unmarked));
    }
}
