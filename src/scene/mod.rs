//! What a ray can hit: geometry, acceleration structures, materials, lights and environment.

pub mod environment;
pub mod gpu_types;
pub mod lights;
pub mod materials;
mod texture_layers;
pub mod textures;
