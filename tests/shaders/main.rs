//! Shaders without an app: their modules, functions and passes against mirrors on the CPU, and these mirrors against what is known.

#[path = "../common/mod.rs"]
mod common;

mod compute;
mod cost;
mod gpu;
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
