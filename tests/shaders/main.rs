//! Shaders without an app: compares their modules, functions and passes with twins on the CPU, and these twins with known results.

#[path = "../common/mod.rs"]
mod common;

mod compute;
mod cost;
mod gpu;
mod linked;
mod wesl;

mod denoise;
mod fog;
mod haze;
mod light_sampling;
mod lights;
mod march;
mod modules;
mod packing;
mod rate;
mod rays;
mod sampling;
mod screen;
mod tracer;
mod translate;
