//! The denoiser.

mod pass;
mod reference;
pub mod wall;

mod filters;
mod passes;
mod resting;
