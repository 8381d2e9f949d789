//! The software tracer.

mod soup;

mod bvh;
mod corrupt;
mod oracle;
mod shader;
