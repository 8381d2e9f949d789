//! Back end of `trace/vrs.rs`: creates the pipeline, keeps descriptor sets and rate images, and records the pass.

use super::{
    contents::GroupContents,
    descriptors::DescriptorSet,
    device::{Vulkan, raw_view},
    draw::{PipelineRequest, VrsDraw},
    init::{Capabilities, HardwareVrs},
    pass::PassCommands,
    pipeline::RawPipeline,
    rate_image::RateImage,
    retry::Retry,
    shader::{Linker, Target, link, linker, translate},
    states::StateSetter,
};
use crate::device::try_allocate;
use bevy::{
    asset::Assets,
    ecs::{entity::EntityHashMap, prelude::*},
    log::warn,
    platform::collections::HashMap,
    render::{
        Extract,
        render_resource::{
            BindGroupId, BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedComputePipelineId,
            CommandEncoderDescriptor, ComputePipelineDescriptor, PipelineCache, ShaderStages, TextureSampleType,
            TextureView, TextureViewId, WgpuFeatures, binding_types,
        },
        renderer::{RenderContext, RenderDevice},
    },
    shader::Shader,
    tasks::{AsyncComputeTaskPool, Task, futures::check_ready},
    utils::default,
};
use core::num::NonZeroU64;
use std::sync::Arc;
use wgpu::hal::api::Vulkan as VulkanApi;

/// Number of frames after which unused resources are released.
const KEPT_FRAMES: u32 = 2;
/// Number of frames between two attempts to link the shader.
const LINK_INTERVAL: u32 = 20;

enum PipelineState {
    /// Not requested.
    Unwanted,
    /// Its shader is linked after this many frames.
    Waiting(u32),
    /// `None` if some of the shader's modules are still being loaded.
    Compiling(Task<Result<Option<RawPipeline>, String>>),
    Ready(Arc<RawPipeline>),
    Failed(String),
}

struct ViewState {
    /// `None` at the full rate.
    rates: Option<Arc<RateImage>>,
    targets: [TextureViewId; 2],
    used: u32,
}

struct KnownSet {
    set: Arc<DescriptorSet>,
    used: u32,
}

/// Pipeline, descriptor sets and rate images; absent if the device has no shading-rate attachments.
#[derive(Resource)]
pub(crate) struct VrsBackend {
    support: HardwareVrs,
    vulkan: Arc<Vulkan>,
    capabilities: Capabilities,
    features: WgpuFeatures,
    storage_buffers: u32,
    pack_layout: BindGroupLayoutDescriptor,
    /// Entry points of the attachment shader.
    pack: Option<CachedComputePipelineId>,
    touch: Option<CachedComputePipelineId>,
    request: Option<PipelineRequest>,
    state: PipelineState,
    retry: Retry,
    views: EntityHashMap<ViewState>,
    sets: HashMap<BindGroupId, KnownSet>,
    frame: u32,
}

impl VrsBackend {
    fn new(support: &HardwareVrs, device: &RenderDevice) -> Result<Self, String> {
        let capabilities = support.capabilities()?;
        let vulkan = Arc::new(Vulkan::new(device, &capabilities)?);
        let pack_layout = BindGroupLayoutDescriptor::new(
            "glint_vrs_rates",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    binding_types::texture_2d(TextureSampleType::Uint),
                    binding_types::storage_buffer_sized(false, NonZeroU64::new(4)),
                ),
            ),
        );
        Ok(Self {
            support: support.clone(),
            vulkan,
            capabilities,
            features: device.features(),
            storage_buffers: device.limits().max_storage_buffers_per_shader_stage,
            pack_layout,
            pack: None,
            touch: None,
            request: None,
            state: PipelineState::Unwanted,
            retry: Retry::default(),
            views: EntityHashMap::default(),
            sets: HashMap::default(),
            frame: 0,
        })
    }

    /// Advances the pipeline, which is compiled in the background. Returns true once [`record`](Self::record) can be called. Call in
    /// [`Prepare`](bevy::render::RenderSystems::Prepare) of each frame in which a view needs it; `request` is called once.
    ///
    /// # Errors
    /// The reason why there will be no pipeline.
    pub(crate) fn prepare(
        &mut self,
        cache: &PipelineCache,
        request: impl FnOnce() -> PipelineRequest,
    ) -> Result<bool, String> {
        if self.request.is_none() {
            let request = request();
            let queue = |entry_point: &'static str, layout| {
                cache.queue_compute_pipeline(ComputePipelineDescriptor {
                    label: Some(format!("glint_vrs_{entry_point}").into()),
                    layout,
                    shader: request.attachment_shader.clone(),
                    entry_point: Some(entry_point.into()),
                    ..default()
                })
            };
            self.pack = Some(queue("pack", vec![self.pack_layout.clone()]));
            self.touch = Some(queue("touch", request.layouts.to_vec()));
            self.request = Some(request);
            self.state = PipelineState::Waiting(0);
        }
        let compiled = match &mut self.state {
            PipelineState::Compiling(task) => check_ready(task),
            PipelineState::Waiting(frames) => {
                *frames = frames.saturating_sub(1);
                None
            }
            _ => None,
        };
        match compiled {
            None => {}
            Some(Ok(Some(pipeline))) => self.state = PipelineState::Ready(Arc::new(pipeline)),
            Some(Ok(None)) => self.state = PipelineState::Waiting(LINK_INTERVAL),
            Some(Err(reason)) => self.fail(reason),
        }
        match &self.state {
            PipelineState::Failed(reason) => Err(reason.clone()),
            _ => Ok(self.is_ready(cache)),
        }
    }

    /// Returns whether [`record`](Self::record) can be called.
    pub(crate) fn is_ready(&self, cache: &PipelineCache) -> bool {
        let is_compiled = |id: Option<_>| id.is_some_and(|id| cache.get_compute_pipeline(id).is_some());
        matches!(self.state, PipelineState::Ready(_)) && is_compiled(self.pack) && is_compiled(self.touch)
    }

    /// Disables the pass on this device for a while; `reason` is the end of a sentence.
    pub(crate) fn fail(&mut self, reason: String) {
        self.retry.fail();
        self.support.set(Err(reason.clone()));
        self.state = PipelineState::Failed(reason);
    }

    fn link(&mut self, shaders: &Assets<Shader>) {
        let (PipelineState::Waiting(0), Some(request)) = (&self.state, &self.request) else {
            return;
        };
        if !shaders.contains(&request.shader) {
            return;
        }
        let mut linker: Linker = linker(shaders, self.storage_buffers);
        let (shader, defs, layouts) = (request.shader.id(), request.defs.clone(), request.layouts.clone());
        let vulkan = Arc::clone(&self.vulkan);
        let target = Target {
            version: self.capabilities.version,
            features: self.features,
        };
        let partially_bound = self.features.contains(WgpuFeatures::PARTIALLY_BOUND_BINDING_ARRAY);
        let has_rates = self.capabilities.rates.is_some();
        self.state = PipelineState::Compiling(AsyncComputeTaskPool::get().spawn(async move {
            let Some(wgsl) = link(&mut linker, shader, &defs)? else {
                return Ok(None);
            };
            let spirv = translate(&wgsl, &layouts, target)?;
            RawPipeline::new(&vulkan, &layouts, &spirv, partially_bound, has_rates).map(Some)
        }));
    }

    /// Records the pass of a view. Transitions of all resources go into the context's encoder; the pass itself is a command buffer after
    /// it. Later commands can use the targets as if wgpu had drawn to them.
    ///
    /// # Errors
    /// The reason why nothing was drawn.
    pub(crate) fn record(
        &mut self,
        ctx: &mut RenderContext,
        cache: &PipelineCache,
        pass: &VrsDraw,
    ) -> Result<(), String> {
        let PipelineState::Ready(pipeline) = &self.state else {
            return Err("the pipeline isn't compiled".into());
        };
        let pipeline = Arc::clone(pipeline);
        let compiled = |id: Option<_>| id.and_then(|id| cache.get_compute_pipeline(id));
        let (Some(pack), Some(touch)) = (compiled(self.pack), compiled(self.touch)) else {
            return Err("the pipelines around the pass aren't compiled".into());
        };
        self.capabilities.fits(pass.sizes.tile)?;
        let device = ctx.render_device().clone();
        let sets = [
            self.descriptor_set(&pipeline, 0, pass.groups[0].contents.contents()?)?,
            self.descriptor_set(&pipeline, 1, pass.groups[1].contents.contents()?)?,
            self.descriptor_set(&pipeline, 2, pass.groups[2].contents.contents()?)?,
        ];
        if pipeline.has_address && sets.iter().all(|set| set.acceleration_structure.is_none()) {
            return Err("no acceleration structure is bound".into());
        }
        let targets = [pass.ray_radiance, pass.ray_sample];
        let raw_targets = [raw_view(targets[0])?, raw_view(targets[1])?];
        let (rates, new_targets) = self.view_state(&device, pass)?;
        let pack_layout = cache.get_bind_group_layout(&self.pack_layout);
        let states = StateSetter {
            pack,
            pack_layout,
            touch,
        };
        states.set(ctx, pass, rates.as_deref(), new_targets);

        let offsets: Vec<u32> = pass.groups.iter().flat_map(|group| group.offsets).copied().collect();
        let commands = PassCommands {
            vulkan: &self.vulkan,
            pipeline: &pipeline,
            sets: &sets,
            dynamic_offsets: &offsets,
            rates: rates.as_deref(),
            targets: raw_targets,
            size: pass.sizes.trace(),
            tile: pass.sizes.tile,
        };
        let create = || {
            device.create_command_encoder(&CommandEncoderDescriptor {
                label: Some("glint_hardware_vrs"),
            })
        };
        let mut encoder = try_allocate(&device, create).ok_or("the device has no memory for commands")?;
        // SAFETY: this encoder has no other use; the pass ends everything that it begins; its resources are kept alive below.
        let recorded = unsafe {
            encoder
                .as_hal_mut::<VulkanApi, _, _>(|encoder| encoder.map(|encoder| commands.record(encoder.raw_handle())))
        };
        if recorded.is_none() {
            return Err("the command encoder isn't one of Vulkan".into());
        }
        let buffer = encoder.finish();
        let kept = (pipeline, sets, rates, targets.map(TextureView::clone));
        buffer.on_submitted_work_done(move || drop(kept));
        ctx.add_command_buffer(buffer);
        self.retry.succeed();
        Ok(())
    }

    fn descriptor_set(
        &mut self,
        pipeline: &RawPipeline,
        index: usize,
        contents: &GroupContents,
    ) -> Result<Arc<DescriptorSet>, String> {
        let id = contents.bind_group.id();
        if let Some(known) = self.sets.get_mut(&id) {
            known.used = self.frame;
            return Ok(Arc::clone(&known.set));
        }
        let set = Arc::new(DescriptorSet::new(&self.vulkan, &pipeline.sets[index], contents)?);
        self.sets.insert(
            id,
            KnownSet {
                set: Arc::clone(&set),
                used: self.frame,
            },
        );
        Ok(set)
    }

    /// The view's rate image, and whether its targets are new.
    fn view_state(&mut self, device: &RenderDevice, pass: &VrsDraw) -> Result<(Option<Arc<RateImage>>, bool), String> {
        let tiles = pass.sizes.tiles();
        let targets = [pass.ray_radiance.id(), pass.ray_sample.id()];
        if let Some(known) = self.views.get_mut(&pass.view)
            && known.rates.as_ref().is_none_or(|rates| rates.tiles == tiles)
        {
            let new_targets = known.targets != targets;
            known.targets = targets;
            known.used = self.frame;
            return Ok((known.rates.clone(), new_targets));
        }
        let rates = match self.capabilities.rates {
            Some(_) => Some(Arc::new(RateImage::new(&self.vulkan, device, tiles)?)),
            None => None,
        };
        let state = ViewState {
            rates: rates.clone(),
            targets,
            used: self.frame,
        };
        self.views.insert(pass.view, state);
        Ok((rates, true))
    }
}

/// Creates the pass for each device that has its requirements.
pub(super) fn init_backend(mut commands: Commands, support: Res<HardwareVrs>, device: Res<RenderDevice>) {
    commands.remove_resource::<VrsBackend>();
    match VrsBackend::new(&support, &device) {
        Ok(backend) => commands.insert_resource(backend),
        Err(reason) => {
            warn!("no hardware variable rate shading: {reason}");
            support.set(Err(reason));
        }
    }
}

/// Links the shader once its modules are loaded; only the main world has them.
pub(super) fn collect_shaders(backend: Option<ResMut<VrsBackend>>, shaders: Extract<Option<Res<Assets<Shader>>>>) {
    if let (Some(mut backend), Some(shaders)) = (backend, shaders.as_ref()) {
        backend.link(shaders);
    }
}

/// Releases resources that no view has used for a while, and retries failed passes.
pub(super) fn evict_unused(backend: Option<ResMut<VrsBackend>>) {
    let Some(mut backend) = backend else { return };
    let backend = &mut *backend;
    if backend.retry.is_due() {
        backend.support.set(Ok(backend.capabilities));
        backend.state = PipelineState::Waiting(0);
    }
    let frame = backend.frame;
    let is_used = |used: u32| frame.wrapping_sub(used) <= KEPT_FRAMES;
    backend.views.retain(|_, view| is_used(view.used));
    backend.sets.retain(|_, set| is_used(set.used));
    backend.frame = frame.wrapping_add(1);
}
