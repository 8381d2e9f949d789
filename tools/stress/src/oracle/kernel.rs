//! Makes the app's own tracer answer a list of rays, in the current scene. `tests/shaders` compiles this file, too.

use bevy::{
    prelude::*,
    render::{
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BufferDescriptor,
            BufferInitDescriptor, BufferUsages, CachedComputePipelineId, CachedPipelineState, CommandEncoderDescriptor,
            ComputePassDescriptor, ComputePipelineDescriptor, PipelineCache, ShaderStages, binding_types,
        },
        renderer::{RenderDevice, RenderQueue},
        sync_world::RenderEntity,
    },
    shader::{Shader, ShaderDefVal},
};
use bevy_glint::internals::{
    SceneBindings,
    bvh::TraceRay,
    environment::{EnvironmentBindings, layout_descriptor},
    instances::SceneInstances,
};
use bytemuck::{Pod, Zeroable};
use core::num::NonZeroU64;
use glint_scenes::{HeadlessApp, read_buffer};

const NO_HIT: u32 = u32::MAX;
/// Rays of a workgroup.
const GROUP: u32 = 64;

/// `Answer` of `oracle.wesl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct GpuAnswer {
    t: f32,
    instance: u32,
    primitive: u32,
    front_face: u32,
    barycentrics: [f32; 2],
    blocked: u32,
    _padding: u32,
}

/// The surface that a ray hits first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hit {
    pub t: f32,
    /// `None` if its slot is empty.
    pub entity: Option<Entity>,
    pub primitive: u32,
    pub front_face: bool,
    pub barycentrics: [f32; 2],
}

/// The tracer's answer for a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    pub hit: Option<Hit>,
    /// An object that casts shadows is in the way; `Some(None)` if its slot is empty.
    pub blocked: Option<Option<Entity>>,
}

/// The kernel, compiled once for each set of definitions that scenes need.
#[derive(Resource)]
struct OracleKernel {
    shader: Handle<Shader>,
    pipelines: Vec<(Vec<ShaderDefVal>, CachedComputePipelineId)>,
}

fn lists_layout() -> BindGroupLayoutDescriptor {
    let item = |size: usize| NonZeroU64::new(size as u64);
    BindGroupLayoutDescriptor::new(
        "oracle_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                binding_types::storage_buffer_read_only_sized(false, item(size_of::<[f32; 8]>())),
                binding_types::storage_buffer_sized(false, item(size_of::<GpuAnswer>())),
            ),
        ),
    )
}

/// A resource of the render world.
fn resource<R: Resource>(app: &HeadlessApp) -> Option<&R> {
    app.render_world().ok()?.get_resource()
}

/// The pipeline for the current scene, once it is compiled. The first call for a scene begins to compile it. The log has the error of a
/// kernel that can't be compiled.
pub fn compiled(app: &mut HeadlessApp) -> Option<CachedComputePipelineId> {
    let id = queue(app)?;
    let state = resource::<PipelineCache>(app)?.get_compute_pipeline_state(id);
    matches!(state, CachedPipelineState::Ok(_)).then_some(id)
}

/// The pipeline for the current scene. `None` without a scene.
fn queue(app: &mut HeadlessApp) -> Option<CachedComputePipelineId> {
    let defs = resource::<SceneBindings>(app)?.shader_defs();
    let world = app.world();
    if !world.contains_resource::<OracleKernel>() {
        let shader = Shader::from_wesl(include_str!("oracle.wesl"), "embedded://glint_stress/oracle.wesl");
        let shader = world.resource_mut::<Assets<Shader>>().add(shader);
        let pipelines = Vec::new();
        world.insert_resource(OracleKernel { shader, pipelines });
    }
    let kernel = world.resource::<OracleKernel>();
    if let Some((_, id)) = kernel.pipelines.iter().find(|(known, _)| *known == defs) {
        return Some(*id);
    }
    let shader = kernel.shader.clone();
    let scene = resource::<SceneBindings>(app)?;
    let id = resource::<PipelineCache>(app)?.queue_compute_pipeline(ComputePipelineDescriptor {
        label: Some("oracle".into()),
        layout: vec![lists_layout(), scene.layout.clone(), layout_descriptor()],
        shader,
        shader_defs: defs.clone(),
        entry_point: Some("trace_rays".into()),
        ..default()
    });
    let mut kernel = app.world().resource_mut::<OracleKernel>();
    kernel.pipelines.push((defs, id));
    Some(id)
}

/// Answers for rays, in their order, in the scene of the last frame. The camera reflects, and decides on the layers that rays see. `None`
/// if the scene is not on the GPU, or the kernel isn't compiled for it.
pub fn trace(app: &mut HeadlessApp, camera: Entity, rays: &[TraceRay]) -> Option<Vec<Answer>> {
    let id = compiled(app)?;
    let view = app.world().get::<RenderEntity>(camera).map(RenderEntity::id)?;
    let device = resource::<RenderDevice>(app)?;
    let cache = resource::<PipelineCache>(app)?;
    let scene = resource::<SceneBindings>(app)?.bind_group.as_ref()?;
    let environment = resource::<EnvironmentBindings>(app)?.bind_group(view)?;
    let list: Vec<[f32; 8]> = rays
        .iter()
        .map(|ray| {
            let (o, d) = (ray.origin, ray.direction);
            [o.x, o.y, o.z, ray.t_min, d.x, d.y, d.z, ray.t_max]
        })
        .collect();
    let input = device.create_buffer_with_data(&BufferInitDescriptor {
        label: Some("oracle_rays"),
        contents: bytemuck::cast_slice(&list),
        usage: BufferUsages::STORAGE,
    });
    let output = device.create_buffer(&BufferDescriptor {
        label: Some("oracle_answers"),
        size: (rays.len() * size_of::<GpuAnswer>()) as u64,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let lists = device.create_bind_group(
        "oracle",
        &cache.get_bind_group_layout(&lists_layout()),
        &BindGroupEntries::sequential((input.as_entire_binding(), output.as_entire_binding())),
    );
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor { label: Some("oracle") });
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("oracle"),
            timestamp_writes: None,
        });
        pass.set_pipeline(cache.get_compute_pipeline(id)?);
        pass.set_bind_group(0, &lists, &[]);
        pass.set_bind_group(1, scene, &[]);
        pass.set_bind_group(2, environment, &[]);
        pass.dispatch_workgroups((rays.len() as u32).div_ceil(GROUP), 1, 1);
    }
    resource::<RenderQueue>(app)?.submit([encoder.finish()]);
    let bytes = read_buffer(app.render_world().ok()?, &output).ok()?;
    let slots = resource::<SceneInstances>(app)?;
    let entity = |slot: u32| (slot != NO_HIT).then(|| slots.get(slot).map(|source| source.entity));
    let answer = |answer: GpuAnswer| Answer {
        hit: entity(answer.instance).map(|entity| Hit {
            t: answer.t,
            entity,
            primitive: answer.primitive,
            front_face: answer.front_face != 0,
            barycentrics: answer.barycentrics,
        }),
        blocked: entity(answer.blocked),
    };
    Some(bytemuck::pod_collect_to_vec(&bytes).into_iter().map(answer).collect())
}
