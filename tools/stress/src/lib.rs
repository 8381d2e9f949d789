//! Attacks every stage of `bevy_glint`: `cargo xtask stress --minutes 30`.
//!
//! | module | knows |
//! |---|---|
//! | [`recipe`] | what a hostile scene is made of: a seed and ingredients, drawn at random and made simpler |
//! | [`ingredients`], [`glb`] | how each ingredient is built |
//! | [`runner`] | how a recipe is rendered, and whose fault it is when that fails |
//! | [`checks`], [`paths`] | what must hold of every scene |
//! | [`energy`], [`furnace`], [`stability`], [`long_run`] | what must hold of known scenes: light, flicker, time |
//! | [`bounds`] | what runtime checks in shaders may change: nothing |
//! | [`faults`] | devices that lack something or are lost, shaders that don't compile |
//! | [`viewer`] | what the viewer makes of broken files |
//! | [`judge`] | what a measurement says about a limit, and when it says nothing |
//! | [`section`], [`work`], [`measure`] | the parts of a run, and what a working process does for each |
//! | [`supervisor`], [`process`], [`pulse`], [`outcome`] | who divides the time, starts processes, outlives them and sums up |
//!
//! Everything random follows from a seed. What fails is printed with the options that try it again.

pub mod bounds;
pub mod checks;
pub mod energy;
pub mod faults;
pub mod furnace;
mod game;
pub mod glb;
pub mod ingredients;
pub mod judge;
pub mod long_run;
pub mod measure;
pub mod messages;
pub mod outcome;
pub mod paths;
pub mod picture;
pub mod process;
pub mod pulse;
pub mod random;
pub mod recipe;
pub mod report;
pub mod runner;
pub mod section;
mod settle;
pub mod stability;
pub mod stage;
pub mod still;
pub mod supervisor;
pub mod viewer;
pub mod work;
