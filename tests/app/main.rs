//! Apps that reflect: images, reports, the panel, examples, and the README as a new user follows it.

#[path = "../common/mod.rs"]
mod common;

mod pictures;
mod stage;

mod adaptive;
mod arrivals;
mod auto_quality;
mod back_ends;
mod bounces;
mod bsn;
mod budget;
mod compiling;
mod convergence;
mod debug_views;
mod deferred;
mod details;
mod devices;
mod dynamics;
mod effects;
mod events;
mod examples;
mod exposure;
mod floating_origin;
mod forward;
mod front_layer;
mod ground_truth;
mod guides;
mod half_resolution;
mod idle;
mod levels;
mod lights;
mod lives;
mod many_lights;
mod materials;
mod memory;
mod merging;
mod mirror_suite;
mod mirrored;
mod new_user;
#[cfg(feature = "egui")]
mod panel;
mod plugin;
mod poses;
mod quality;
mod reflect;
mod render_layers;
mod resolution;
mod robustness;
mod screen_traces;
mod see_through;
mod shipped;
mod static_views;
mod surface_shader;
mod toggle;
mod trails;
mod walk;
mod waves;
mod worlds;
