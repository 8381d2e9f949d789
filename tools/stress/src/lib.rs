//! Attacks every stage of `bevy_glint`: `cargo xtask stress --minutes 30`.
//!
//! From the top down; a module imports only modules below it.
//!
//! | module | content |
//! |---|---|
//! | [`runner`], [`summary`] | divides the time among sections, survives crashes and hangs of worker processes, sums up |
//! | [`campaign`] | keeps what many thousands of scenes have shown, and which ingredients have met |
//! | [`process`] | starts a worker process, reads its messages, kills it when it hangs |
//! | [`worker`], [`report`] | executes the job of a worker process and reports |
//! | [`protocol`], [`options`], [`selection`] | jobs, messages, options, and parts of a run, as data |
//! | [`viewer`] | broken files in the viewer |
//! | [`faults`] | devices that lack something or are lost, shaders that don't compile |
//! | [`bounds`] | runtime checks in shaders must not change a frame |
//! | [`fuzzer`] | renders scenarios, attributes failures to the library or to Bevy, simplifies scenarios that fail |
//! | [`energy`], [`furnace`], [`stability`], [`long_run`] | properties of known scenes: light, flicker, time |
//! | `oracle` | rays through a scene against brute force |
//! | `budget` | time and memory that a scene may take |
//! | [`invariants`], [`path_equivalence`] | properties of every scene |
//! | `events` | applies events between frames |
//! | [`scenario`] | a hostile scene as data: a seed and a list of generators |
//! | [`generators`], [`glb`] | generators of meshes, lights, files, views, settings and events |
//! | [`static_scene`] | known scenes in which nothing moves, and averages of their frames |
//! | `fixture`, `wait` | an app to inject faults into; waiting for work in the background |
//! | [`harness`] | an app without a window that survives the loss of its device |
//! | [`statistics`], [`image`], [`log_capture`], [`heartbeat`], [`tally`], [`verdict`], [`word`] | small tools |
//!
//! Everything random follows from a seed. Each failure is printed with the options that repeat it.

pub mod bounds;
mod budget;
pub mod campaign;
pub mod energy;
mod events;
pub mod faults;
mod fixture;
pub mod furnace;
pub mod fuzzer;
pub mod generators;
pub mod glb;
pub mod harness;
pub mod heartbeat;
pub mod image;
pub mod invariants;
pub mod log_capture;
pub mod long_run;
pub mod options;
mod oracle;
pub mod path_equivalence;
pub mod process;
pub mod protocol;
pub mod report;
pub mod runner;
pub mod scenario;
pub mod selection;
pub mod stability;
pub mod static_scene;
pub mod statistics;
pub mod summary;
pub mod tally;
pub mod verdict;
pub mod viewer;
mod wait;
pub mod word;
pub mod worker;

#[cfg(test)]
mod tests;
