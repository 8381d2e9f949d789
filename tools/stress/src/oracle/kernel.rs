//! Makes the app's own tracer answer a list of rays, in the current scene.

use crate::harness::Harness;
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
use std::{thread, time::Duration};

const NO_HIT: u32 = u32::MAX;
/// Leaves processor time to the threads that compile.
const NAP: Duration = Duration::from_millis(1);
/// Limit of changes of the definitions while the kernel is compiled for others.
const ATTEMPTS: u32 = 4;
/// Rays of a workgroup.
const GROUP: u32 = 64;

/// `Answer` of `oracle.wesl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct GpuAnswer {
    t: f32,
    instance: u32,
    blocked: u32,
    _padding: u32,
}

/// The tracer's answer for a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Distance and object of the closest hit; no object if its slot is empty.
    pub hit: Option<(f32, Option<Entity>)>,
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

/// Renders until the scene is static and the kernel is compiled for it; false if that takes too many frames. The log has the error of a
/// kernel that can't be compiled.
pub fn prepare(harness: &mut Harness, patience: u32) -> bool {
    for _ in 0..ATTEMPTS {
        if !harness.wait_until_idle(patience) {
            return false;
        }
        // The scene stays static while no frame is rendered, and so do the definitions.
        if compiled(harness).is_some() {
            return true;
        }
        let mut frames = 0;
        while compiled(harness).is_none() {
            if frames == patience {
                return false;
            }
            frames += 1;
            harness.step(1);
            thread::sleep(NAP);
        }
    }
    false
}

/// Answers for rays, in their order, in the scene of the last frame. The camera reflects, and decides on the layers that rays see. `None`
/// if the scene is not on the GPU, or the kernel isn't compiled for it.
pub fn trace(harness: &mut Harness, camera: Entity, rays: &[TraceRay]) -> Option<Vec<Answer>> {
    let id = compiled(harness)?;
    let view = harness.world().get::<RenderEntity>(camera).map(RenderEntity::id);
    dispatch(harness, view, id, rays)
}

/// The pipeline for the current scene, once it is compiled.
fn compiled(harness: &mut Harness) -> Option<CachedComputePipelineId> {
    let id = queue(harness)?;
    let cache = harness.render_resource::<PipelineCache>()?;
    matches!(cache.get_compute_pipeline_state(id), CachedPipelineState::Ok(_)).then_some(id)
}

/// The pipeline for the current scene. `None` without a scene.
fn queue(harness: &mut Harness) -> Option<CachedComputePipelineId> {
    let defs = harness.render_resource::<SceneBindings>()?.shader_defs();
    let world = harness.world();
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
    let scene = harness.render_resource::<SceneBindings>()?;
    let cache = harness.render_resource::<PipelineCache>()?;
    let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
        label: Some("oracle".into()),
        layout: vec![lists_layout(), scene.layout.clone(), layout_descriptor()],
        shader,
        shader_defs: defs.clone(),
        entry_point: Some("trace_rays".into()),
        ..default()
    });
    harness
        .world()
        .resource_mut::<OracleKernel>()
        .pipelines
        .push((defs, id));
    Some(id)
}

fn dispatch(
    harness: &Harness,
    view: Option<Entity>,
    id: CachedComputePipelineId,
    rays: &[TraceRay],
) -> Option<Vec<Answer>> {
    let device = harness.render_resource::<RenderDevice>()?;
    let cache = harness.render_resource::<PipelineCache>()?;
    let scene = harness.render_resource::<SceneBindings>()?.bind_group.as_ref()?;
    let environment = harness.render_resource::<EnvironmentBindings>()?.bind_group(view?)?;
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
    harness.render_resource::<RenderQueue>()?.submit([encoder.finish()]);
    let bytes = harness.read_buffer(&output)?;
    let slots = harness.render_resource::<SceneInstances>()?;
    let entity = |slot: u32| (slot != NO_HIT).then(|| slots.get(slot).map(|source| source.entity));
    let answer = |answer: GpuAnswer| Answer {
        hit: entity(answer.instance).map(|entity| (answer.t, entity)),
        blocked: entity(answer.blocked),
    };
    Some(bytemuck::pod_collect_to_vec(&bytes).into_iter().map(answer).collect())
}
