//! Skinned and morphed meshes in their pose.
//!
//! - `extract.rs` reads joints and morph weights.

mod extract;

pub(super) use extract::{ExtractedPoses, extract_poses};
