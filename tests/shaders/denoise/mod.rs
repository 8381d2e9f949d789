//! The denoiser.

mod pass;
mod reference;
pub mod wall;

mod filters;
mod one_pass;
mod passes;
mod resting;
