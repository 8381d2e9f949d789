//! Kinds of events between frames: sizes, settings and clocks change, objects come and go, cameras jump.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Events between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum EventKind {
    /// The image changes its size in every frame.
    Resize,
    /// Reflections are switched off and on in every frame.
    ToggleReflections,
    /// HDR is switched off and on.
    ToggleHdr,
    /// Multisampling is switched on and off.
    ToggleMsaa,
    /// The camera is inactive in every other frame.
    ToggleCamera,
    /// Everything is despawned halfway, including the cameras.
    DespawnAll,
    /// All objects are despawned halfway.
    DespawnObjects,
    /// Objects are despawned and spawned in every frame.
    Respawn,
    /// The clock is paused and resumed.
    PauseTime,
    /// The clock jumps.
    JumpTime,
    /// Frame numbers overflow.
    FrameOverflow,
    /// The camera moves a little in every frame.
    MoveCamera,
    /// The camera jumps far and back.
    Teleport,
    /// The camera's position is NaN for one frame.
    NanCameraOnce,
    /// The exposure jumps.
    JumpExposure,
    /// The technique changes in every frame.
    SwitchTechnique,
    /// The preset changes in every frame.
    SwitchPreset,
    /// The rate changes in every frame.
    SwitchRate,
    /// The debug view changes in every frame.
    SwitchView,
    /// History is cleared in every frame.
    ResetHistory,
    /// Objects move.
    MoveObjects,
    /// The objects' positions are NaN for one frame.
    NanObjectOnce,
    /// Meshes change.
    ChangeMeshes,
    /// Materials change.
    ChangeMaterials,
    /// Objects are hidden, shown, excluded from reflections and included.
    ToggleVisibility,
    /// The environment map comes and goes.
    ToggleEnvironment,
    /// The projection changes.
    ChangeProjection,
    /// Meshes are removed, and others inserted under their ids.
    ReplaceMeshes,
    /// Meshes exist only in the render world, and then in both worlds again.
    ChangeUsage,
    /// Images are reloaded, in other sizes.
    ReloadImages,
    /// Materials request images that can't be loaded.
    FailedImage,
    /// Objects are disabled and enabled.
    ToggleDisabled,
    /// A level is loaded in one frame and unloaded in the next.
    LoadLevels,
    /// Skinned characters begin to move and stop.
    MoveCrowd,
}

impl EventKind {
    /// Objects come, go, move or are hidden, or their meshes change.
    #[must_use]
    pub fn changes_objects(self) -> bool {
        matches!(
            self,
            Self::DespawnAll
                | Self::DespawnObjects
                | Self::Respawn
                | Self::MoveObjects
                | Self::NanObjectOnce
                | Self::ChangeMeshes
                | Self::ToggleVisibility
                | Self::ReplaceMeshes
                | Self::ChangeUsage
                | Self::ToggleDisabled
                | Self::LoadLevels
                | Self::MoveCrowd
        )
    }

    /// Scene, camera and settings don't change.
    #[must_use]
    pub fn is_static(self) -> bool {
        matches!(
            self,
            Self::PauseTime | Self::JumpTime | Self::FrameOverflow | Self::ResetHistory
        )
    }
}
