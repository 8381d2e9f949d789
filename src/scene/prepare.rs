//! From the mirrored scene to the buffers, structures and the bind group that shaders read.

mod top_level;

use super::{
    acceleration::{AccelerationStructures, rows},
    alpha_images::AlphaImages,
    bvh::{Item, LARGEST_STACK, MAX_INSTANCES, TRAVERSAL_FLAGS, owner},
    gpu_types::{
        GpuInstance, GpuLight, GpuMaterial, GpuSceneCounts, INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW,
        INSTANCE_MIRRORED, INSTANCE_RECEIVES_SHADOW,
    },
    instances::{InstanceSource, SceneInstances},
    lights::ExtractedLights,
    masks::{Changes, MaskKey, MaskSets, Surroundings},
    materials::{MaterialAssets, MaterialTable, instance_flags, is_traced},
    merge::{Placement, StaticMerge},
    meshes::{SceneMesh, SceneMeshes},
    textures::TextureTable,
    top_level::{Object, TopLevel},
    upload::StorageSlice,
};
use crate::{
    device::ReflectionTracer, scene::activity::SceneActivity, settings::WantsReflections, status::ReflectionStatus,
    vrs::BindGroupContents,
};
use bevy::{
    asset::AssetId,
    ecs::prelude::*,
    math::Affine3A,
    mesh::UvChannel,
    pbr::StandardMaterial,
    platform::collections::HashSet,
    render::{
        render_resource::{
            BindGroup, BindGroupEntry, BindGroupLayoutDescriptor, Buffer, BufferDescriptor, BufferUsages,
            DefaultImageSamplerDescriptor, PipelineCache, ShaderStages, binding_types,
        },
        renderer::{RenderDevice, RenderQueue},
    },
    shader::ShaderDefVal,
};
use core::num::NonZeroU64;

/// The scene's buffers and bind group (group 1 of `bindings.wesl`).
#[derive(Resource)]
pub struct SceneBindings {
    /// Layout of group 1.
    pub layout: BindGroupLayoutDescriptor,
    /// The bind group of this frame; `None` until the first frame in which a camera reflects.
    pub bind_group: Option<BindGroup>,
    /// Contents of the bind group while a view uses variable rate shading.
    pub(crate) contents: BindGroupContents,
    tracer: ReflectionTracer,
    texture_def: Option<&'static str>,
    instances: StorageSlice<GpuInstance>,
    instance_data: Vec<GpuInstance>,
    present: Vec<bool>,
    /// Slots from here on are not in the instance buffer: their objects are missing.
    instance_limit: usize,
    materials: StorageSlice<GpuMaterial>,
    lights: StorageSlice<GpuLight>,
    uniform: Buffer,
    uniform_data: GpuSceneCounts,
    /// Objects that can be hit, and those of them with alpha tests.
    present_instances: usize,
    masked_instances: usize,
    top_level: TopLevel,
    merge: StaticMerge,
    masks: MaskSets,
    acceleration: Option<AccelerationStructures>,
    /// Rays can hit something that needs the alpha test, or it isn't known yet whether they can.
    masked: bool,
    /// The scene's trees need a larger stack than usual.
    deep: bool,
    defs_version: u32,
    /// Counts changes that rays can see.
    pub(crate) version: u32,
    /// Generations of the resources that the bind group was created from.
    generations: [u64; 7],
}

impl FromWorld for SceneBindings {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let queue = world.resource::<RenderQueue>();
        let meshes = world.resource::<SceneMeshes>();
        let textures = world.resource::<TextureTable>();
        let tracer = meshes.tracer();
        Self {
            layout: layout(tracer, textures),
            bind_group: None,
            contents: BindGroupContents::default(),
            tracer,
            texture_def: textures.mode().shader_def(),
            instances: StorageSlice::new(device, "glint_instances"),
            instance_data: Vec::new(),
            present: Vec::new(),
            instance_limit: usize::MAX,
            materials: StorageSlice::new(device, "glint_materials"),
            lights: StorageSlice::new(device, "glint_lights"),
            uniform: device.create_buffer(&BufferDescriptor {
                label: Some("glint_scene"),
                size: size_of::<GpuSceneCounts>() as u64,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            uniform_data: GpuSceneCounts::default(),
            present_instances: 0,
            masked_instances: 0,
            top_level: TopLevel::default(),
            merge: StaticMerge::default(),
            masks: MaskSets::default(),
            acceleration: (tracer == ReflectionTracer::RayQuery).then(|| AccelerationStructures::new(device, queue)),
            masked: true,
            deep: false,
            defs_version: 0,
            version: 0,
            generations: [u64::MAX; 7],
        }
    }
}

fn layout(tracer: ReflectionTracer, textures: &TextureTable) -> BindGroupLayoutDescriptor {
    let stages = ShaderStages::COMPUTE | ShaderStages::FRAGMENT;
    let storage = |size: usize| binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(size as u64));
    let mut entries = vec![
        storage(4).build(0, stages),
        storage(size_of::<GpuInstance>()).build(1, stages),
        storage(size_of::<GpuMaterial>()).build(2, stages),
        storage(size_of::<GpuLight>()).build(3, stages),
        storage(size_of::<GpuSceneCounts>()).build(4, stages),
    ];
    match tracer {
        ReflectionTracer::RayQuery => entries.push(binding_types::acceleration_structure().build(5, stages)),
        ReflectionTracer::Bvh => entries.push(storage(size_of::<Item>()).build(6, stages)),
    }
    entries.push(textures.texture_layout().build(8, stages));
    entries.push(textures.sampler_layout().build(9, stages));
    BindGroupLayoutDescriptor {
        label: "glint_scene_layout".into(),
        entries,
    }
}

impl SceneBindings {
    /// Returns the definitions that shaders which import the scene's modules must be compiled with for the scene as it is. Code
    /// that keeps pipelines has to follow [`Self::shader_defs_version`], or use [`Self::shader_defs_for`] any scene.
    pub fn shader_defs(&self) -> Vec<ShaderDefVal> {
        self.shader_defs_for(self.has_masked_geometry())
    }

    /// The same with or without masked geometry. Shaders for scenes with it are right for all scenes; those for scenes without it
    /// take masked and blended surfaces for solid with the BVH tracer, except for what merged trees leave out, can't tell their
    /// triangles, and are a little smaller and faster there. With ray queries there is no difference.
    ///
    /// A change of the scene never waits for a compiler where both are compiled from the start.
    pub fn shader_defs_for(&self, masked_geometry: bool) -> Vec<ShaderDefVal> {
        let mut defs = self.tracer.shader_defs();
        defs.extend(self.texture_def.map(Into::into));
        if masked_geometry && self.tracer == ReflectionTracer::Bvh {
            defs.push("ALPHA_MASKED_GEOMETRY".into());
        }
        if self.deep {
            defs.push(ShaderDefVal::UInt("BVH_STACK_SIZE".into(), LARGEST_STACK));
        }
        defs
    }

    /// For any scene.
    pub(crate) fn shader_defs_for_any(&self) -> Vec<ShaderDefVal> {
        let mut defs = self.shader_defs_for(true);
        if self.tracer == ReflectionTracer::Bvh && !self.deep {
            defs.push(ShaderDefVal::UInt("BVH_STACK_SIZE".into(), LARGEST_STACK));
        }
        defs
    }

    /// Returns whether the scene's trees need a larger stack than shaders usually have. A larger stack slows rays down
    /// a little.
    pub(crate) fn has_deep_trees(&self) -> bool {
        self.deep
    }

    /// Returns whether the scene has more lights than a hit has bits for: `SHARED_LIGHTS` of `shading.wesl`.
    pub(crate) fn has_many_lights(&self) -> bool {
        self.lights.count() > 64
    }

    /// Returns whether rays can hit something that needs the alpha test. Also `true` until the first object can be hit.
    pub fn has_masked_geometry(&self) -> bool {
        self.masked
    }

    /// Changes whenever [`Self::shader_defs`] does.
    pub fn shader_defs_version(&self) -> u32 {
        self.defs_version
    }

    /// The active tracer.
    pub fn tracer(&self) -> ReflectionTracer {
        self.tracer
    }
}

/// Brings instances, merged trees and the top level up to date; does nothing where nothing changed. Runs before materials
/// are packed, which forgets what changed.
pub fn prepare_instances(
    mut bindings: ResMut<SceneBindings>,
    mut instances: ResMut<SceneInstances>,
    mut materials: ResMut<MaterialTable>,
    mut textures: ResMut<TextureTable>,
    mut alpha_images: ResMut<AlphaImages>,
    mut changed_materials: Local<HashSet<AssetId<StandardMaterial>>>,
    mut meshes: ResMut<SceneMeshes>,
    assets: Res<MaterialAssets>,
    default_sampler: Res<DefaultImageSamplerDescriptor>,
    activity: Res<SceneActivity>,
    status: Res<ReflectionStatus>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let (bindings, meshes) = (&mut *bindings, &mut *meshes);
    if !activity.active {
        if bindings.bind_group.is_some() {
            bindings.release(meshes, &device, &queue);
            alpha_images.keep(|_| false);
            *materials = MaterialTable::default();
            textures.clear(&device);
            status.update(|report| {
                (report.instances, report.scene_bytes) = (0, 0);
                (report.merged_instances, report.merged_triangles) = (0, 0);
                (report.merges_pending, report.micromaps_pending) = (false, false);
            });
        }
        return;
    }
    let mut dirty = instances.take_dirty();
    let moved = instances.take_moved();
    changed_materials.clear();
    changed_materials.extend(assets.changed());
    if !meshes.changed.is_empty() || !changed_materials.is_empty() {
        let touched = |instance: &InstanceSource| {
            meshes.changed.contains(&instance.mesh) || changed_materials.contains(&instance.material)
        };
        let slots = instances.slots().iter().enumerate();
        dirty.extend(
            slots
                .filter(|(_, slot)| slot.as_ref().is_some_and(touched))
                .map(|(i, _)| i as u32),
        );
    }
    let changes = Changes {
        images: textures.take_touched(),
        materials: &changed_materials,
    };
    let surroundings = Surroundings {
        materials: &assets,
        textures: &textures,
        default_sampler: &default_sampler,
    };
    if bindings.tracer == ReflectionTracer::Bvh {
        let touched = bindings
            .masks
            .update(&changes, &surroundings, &mut alpha_images, meshes, &queue);
        dirty.extend(touched);
    }
    let changed = bindings.update_instances(
        dirty,
        &moved,
        &instances,
        &mut materials,
        &surroundings,
        meshes,
        &device,
        &queue,
    );
    if changed {
        bindings.version = bindings.version.wrapping_add(1);
    }
    // Rays see no difference between an object and its copy in a merged tree, so this is no change of the scene.
    if bindings.tracer == ReflectionTracer::Bvh {
        if bindings.merge.update(&bindings.masks, meshes, &queue, &status) || changed {
            bindings.top_level.touch();
        }
        bindings.update_bvh_top_level(&instances, meshes, &queue, &status);
        let (masks, is_building) = (&bindings.masks, bindings.top_level.is_building());
        status.update(|report| {
            report.merges_pending |= is_building;
            report.micromaps_pending = masks.is_pending();
            report.micromap_builds = masks.builds();
        });
    } else if changed {
        bindings.build_ray_query_top_level(&instances, meshes, &device, &queue, &status);
    }
}

/// Uploads materials, lights and counts that changed.
pub fn prepare_tables(
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
        bindings.version = bindings.version.wrapping_add(1);
        bindings
            .materials
            .write(materials.materials(), changed, &device, &queue);
    }
    if lights.changed || bindings.bind_group.is_none() {
        bindings.version = bindings.version.wrapping_add(1);
        bindings
            .lights
            .write(&lights.lights, 0..lights.lights.len(), &device, &queue);
    }
    let uniform = GpuSceneCounts {
        light_count: bindings.lights.count() as u32,
        instance_count: bindings.instances.count() as u32,
        material_count: bindings.materials.count() as u32,
        texture_count: textures.texture_count(),
        ..bindings.uniform_data
    };
    if uniform != bindings.uniform_data || bindings.bind_group.is_none() {
        bindings.uniform_data = uniform;
        queue.write_buffer(&bindings.uniform, 0, bytemuck::bytes_of(&uniform));
    }
}

impl SceneBindings {
    /// Gives back what an idle scene doesn't need.
    fn release(&mut self, meshes: &mut SceneMeshes, device: &RenderDevice, queue: &RenderQueue) {
        self.merge.clear(meshes);
        self.masks.clear(meshes);
        self.top_level.clear(meshes);
        (self.present_instances, self.masked_instances) = (0, 0);
        self.set_masked(true);
        self.set_deep(false);
        self.bind_group = None;
        self.contents.clear();
        self.instance_data.clear();
        self.present.clear();
        self.instance_limit = usize::MAX;
        self.uniform_data = GpuSceneCounts::default();
        self.instances = StorageSlice::new(device, "glint_instances");
        self.materials = StorageSlice::new(device, "glint_materials");
        self.lights = StorageSlice::new(device, "glint_lights");
        self.acceleration =
            (self.tracer == ReflectionTracer::RayQuery).then(|| AccelerationStructures::new(device, queue));
        self.generations = [u64::MAX; 7];
    }

    /// Returns whether anything changed for rays.
    #[expect(clippy::too_many_arguments, reason = "it joins all tables of the scene")]
    fn update_instances(
        &mut self,
        dirty: Vec<u32>,
        moved: &[u32],
        instances: &SceneInstances,
        materials: &mut MaterialTable,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> bool {
        // Objects at the end may be gone.
        let len = instances.slots().len().max(self.present.len());
        self.instance_data.resize(len, GpuInstance::default());
        self.present.resize(len, false);
        let assets = surroundings.materials;
        let limit = self.instances.reserve(len, device).min(MAX_INSTANCES);
        let mut written = Vec::new();
        let mut changed = false;
        let mut dirty = dirty;
        if limit > self.instance_limit {
            // There was no room for them.
            for slot in self.instance_limit..limit.min(len) {
                self.present[slot] = false;
                dirty.push(slot as u32);
            }
        }
        self.instance_limit = limit;
        for &slot in moved {
            if self.move_instance(slot, instances, limit) {
                written.push(slot);
                changed = true;
            } else {
                dirty.push(slot);
            }
        }
        for slot in dirty {
            let mut packed = instances.get(slot).and_then(|source| {
                let mesh = meshes.get(source.mesh)?;
                let material = assets.get(source.material)?;
                let flags = is_traced(material).then(|| instance_flags(material))?;
                pack_instance(source, mesh, materials.index(source.material), flags)
            });
            if self.tracer == ReflectionTracer::Bvh {
                let wanted = packed.and_then(|packed| mask_key(&packed, instances.get(slot)?, assets, meshes));
                let masks = self.masks.assign(slot, wanted, surroundings, meshes, queue);
                if let (Some(packed), Some(_)) = (&mut packed, wanted) {
                    match masks {
                        Some(masks) => packed.masks = masks,
                        None => packed.flags &= !INSTANCE_ALPHA_MASKED,
                    }
                }
                let mergeable = packed.filter(|_| (slot as usize) < limit);
                let placement = mergeable.and_then(|packed| {
                    let source = instances.get(slot)?;
                    Some(Placement {
                        entity: source.entity,
                        mesh: source.mesh,
                        version: meshes.get(source.mesh)?.version,
                        world_from_object: source.world_from_object,
                        flags: packed.flags & TRAVERSAL_FLAGS,
                        masks: packed.masks,
                        micromaps: self.masks.micromaps(slot).name,
                    })
                });
                self.merge.observe(slot, placement);
            }
            let slot = slot as usize;
            let replaced = instances
                .get(slot as u32)
                .is_some_and(|source| meshes.changed.contains(&source.mesh));
            let same = self.present[slot] == packed.is_some()
                && packed.is_none_or(|packed| self.instance_data[slot] == packed && !replaced);
            if same {
                continue;
            }
            changed = true;
            if slot < limit {
                if self.present[slot] {
                    self.count(self.instance_data[slot].flags, -1);
                }
                if let Some(packed) = packed {
                    self.count(packed.flags, 1);
                }
            }
            self.present[slot] = packed.is_some();
            if let Some(packed) = packed {
                self.instance_data[slot] = packed;
                written.push(slot as u32);
            }
            if self.tracer == ReflectionTracer::Bvh && !self.merge.is_merged(slot as u32) {
                let source = instances.get(slot as u32).filter(|_| slot < limit);
                let object = packed
                    .zip(source)
                    .and_then(|(packed, source)| Object::new(source, slot as u32, packed.flags, meshes));
                match object {
                    Some(object) => self.top_level.set(slot as u32, object),
                    None => self.top_level.remove(slot as u32),
                }
            }
        }
        self.instance_data.truncate(instances.slots().len());
        self.present.truncate(instances.slots().len());
        written.sort_unstable();
        self.instances
            .write_elements(&self.instance_data, &written, device, queue);
        changed
    }

    /// An object that has moved, and changed nothing else. Returns false where more follows from that.
    fn move_instance(&mut self, slot: u32, instances: &SceneInstances, limit: usize) -> bool {
        let index = slot as usize;
        if self.present.get(index) != Some(&true) || index >= limit {
            return false;
        }
        let Some(matrices) = instances
            .get(slot)
            .and_then(|source| Matrices::of(&source.world_from_object))
        else {
            return false;
        };
        let data = &mut self.instance_data[index];
        if matrices.mirrored != (data.flags & INSTANCE_MIRRORED != 0) {
            return false;
        }
        data.world_from_object = matrices.world_from_object;
        data.object_from_world = matrices.object_from_world;
        let flags = data.flags;
        if self.tracer == ReflectionTracer::Bvh
            && let Some(source) = instances.get(slot)
        {
            self.merge.observe_move(slot, source.world_from_object);
            self.top_level
                .set_transform(slot, source.world_from_object, owner(slot, flags));
        }
        true
    }
}

/// The masks that an instance needs; `None` where it isn't alpha-masked.
fn mask_key(
    packed: &GpuInstance,
    source: &InstanceSource,
    assets: &MaterialAssets,
    meshes: &SceneMeshes,
) -> Option<MaskKey> {
    if packed.flags & INSTANCE_ALPHA_MASKED == 0 {
        return None;
    }
    Some(MaskKey {
        mesh: source.mesh,
        version: meshes.get(source.mesh)?.version,
        material: source.material,
        second_uvs: assets.get(source.material)?.base_color_channel == UvChannel::Uv1,
    })
}

/// The place of an object as shaders read it.
struct Matrices {
    world_from_object: [[f32; 4]; 3],
    object_from_world: [[f32; 4]; 3],
    mirrored: bool,
}

impl Matrices {
    /// `None` where the transform can't be inverted or isn't finite: such an object is invisible in the raster picture, too.
    fn of(world_from_object: &Affine3A) -> Option<Self> {
        let determinant = world_from_object.matrix3.determinant();
        let object_from_world: Affine3A = world_from_object.inverse();
        if !world_from_object.is_finite() || !object_from_world.is_finite() || determinant == 0.0 {
            return None;
        }
        Some(Self {
            world_from_object: bytemuck::cast(rows(world_from_object)),
            object_from_world: bytemuck::cast(rows(&object_from_world)),
            mirrored: determinant < 0.0,
        })
    }
}

/// `None` where the object has no place that shaders could read.
fn pack_instance(source: &InstanceSource, mesh: &SceneMesh, material: u32, flags: u32) -> Option<GpuInstance> {
    let matrices = Matrices::of(&source.world_from_object)?;
    let mut flags = flags;
    if matrices.mirrored {
        flags |= INSTANCE_MIRRORED;
    }
    if source.casts_shadow {
        flags |= INSTANCE_CASTS_SHADOW;
    }
    if source.receives_shadow {
        flags |= INSTANCE_RECEIVES_SHADOW;
    }
    Some(GpuInstance {
        world_from_object: matrices.world_from_object,
        object_from_world: matrices.object_from_world,
        geometry_base: mesh.geometry.base(),
        material,
        flags,
        id: source.entity.index_u32(),
        masks: 0,
        _padding: [0; 3],
    })
}

/// Makes the bind group anew where one of its resources was replaced.
pub fn prepare_scene_bind_group(
    mut bindings: ResMut<SceneBindings>,
    meshes: Res<SceneMeshes>,
    textures: Res<TextureTable>,
    activity: Res<SceneActivity>,
    views: Query<&WantsReflections>,
    default_sampler: Res<DefaultImageSamplerDescriptor>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    status: Res<ReflectionStatus>,
) {
    let bindings = &mut *bindings;
    if !activity.active {
        return;
    }
    let generations = [
        meshes.geometry.generation(),
        meshes.bvh.generation(),
        bindings.instances.generation(),
        bindings.materials.generation(),
        bindings.lights.generation(),
        textures.generation(),
        bindings
            .acceleration
            .as_ref()
            .map_or(0, |acceleration| acceleration.generation),
    ];
    let current = bindings.bind_group.is_some() && generations == bindings.generations;
    let uses_vrs = views.iter().any(WantsReflections::uses_vrs);
    if !current || !uses_vrs {
        bindings.contents.clear();
    }
    let fill = uses_vrs && bindings.contents.is_missing();
    if current && !fill {
        return;
    }
    let resources = textures.resources();
    let mut entries = vec![
        entry(0, meshes.geometry.buffer()),
        entry(1, bindings.instances.buffer()),
        entry(2, bindings.materials.buffer()),
        entry(3, bindings.lights.buffer()),
        entry(4, &bindings.uniform),
    ];
    match &bindings.acceleration {
        Some(acceleration) => {
            entries.push(BindGroupEntry {
                binding: 5,
                resource: acceleration.tlas().as_binding(),
            });
        }
        None => entries.push(entry(6, meshes.bvh.buffer())),
    }
    entries.push(BindGroupEntry {
        binding: 8,
        resource: resources.textures(),
    });
    entries.push(BindGroupEntry {
        binding: 9,
        resource: resources.samplers(),
    });
    if !current {
        bindings.generations = generations;
        bindings.version = bindings.version.wrapping_add(1);
        let layout = cache.get_bind_group_layout(&bindings.layout);
        bindings.bind_group = Some(device.create_bind_group("glint_scene", &layout, &entries));
    }
    if let (true, Some(bind_group)) = (fill, &bindings.bind_group) {
        let samplers = textures.sampler_descriptors(&default_sampler);
        bindings.contents.fill(&device, bind_group, &entries, &samplers);
    }
    let bytes = meshes.geometry.capacity_bytes()
        + meshes.bvh.capacity_bytes()
        + bindings.instances.buffer().size()
        + bindings.materials.buffer().size()
        + bindings.lights.buffer().size();
    status.update(|report| report.scene_bytes = bytes);
}

fn entry(binding: u32, buffer: &Buffer) -> BindGroupEntry<'_> {
    BindGroupEntry {
        binding,
        resource: buffer.as_entire_binding(),
    }
}
