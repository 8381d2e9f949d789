//! The metrics on rendered images: equal settings have no difference, and known damage ranks in the right order.

use super::{image::from_rgba, metrics};
use crate::machine::unless_skipped;
use bevy::{math::UVec2, prelude::*};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTechnique, ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SceneName, SceneOptions};
use image::RgbImage;
use std::time::{Duration, Instant};

/// Frames that are averaged.
const SAMPLES: u32 = 24;

fn app() -> Option<HeadlessApp> {
    let settings = HeadlessSettings {
        size: UVec2::new(192, 108),
        ..default()
    };
    let tracer = ReflectionTracerChoice::Bvh;
    let app = HeadlessApp::new(settings, |app| {
        app.add_plugins(RayTracedReflectionsPlugin { tracer, ..default() });
    });
    unless_skipped(app.map_err(|error| error.to_string()))
}

/// The mirror floor with some roughness; `None` for no reflection.
fn render(app: &mut HeadlessApp, camera: Entity, roughness: Option<f32>) -> RgbImage {
    let world = app.world();
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    for (_, material) in materials.iter_mut() {
        if material.metallic == 1.0 {
            material.perceptual_roughness = roughness.unwrap_or(0.0);
        }
    }
    let settings = RayTracedReflections {
        technique: ReflectionTechnique::Converged,
        roughness_cutoff: 1.0,
        roughness_fade: 0.0,
        ..default()
    };
    if roughness.is_some() {
        world.entity_mut(camera).insert(settings);
    } else {
        world.entity_mut(camera).remove::<RayTracedReflections>();
    }
    app.warm_up(20_000).unwrap();
    let start = Instant::now();
    while roughness.is_some() {
        let report = app.world().resource::<ReflectionStatus>().report();
        if report.ready && report.meshes_pending == 0 {
            break;
        }
        assert!(start.elapsed() < Duration::from_secs(300), "{report}");
        std::thread::sleep(Duration::from_millis(2));
        app.step(1);
    }
    app.step(4);
    if let Some(mut settings) = app.world().get_mut::<RayTracedReflections>(camera) {
        settings.reset = true;
    }
    app.step(SAMPLES);
    let size = app.size();
    from_rgba(size.x, size.y, app.capture().unwrap()).unwrap()
}

/// Every pixel one to the left.
fn shifted(image: &RgbImage) -> RgbImage {
    let (width, height) = image.dimensions();
    RgbImage::from_fn(width, height, |x, y| image[((x + 1) % width, y)])
}

#[test]
fn known_damage_ranks_as_it_must() {
    let Some(mut app) = app() else { return };
    let camera = app.spawn_scene(SceneName::MirrorRoom, &SceneOptions::default());
    let truth = render(&mut app, camera, Some(0.0));
    let again = render(&mut app, camera, Some(0.0));
    let slight = render(&mut app, camera, Some(0.2));
    let strong = render(&mut app, camera, Some(0.5));
    let off = render(&mut app, camera, None);
    let flip = |image: &RgbImage| metrics::flip(&truth, image).unwrap().mean;
    let psnr = |image: &RgbImage| metrics::psnr(&truth, image).unwrap();
    let moved = shifted(&truth);
    println!(
        "FLIP: again {:.5}, moved {:.5}, roughness 0.2 {:.5}, 0.5 {:.5}, off {:.5}",
        flip(&again),
        flip(&moved),
        flip(&slight),
        flip(&strong),
        flip(&off)
    );
    assert_eq!(flip(&truth), 0.0);
    assert_eq!(psnr(&truth), metrics::PERFECT_PSNR);
    // A mirror has no noise: the same settings give the same image.
    assert!(flip(&again) < 1e-3, "{}", flip(&again));
    assert!(flip(&moved) > 10.0 * flip(&again).max(1e-4), "{}", flip(&moved));
    assert!(flip(&slight) > 10.0 * flip(&again).max(1e-4), "{}", flip(&slight));
    assert!(flip(&strong) > flip(&slight), "{} {}", flip(&strong), flip(&slight));
    assert!(flip(&off) > flip(&slight), "{} {}", flip(&off), flip(&slight));
    assert!(psnr(&off) < psnr(&slight) && psnr(&slight) < psnr(&again));
}
