//! Helpers of the integration tests. Each test binary uses a part of them.
#![allow(dead_code)]

pub mod gpu;
pub mod soup;
pub mod wesl;
