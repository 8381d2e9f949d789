//! Scenes built from code, a harness that renders them without a window, and worker processes: shared by the examples, the tests and the
//! measurements.
//!
//! Units are metres, lumens, lux and cd/m², as in Bevy. No code here depends on the reflections: every scene renders with plain Bevy.

#[cfg(not(target_arch = "wasm32"))]
mod alone;
mod animation;
mod atrium;
mod builder;
mod camera_path;
mod camera_place;
mod demo;
mod environment;
mod file_light;
#[cfg(not(target_arch = "wasm32"))]
mod file_scene;
mod file_view;
mod geometry;
mod glass;
#[cfg(not(target_arch = "wasm32"))]
mod gltf;
#[cfg(not(target_arch = "wasm32"))]
mod headless;
mod held_out;
mod image_size;
mod materials;
#[cfg(not(target_arch = "wasm32"))]
mod missing_images;
mod moving;
mod patterns;
mod prelude;
mod props;
mod random;
#[cfg(not(target_arch = "wasm32"))]
mod recorded_path;
mod scene;
mod shapes;
mod sky;
mod small;
mod street;
mod temple;
mod texture;
#[cfg(not(target_arch = "wasm32"))]
mod worker;

#[cfg(not(target_arch = "wasm32"))]
pub use alone::is_alone;
pub use animation::{SceneAnimationPlugin, set_time};
pub use builder::{SceneBuilder, SceneMesh, SceneStatistics};
pub use camera_path::CameraPath;
pub use camera_place::CameraPlace;
pub use environment::{Environment, SceneOptions};
pub use file_light::{file_environment, file_sun};
#[cfg(not(target_arch = "wasm32"))]
pub use file_scene::{arrange_file, file_cameras, load_file};
pub use file_view::FileView;
pub use geometry::Geometry;
#[cfg(not(target_arch = "wasm32"))]
pub use gltf::write_test_assets;
#[cfg(not(target_arch = "wasm32"))]
pub use headless::{
    HeadlessApp, HeadlessError, HeadlessSettings, LogMessage, Output, ReplacedShader, SystemClock, browser_device,
    capture_log, decode_halves, note_left_out, read_buffer, read_image, read_texture, save_picture, take_log,
};
pub use image_size::ImageSize;
#[cfg(not(target_arch = "wasm32"))]
pub use missing_images::{MissingImages, MissingImagesPlugin};
pub use random::Random;
#[cfg(not(target_arch = "wasm32"))]
pub use recorded_path::RecordedPath;
pub use scene::{SceneName, UnknownScene, camera, environment, spawn, spawn_with};
pub use sky::{Sky, even_cube, sun_direction};
pub use small::FURNACE_ROUGHNESS;
pub use texture::{Content, Texel, TextureSet, drop_anisotropy, mip_chain};
#[cfg(not(target_arch = "wasm32"))]
pub use worker::{WorkerLimits, run_worker, this_program};
