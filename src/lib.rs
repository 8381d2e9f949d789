//! Ray-traced reflections at a variable shading rate for the Bevy game engine.

pub mod scene;
