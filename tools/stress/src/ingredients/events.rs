//! What happens between frames: sizes, settings and clocks change, things come and go, cameras jump.

use super::{HostileScene, kinds};
use crate::stage::{FRAME_TIME, Stage};
use bevy::{
    camera::{Exposure, Hdr},
    diagnostic::FrameCount,
    prelude::*,
    time::TimeUpdateStrategy,
};
use bevy_glint::{DebugView, NotReflected, Preset, RayTracedReflections, ShadingRate, ShadingRateHeuristic, Technique};
use core::time::Duration;

kinds! {
    /// What happens.
    EventKind {
        /// The picture gets another size in every frame.
        Resize,
        /// Reflections are switched off and on in every frame.
        ToggleReflections,
        /// HDR is switched off and on.
        ToggleHdr,
        /// Multisampling is asked for and taken back.
        ToggleMsaa,
        /// The camera rests in every other frame.
        ToggleCamera,
        /// Everything is despawned halfway, the cameras, too.
        DespawnAll,
        /// All objects are despawned halfway.
        DespawnObjects,
        /// Objects are despawned and spawned in every frame.
        Respawn,
        /// The clock stands still, runs, and stands still again.
        PauseTime,
        /// The clock jumps.
        JumpTime,
        /// Frame numbers run over.
        FrameOverflow,
        /// The camera moves a little in every frame.
        MoveCamera,
        /// The camera jumps far and back.
        Teleport,
        /// The camera's place is NaN for one frame.
        NanCameraOnce,
        /// The exposure jumps.
        JumpExposure,
        /// Every frame has another technique.
        SwitchTechnique,
        /// Every frame has another preset.
        SwitchPreset,
        /// Every frame has another rate.
        SwitchRate,
        /// Every frame has another debug view.
        SwitchView,
        /// History is forgotten in every frame.
        ResetHistory,
        /// Objects move.
        MoveObjects,
        /// An object's place is NaN for one frame.
        NanObjectOnce,
        /// Meshes change.
        ChangeMeshes,
        /// Materials change.
        ChangeMaterials,
        /// Objects are hidden, shown, opted out, opted in.
        ToggleVisibility,
        /// The environment map comes and goes.
        ToggleEnvironment,
        /// The projection changes.
        ChangeProjection,
    }
}

impl EventKind {
    /// Scene, camera and settings stay as they are.
    #[must_use]
    pub fn is_still(self) -> bool {
        matches!(
            self,
            Self::PauseTime | Self::JumpTime | Self::FrameOverflow | Self::ResetHistory
        )
    }
}

/// Lets an event happen before a frame.
pub fn before_frame(kind: EventKind, stage: &mut Stage, scene: &mut HostileScene, frame: u32, frames: u32) {
    let odd = frame % 2 == 1;
    let halfway = frame == frames / 2;
    match kind {
        EventKind::DespawnAll => {
            if halfway {
                scene.remove(stage);
            }
        }
        EventKind::DespawnObjects => {
            if halfway {
                despawn_subjects(stage, scene);
            }
        }
        EventKind::Respawn => respawn(stage, scene),
        EventKind::PauseTime | EventKind::JumpTime | EventKind::FrameOverflow => clocks(kind, stage, frame),
        EventKind::MoveObjects
        | EventKind::NanObjectOnce
        | EventKind::ChangeMeshes
        | EventKind::ChangeMaterials
        | EventKind::ToggleVisibility => objects(kind, stage, scene, frame),
        EventKind::Resize => {
            for &camera in &scene.cameras {
                let random = &mut scene.random;
                let size = UVec2::new(1 + random.below(90) as u32, 1 + random.below(70) as u32);
                stage.resize(camera, size);
            }
        }
        _ => {
            for camera in scene.cameras.clone() {
                if stage.world().get_entity(camera).is_ok() {
                    one_camera(kind, stage, scene, camera, (frame, odd));
                }
            }
        }
    }
}

fn clocks(kind: EventKind, stage: &mut Stage, frame: u32) {
    let world = stage.world();
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

fn despawn_subjects(stage: &mut Stage, scene: &mut HostileScene) {
    for entity in scene.subjects.drain(..) {
        if let Ok(entity) = stage.world().get_entity_mut(entity) {
            entity.despawn();
        }
    }
}

fn respawn(stage: &mut Stage, scene: &mut HostileScene) {
    despawn_subjects(stage, scene);
    if stage.world().get_entity(scene.root).is_err() {
        return;
    }
    for _ in 0..4 {
        let random = &mut scene.random;
        let place = Transform::from_xyz(random.range(-1.0, 1.0), random.range(0.2, 1.0), random.range(-1.0, 0.5));
        let metallic = random.pick(&[0.0, 1.0]);
        let world = stage.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(0.4));
        let material = StandardMaterial {
            metallic,
            perceptual_roughness: 0.3,
            ..default()
        };
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
        let object = (Mesh3d(mesh), MeshMaterial3d(material), place, ChildOf(scene.root));
        scene.subjects.push(world.spawn(object).id());
    }
}

fn objects(kind: EventKind, stage: &mut Stage, scene: &mut HostileScene, frame: u32) {
    let random = &mut scene.random;
    let world = stage.world();
    for (index, &entity) in scene.subjects.iter().enumerate() {
        match kind {
            EventKind::MoveObjects => {
                if let Some(mut transform) = world.get_mut::<Transform>(entity) {
                    transform.translation.y += random.range(-0.1, 0.1);
                    transform.rotate_y(0.3);
                }
            }
            EventKind::NanObjectOnce => {
                if let Some(mut transform) = world.get_mut::<Transform>(entity) {
                    transform.translation.x = if frame == 1 { f32::NAN } else { index as f32 * 0.3 - 1.0 };
                }
            }
            EventKind::ChangeMeshes => {
                let Some(mesh) = world.get::<Mesh3d>(entity).map(|mesh| mesh.0.clone()) else {
                    continue;
                };
                let size = random.range(0.1, 0.7);
                if let Some(mut mesh) = world.resource_mut::<Assets<Mesh>>().get_mut(&mesh) {
                    *mesh = Cuboid::from_length(size).into();
                }
            }
            EventKind::ChangeMaterials => {
                let Some(material) = world
                    .get::<MeshMaterial3d<StandardMaterial>>(entity)
                    .map(|material| material.0.clone())
                else {
                    continue;
                };
                let (roughness, mode) = (random.range(0.0, 1.0), random.pick(&MODES));
                if let Some(mut material) = world.resource_mut::<Assets<StandardMaterial>>().get_mut(&material) {
                    material.perceptual_roughness = roughness;
                    material.alpha_mode = mode;
                }
            }
            _ => {
                if let Ok(mut object) = world.get_entity_mut(entity) {
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
}

const MODES: [AlphaMode; 4] = [
    AlphaMode::Opaque,
    AlphaMode::Mask(0.5),
    AlphaMode::Opaque,
    AlphaMode::Blend,
];
const TECHNIQUES: [Technique; 4] = [
    Technique::Reference,
    Technique::Variable,
    Technique::Converged,
    Technique::Quarter,
];

fn one_camera(kind: EventKind, stage: &mut Stage, scene: &mut HostileScene, entity: Entity, when: (u32, bool)) {
    let (frame, odd) = when;
    let rate = scene.random.pick(&ShadingRate::ALL);
    let plan = &scene.plan;
    let home = plan.transform;
    let place = match kind {
        EventKind::MoveCamera => Some(home.translation + Vec3::new(0.01, 0.003, -0.02) * frame as f32),
        EventKind::Teleport if odd => Some(home.translation + Vec3::new(1e6, 1.0, -40.0)),
        EventKind::NanCameraOnce if frame == 1 => Some(Vec3::splat(f32::NAN)),
        EventKind::Teleport | EventKind::NanCameraOnce => Some(home.translation),
        _ => None,
    };
    let mut camera = stage.world().entity_mut(entity);
    if let (Some(place), Some(mut transform)) = (place, camera.get_mut::<Transform>()) {
        transform.translation = place;
    }
    match kind {
        EventKind::ToggleReflections => match &plan.reflections {
            Some(reflections) if odd => _ = camera.insert(reflections.clone()),
            _ => _ = camera.remove::<RayTracedReflections>(),
        },
        EventKind::ToggleHdr => {
            _ = if odd {
                camera.insert(Hdr)
            } else {
                camera.remove::<Hdr>()
            }
        }
        EventKind::ToggleMsaa => _ = camera.insert(if odd { Msaa::Off } else { Msaa::Sample4 }),
        EventKind::ToggleCamera => {
            if let Some(mut camera) = camera.get_mut::<Camera>() {
                camera.is_active = odd;
            }
        }
        EventKind::JumpExposure => {
            let ev100 = if odd { 12.0 } else { -0.263 };
            camera.insert(Exposure { ev100 });
        }
        EventKind::SwitchTechnique => {
            if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
                reflections.technique = TECHNIQUES[frame as usize % TECHNIQUES.len()];
            }
        }
        EventKind::SwitchPreset => _ = camera.insert(Preset::ALL[frame as usize % Preset::ALL.len()].settings()),
        EventKind::SwitchRate => _ = camera.insert(ShadingRateHeuristic::Uniform(rate)),
        EventKind::SwitchView => _ = camera.insert(DebugView::ALL[frame as usize % DebugView::ALL.len()]),
        EventKind::ResetHistory => {
            if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
                reflections.reset = true;
            }
        }
        EventKind::ToggleEnvironment => match &plan.light {
            Some(light) if odd => _ = camera.insert(light.clone()),
            _ => _ = camera.remove::<EnvironmentMapLight>(),
        },
        EventKind::ChangeProjection => {
            let projection = if odd {
                Projection::from(OrthographicProjection {
                    scale: 0.05,
                    ..OrthographicProjection::default_3d()
                })
            } else {
                plan.projection.clone()
            };
            camera.insert(projection);
        }
        _ => {}
    }
}
