//! The software tracer.

mod soup;

mod bvh;
mod coplanar;
mod corrupt;
mod oracle;
mod shader;
