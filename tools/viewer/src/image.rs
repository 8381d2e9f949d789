//! Renders an image without a window.

use crate::{
    arguments::{Arguments, IMAGE_ENDING},
    gltf::Framing,
    method::Method,
    plugins,
    source::Source,
};
use bevy::{
    diagnostic::FrameCount,
    light::{DirectionalLightShadowMap, PointLightShadowMap},
    prelude::*,
};
use bevy_glint::{RayTracedReflections, ReflectionStatus};
use glint_scenes::{HeadlessApp, HeadlessSettings, browser_device, drop_anisotropy, save_picture};
use std::{thread, time::Duration};

/// Frames within which loading and compiling must finish.
const FRAME_LIMIT: u32 = 20_000;

/// Renders the image of the command line and writes it.
pub fn write(arguments: &Arguments) -> Result<(), String> {
    let source = arguments.source()?;
    let method = arguments.method()?;
    let path = arguments.out(&source, IMAGE_ENDING)?;
    let size = if arguments.compare {
        (arguments.size() / 2).max(UVec2::ONE)
    } else {
        arguments.size()
    };
    let mut app = headless_app(arguments, size, HeadlessSettings::default().timestep)?;
    source.spawn(app.world());
    if arguments.browser {
        drop_anisotropy(&mut app.world().resource_mut());
    }
    let camera = app.spawn_camera(arguments.view);
    source.set_up_camera(camera, arguments.path, app.world());
    let mut image = |method: &Method, is_still, frames| {
        method.apply(&mut app.world().entity_mut(camera), arguments.backend);
        render(&mut app, &source, is_still, frames)
    };
    let (size, bytes) = if arguments.compare {
        let images = [
            image(&Method::Off, true, arguments.frames)?,
            image(&Method::ScreenSpace, true, arguments.frames)?,
            image(&method, true, arguments.frames)?,
            image(&Method::ground_truth(), true, arguments.truth_frames)?,
        ];
        (size * 2, two_rows(size, &images))
    } else {
        (
            size,
            image(&method, arguments.still || method.is_converged(), arguments.frames)?,
        )
    };
    save_picture(size, bytes, &path).map_err(|error| error.to_string())?;
    println!("wrote {}", path.display());
    Ok(())
}

/// An app without a window, in which this much time passes from frame to frame.
pub fn headless_app(arguments: &Arguments, size: UVec2, timestep: Duration) -> Result<HeadlessApp, String> {
    let mut settings = HeadlessSettings {
        size,
        timestep,
        log: true,
        ..default()
    };
    if arguments.browser {
        settings.device = browser_device();
    }
    HeadlessApp::with_device(
        settings,
        |app| plugins::add_before_bevy(app, arguments.backend),
        |app| {
            plugins::add_after_bevy(app, arguments);
            // A small image doesn't show more of them, and a CPU takes long to draw large ones.
            let edge = size.max_element().saturating_mul(2).next_power_of_two() as usize;
            app.insert_resource(DirectionalLightShadowMap {
                size: edge.clamp(256, 2048),
            });
            app.insert_resource(PointLightShadowMap {
                size: edge.clamp(256, 2048) / 2,
            });
        },
    )
    .map_err(|error| error.to_string())
}

/// Renders frames once everything is ready; `is_still` stops the clock.
fn render(app: &mut HeadlessApp, source: &Source, is_still: bool, frames: u32) -> Result<Vec<u8>, String> {
    wait_until_ready(app, source)?;
    // The same noise in each image, however many frames that took.
    app.world().resource_mut::<FrameCount>().0 = 0;
    if is_still {
        app.world().resource_mut::<Time<Virtual>>().pause();
    }
    app.step(frames);
    app.capture().map_err(|error| error.to_string())
}

/// Waits until everything is loaded, compiled and can be hit by rays.
pub fn wait_until_ready(app: &mut HeadlessApp, source: &Source) -> Result<(), String> {
    app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
    if let Source::File(path) = source
        && *app.world().resource::<Framing>() != Framing::Done
    {
        return Err(format!("'{}' holds nothing that can be seen", path.display()));
    }
    wait_for_scene(app);
    Ok(())
}

/// Renders with the clock stopped until rays can hit everything, then resets every history and starts the clock: moving objects
/// keep their places, however long that took.
fn wait_for_scene(app: &mut HeadlessApp) {
    app.world().resource_mut::<Time<Virtual>>().pause();
    for _ in 0..FRAME_LIMIT {
        if !is_pending(app.world()) {
            break;
        }
        thread::sleep(Duration::from_millis(2));
        app.step(1);
    }
    // Uploads of the last frame are traced in the next one.
    app.step(2);
    let world = app.world();
    for mut reflections in world.query::<&mut RayTracedReflections>().iter_mut(world) {
        reflections.reset = true;
    }
    world.resource_mut::<Time<Virtual>>().unpause();
}

/// A camera reflects, and rays can't hit everything yet.
fn is_pending(world: &mut World) -> bool {
    let is_wanted = world.query::<&RayTracedReflections>().iter(world).next().is_some();
    let report = world.resource::<ReflectionStatus>().report();
    is_wanted && report.tracer.is_some() && (!report.ready || report.meshes_pending > 0)
}

/// Four images of one size as one: two above, two below.
fn two_rows(size: UVec2, images: &[Vec<u8>]) -> Vec<u8> {
    let line = size.x as usize * 4;
    let mut bytes = Vec::with_capacity(images.len() * line * size.y as usize);
    for row in images.chunks(2) {
        for y in 0..size.y as usize {
            for image in row {
                bytes.extend_from_slice(&image[y * line..(y + 1) * line]);
            }
        }
    }
    bytes
}
