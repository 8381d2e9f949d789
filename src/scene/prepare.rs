//! From the mirrored scene to the buffers and structures that shaders read.

mod instances;
mod top_level;

use super::{
    activity::SceneActivity,
    alpha_images::AlphaImages,
    bind_group::SceneBindings,
    change::Change,
    environment::ViewEnvironment,
    gpu_types::GpuSceneCounts,
    instances::{InstanceSource, SceneInstances},
    light_probes::ExtractedLightProbes,
    lights::ExtractedLights,
    masks::{Changes, Surroundings},
    materials::{MaterialAssets, MaterialTable},
    meshes::SceneMeshes,
    pose::PoseInputs,
    render_layers::SceneLayers,
    textures::TextureTable,
};
use crate::{device::ReflectionTracer, status::ReflectionStatus};
use bevy::{
    asset::UntypedAssetId,
    ecs::{prelude::*, system::SystemParam},
    platform::collections::HashSet,
    render::{
        render_asset::RenderAssets,
        render_resource::DefaultImageSamplerDescriptor,
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
};

/// The tables that instances refer to, and those whose entries follow from instances.
#[derive(SystemParam)]
pub(super) struct SceneTables<'w> {
    instances: ResMut<'w, SceneInstances>,
    meshes: ResMut<'w, SceneMeshes>,
    materials: ResMut<'w, MaterialTable>,
    textures: ResMut<'w, TextureTable>,
    alpha_images: ResMut<'w, AlphaImages>,
    poses: PoseInputs<'w>,
}

/// Materials as the app made them, and the sampler of images that have none of their own.
#[derive(SystemParam)]
pub(super) struct SceneMaterials<'w> {
    assets: Res<'w, MaterialAssets>,
    default_sampler: Res<'w, DefaultImageSamplerDescriptor>,
}

/// Brings instances, merged trees and the top level up to date; does nothing where nothing changed. Runs before materials
/// are packed, which forgets what changed.
pub(super) fn prepare_instances(
    mut bindings: ResMut<SceneBindings>,
    mut tables: SceneTables,
    materials: SceneMaterials,
    mut changed_materials: Local<HashSet<UntypedAssetId>>,
    activity: Res<SceneActivity>,
    status: Res<ReflectionStatus>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let bindings = &mut *bindings;
    if !activity.active {
        if bindings.bind_group.is_some() {
            bindings.release(&mut tables.meshes, &device, &queue);
            tables.release(&device);
            report_nothing(&status);
        }
        return;
    }
    changed_materials.clear();
    changed_materials.extend(materials.assets.changed());
    let mut dirty = tables.take_dirty(&changed_materials);
    let moved = tables.instances.take_moved();
    let changes = Changes {
        images: tables.textures.take_touched(),
        materials: &changed_materials,
    };
    bindings
        .lightmaps
        .follow(&mut dirty, changes.images, &tables.instances, &mut tables.textures);
    let surroundings = Surroundings {
        materials: &materials.assets,
        textures: &tables.textures,
        default_sampler: &materials.default_sampler,
    };
    let (instances, meshes) = (&*tables.instances, &mut *tables.meshes);
    if bindings.tracer == ReflectionTracer::Bvh {
        let images = &mut tables.alpha_images;
        dirty.extend(bindings.masks.update(&changes, &surroundings, images, meshes, &queue));
    }
    let poses = bindings.poses.follow(&tables.poses, instances, meshes, &device, &queue);
    if !poses.switched.is_empty() {
        status.update(|report| report.posed_instances = bindings.poses.count());
    }
    dirty.extend(poses.switched);
    let slots = instances.slots().len();
    dirty.extend(bindings.instances.reserve(slots, &device));
    let change = bindings
        .move_instances(&moved, instances, &mut dirty)
        .max(bindings.update_instances(&dirty, instances, &mut tables.materials, &surroundings, meshes, &queue))
        .max(bindings.update_posed(&poses.posed, instances, meshes));
    let changed = change > Change::Nothing;
    bindings.instances.settle();
    bindings.instances.truncate(slots);
    bindings.instances.upload(&device, &queue);
    bindings.version.note(change);
    // Rays see no difference between an object and its copy in a merged tree, so this is no change of the scene.
    if bindings.tracer == ReflectionTracer::Bvh {
        let place_of = |slot| instances.get(slot).map(|source| source.world_from_object);
        if bindings
            .merge
            .update(place_of, &bindings.masks, meshes, &queue, &status)
            || changed
        {
            bindings.top_level.touch();
        }
        bindings.update_bvh_top_level(instances, meshes, &queue, &status);
    } else if changed {
        bindings.build_ray_query_top_level(instances, meshes, &device, &queue, &status);
    }
}

impl SceneTables<'_> {
    /// Gives back what an idle scene doesn't need.
    fn release(&mut self, device: &RenderDevice) {
        self.alpha_images.keep(|_| false);
        *self.materials = MaterialTable::default();
        self.textures.clear(device);
    }

    /// Slots of objects that changed, or whose mesh or material did.
    fn take_dirty(&mut self, changed_materials: &HashSet<UntypedAssetId>) -> Vec<u32> {
        let mut dirty = self.instances.take_dirty();
        let changed_meshes = &self.meshes.changed;
        if !changed_meshes.is_empty() || !changed_materials.is_empty() {
            let touched = |instance: &InstanceSource| {
                changed_meshes.contains(&instance.mesh) || changed_materials.contains(&instance.material)
            };
            let slots = (0..).zip(self.instances.slots());
            dirty.extend(
                slots
                    .filter(|(_, slot)| slot.as_ref().is_some_and(touched))
                    .map(|(slot, _)| slot),
            );
        }
        dirty
    }
}

/// The status of a scene that no camera looks at.
fn report_nothing(status: &ReflectionStatus) {
    status.update(|report| {
        (report.instances, report.scene_bytes) = (0, 0);
        (report.merged_instances, report.merged_triangles) = (0, 0);
        report.posed_instances = 0;
        (report.merges_pending, report.micromaps_pending) = (false, false);
    });
}

/// Notes what materials and views ask of shaders.
pub(super) fn note_features(
    mut bindings: ResMut<SceneBindings>,
    materials: Res<MaterialTable>,
    layers: Res<SceneLayers>,
    views: Query<&ViewEnvironment>,
) {
    bindings.has_air = views.iter().any(ViewEnvironment::has_air);
    bindings.has_clearcoat = materials.has_clearcoat();
    bindings.has_render_layers = layers.differ();
}

/// Brings light probes up to date.
pub(super) fn prepare_light_probes(
    mut bindings: ResMut<SceneBindings>,
    extracted: Res<ExtractedLightProbes>,
    images: Res<RenderAssets<GpuImage>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    if bindings.light_probes.update(&extracted, &images, &device, &queue) {
        bindings.version.note(Change::Unmarked);
    }
}

/// Uploads materials, lights and counts that changed.
pub(super) fn prepare_tables(
    mut bindings: ResMut<SceneBindings>,
    mut materials: ResMut<MaterialTable>,
    lights: Res<ExtractedLights>,
    textures: Res<TextureTable>,
    mut meshes: ResMut<SceneMeshes>,
    activity: Res<SceneActivity>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    if !activity.active {
        return;
    }
    let bindings = &mut *bindings;
    let changed_materials = materials.take_dirty();
    if bindings.tracer == ReflectionTracer::Bvh {
        let changed = changed_materials.is_some();
        bindings.masks.write_headers(changed, &materials, &mut meshes, &queue);
    }
    if let Some(changed) = changed_materials {
        bindings.version.note(materials.take_change());
        bindings
            .materials
            .write(materials.materials(), changed, &device, &queue);
    }
    if lights.changed || bindings.bind_group.is_none() {
        bindings.version.note(lights.change);
        bindings.lights.write(&lights.lights, &device, &queue);
    }
    let uniform = GpuSceneCounts {
        light_count: bindings.lights.count(),
        directional_light_count: bindings.lights.directional_count(),
        light_leaf_count: bindings.lights.leaf_count(),
        instance_count: bindings.instances.len() as u32,
        material_count: bindings.materials.count() as u32,
        texture_count: textures.texture_count(),
        reflection_probe_count: bindings.light_probes.reflection_probe_count(),
        irradiance_volume_count: bindings.light_probes.irradiance_volume_count(),
        ..bindings.uniform_data
    };
    if uniform != bindings.uniform_data || bindings.bind_group.is_none() {
        bindings.uniform_data = uniform;
        queue.write_buffer(&bindings.uniform, 0, bytemuck::bytes_of(&uniform));
    }
}
