//! What a ray can hit: geometry, acceleration structures, materials, lights and environment.

pub mod bvh;
pub mod gpu_types;
