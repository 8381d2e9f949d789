//! What a ray can hit: geometry, acceleration structures, materials, lights and environment.

pub mod arena;
pub mod geometry;
pub mod gpu_types;
#[cfg(test)]
mod test_gpu;
