//! The passes that pose meshes on the GPU.

use super::job::{Batch, PoseJob};
use crate::{device::ReflectionTracer, scene::upload::StorageSlice};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    log::error,
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntries, Buffer,
            BufferBinding, BufferId, BufferInitDescriptor, BufferUsages, CachedComputePipelineId, CachedPipelineState,
            CommandEncoder, CommandEncoderDescriptor, ComputePass, ComputePassDescriptor, ComputePipeline,
            ComputePipelineDescriptor, PipelineCache, ShaderStages,
            binding_types::{storage_buffer_read_only_sized, storage_buffer_sized, uniform_buffer_sized},
        },
        renderer::{RenderDevice, RenderQueue},
    },
    shader::{Shader, ShaderCacheError},
    utils::default,
};
use core::num::NonZeroU64;

/// Threads per workgroup.
const THREADS: u32 = 64;
/// Maximum number of workgroups per dispatch; shaders loop over the rest.
const MOST_WORKGROUPS: u32 = 65_535;
/// Maximum number of jobs in a batch.
pub(super) const MOST_JOBS: usize = MOST_WORKGROUPS as usize;
/// Offset between two levels in their buffer, which all devices can bind, and size of a level, in bytes.
const LEVEL_STRIDE: u32 = 256;
const LEVEL_BYTES: u64 = 16;

/// The kernels, compiled on first use.
pub(super) struct KernelCache {
    pose_shader: Handle<Shader>,
    refit_shader: Handle<Shader>,
    tracer: ReflectionTracer,
    queued: Option<(CachedComputePipelineId, Option<[CachedComputePipelineId; 2]>)>,
    /// With the app's shader.
    moving: Option<CachedComputePipelineId>,
    /// The last of these that was compiled. It runs while the next one is compiled, or if that fails.
    last_moving: Option<ComputePipeline>,
    /// The error of the app's shader that was logged.
    told: Option<String>,
    kernels: Option<Kernels>,
}

/// Compiled kernels.
pub(super) struct Kernels {
    pub pose: ComputePipeline,
    /// [`Self::pose`] with the app's shader; `None` without one, and until it is compiled.
    pub moving: Option<ComputePipeline>,
    /// Changes with [`Self::moving`].
    pub moving_version: u64,
    pub pose_layout: BindGroupLayout,
    /// Only for the BVH tracer.
    pub refit: Option<RefitKernels>,
}

/// Kernels that refit the trees of posed meshes.
pub(super) struct RefitKernels {
    pub triangles: ComputePipeline,
    pub nodes: ComputePipeline,
    pub layout: BindGroupLayout,
    pub level_layout: BindGroupLayout,
}

impl KernelCache {
    pub fn new(assets: &AssetServer, tracer: ReflectionTracer) -> Self {
        Self {
            pose_shader: load_embedded_asset!(assets, "pose.wesl"),
            refit_shader: load_embedded_asset!(assets, "refit.wesl"),
            tracer,
            queued: None,
            moving: None,
            last_moving: None,
            told: None,
            kernels: None,
        }
    }

    /// Returns `None` while they are being compiled. `has_shader` is true if the app has a shader.
    pub fn get(&mut self, cache: &PipelineCache, has_shader: bool) -> Option<&Kernels> {
        let moving = if has_shader { self.moving(cache) } else { None };
        if self.kernels.is_none() {
            let (pose, refit) = *self.queued.get_or_insert_with(|| {
                let queue = |label: &'static str, entry_point: &'static str, shader: &Handle<Shader>, layout| {
                    cache.queue_compute_pipeline(ComputePipelineDescriptor {
                        label: Some(label.into()),
                        layout,
                        shader: shader.clone(),
                        entry_point: Some(entry_point.into()),
                        ..default()
                    })
                };
                let pose = queue("glint_pose", "pose_vertices", &self.pose_shader, vec![pose_layout()]);
                let refit = (self.tracer == ReflectionTracer::Bvh).then(|| {
                    let layouts = || vec![refit_layout(), level_layout()];
                    [
                        queue("glint_pose_triangles", "pose_triangles", &self.refit_shader, layouts()),
                        queue("glint_fit_level", "fit_level", &self.refit_shader, layouts()),
                    ]
                });
                (pose, refit)
            });
            let refit = match refit {
                Some([triangles, nodes]) => Some(RefitKernels {
                    triangles: cache.get_compute_pipeline(triangles)?.clone(),
                    nodes: cache.get_compute_pipeline(nodes)?.clone(),
                    layout: cache.get_bind_group_layout(&refit_layout()),
                    level_layout: cache.get_bind_group_layout(&level_layout()),
                }),
                None => None,
            };
            self.kernels = Some(Kernels {
                pose: cache.get_compute_pipeline(pose)?.clone(),
                moving: None,
                moving_version: 0,
                pose_layout: cache.get_bind_group_layout(&pose_layout()),
                refit,
            });
        }
        let id = |kernel: &Option<ComputePipeline>| kernel.as_ref().map(ComputePipeline::id);
        let kernels = self.kernels.as_mut()?;
        kernels.moving_version += u64::from(id(&kernels.moving) != id(&moving));
        kernels.moving = moving;
        Some(kernels)
    }

    /// The kernel with the app's shader. Logs each error of the shader once.
    fn moving(&mut self, cache: &PipelineCache) -> Option<ComputePipeline> {
        let id = *self.moving.get_or_insert_with(|| {
            cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some("glint_pose_moving".into()),
                layout: vec![pose_layout()],
                shader: self.pose_shader.clone(),
                shader_defs: vec!["VERTEX_SHADER".into()],
                entry_point: Some("pose_vertices".into()),
                ..default()
            })
        });
        match cache.get_compute_pipeline_state(id) {
            CachedPipelineState::Err(
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
            ) => {}
            CachedPipelineState::Err(error) => {
                let error = error.to_string();
                if self.told.as_ref() != Some(&error) {
                    error!(
                        "the shader of `ReflectedVertexShader` failed, so that reflections move vertices as the last one did, if \
                         there was one: {error}"
                    );
                    self.told = Some(error);
                }
            }
            _ => {}
        }
        if let Some(compiled) = cache.get_compute_pipeline(id) {
            self.last_moving = Some(compiled.clone());
            self.told = None;
        }
        self.last_moving.clone()
    }
}

pub(super) fn pose_layout() -> BindGroupLayoutDescriptor {
    let entries = BindGroupLayoutEntries::sequential(
        ShaderStages::COMPUTE,
        (
            storage_buffer_read_only_sized(false, NonZeroU64::new(size_of::<PoseJob>() as u64)),
            storage_buffer_read_only_sized(false, NonZeroU64::new(4)),
            storage_buffer_sized(false, NonZeroU64::new(4)),
        ),
    );
    BindGroupLayoutDescriptor::new("glint_pose", &entries)
}

pub(super) fn refit_layout() -> BindGroupLayoutDescriptor {
    let entries = BindGroupLayoutEntries::sequential(
        ShaderStages::COMPUTE,
        (
            storage_buffer_read_only_sized(false, NonZeroU64::new(size_of::<PoseJob>() as u64)),
            storage_buffer_read_only_sized(false, NonZeroU64::new(4)),
            storage_buffer_sized(false, NonZeroU64::new(4)),
            storage_buffer_sized(false, NonZeroU64::new(48)),
            storage_buffer_sized(false, NonZeroU64::new(16)),
        ),
    );
    BindGroupLayoutDescriptor::new("glint_refit", &entries)
}

pub(super) fn level_layout() -> BindGroupLayoutDescriptor {
    let entries = BindGroupLayoutEntries::single(
        ShaderStages::COMPUTE,
        uniform_buffer_sized(false, NonZeroU64::new(LEVEL_BYTES)),
    );
    BindGroupLayoutDescriptor::new("glint_level", &entries)
}

/// Buffers of the passes.
pub(super) struct PosePass {
    jobs: StorageSlice<PoseJob>,
    values: StorageSlice<u32>,
    boxes: StorageSlice<[f32; 4]>,
    /// One bind group for each level of the deepest tree so far.
    levels: Vec<BindGroup>,
    bound: Option<Bound>,
}

/// Bind groups of the passes, valid for these buffers.
struct Bound {
    buffers: [BufferId; 5],
    pose: BindGroup,
    /// Only for the BVH tracer.
    refit: Option<BindGroup>,
}

impl PosePass {
    pub fn new(device: &RenderDevice) -> Self {
        Self {
            jobs: StorageSlice::new(device, "glint_pose_jobs"),
            values: StorageSlice::new(device, "glint_pose_values"),
            boxes: StorageSlice::new(device, "glint_pose_boxes"),
            levels: Vec::new(),
            bound: None,
        }
    }

    /// Drops references to mesh buffers that have been replaced.
    pub fn forget_others(&mut self, [geometry, bvh]: [&Buffer; 2]) {
        let current = [geometry, bvh].map(Buffer::id);
        self.bound.take_if(|bound| bound.buffers[2..4] != current);
    }

    /// Size of the buffers in bytes.
    pub fn bytes(&self) -> u64 {
        self.jobs.buffer().size() + self.values.buffer().size() + self.boxes.buffer().size()
    }

    /// Reserves space for a batch. Returns false if the device lacks memory.
    pub fn reserve(&mut self, batch: &Batch, device: &RenderDevice) -> bool {
        let boxes = 2 * batch.boxes as usize;
        self.jobs.may_ask_again();
        self.values.may_ask_again();
        self.boxes.may_ask_again();
        self.jobs.reserve(batch.jobs.len(), device) >= batch.jobs.len()
            && self.values.reserve(batch.values.len(), device) >= batch.values.len()
            && self.boxes.reserve(boxes, device) >= boxes
    }

    /// Records the passes that pose all meshes of a batch for which there is space.
    pub fn record(
        &mut self,
        batch: &Batch,
        kernels: &Kernels,
        buffers: [&Buffer; 2],
        diagnostics: Option<&DiagnosticsRecorder>,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> CommandEncoder {
        self.jobs.write(&batch.jobs, 0..batch.jobs.len(), device, queue);
        self.values.write(&batch.values, 0..batch.values.len(), device, queue);
        if let Some(kernels) = &kernels.refit {
            self.levels_up_to(batch, kernels, device);
        }
        self.bind(kernels, buffers, device);
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("glint_pose"),
        });
        let span = diagnostics.time_span(&mut encoder, "glint_pose");
        if let Some(bound) = &self.bound {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("glint_pose"),
                timestamp_writes: None,
            });
            let moving = kernels.moving.as_ref().filter(|_| batch.is_moved);
            pass.set_pipeline(moving.unwrap_or(&kernels.pose));
            pass.set_bind_group(0, &bound.pose, &[]);
            dispatch(&mut pass, batch, |job| job.vertex_count);
            if let (Some(kernels), Some(bind_group)) = (&kernels.refit, &bound.refit) {
                self.refit(&mut pass, batch, kernels, bind_group);
            }
        }
        span.end(&mut encoder);
        encoder
    }

    /// Creates bind groups, unless they exist for the same buffers.
    fn bind(&mut self, kernels: &Kernels, [geometry, bvh]: [&Buffer; 2], device: &RenderDevice) {
        let [jobs, values, boxes] = [self.jobs.buffer(), self.values.buffer(), self.boxes.buffer()];
        let buffers = [jobs, values, geometry, bvh, boxes].map(Buffer::id);
        if self.bound.as_ref().is_some_and(|bound| bound.buffers == buffers) {
            return;
        }
        let entries = BindGroupEntries::sequential((
            jobs.as_entire_binding(),
            values.as_entire_binding(),
            geometry.as_entire_binding(),
        ));
        let pose = device.create_bind_group("glint_pose", &kernels.pose_layout, &entries);
        let refit = kernels.refit.as_ref().map(|kernels| {
            let entries = BindGroupEntries::sequential((
                jobs.as_entire_binding(),
                values.as_entire_binding(),
                geometry.as_entire_binding(),
                bvh.as_entire_binding(),
                boxes.as_entire_binding(),
            ));
            device.create_bind_group("glint_refit", &kernels.layout, &entries)
        });
        self.bound = Some(Bound { buffers, pose, refit });
    }

    fn refit(&self, pass: &mut ComputePass, batch: &Batch, kernels: &RefitKernels, bind_group: &BindGroup) {
        pass.set_pipeline(&kernels.triangles);
        pass.set_bind_group(0, bind_group, &[]);
        let Some(any_level) = self.levels.first() else { return };
        pass.set_bind_group(1, any_level, &[]);
        dispatch(pass, batch, |job| job.triangle_count);
        pass.set_pipeline(&kernels.nodes);
        let depth = depth(batch) as usize;
        for (level, bind_group) in self.levels.iter().enumerate().take(depth).rev() {
            pass.set_bind_group(1, bind_group, &[]);
            dispatch(pass, batch, |job| {
                let starts = batch.values.get(job.levels as usize + level..).unwrap_or_default();
                match starts {
                    [first, end, ..] if level < job.level_count as usize => end - first,
                    _ => 0,
                }
            });
        }
    }

    /// Bind groups with the index of the level for shaders.
    fn levels_up_to(&mut self, batch: &Batch, kernels: &RefitKernels, device: &RenderDevice) {
        let depth = depth(batch);
        if depth as usize <= self.levels.len() {
            return;
        }
        let depth = depth.next_power_of_two();
        let mut contents = vec![0u32; (depth * LEVEL_STRIDE / 4) as usize];
        for (level, words) in (0..).zip(contents.chunks_exact_mut(LEVEL_STRIDE as usize / 4)) {
            words[0] = level;
        }
        let buffer = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("glint_levels"),
            contents: bytemuck::cast_slice(&contents),
            usage: BufferUsages::UNIFORM,
        });
        let bind_group = |level: u32| {
            let binding = BufferBinding {
                buffer: &buffer,
                offset: u64::from(level * LEVEL_STRIDE),
                size: NonZeroU64::new(LEVEL_BYTES),
            };
            device.create_bind_group("glint_level", &kernels.level_layout, &BindGroupEntries::single(binding))
        };
        self.levels = (0..depth).map(bind_group).collect();
    }
}

fn depth(batch: &Batch) -> u32 {
    batch.jobs.iter().map(|job| job.level_count).max().unwrap_or(0)
}

/// Dispatches a row of workgroups for each job, as long as the largest job needs.
fn dispatch(pass: &mut ComputePass, batch: &Batch, threads: impl Fn(&PoseJob) -> u32) {
    let most = batch.jobs.iter().map(threads).max().unwrap_or(0);
    let workgroups = most.div_ceil(THREADS).min(MOST_WORKGROUPS);
    if workgroups > 0 {
        pass.dispatch_workgroups(workgroups, batch.jobs.len() as u32, 1);
    }
}
