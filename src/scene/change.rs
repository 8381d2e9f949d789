//! Changes of the scene, by their effect on views that converge while nothing changes.

/// Frames for which a changed object stays marked: rays are few, and objects can move in some frames only. More keeps views from
/// converging for longer after a change; less misses changes that few rays hit.
pub const RESTLESS_FRAMES: u32 = 16;

/// A change of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Change {
    /// There is none.
    #[default]
    Nothing,
    /// Rays tell whether they meet it, by a mark on an instance, a material or a light. It concerns the views in which they do.
    Marked,
    /// It concerns all views: something came, went or began to move, and rays that meet it no longer can't tell.
    Unmarked,
}

/// Counts changes of the scene that rays can see.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneVersion {
    /// All of them.
    pub all: u32,
    /// Changes that concern all views.
    pub unmarked: u32,
}

impl SceneVersion {
    /// Counts a change.
    pub fn note(&mut self, change: Change) {
        self.all = self.all.wrapping_add(u32::from(change > Change::Nothing));
        self.unmarked = self.unmarked.wrapping_add(u32::from(change == Change::Unmarked));
    }
}
