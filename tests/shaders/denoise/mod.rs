//! The denoiser.

mod pass;
mod reference;
mod wall;

mod filters;
mod passes;
