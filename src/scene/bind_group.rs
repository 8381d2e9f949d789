//! The scene's buffers and their bind group: group 1 of `bindings.wesl`.

mod instance_table;
mod shader_defs;

use super::{
    acceleration::AccelerationStructures,
    activity::SceneActivity,
    bvh::Item,
    change::{Change, SceneVersion},
    coplanar::DepthBiases,
    decals::DecalTable,
    environment::can_have_haze,
    features::Features,
    forward::ForwardObjects,
    gpu_types::{GpuInstance, GpuLight, GpuLightProbe, GpuMaterial, GpuSceneCounts},
    light_probes::{self, LightProbes},
    light_table::LightTable,
    light_textures::LightTextures,
    lightmaps::Lightmaps,
    masks::MaskSets,
    merge::StaticMerge,
    meshes::SceneMeshes,
    particles::ParticleTable,
    pose::Poses,
    scatter::ScatterKernels,
    see_through::SeeThroughObjects,
    textures::TextureTable,
    top_level::TopLevel,
    upload::StorageSlice,
};
use crate::{device::ReflectionTracer, settings::WantsReflections, status::ReflectionStatus, vrs::BindGroupContents};
use bevy::{
    ecs::{entity::EntityHashMap, prelude::*, system::SystemParam},
    math::{DVec3, Vec3},
    render::{
        render_resource::{
            BindGroup, BindGroupEntry, BindGroupLayoutDescriptor, BindingResource, Buffer, BufferDescriptor,
            BufferUsages, DefaultImageSamplerDescriptor, PipelineCache, ShaderStages, binding_types,
        },
        renderer::{RenderDevice, RenderQueue},
    },
};
use core::num::NonZeroU64;

pub(super) use instance_table::{InstanceTable, pack_instance};
pub(crate) use shader_defs::SceneDefinitions;

/// The scene's buffers and bind group (group 1 of `bindings.wesl`).
#[derive(Resource)]
pub struct SceneBindings {
    /// Layout of group 1.
    pub layout: BindGroupLayoutDescriptor,
    /// The bind group of this frame; `None` until the first frame in which a camera reflects.
    pub bind_group: Option<BindGroup>,
    /// Contents of the bind group while a view uses variable rate shading.
    pub(crate) contents: BindGroupContents,
    pub(super) tracer: ReflectionTracer,
    texture_def: Option<&'static str>,
    /// There can be haze in front of the surfaces that rays hit.
    can_have_haze: bool,
    scatter_kernels: ScatterKernels,
    pub(super) instances: InstanceTable,
    pub(super) materials: StorageSlice<GpuMaterial>,
    pub(super) lights: LightTable,
    pub(super) light_textures: LightTextures,
    pub(super) uniform: Buffer,
    pub(super) uniform_data: GpuSceneCounts,
    pub(super) top_level: TopLevel,
    pub(super) merge: StaticMerge,
    pub(super) masks: MaskSets,
    pub(super) poses: Poses,
    /// Objects with see-through materials such as glass and water.
    pub(crate) see_through: SeeThroughObjects,
    pub(super) depth_biases: DepthBiases,
    /// Opaque objects that Bevy doesn't draw into its G-buffer.
    pub(crate) forward: ForwardObjects,
    pub(super) lightmaps: Lightmaps,
    pub(super) light_probes: LightProbes,
    pub(super) particles: ParticleTable,
    pub(super) decals: DecalTable,
    /// Features that tables have reported; [`Self::features`] returns all of them.
    pub(super) features: Features,
    pub(super) acceleration: Option<AccelerationStructures>,
    /// All back ends in use support two acceleration structures.
    pub(super) may_split: bool,
    defs_version: u32,
    /// Vector by which the whole world was shifted in this frame ...
    pub(crate) shift: Vec3,
    /// ... and the sum of all of them. Views compare it with that of their last frame, which can be older.
    pub(crate) origin: DVec3,
    /// Places of reflecting cameras in the last frame.
    pub(super) cameras: EntityHashMap<Vec3>,
    /// Counts changes of the scene.
    pub(crate) version: SceneVersion,
    /// Generations of the resources that the bind group was created from.
    generations: [u64; 8],
}

impl FromWorld for SceneBindings {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let queue = world.resource::<RenderQueue>();
        let meshes = world.resource::<SceneMeshes>();
        let textures = world.resource::<TextureTable>();
        let tracer = meshes.tracer();
        let trees = (tracer == ReflectionTracer::Bvh).then_some(size_of::<Item>());
        let sizes = [size_of::<GpuInstance>(), size_of::<GpuLight>()]
            .into_iter()
            .chain(trees);
        Self {
            layout: layout(tracer, textures, device),
            bind_group: None,
            contents: BindGroupContents::default(),
            tracer,
            texture_def: textures.mode().shader_def(),
            can_have_haze: can_have_haze(device.features()),
            scatter_kernels: ScatterKernels::new(world, sizes),
            instances: InstanceTable::new(device),
            materials: StorageSlice::new(device, "glint_materials"),
            lights: LightTable::new(device),
            light_textures: LightTextures::default(),
            uniform: device.create_buffer(&BufferDescriptor {
                label: Some("glint_scene"),
                size: size_of::<GpuSceneCounts>() as u64,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            uniform_data: GpuSceneCounts::default(),
            top_level: TopLevel::default(),
            merge: StaticMerge::default(),
            masks: MaskSets::default(),
            poses: Poses::new(world, tracer),
            see_through: SeeThroughObjects::default(),
            depth_biases: DepthBiases::default(),
            forward: ForwardObjects::default(),
            lightmaps: Lightmaps::default(),
            light_probes: LightProbes::new(textures.mode(), device, queue),
            particles: ParticleTable::default(),
            decals: DecalTable::default(),
            features: Features::MASKED,
            acceleration: (tracer == ReflectionTracer::RayQuery).then(|| AccelerationStructures::new(device, queue)),
            may_split: true,
            defs_version: 0,
            shift: Vec3::ZERO,
            origin: DVec3::ZERO,
            cameras: EntityHashMap::default(),
            version: SceneVersion::default(),
            generations: [u64::MAX; 8],
        }
    }
}

fn layout(tracer: ReflectionTracer, textures: &TextureTable, device: &RenderDevice) -> BindGroupLayoutDescriptor {
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
        ReflectionTracer::RayQuery => {
            entries.extend([5, 7].map(|binding| binding_types::acceleration_structure().build(binding, stages)));
        }
        ReflectionTracer::Bvh => entries.push(storage(size_of::<Item>()).build(6, stages)),
    }
    entries.push(textures.texture_layout().build(8, stages));
    entries.push(textures.sampler_layout().build(9, stages));
    if let Some([maps, volumes]) = light_probes::texture_layouts(textures.mode(), device) {
        entries.push(storage(size_of::<GpuLightProbe>()).build(10, stages));
        entries.push(maps.build(11, stages));
        entries.push(volumes.build(12, stages));
    }
    BindGroupLayoutDescriptor {
        label: "glint_scene_layout".into(),
        entries,
    }
}

impl SceneBindings {
    /// The active tracer.
    #[cfg(feature = "internals")]
    pub fn tracer(&self) -> ReflectionTracer {
        self.tracer
    }

    /// Returns whether the scene has more lights than a hit has bits for: `SHARED_LIGHTS` of `shading.wesl`.
    fn has_many_lights(&self) -> bool {
        self.uniform_data.light_count > 64
    }

    /// Returns whether objects have moved since the last frame with known motion.
    pub(crate) fn knows_motions(&self) -> bool {
        self.instances.knows_motions()
    }

    /// Returns whether there are reflective surfaces that Bevy might draw in front of its G-buffer.
    pub(crate) fn has_layer_surfaces(&self) -> bool {
        self.see_through.entities().next().is_some() || self.has_forward_surfaces()
    }

    /// Returns whether there are reflective opaque surfaces that Bevy draws in its forward pass.
    pub(crate) fn has_forward_surfaces(&self) -> bool {
        self.forward.count() > 0
    }

    /// Lets tables upload large changes by compute kernels, once these are compiled.
    pub(super) fn follow_kernels(&mut self, meshes: &mut SceneMeshes, cache: &PipelineCache) {
        self.instances.follow_kernel(&self.scatter_kernels, cache);
        self.lights.follow_kernel(&self.scatter_kernels, cache);
        meshes.bvh.follow_kernel(&self.scatter_kernels, cache);
    }

    /// Frees the memory that an idle scene doesn't need.
    pub(super) fn release(&mut self, meshes: &mut SceneMeshes, device: &RenderDevice, queue: &RenderQueue) {
        self.merge.clear(meshes);
        self.masks.clear(meshes);
        self.poses.clear(meshes);
        self.top_level.clear(meshes);
        self.see_through = SeeThroughObjects::default();
        self.depth_biases = DepthBiases::default();
        self.forward = ForwardObjects::default();
        self.lightmaps = Lightmaps::default();
        self.light_textures = LightTextures::default();
        self.light_probes.clear();
        self.particles.clear(meshes);
        self.decals.clear(meshes);
        self.set_tree_features(true, false);
        self.bind_group = None;
        self.contents.clear();
        self.uniform_data = GpuSceneCounts::default();
        self.instances = InstanceTable::new(device);
        self.materials = StorageSlice::new(device, "glint_materials");
        self.lights = LightTable::new(device);
        self.acceleration =
            (self.tracer == ReflectionTracer::RayQuery).then(|| AccelerationStructures::new(device, queue));
        self.generations = [u64::MAX; 8];
    }

    /// Generations of the resources that this frame's bind group would use.
    fn current_generations(&self, meshes: &SceneMeshes, textures: &TextureTable) -> [u64; 8] {
        let acceleration = self.acceleration.as_ref();
        [
            meshes.geometry.generation(),
            meshes.bvh.generation(),
            self.instances.generation(),
            self.materials.generation(),
            self.lights.generation(),
            textures.generation(),
            acceleration.map_or(0, |acceleration| acceleration.generation),
            self.light_probes.generation(),
        ]
    }

    /// Bytes of all buffers of the scene.
    fn bytes(&self, meshes: &SceneMeshes) -> u64 {
        meshes.geometry.capacity_bytes()
            + meshes.bvh.capacity_bytes()
            + self.instances.buffer().size()
            + self.materials.buffer().size()
            + self.lights.buffer().size()
            + self.poses.bytes()
    }
}

/// The textures of the scene, and the sampler for images without their own.
#[derive(SystemParam)]
pub(super) struct SceneTextures<'w> {
    table: Res<'w, TextureTable>,
    default_sampler: Res<'w, DefaultImageSamplerDescriptor>,
}

/// Rebuilds the bind group if one of its resources was replaced.
pub(super) fn prepare_scene_bind_group(
    mut bindings: ResMut<SceneBindings>,
    meshes: Res<SceneMeshes>,
    textures: SceneTextures,
    activity: Res<SceneActivity>,
    views: Query<&WantsReflections>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    status: Res<ReflectionStatus>,
) {
    let bindings = &mut *bindings;
    if !activity.active {
        return;
    }
    let generations = bindings.current_generations(&meshes, &textures.table);
    let current = bindings.bind_group.is_some() && generations == bindings.generations;
    let uses_vrs = views.iter().any(WantsReflections::uses_vrs);
    if !current || !uses_vrs {
        bindings.contents.clear();
    }
    let fill = uses_vrs && bindings.contents.is_missing();
    if current && !fill {
        return;
    }
    let resources = textures.table.resources();
    let mut entries = vec![
        entry(0, meshes.geometry.buffer()),
        entry(1, bindings.instances.buffer()),
        entry(2, bindings.materials.buffer()),
        entry(3, bindings.lights.buffer()),
        entry(4, &bindings.uniform),
    ];
    match &bindings.acceleration {
        Some(acceleration) => {
            let structures = [5, 7].into_iter().zip(acceleration.tlas());
            entries.extend(structures.map(|(binding, tlas)| BindGroupEntry {
                binding,
                resource: tlas.as_binding(),
            }));
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
    let probe_textures = bindings.light_probes.textures();
    if let Some(textures) = &probe_textures {
        entries.push(entry(10, bindings.light_probes.buffer()));
        for (binding, views) in [(11, &textures.maps), (12, &textures.volumes)] {
            entries.push(BindGroupEntry {
                binding,
                resource: BindingResource::TextureViewArray(views),
            });
        }
    }
    if !current {
        // New buffers and textures have the same contents as the old ones, except for changes that are already noted.
        if bindings.bind_group.is_none() {
            bindings.version.note(Change::Unmarked);
        }
        bindings.generations = generations;
        let layout = cache.get_bind_group_layout(&bindings.layout);
        bindings.bind_group = Some(device.create_bind_group("glint_scene", &layout, &entries));
    }
    if let (true, Some(bind_group)) = (fill, &bindings.bind_group) {
        let samplers = textures.table.sampler_descriptors(&textures.default_sampler);
        bindings.contents.fill(&device, bind_group, &entries, &samplers);
    }
    let bytes = bindings.bytes(&meshes);
    status.update(|report| report.scene_bytes = bytes);
}

fn entry(binding: u32, buffer: &Buffer) -> BindGroupEntry<'_> {
    BindGroupEntry {
        binding,
        resource: buffer.as_entire_binding(),
    }
}
