//! Which rays are traced, and what they count for.

pub mod directional_albedo;
