//! Renders a film without a window: the camera's path through a scene, with the environment map alone at the left, and with reflections at
//! the right.

use crate::{
    arguments::{Arguments, FILM_ENDING},
    image::{headless_app, wait_until_ready},
    method::Method,
    source::Source,
};
use bevy::prelude::*;
use core::time::Duration;
use std::fs;
use webp_animation::{Encoder, EncoderOptions, EncodingConfig, WebPData};

/// Quality of a frame, 0 to 100. At a higher quality the file is larger: 60 takes 21 KB for two images of 320x180.
const QUALITY: f32 = 60.0;
/// Rendered frames for each frame of the film, so that histories work as in a game.
const STEPS: u32 = 4;
/// White pixels between both images.
const GAP: usize = 4;

/// Renders the film of the command line and writes it. `frames` is its number of frames.
pub fn write(arguments: &Arguments, frames: u32) -> Result<(), String> {
    let source = arguments.source()?;
    let Source::BuiltIn(scene, _) = source else {
        return Err("a film needs the camera path of a built-in scene".to_owned());
    };
    let path = arguments.out(&source, FILM_ENDING)?;
    let seconds = glint_scenes::CameraPath::of(scene).seconds;
    let timestep = Duration::from_secs_f32(seconds / (frames * STEPS) as f32);
    let methods = [Method::Off, arguments.method()?];
    let mut sides = Vec::new();
    for method in &methods {
        sides.push(side(arguments, &source, method, frames, timestep)?);
    }
    let size = arguments.size();
    let joined = sides[0]
        .iter()
        .zip(&sides[1])
        .map(|(left, right)| beside(size, left, right));
    let film = encode(joined, size, timestep * STEPS).map_err(|error| error.to_string())?;
    fs::write(&path, &*film).map_err(|error| error.to_string())?;
    println!("wrote {} ({} KB)", path.display(), film.len() / 1000);
    Ok(())
}

/// All images of the film by one method.
fn side(
    arguments: &Arguments,
    source: &Source,
    method: &Method,
    frames: u32,
    timestep: Duration,
) -> Result<Vec<Vec<u8>>, String> {
    let mut app = headless_app(arguments, arguments.size(), timestep)?;
    source.spawn(app.world());
    let camera = app.spawn_camera(arguments.view);
    source.set_up_camera(camera, 0.0, app.world());
    method.apply(&mut app.world().entity_mut(camera), arguments.backend);
    wait_until_ready(&mut app, source)?;
    let mut images = Vec::new();
    for step in 0..frames * STEPS {
        source.move_camera(camera, step as f32 / (frames * STEPS) as f32, app.world());
        app.step(1);
        if step % STEPS == STEPS - 1 {
            images.push(app.capture().map_err(|error| error.to_string())?);
        }
    }
    Ok(images)
}

/// Two images of one size as one.
fn beside(size: UVec2, left: &[u8], right: &[u8]) -> Vec<u8> {
    let line = size.x as usize * 4;
    let lines = left.chunks_exact(line).zip(right.chunks_exact(line));
    lines
        .flat_map(|(left, right)| [left, &[255; 4 * GAP], right].concat())
        .collect()
}

fn encode(
    images: impl Iterator<Item = Vec<u8>>,
    size: UVec2,
    frame_time: Duration,
) -> Result<WebPData, webp_animation::Error> {
    let options = EncoderOptions {
        // Each frame is complete: squares that stay from earlier frames are seen on what moves slowly.
        kmin: 0,
        kmax: 1,
        encoding_config: Some(EncodingConfig::new_lossy(QUALITY)),
        ..default()
    };
    let mut encoder = Encoder::new_with_options((2 * size.x + GAP as u32, size.y), options)?;
    let mut time = Duration::ZERO;
    for image in images {
        encoder.add_frame(&image, time.as_millis() as i32)?;
        time += frame_time;
    }
    encoder.finalize(time.as_millis() as i32)
}
