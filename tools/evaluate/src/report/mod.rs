//! Results: rows and statistics of the measurements, and the tables, charts and texts made of them.

mod analysis;
mod charts;
mod decomposition;
mod dominance;
mod held_out;
mod light_bias;
mod objects;
pub mod output;
mod paper;
mod pareto;
mod readme;
pub mod regressions;
pub mod rows;
mod stats;
mod summary;
pub mod table;
pub mod tables;
