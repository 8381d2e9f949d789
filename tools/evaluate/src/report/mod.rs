//! Results: rows of the measurements, and the tables and charts made of them.

mod charts;
mod decomposition;
mod dominance;
mod held_out;
mod light_bias;
mod markdown;
mod objects;
mod output;
mod paper;
mod readme;
pub mod regressions;
pub mod rows;
pub mod summary;
pub mod table;
pub mod tables;
