//! The render-world side of `kernels.wesl`.

use bevy::{
    core_pipeline::{
        core_3d::main_opaque_pass_3d,
        schedule::{Core3d, Core3dSystems},
    },
    prelude::*,
    render::{
        Render, RenderApp, RenderSystems,
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, Buffer, BufferDescriptor,
            BufferUsages, CachedComputePipelineId, CachedPipelineState, ComputePassDescriptor, ComputePipeline,
            ComputePipelineDescriptor, PipelineCache, ShaderStages, binding_types,
        },
        renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery},
        view::ExtractedView,
    },
    shader::Shader,
};
use bevy_glint::{
    RayTracedReflections, ReflectionSystems, ReflectionTracer,
    internals::{
        SceneBindings,
        environment::{EnvironmentBindings, layout_descriptor},
    },
};
use bytemuck::{Pod, Zeroable};
use core::num::NonZeroU64;

/// Bytes of a stored ray.
const RAY_BYTES: u64 = 32;
/// Workgroups in one row of the folded grid.
const GRID_ROW: u32 = 32_768;
const ENTRY_POINTS: [&str; 5] = [
    "collect_primary",
    "collect_reflections",
    "trace_rays",
    "count_hits",
    "trace_rays",
];
/// The last one is compiled without the alpha test, if that makes a difference.
const SOLID: usize = 4;

/// A list of rays.
pub struct RaySet {
    /// The word in tables and in names of diagnostics.
    pub word: &'static str,
    /// The kernel that collects it.
    collect: usize,
    /// Pixels along each axis that share a ray.
    stride: u32,
    /// Alpha-masked objects count as solid, except for the parts that merged trees omit.
    solid: bool,
}

impl RaySet {
    /// Diagnostics of rays, hits and GPU time.
    pub fn diagnostics(&self) -> [String; 3] {
        let word = self.word;
        [
            format!("render/bench_{word}_rays"),
            format!("render/bench_{word}_hits"),
            format!("render/bench/{word}/elapsed_gpu"),
        ]
    }
}

/// All lists.
pub const RAY_SETS: [RaySet; 3] = [
    RaySet {
        word: "primary",
        collect: 0,
        stride: 1,
        solid: false,
    },
    RaySet {
        word: "reflection",
        collect: 1,
        stride: 2,
        solid: false,
    },
    RaySet {
        word: "solid",
        collect: 1,
        stride: 2,
        solid: true,
    },
];

#[derive(Resource)]
struct KernelShader(Handle<Shader>);

#[derive(Resource)]
struct Kernels {
    layout: BindGroupLayoutDescriptor,
    pipelines: [CachedComputePipelineId; ENTRY_POINTS.len()],
    has_solid: bool,
    /// Version of the scene's shader definitions.
    version: u32,
    buffers: Option<KernelBuffers>,
}

struct KernelBuffers {
    size: UVec2,
    view: Buffer,
    counters: Buffer,
    bind_group: BindGroup,
}

/// `BenchView` of `kernels.wesl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct GpuBenchView {
    world_from_clip: [[f32; 4]; 4],
    camera: [f32; 3],
    spread: f32,
    size: [u32; 2],
    max_ray_length: f32,
    _padding: u32,
}

/// Size of the kernels' largest buffer in bytes.
pub fn largest_buffer(size: UVec2) -> u64 {
    u64::from(size.x) * u64::from(size.y) * RAY_BYTES
}

/// Runs the kernels after the reflections of each view.
pub fn add(app: &mut App) {
    let shader = Shader::from_wesl(include_str!("kernels.wesl"), "embedded://bevy_glint_bench/kernels.wesl");
    let shader = app.world_mut().resource_mut::<Assets<Shader>>().add(shader);
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        return;
    };
    render_app
        .insert_resource(KernelShader(shader))
        .add_systems(Render, queue_kernels.in_set(RenderSystems::Prepare))
        .add_systems(
            Core3d,
            run_kernels
                .after(ReflectionSystems::Passes)
                .before(main_opaque_pass_3d)
                .in_set(Core3dSystems::MainPass),
        );
}

/// Queues the pipelines once the scene's layout is known.
fn queue_kernels(
    mut commands: Commands,
    shader: Res<KernelShader>,
    scene: Option<Res<SceneBindings>>,
    kernels: Option<Res<Kernels>>,
    cache: Res<PipelineCache>,
) {
    if let Some(kernels) = &kernels {
        for id in kernels.pipelines {
            if let CachedPipelineState::Err(error) = cache.get_compute_pipeline_state(id) {
                error_once!("a kernel of the benchmark failed to compile: {error}");
            }
        }
    }
    let Some(scene) = scene else { return };
    if kernels.is_some_and(|kernels| kernels.version == scene.shader_defs_version()) {
        return;
    }
    let storage = |size| binding_types::storage_buffer_sized(false, NonZeroU64::new(size));
    let layout = BindGroupLayoutDescriptor::new(
        "bench_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                binding_types::uniform_buffer_sized(false, NonZeroU64::new(size_of::<GpuBenchView>() as u64)),
                storage(RAY_BYTES),
                storage(8),
                storage(8),
            ),
        ),
    );
    let pipelines = core::array::from_fn(|index| {
        let name = ENTRY_POINTS[index];
        let shader_defs = if index == SOLID {
            scene.shader_defs_for(false)
        } else {
            scene.shader_defs()
        };
        cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(name.into()),
            layout: vec![layout.clone(), scene.layout.clone(), layout_descriptor()],
            shader: shader.0.clone(),
            shader_defs,
            entry_point: Some(name.into()),
            ..default()
        })
    });
    commands.insert_resource(Kernels {
        layout,
        pipelines,
        has_solid: scene.tracer() == ReflectionTracer::Bvh && scene.has_masked_geometry(),
        version: scene.shader_defs_version(),
        buffers: None,
    });
}

impl Kernels {
    fn buffers(&mut self, size: UVec2, device: &RenderDevice, cache: &PipelineCache) -> &KernelBuffers {
        if self.buffers.as_ref().is_some_and(|buffers| buffers.size != size) {
            self.buffers = None;
        }
        let layout = &self.layout;
        self.buffers.get_or_insert_with(|| {
            let buffer = |label, size, usage| {
                device.create_buffer(&BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let pixels = u64::from(size.x) * u64::from(size.y);
            let view_bytes = size_of::<GpuBenchView>() as u64;
            let view = buffer("bench_view", view_bytes, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
            let rays = buffer("bench_rays", pixels * RAY_BYTES, BufferUsages::STORAGE);
            let counters = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            let counters = buffer("bench_counters", 8, counters);
            let results = buffer("bench_results", pixels * 8, BufferUsages::STORAGE);
            let bind_group = device.create_bind_group(
                "bench",
                &cache.get_bind_group_layout(layout),
                &BindGroupEntries::sequential((
                    view.as_entire_binding(),
                    rays.as_entire_binding(),
                    counters.as_entire_binding(),
                    results.as_entire_binding(),
                )),
            );
            KernelBuffers {
                size,
                view,
                counters,
                bind_group,
            }
        })
    }
}

fn run_kernels(
    view: ViewQuery<&ExtractedView>,
    kernels: Option<ResMut<Kernels>>,
    scene: Option<Res<SceneBindings>>,
    environments: Option<Res<EnvironmentBindings>>,
    cache: Res<PipelineCache>,
    queue: Res<RenderQueue>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let view = view.into_inner();
    let (Some(mut kernels), Some(scene), Some(environments)) = (kernels, scene, environments) else {
        return;
    };
    let (Some(scene), Some(environment)) = (scene.bind_group.as_ref(), environments.bind_group(entity)) else {
        return;
    };
    let [
        Some(primary),
        Some(reflections),
        Some(trace),
        Some(count),
        Some(trace_solid),
    ] = kernels.pipelines.map(|id| cache.get_compute_pipeline(id))
    else {
        return;
    };
    let collect = [primary, reflections];
    let has_solid = kernels.has_solid;
    let size = UVec2::new(view.viewport.z, view.viewport.w);
    let device = ctx.render_device().clone();
    let buffers = kernels.buffers(size, &device, &cache);
    queue.write_buffer(&buffers.view, 0, bytemuck::bytes_of(&gpu_view(view, size)));

    let groups = [&buffers.bind_group, scene, environment];
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let record = |ctx: &mut RenderContext, offset: u64, name: String| {
        let counter = buffers.counters.slice(offset..offset + 4);
        diagnostics.record_u32(ctx.command_encoder(), &counter, name);
    };
    let total = diagnostics.time_span(ctx.command_encoder(), "bench");
    for set in RAY_SETS.iter().filter(|set| has_solid || !set.solid) {
        ctx.command_encoder().clear_buffer(&buffers.counters, 0, None);
        let rays = size.map(|extent| extent.div_ceil(set.stride));
        let tiles = rays.map(|extent| extent.div_ceil(8));
        dispatch(&mut ctx, collect[set.collect], groups, tiles);
        record(&mut ctx, 0, format!("bench_{}_rays", set.word));

        let workgroups = (rays.x * rays.y).div_ceil(64);
        let row = workgroups.min(GRID_ROW);
        let grid = UVec2::new(row, workgroups.div_ceil(row.max(1)));
        let span = diagnostics.time_span(ctx.command_encoder(), set.word);
        dispatch(&mut ctx, if set.solid { trace_solid } else { trace }, groups, grid);
        span.end(ctx.command_encoder());

        dispatch(&mut ctx, count, groups, grid);
        record(&mut ctx, 4, format!("bench_{}_hits", set.word));
    }
    total.end(ctx.command_encoder());
}

fn gpu_view(view: &ExtractedView, size: UVec2) -> GpuBenchView {
    let world_from_clip = view.world_from_view.to_matrix() * view.clip_from_view.inverse();
    GpuBenchView {
        world_from_clip: world_from_clip.to_cols_array_2d(),
        camera: view.world_from_view.translation().to_array(),
        spread: 2.0 / (view.clip_from_view.y_axis.y * size.y as f32).abs().max(1e-6),
        size: size.to_array(),
        max_ray_length: RayTracedReflections::default().max_ray_length,
        _padding: 0,
    }
}

fn dispatch(ctx: &mut RenderContext, pipeline: &ComputePipeline, groups: [&BindGroup; 3], grid: UVec2) {
    let descriptor = ComputePassDescriptor {
        label: Some("bench"),
        timestamp_writes: None,
    };
    let mut pass = ctx.command_encoder().begin_compute_pass(&descriptor);
    pass.set_pipeline(pipeline);
    for (index, group) in groups.into_iter().enumerate() {
        pass.set_bind_group(index as u32, group, &[]);
    }
    pass.dispatch_workgroups(grid.x, grid.y, 1);
}
