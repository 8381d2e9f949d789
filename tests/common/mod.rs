//! Helpers of the integration tests. Each test binary uses a part of them.
#![allow(dead_code, reason = "each test binary uses a part")]

pub mod child;
pub mod gpu;
pub mod soup;
pub mod wesl;
