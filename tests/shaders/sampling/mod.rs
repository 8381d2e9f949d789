//! Sequences of random numbers and the lobe of reflected rays.

pub mod reference;

mod lobe;
mod noise;
mod shader;
