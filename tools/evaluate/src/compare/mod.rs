//! Errors of images: FLIP and others, computed beside the renderer and written down at once.

pub mod decomposition;
#[cfg(test)]
mod degradations;
pub mod image;
pub mod log;
pub mod metrics;
pub mod pool;
pub mod reflected_light;
pub mod score;
