//! Ray-traced reflections at a variable shading rate for the Bevy game engine.

// A library reports through the log and through types; it neither prints nor panics on what a user gave it.
#![warn(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, clippy::expect_used)]

pub mod scene;
pub mod trace;
