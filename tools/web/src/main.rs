//! The demo for browsers with WebGPU: `cargo xtask web` builds its page.
//!
//! | file | contents |
//! |---|---|
//! | `page.rs` | input from the page, and output to it |
//! | `demo.rs` | scene, camera and panel |
//! | `compare.rs` | the frame with and without ray-traced reflections, side by side |

#[cfg(target_arch = "wasm32")]
mod compare;
#[cfg(target_arch = "wasm32")]
mod demo;
#[cfg(target_arch = "wasm32")]
mod page;

#[cfg(target_arch = "wasm32")]
fn main() {
    demo::run();
}

#[cfg(not(target_arch = "wasm32"))]
fn main() {
    eprintln!("this program runs in browsers; `cargo xtask web` builds a page around it");
}
