//! Measures, for each technique of `bevy_glint`, how much GPU time buys how much error, on which scene.
//!
//! `cargo xtask evaluate --quick --out results` runs it. One process plans ([`plan`]), compares pictures ([`pool`]) and writes
//! ([`rows`], [`summary`], [`charts`]); for each scene it starts another one that renders ([`run`], [`timing`]), so that a
//! driver that crashes costs one technique and not the run. Everything that is measured lies in files ([`state`], [`ledger`]) at
//! once: a run that was interrupted goes on where it stopped, and scenes can be measured one after the other into one folder.
//!
//! | module | knows |
//! |---|---|
//! | [`protocol`], [`plan`] | what is measured, how much of it, in which order |
//! | [`techniques`], [`stage`] | the library and the scenes: nothing else does |
//! | [`run`], [`timing`], [`truth`] | how to render and to time |
//! | [`jobs`], [`report`], [`progress`] | processes and the way between them |
//! | [`picture`], [`metrics`], [`stats`], [`judge`] | errors and noise |
//! | [`pool`], [`ledger`], [`state`] | what is compared when, and what is done |
//! | [`rows`], [`table`], [`compare`], [`charts`], [`summary`], [`findings`], [`paper`], [`readme`] | results |

mod background;
mod capture;
pub mod charts;
pub mod compare;
mod drawing;
pub mod findings;
pub mod jobs;
pub mod judge;
pub mod ledger;
pub mod machine;
pub mod metrics;
pub mod paper;
pub mod picture;
pub mod plan;
pub mod pool;
pub mod progress;
pub mod protocol;
pub mod raster;
pub mod readme;
pub mod report;
pub mod rows;
pub mod run;
pub mod stage;
pub mod state;
pub mod stats;
pub mod summary;
pub mod table;
pub mod techniques;
pub mod timing;
pub mod truth;
