//! Errors of images (FLIP and others), computed in parallel to the renderer and written at once.

pub mod decomposition;
#[cfg(test)]
mod degradations;
pub mod image;
pub mod log;
pub mod metrics;
pub mod mix;
pub mod pool;
pub mod reflected_light;
pub mod score;
