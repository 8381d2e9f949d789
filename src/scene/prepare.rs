//! Updates the buffers and structures for shaders from the extracted scene.

mod instances;
mod shift;
mod top_level;

pub(crate) use shift::moves_along;

use super::{
    activity::SceneActivity,
    alpha_images::AlphaImages,
    bind_group::SceneBindings,
    change::Change,
    decals::ExtractedDecals,
    environment::ViewEnvironment,
    features::Features,
    gpu_types::GpuSceneCounts,
    instances::SceneInstances,
    light_probes::ExtractedLightProbes,
    lights::ExtractedLights,
    masks::{Changes, Surroundings},
    materials::{MaterialAssets, MaterialTable, update_materials},
    meshes::{SceneMeshes, upload::upload_meshes},
    origin::AnnouncedShift,
    particles::ExtractedParticles,
    pose::{ExtractedPoses, PoseInputs},
    render_layers::SceneLayers,
    textures::TextureTable,
};
use crate::{
    device::ReflectionTracer,
    settings::{ReflectionView, WantsReflections},
    status::ReflectionStatus,
};
use bevy::{
    asset::{AssetId, UntypedAssetId},
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    pbr::{AreaLightLuts, deferred::DeferredLightingLayout},
    platform::collections::HashSet,
    render::{
        diagnostic::DiagnosticsRecorder,
        render_asset::RenderAssets,
        render_resource::{DefaultImageSamplerDescriptor, PipelineCache},
        renderer::{PendingCommandBuffers, RenderDevice, RenderQueue},
        texture::GpuImage,
        view::ExtractedView,
    },
};

/// All data of the scene and its sources, for a single system that updates them in turn: each system looks up its resources again, which
/// are cache misses in large worlds.
#[derive(SystemParam)]
pub(super) struct Scene<'w, 's> {
    bindings: ResMut<'w, SceneBindings>,
    instances: ResMut<'w, SceneInstances>,
    meshes: ResMut<'w, SceneMeshes>,
    materials: ResMut<'w, MaterialTable>,
    textures: ResMut<'w, TextureTable>,
    alpha_images: ResMut<'w, AlphaImages>,
    poses: Res<'w, ExtractedPoses>,
    lights: ResMut<'w, ExtractedLights>,
    light_probes: Res<'w, ExtractedLightProbes>,
    particles: Res<'w, ExtractedParticles>,
    decals: Res<'w, ExtractedDecals>,
    layers: Res<'w, SceneLayers>,
    views: Query<'w, 's, &'static ViewEnvironment>,
    wanted: Query<'w, 's, &'static WantsReflections>,
    cameras: Query<'w, 's, (Entity, &'static ExtractedView), With<ReflectionView>>,
    /// Materials from the main world.
    assets: ResMut<'w, MaterialAssets>,
    images: Res<'w, RenderAssets<GpuImage>>,
    area_lights: Option<Res<'w, AreaLightLuts>>,
    lighting: Option<Res<'w, DeferredLightingLayout>>,
    /// The sampler for images without their own.
    default_sampler: Res<'w, DefaultImageSamplerDescriptor>,
    cache: Res<'w, PipelineCache>,
    diagnostics: Option<Res<'w, DiagnosticsRecorder>>,
    activity: Res<'w, SceneActivity>,
    announced: ResMut<'w, AnnouncedShift>,
    status: Res<'w, ReflectionStatus>,
    device: Res<'w, RenderDevice>,
    queue: Res<'w, RenderQueue>,
    /// Commands of the frame, which are submitted together.
    commands: ResMut<'w, PendingCommandBuffers>,
}

/// Updates everything in the scene that rays can hit.
pub(super) fn prepare_scene(mut scene: Scene, mut changed_materials: Local<HashSet<UntypedAssetId>>) {
    let scene = &mut scene;
    upload_meshes(&mut scene.meshes, &scene.status, &scene.queue);
    scene
        .textures
        .update(&scene.device, &scene.queue, &scene.cache, &scene.images);
    let resettled = scene.textures.take_resettled();
    scene.bindings.follow_kernels(&mut scene.meshes, &scene.cache);
    scene.prepare_box_tables(&resettled);
    scene.prepare_instances(&mut changed_materials, &resettled);
    update_materials(
        &mut scene.assets,
        &mut scene.materials,
        &mut scene.textures,
        &scene.images,
        &resettled,
    );
    scene.prepare_light_probes();
    scene.note_repainted();
    scene.note_features();
    scene.prepare_tables(&resettled);
}

impl Scene<'_, '_> {
    /// Updates instances, merged trees and the top level, if anything changed. Runs before materials are packed, which clears their
    /// changes. `resettled` are images that were loaded or have new content.
    fn prepare_instances(
        &mut self,
        changed_materials: &mut HashSet<UntypedAssetId>,
        resettled: &HashSet<AssetId<Image>>,
    ) {
        if !self.activity.active {
            self.release();
            return;
        }
        changed_materials.clear();
        changed_materials.extend(self.assets.changed());
        let mut dirty = self.take_dirty();
        let moved = self.instances.take_moved();
        let relocated = self.instances.take_relocated();
        let changes = Changes {
            images: self.textures.take_touched(),
            materials: changed_materials,
        };
        let bindings = &mut *self.bindings;
        let relit = bindings
            .lightmaps
            .follow(&mut dirty, resettled, &self.instances, &mut self.textures);
        for source in relit.iter().filter_map(|slot| self.instances.get(*slot)) {
            self.materials.note_relit(source.material);
        }
        let surroundings = Surroundings {
            materials: &self.assets,
            textures: &self.textures,
            default_sampler: &self.default_sampler,
        };
        let (device, queue, status) = (&*self.device, &*self.queue, &*self.status);
        let (instances, meshes) = (&*self.instances, &mut *self.meshes);
        if bindings.tracer == ReflectionTracer::Bvh {
            let images = &mut self.alpha_images;
            dirty.extend(bindings.masks.update(&changes, &surroundings, images, meshes, queue));
        }
        let inputs = PoseInputs {
            extracted: &self.poses,
            relocated: &relocated,
            cache: &self.cache,
            diagnostics: self.diagnostics.as_deref(),
        };
        let poses = bindings.poses.follow(&inputs, instances, meshes, (device, queue));
        if !poses.switched.is_empty() {
            status.update(|report| report.posed_instances = bindings.poses.count());
        }
        dirty.extend(poses.switched);
        let slots = instances.slots().len();
        dirty.extend(bindings.instances.reserve(slots, device));
        let places = self.cameras.iter();
        let places = places.map(|(camera, view)| (camera, view.world_from_view.translation()));
        let steps = bindings.steps_of_cameras(places);
        let shift = bindings.find_shift(&moved, &steps, self.announced.take());
        bindings.note_shift(shift.as_ref(), moved.len());
        let is_shifted = shift.is_some();
        let moving = match shift {
            Some(shift) => &bindings.shift_all(shift, &moved, instances),
            None => &moved.iter().map(|moved| moved.slot).collect(),
        };
        let change = bindings
            .move_instances(moving, instances, &mut dirty)
            .max(bindings.update_instances(&dirty, instances, &mut self.materials, &surroundings, meshes, queue))
            .max(bindings.update_posed(&poses.posed, instances, meshes));
        let changed = change > Change::Nothing || is_shifted;
        bindings.instances.settle();
        bindings.instances.truncate(slots);
        bindings.instances.upload(device, queue);
        bindings.version.note(change);
        // An object looks the same as its copy in a merged tree, so this isn't a change of the scene.
        let is_bvh = bindings.tracer == ReflectionTracer::Bvh;
        if is_bvh {
            let place_of = |slot| instances.place_of(slot);
            bindings.merge.truncate(slots);
            if bindings.merge.update(place_of, &bindings.masks, meshes, queue, status) || changed {
                bindings.top_level.touch();
            }
            bindings.update_bvh_top_level(instances, meshes, queue, status);
        }
        // The buffers aren't replaced from here on.
        let commands = &mut *self.commands;
        (bindings.poses).record(&poses.posed, &inputs, meshes, (device, queue), commands);
        let may_split = !self.wanted.iter().any(WantsReflections::uses_vrs);
        if !is_bvh && (bindings.must_build_again(may_split) || changed) {
            dirty.extend(moved.iter().map(|moved| moved.slot).chain(poses.posed));
            let builds = bindings.build_ray_query_top_level(&dirty, instances, meshes, device, queue, status);
            // Builds come after the commands that pose their inputs.
            commands.push(builds);
        }
    }

    /// Frees the memory that an idle scene doesn't need.
    fn release(&mut self) {
        if self.bindings.bind_group.is_none() {
            return;
        }
        self.bindings.release(&mut self.meshes, &self.device, &self.queue);
        self.alpha_images.keep(|_| false);
        *self.materials = MaterialTable::default();
        self.textures.clear(&self.device);
        report_nothing(&self.status);
    }

    /// Slots of objects that changed, or whose mesh or material changed, without duplicates.
    fn take_dirty(&mut self) -> Vec<u32> {
        let meshes = &self.meshes;
        self.instances.show_new_meshes(|mesh| meshes.expects(mesh));
        let mut dirty = self.instances.take_dirty();
        let others = dirty.len();
        for mesh in &meshes.changed {
            dirty.extend(self.instances.slots_of_mesh(*mesh));
        }
        for material in self.assets.reshaped() {
            dirty.extend(self.instances.slots_of_material(material));
        }
        if dirty.len() > others {
            dirty.sort_unstable();
            dirty.dedup();
        }
        dirty
    }

    /// Updates the features that materials and cameras need in shaders.
    fn note_features(&mut self) {
        let able = self.device.features();
        let any = |has: &dyn Fn(&ViewEnvironment) -> bool| self.views.iter().any(has);
        let noted = [
            (Features::ATMOSPHERE, any(&ViewEnvironment::has_air)),
            (Features::HAZE, any(&|view| view.has_haze(able))),
            (Features::FOG_VOLUMES, any(&ViewEnvironment::has_fog_volumes)),
            (Features::FOG_DENSITY, any(&ViewEnvironment::has_fog_density)),
            (Features::CLEARCOAT, self.materials.has_clearcoat()),
            (
                Features::DIFFUSE_TRANSMISSION,
                self.materials.has_diffuse_transmission(),
            ),
            (Features::SPECULAR_TINT, self.materials.has_specular_tint()),
            (Features::RENDER_LAYERS, self.layers.differ()),
            (Features::RECT_LIGHTS, self.lights.has_rects()),
            (
                Features::DECALS,
                self.bindings.decals.are_shown(self.materials.shows_decals()),
            ),
        ];
        for (feature, is_there) in noted {
            self.bindings.features.set(feature, is_there);
        }
        self.lights.detect_rects(self.area_lights.as_deref(), &self.images);
        if !self.lights.textures().is_empty() {
            self.bindings.light_textures.detect(self.lighting.as_deref());
        }
    }

    /// Updates particles and decals. Runs before instances, after which no buffer is replaced, and before materials are packed, which clears
    /// their changes.
    fn prepare_box_tables(&mut self, resettled: &HashSet<AssetId<Image>>) {
        if !self.activity.active {
            return;
        }
        let bindings = &mut *self.bindings;
        let (meshes, queue) = (&mut *self.meshes, &*self.queue);
        let (assets, materials) = (&*self.assets, &mut *self.materials);
        let flown = bindings
            .particles
            .update(&self.particles, assets, materials, meshes, queue);
        let (lighting, textures) = (self.lighting.as_deref(), &mut *self.textures);
        let decals = &mut bindings.decals;
        let on_materials = materials.shows_decals();
        let pasted = decals.follow(
            (&self.decals, on_materials),
            lighting,
            resettled,
            textures,
            meshes,
            queue,
        );
        bindings.version.note(flown.max(pasted));
    }

    /// Updates light probes.
    fn prepare_light_probes(&mut self) {
        let probes = &mut self.bindings.light_probes;
        let change = probes.update(&self.light_probes, &self.images, &self.device, &self.queue);
        self.bindings.version.note(change);
    }

    /// Notes a change if images of environments or light probes have new content: Bevy often keeps their textures then.
    fn note_repainted(&mut self) {
        let repainted = self.textures.take_repainted();
        let is_seen = |image: &AssetId<Image>| {
            self.views.iter().any(|view| view.shows(*image)) || self.light_probes.shows(*image)
        };
        if repainted.iter().any(is_seen) {
            self.bindings.version.note(Change::Unmarked);
        }
    }

    /// Uploads changed materials, lights and counts.
    fn prepare_tables(&mut self, resettled: &HashSet<AssetId<Image>>) {
        if !self.activity.active {
            return;
        }
        let bindings = &mut *self.bindings;
        let (device, queue) = (&*self.device, &*self.queue);
        let changed_materials = self.materials.take_dirty();
        if bindings.tracer == ReflectionTracer::Bvh {
            let changed = changed_materials.is_some();
            bindings
                .masks
                .write_headers(changed, &self.materials, &mut self.meshes, queue);
        }
        // A material that is already marked causes no upload, but is still a change.
        bindings.version.note(self.materials.take_change());
        let again = [bindings.materials.may_ask_again(), bindings.lights.may_ask_again()];
        if changed_materials.is_some() || again[0] {
            let changed = changed_materials.unwrap_or_default();
            bindings
                .materials
                .write(self.materials.materials(), changed, device, queue);
        }
        let (touched, mut change) = self.lights.take_changes(bindings.shift);
        if bindings.features.contains(Features::ATMOSPHERE) && self.lights.touches_sun(&touched) {
            // The light also affects sky and haze, which rays see without hitting anything that is marked.
            change = Change::Unmarked;
        }
        let retextured = bindings
            .light_textures
            .follow(self.lights.textures(), resettled, &mut self.textures);
        if retextured {
            // Lights have no mark for changed textures.
            change = Change::Unmarked;
        }
        if !touched.is_empty() || retextured || bindings.bind_group.is_none() || again[1] {
            bindings.version.note(change);
            let (lights, textures) = (self.lights.lights(), &bindings.light_textures);
            bindings
                .lights
                .write_with_textures(lights, &touched, textures, device, queue);
        }
        if again.contains(&true) {
            // Contents that didn't fit before might be in the tables now.
            bindings.version.note(Change::Unmarked);
        }
        let [first_light_texture, light_texture_count] = bindings.lights.textures();
        let [largest_depth_bias, depth_bias_range] = bindings.depth_biases.range();
        let [particles, decals] = [bindings.particles.place(), bindings.decals.place()];
        let uniform = GpuSceneCounts {
            light_count: bindings.lights.count(),
            directional_light_count: bindings.lights.directional_count(),
            light_leaf_count: bindings.lights.leaf_count(),
            light_texture_count,
            first_light_texture,
            instance_count: bindings.instances.len() as u32,
            material_count: bindings.materials.count() as u32,
            texture_count: self.textures.texture_count(),
            reflection_probe_count: bindings.light_probes.reflection_probe_count(),
            irradiance_volume_count: bindings.light_probes.irradiance_volume_count(),
            restless_probes: bindings.light_probes.restless(),
            largest_depth_bias,
            depth_bias_range,
            first_particle_word: particles.first_word,
            particle_leaf_count: particles.leaves,
            particle_count: particles.records,
            particles_move: bindings.particles.move_now().into(),
            first_decal_word: decals.first_word,
            decal_leaf_count: decals.leaves,
            decal_count: decals.records,
            ..bindings.uniform_data
        };
        if uniform != bindings.uniform_data || bindings.bind_group.is_none() {
            bindings.uniform_data = uniform;
            queue.write_buffer(&bindings.uniform, 0, bytemuck::bytes_of(&uniform));
        }
    }
}

/// Reports the status of a scene without reflecting cameras.
fn report_nothing(status: &ReflectionStatus) {
    status.update(|report| {
        (report.instances, report.scene_bytes) = (0, 0);
        (report.merged_instances, report.merged_triangles) = (0, 0);
        report.posed_instances = 0;
        (report.merges_pending, report.micromaps_pending) = (false, false);
    });
}
