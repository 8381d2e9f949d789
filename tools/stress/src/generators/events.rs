//! Kinds of events between frames: sizes, settings and clocks change, objects come and go, cameras jump.

use Change::{Everything, Nothing, Objects, Restart, View};

/// What an event changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    /// Neither the scene nor a camera nor its settings.
    Nothing,
    /// Cameras, their settings, or materials.
    View,
    /// Reflecting cameras go and come.
    Restart,
    /// Objects come, go, move or are hidden, or their meshes change.
    Objects,
    /// Both objects and cameras go.
    Everything,
}

kinds! {
    EventKind, fn change() -> Change {
        // To a random size in every frame.
        Resize => View,
        ToggleReflections => Restart,
        ToggleHdr => View,
        ToggleMsaa => View,
        ToggleCamera => Restart,
        // Halfway.
        DespawnAll => Everything,
        DespawnObjects => Objects,
        // In every frame.
        Respawn => Objects,
        PauseTime => Nothing,
        JumpTime => Nothing,
        // Frame numbers overflow.
        FrameOverflow => Nothing,
        // A little in every frame.
        MoveCamera => View,
        // Far away and back.
        Teleport => View,
        NanCameraOnce => View,
        JumpExposure => View,
        SwitchTechnique => View,
        SwitchPreset => View,
        SwitchRate => View,
        SwitchView => View,
        ResetHistory => Nothing,
        MoveObjects => Objects,
        NanObjectOnce => Objects,
        ChangeMeshes => Objects,
        ChangeMaterials => View,
        // Objects are also excluded from reflections and included.
        ToggleVisibility => Objects,
        // The environment map comes and goes.
        ToggleEnvironment => View,
        ChangeProjection => View,
        // Meshes are removed, and others inserted under their ids.
        ReplaceMeshes => Objects,
        // Meshes exist only in the render world, and then in both worlds again.
        ChangeUsage => Objects,
        // In other sizes.
        ReloadImages => View,
        // Materials request images that can't be loaded.
        FailedImage => View,
        // Objects are disabled and enabled.
        ToggleDisabled => Objects,
        // A level is loaded in one frame and unloaded in the next.
        LoadLevels => Objects,
        // Skinned characters begin to move and stop.
        MoveCrowd => Objects,
    }
}

impl EventKind {
    #[cfg(test)]
    pub fn changes_objects(self) -> bool {
        matches!(change(self), Objects | Everything)
    }

    /// Reflecting cameras go, and can come back.
    pub fn restarts(self) -> bool {
        matches!(change(self), Restart | Everything)
    }

    /// Scene, camera and settings don't change.
    pub fn is_static(self) -> bool {
        change(self) == Nothing
    }
}
