//! Attacks every stage of `bevy_glint`: `cargo xtask stress --minutes 30`.
//!
//! | module | knows |
//! |---|---|
//! | [`recipe`] | what a hostile scene is made of: a seed and ingredients, drawn at random and made simpler |
//! | [`ingredients`] | how each ingredient is built |
//! | [`runner`] | how a recipe is rendered, and whose fault it is when that fails |
//! | [`checks`], [`paths`] | what must hold of every scene |
//! | [`energy`], [`stability`], [`long_run`] | what must hold of known scenes: light, flicker, time |
//! | [`faults`] | devices that lack something or are lost, shaders that don't compile |
//! | [`section`], [`work`], [`supervisor`] | the parts of a run, processes that run them, and the one that outlives these |
//!
//! Everything random follows from a seed. What fails is printed with the options that try it again.

pub mod checks;
pub mod energy;
pub mod faults;
mod game;
pub mod ingredients;
pub mod long_run;
pub mod messages;
pub mod paths;
pub mod picture;
pub mod random;
pub mod recipe;
pub mod report;
pub mod runner;
pub mod section;
pub mod stability;
pub mod stage;
pub mod still;
pub mod supervisor;
pub mod work;
