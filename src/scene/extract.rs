//! Systems that extract the scene from the main world. We keep their number small, with several tables per system: each one looks up its
//! queries and resources again, which are cache misses in large worlds.

use super::{
    activity::SceneActivity,
    alpha_images::{AlphaImages, extract_alpha_images},
    decals::{DecalWorld, ExtractedDecals, extract_decals},
    environment::{Atmospheres, ReflectingCameras, ViewEnvironment, follow_environments},
    fog_volumes::FogWorld,
    instances::{SceneInstances, extract::RemovedFromScene, lost::LostComponents},
    light_probes::{ExtractedLightProbes, ProbeWorld, extract_light_probes},
    lights::{
        ExtractedLights,
        extract::{KnownLights, LightWorld, extract_lights},
    },
    meshes::{MeshWorld, SceneMeshes, extract_meshes, kept::RenderWorldMeshes},
    origin::{AnnouncedShift, OriginShift},
    particles::{ExtractedParticles, ParticleWorld, extract_particles},
    pose::{ExtractedPoses, PoseWorld, VertexShader, extract_poses},
    render_layers::{LightLayers, SceneLayers, layers_of_shadows},
    textures::{TextureTable, extract_texture_changes},
};
use crate::{device::RealTime, settings::ReflectionRetention};
use bevy::{
    asset::{AssetEvent, Assets},
    camera::ClearColor,
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    light::GlobalAmbientLight,
    render::{Extract, renderer::RenderDevice},
};

/// Parts of the main world that determine for which cameras the scene is extracted, and which entities are gone.
#[derive(SystemParam)]
pub(super) struct Onlookers<'w, 's> {
    cameras: ReflectingCameras<'w, 's>,
    light_layers: LightLayers<'w, 's>,
    ambient: Option<Res<'w, GlobalAmbientLight>>,
    clear_color: Option<Res<'w, ClearColor>>,
    fog: FogWorld<'w, 's>,
    retention: Option<Res<'w, ReflectionRetention>>,
    shifts: MessageReader<'w, 's, OriginShift>,
    removed: RemovedFromScene<'w, 's>,
}

/// Runs before all other extraction of the scene. Extraction stops some time after the last camera reflected.
pub(super) fn begin_extraction(
    mut world: Extract<Onlookers>,
    mut commands: Commands,
    (time, atmospheres): (Res<RealTime>, Atmospheres),
    mut views: Query<(Entity, &mut ViewEnvironment)>,
    mut activity: ResMut<SceneActivity>,
    mut layers: ResMut<SceneLayers>,
    (mut lost, mut announced): (ResMut<LostComponents>, ResMut<AnnouncedShift>),
    mut instances: ResMut<SceneInstances>,
) {
    announced.add(world.shifts.read());
    let active = world.cameras.iter().filter(|(_, _, camera, ..)| camera.is_active);
    let kept = world.retention.as_deref().copied().unwrap_or_default().0;
    activity.follow(active.clone().next().is_some(), time.delta(), kept);
    let stays = activity.active && !activity.watched;
    if stays {
        layers.follow_lights(layers_of_shadows(&world.light_layers));
    } else {
        layers.follow(
            active.map(|(.., drawn, reflected, _, _)| (drawn, reflected)),
            layers_of_shadows(&world.light_layers),
        );
        follow_environments(
            &world.cameras,
            world.ambient.as_deref(),
            world.clear_color.as_deref(),
            &layers,
            &atmospheres,
            &world.fog,
            &mut views,
            &mut commands,
        );
    }
    lost.follow(&mut world.removed);
    if (!activity.active || activity.started) && !instances.is_empty() {
        instances.clear();
    }
    instances.compact();
}

/// Drops objects that are gone, and extracts poses and meshes of the others. Runs after all objects have been extracted.
pub(super) fn extract_shapes(
    mut world: Extract<(PoseWorld, MeshWorld)>,
    activity: Res<SceneActivity>,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
    mut meshes: ResMut<SceneMeshes>,
    mut render_world: ResMut<RenderWorldMeshes>,
    (mut poses, shader): (ResMut<ExtractedPoses>, Option<Res<VertexShader>>),
    device: Res<RenderDevice>,
) {
    let (poses_there, meshes_there) = &mut *world;
    lost.drop_objects(&mut instances);
    instances.keep_last_meshes(|last, now| meshes.may_show(last) && !meshes.is_settled(now));
    let shader = shader.as_deref();
    extract_poses(
        poses_there,
        activity.active,
        shader,
        &mut meshes,
        &mut instances,
        &mut poses,
    );
    extract_meshes(
        meshes_there,
        activity.active,
        &mut instances,
        &mut meshes,
        &mut render_world,
        &device,
    );
}

/// Extracts lights, light probes, particles and decals.
pub(super) fn extract_lighting(
    world: Extract<(LightWorld, ProbeWorld, ParticleWorld, DecalWorld)>,
    activity: Res<SceneActivity>,
    layers: Res<SceneLayers>,
    mut lights: ResMut<ExtractedLights>,
    mut known: Local<KnownLights>,
    probes: ResMut<ExtractedLightProbes>,
    (mut particles, mut decals): (ResMut<ExtractedParticles>, ResMut<ExtractedDecals>),
) {
    let (lights_there, probes_there, particles_there, decals_there) = &*world;
    extract_lights(lights_there, activity.active, &layers, &mut lights, &mut known);
    if activity.watched || !activity.active {
        extract_light_probes(probes_there, activity.active, probes);
    }
    extract_particles(particles_there, &activity, &layers, &mut particles);
    extract_decals(decals_there, &activity, &layers, &mut decals);
}

/// Tracks images of the main world.
pub(super) fn extract_images(
    mut world: Extract<(Option<Res<Assets<Image>>>, MessageReader<AssetEvent<Image>>)>,
    mut textures: ResMut<TextureTable>,
    mut alphas: ResMut<AlphaImages>,
) {
    let (images, events) = &mut *world;
    let images = images.as_deref();
    if let Some(images) = images {
        extract_texture_changes(images, events.read(), &mut textures);
    }
    extract_alpha_images(images, &mut alphas);
}
