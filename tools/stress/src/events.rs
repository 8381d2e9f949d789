//! Applies events between frames to a scene.

mod life;

use crate::{
    generators::{EventKind, HostileScene},
    harness::{FRAME_TIME, Harness},
};
use bevy::{
    camera::{Exposure, Hdr},
    diagnostic::FrameCount,
    prelude::*,
    time::TimeUpdateStrategy,
};
use bevy_glint::{
    NotReflected, RayTracedReflections, ReflectionDebugView, ReflectionPreset, ReflectionTechnique, ShadingRate,
    ShadingRateHeuristic,
};
use core::time::Duration;

pub fn before_frame(kind: EventKind, harness: &mut Harness, scene: &mut HostileScene, frame: u32, frames: u32) {
    let halfway = frame == frames / 2;
    match kind {
        EventKind::DespawnAll if halfway => scene.remove(harness),
        EventKind::DespawnObjects if halfway => harness.despawn(scene.objects.drain(..)),
        EventKind::DespawnAll | EventKind::DespawnObjects => {}
        EventKind::Respawn => respawn(harness, scene),
        EventKind::PauseTime | EventKind::JumpTime | EventKind::FrameOverflow => change_clocks(kind, harness, frame),
        EventKind::MoveObjects
        | EventKind::NanObjectOnce
        | EventKind::ChangeMeshes
        | EventKind::ChangeMaterials
        | EventKind::ToggleVisibility => change_objects(kind, harness, scene, frame),
        EventKind::ReplaceMeshes
        | EventKind::ChangeUsage
        | EventKind::ReloadImages
        | EventKind::FailedImage
        | EventKind::ToggleDisabled => life::change_assets(kind, harness, scene, frame),
        EventKind::LoadLevels => life::load_level(harness, scene),
        EventKind::MoveCrowd => life::move_crowd(harness, scene, frame),
        EventKind::Resize => {
            for &camera in &scene.cameras {
                let random = &mut scene.random;
                let size = UVec2::new(1 + random.below(90) as u32, 1 + random.below(70) as u32);
                harness.resize(camera, size);
            }
        }
        _ => {
            for camera in scene.cameras.clone() {
                if harness.world().get_entity(camera).is_ok() {
                    change_camera(kind, harness, scene, camera, frame);
                }
            }
        }
    }
}

fn change_clocks(kind: EventKind, harness: &mut Harness, frame: u32) {
    let world = harness.world();
    match kind {
        EventKind::PauseTime => {
            let mut time = world.resource_mut::<Time<Virtual>>();
            if frame % 3 == 1 {
                time.unpause();
            } else {
                time.pause();
            }
        }
        EventKind::JumpTime => {
            let steps = [
                Duration::ZERO,
                Duration::from_secs(3600),
                FRAME_TIME,
                Duration::from_nanos(1),
            ];
            let step = steps[frame as usize % steps.len()];
            world.insert_resource(TimeUpdateStrategy::ManualDuration(step));
            let speed = if frame.is_multiple_of(2) { 0.0 } else { 1000.0 };
            world.resource_mut::<Time<Virtual>>().set_relative_speed(speed);
        }
        _ => {
            if frame == 0 {
                world.insert_resource(FrameCount(u32::MAX - 1));
            }
        }
    }
}

fn respawn(harness: &mut Harness, scene: &mut HostileScene) {
    harness.despawn(scene.objects.drain(..));
    if harness.world().get_entity(scene.root).is_err() {
        return;
    }
    for _ in 0..4 {
        let random = &mut scene.random;
        let position = Transform::from_xyz(random.range(-1.0, 1.0), random.range(0.2, 1.0), random.range(-1.0, 0.5));
        let material = StandardMaterial {
            metallic: random.pick(&[0.0, 1.0]),
            perceptual_roughness: 0.3,
            ..default()
        };
        let objects = harness.spawn_objects(scene.root, Cuboid::from_length(0.4), material, [position]);
        scene.objects.extend(objects);
    }
}

fn change_objects(kind: EventKind, harness: &mut Harness, scene: &mut HostileScene, frame: u32) {
    let random = &mut scene.random;
    let world = harness.world();
    for (index, &entity) in scene.objects.iter().enumerate() {
        let Ok(mut object) = world.get_entity_mut(entity) else {
            continue;
        };
        match kind {
            EventKind::MoveObjects => {
                if let Some(mut transform) = object.get_mut::<Transform>() {
                    transform.translation.y += random.range(-0.1, 0.1);
                    transform.rotate_y(0.3);
                }
            }
            EventKind::NanObjectOnce => {
                if let Some(mut transform) = object.get_mut::<Transform>() {
                    transform.translation.x = if frame == 1 { f32::NAN } else { index as f32 * 0.3 - 1.0 };
                }
            }
            EventKind::ChangeMeshes => {
                let mesh = object.get().map(|Mesh3d(mesh)| mesh.clone());
                let size = random.range(0.1, 0.7);
                change_asset(world, mesh, |mesh: &mut Mesh| *mesh = Cuboid::from_length(size).into());
            }
            EventKind::ChangeMaterials => {
                let material = object.get().map(|MeshMaterial3d(material)| material.clone());
                let (roughness, mode) = (random.range(0.0, 1.0), random.pick(&MODES));
                change_asset(world, material, |material: &mut StandardMaterial| {
                    material.perceptual_roughness = roughness;
                    material.alpha_mode = mode;
                });
            }
            _ => {
                match (frame as usize + index) % 4 {
                    0 => object.insert(Visibility::Hidden),
                    1 => object.insert(Visibility::Inherited),
                    2 => object.insert(NotReflected),
                    _ => object.remove::<NotReflected>(),
                };
            }
        }
    }
}

fn change_asset<A: Asset>(world: &mut World, handle: Option<Handle<A>>, change: impl FnOnce(&mut A)) {
    if let Some(handle) = handle
        && let Some(mut asset) = world.resource_mut::<Assets<A>>().get_mut(&handle)
    {
        change(&mut asset);
    }
}

const MODES: [AlphaMode; 4] = [
    AlphaMode::Opaque,
    AlphaMode::Mask(0.5),
    AlphaMode::Opaque,
    AlphaMode::Blend,
];
const TECHNIQUES: [ReflectionTechnique; 4] = [
    ReflectionTechnique::Reference,
    ReflectionTechnique::Variable,
    ReflectionTechnique::Converged,
    ReflectionTechnique::Quarter,
];

fn change_camera(kind: EventKind, harness: &mut Harness, scene: &mut HostileScene, entity: Entity, frame: u32) {
    let odd = frame % 2 == 1;
    let rate = scene.random.pick(&ShadingRate::ALL);
    let setup = &scene.camera;
    let mut camera = harness.world().entity_mut(entity);
    match kind {
        EventKind::MoveCamera | EventKind::Teleport | EventKind::NanCameraOnce => {
            if let Some(mut transform) = camera.get_mut::<Transform>() {
                transform.translation = position(kind, setup.transform.translation, frame);
            }
        }
        EventKind::ToggleReflections => toggle(&mut camera, setup.reflections.clone().filter(|_| odd)),
        EventKind::ToggleHdr => toggle(&mut camera, odd.then_some(Hdr)),
        EventKind::ToggleMsaa => toggle(&mut camera, Some(if odd { Msaa::Off } else { Msaa::Sample4 })),
        EventKind::ToggleCamera => {
            if let Some(mut camera) = camera.get_mut::<Camera>() {
                camera.is_active = odd;
            }
        }
        EventKind::JumpExposure => {
            let ev100 = if odd { 12.0 } else { -0.263 };
            toggle(&mut camera, Some(Exposure { ev100 }));
        }
        EventKind::SwitchTechnique => {
            if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
                reflections.technique = nth(&TECHNIQUES, frame);
            }
        }
        EventKind::SwitchPreset => toggle(&mut camera, Some(nth(&ReflectionPreset::ALL, frame).settings())),
        EventKind::SwitchRate => toggle(&mut camera, Some(ShadingRateHeuristic::Uniform(rate))),
        EventKind::SwitchView => toggle(&mut camera, Some(nth(&ReflectionDebugView::ALL, frame))),
        EventKind::ResetHistory => {
            if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
                reflections.reset = true;
            }
        }
        EventKind::ToggleEnvironment => toggle(&mut camera, setup.light.clone().filter(|_| odd)),
        EventKind::ChangeProjection => {
            let orthographic = OrthographicProjection {
                scale: 0.05,
                ..OrthographicProjection::default_3d()
            };
            let projection = if odd {
                orthographic.into()
            } else {
                setup.projection.clone()
            };
            toggle(&mut camera, Some(projection));
        }
        _ => {}
    }
}

/// Inserts a bundle, or removes it.
fn toggle<B: Bundle>(camera: &mut EntityWorldMut, bundle: Option<B>) {
    _ = match bundle {
        Some(bundle) => camera.insert(bundle),
        None => camera.remove::<B>(),
    };
}

fn nth<T: Copy>(values: &[T], frame: u32) -> T {
    values[frame as usize % values.len()]
}

fn position(kind: EventKind, home: Vec3, frame: u32) -> Vec3 {
    match kind {
        EventKind::MoveCamera => home + Vec3::new(0.01, 0.003, -0.02) * frame as f32,
        EventKind::Teleport if frame % 2 == 1 => home + Vec3::new(1e6, 1.0, -40.0),
        EventKind::NanCameraOnce if frame == 1 => Vec3::splat(f32::NAN),
        _ => home,
    }
}
