//! What the tracing passes call: makes the pipeline, keeps descriptor sets and rate images, and records the pass.

use super::{
    contents::GroupContents,
    descriptors::DescriptorSet,
    device::{Vulkan, raw_view},
    init::{Capabilities, HardwareVrs},
    pass::PassCommands,
    pipeline::RawPipeline,
    rate_image::RateImage,
    shader::{Linker, Target, link, linker, translate},
    states::StateSetter,
};
use crate::targets::Sizes;
use bevy::{
    asset::{AssetServer, Assets, Handle, load_embedded_asset},
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
    shader::{Shader, ShaderDefVal},
    tasks::{AsyncComputeTaskPool, Task, futures::check_ready},
    utils::default,
};
use core::num::NonZeroU64;
use std::sync::Arc;
use wgpu::hal::api::Vulkan as VulkanApi;

/// Frames after which what no view uses is let go.
const KEPT_FRAMES: u32 = 2;
/// Frames between two attempts to link the shader.
const LINK_INTERVAL: u32 = 20;

/// What the pipeline is made of; the same for all views.
pub(crate) struct PipelineRequest {
    /// A module with the entry points `vertex` (a triangle over the targets) and `fragment` (radiance and record).
    pub shader: Handle<Shader>,
    pub defs: Vec<ShaderDefVal>,
    /// Layouts of the bind groups, as for wgpu's pipelines.
    pub layouts: [BindGroupLayoutDescriptor; 3],
}

/// A bind group of the pass.
pub(crate) struct PassGroup<'a> {
    pub contents: &'a GroupContents,
    /// Dynamic offsets, in the order of their bindings.
    pub offsets: &'a [u32],
}

/// The pass of one view.
pub(crate) struct HardwarePass<'a> {
    pub view: Entity,
    pub sizes: Sizes,
    /// The rate image of this frame.
    pub rate: &'a TextureView,
    pub ray_radiance: &'a TextureView,
    pub ray_record: &'a TextureView,
    pub groups: [PassGroup<'a>; 3],
}

enum PipelineState {
    /// Nobody has asked for it.
    Unwanted,
    /// Its shader is linked after this many frames.
    Waiting(u32),
    /// `None`: some of the shader's modules are still being loaded.
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

/// The hardware back end; absent where the device has no shading-rate attachments.
#[derive(Resource)]
pub(crate) struct HardwareBackend {
    support: HardwareVrs,
    vulkan: Arc<Vulkan>,
    capabilities: Capabilities,
    features: WgpuFeatures,
    storage_buffers: u32,
    shader: Handle<Shader>,
    pack_layout: BindGroupLayoutDescriptor,
    pack: CachedComputePipelineId,
    touch: Option<CachedComputePipelineId>,
    request: Option<PipelineRequest>,
    state: PipelineState,
    views: EntityHashMap<ViewState>,
    sets: HashMap<BindGroupId, KnownSet>,
    frame: u32,
}

impl HardwareBackend {
    fn new(
        support: &HardwareVrs,
        device: &RenderDevice,
        cache: &PipelineCache,
        assets: &AssetServer,
    ) -> Result<Self, String> {
        let capabilities = support.capabilities()?;
        let vulkan = Arc::new(Vulkan::new(device, &capabilities)?);
        let shader: Handle<Shader> = load_embedded_asset!(assets, "rate_image.wesl");
        let pack_layout = BindGroupLayoutDescriptor::new(
            "glint_hardware_rates",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    binding_types::texture_2d(TextureSampleType::Uint),
                    binding_types::storage_buffer_sized(false, NonZeroU64::new(4)),
                ),
            ),
        );
        let pack = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some("glint_hardware_rates".into()),
            layout: vec![pack_layout.clone()],
            shader: shader.clone(),
            entry_point: Some("pack".into()),
            ..default()
        });
        Ok(Self {
            support: support.clone(),
            vulkan,
            capabilities,
            features: device.features(),
            storage_buffers: device.limits().max_storage_buffers_per_shader_stage,
            shader,
            pack_layout,
            pack,
            touch: None,
            request: None,
            state: PipelineState::Unwanted,
            views: EntityHashMap::default(),
            sets: HashMap::default(),
            frame: 0,
        })
    }

    /// Brings the pipeline forward, which compiles beside the frames. True once [`record`](Self::record) can be called. Belongs
    /// in [`Prepare`](bevy::render::RenderSystems::Prepare) of each frame in which a view wants it; `request` is called once.
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
            self.touch = Some(cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some("glint_hardware_touch".into()),
                layout: request.layouts.to_vec(),
                shader: self.shader.clone(),
                entry_point: Some("touch".into()),
                ..default()
            }));
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

    /// Whether [`record`](Self::record) can be called.
    pub(crate) fn is_ready(&self, cache: &PipelineCache) -> bool {
        let is_compiled = |id| cache.get_compute_pipeline(id).is_some();
        matches!(self.state, PipelineState::Ready(_)) && is_compiled(self.pack) && self.touch.is_some_and(is_compiled)
    }

    /// Gives this device up; `reason` is the end of a sentence.
    pub(crate) fn fail(&mut self, reason: String) {
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

    /// Records the pass of a view: into the context's encoder what brings all that it uses into the right states, and the
    /// pass itself as a command buffer behind. What comes later may use the targets as if wgpu had drawn to them.
    ///
    /// # Errors
    /// The reason why nothing was drawn.
    pub(crate) fn record(
        &mut self,
        ctx: &mut RenderContext,
        cache: &PipelineCache,
        pass: &HardwarePass,
    ) -> Result<(), String> {
        let PipelineState::Ready(pipeline) = &self.state else {
            return Err("the pipeline isn't compiled".into());
        };
        let pipeline = Arc::clone(pipeline);
        let (Some(pack), Some(touch)) = (
            cache.get_compute_pipeline(self.pack),
            self.touch.and_then(|id| cache.get_compute_pipeline(id)),
        ) else {
            return Err("the pipelines around the pass aren't compiled".into());
        };
        self.capabilities.fits(pass.sizes.tile)?;
        let device = ctx.render_device().clone();
        let sets = [
            self.descriptor_set(&pipeline, 0, pass.groups[0].contents)?,
            self.descriptor_set(&pipeline, 1, pass.groups[1].contents)?,
            self.descriptor_set(&pipeline, 2, pass.groups[2].contents)?,
        ];
        if pipeline.has_address && sets.iter().all(|set| set.acceleration_structure.is_none()) {
            return Err("no acceleration structure is bound".into());
        }
        let targets = [pass.ray_radiance, pass.ray_record];
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
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("glint_hardware_vrs"),
        });
        // SAFETY: this encoder is used for nothing else; the pass ends what it begins; what it uses is kept below.
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
    fn view_state(
        &mut self,
        device: &RenderDevice,
        pass: &HardwarePass,
    ) -> Result<(Option<Arc<RateImage>>, bool), String> {
        let tiles = pass.sizes.tiles();
        let targets = [pass.ray_radiance.id(), pass.ray_record.id()];
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

/// Makes the back end for each device that has what it needs.
pub(super) fn init_backend(
    mut commands: Commands,
    support: Res<HardwareVrs>,
    device: Res<RenderDevice>,
    cache: Res<PipelineCache>,
    assets: Res<AssetServer>,
) {
    commands.remove_resource::<HardwareBackend>();
    match HardwareBackend::new(&support, &device, &cache, &assets) {
        Ok(backend) => commands.insert_resource(backend),
        Err(reason) => {
            warn!("no hardware variable rate shading: {reason}");
            support.set(Err(reason));
        }
    }
}

/// Links the shader once its modules are loaded; only the main world has them.
pub(super) fn collect_shaders(backend: Option<ResMut<HardwareBackend>>, shaders: Extract<Option<Res<Assets<Shader>>>>) {
    if let (Some(mut backend), Some(shaders)) = (backend, shaders.as_ref()) {
        backend.link(shaders);
    }
}

/// Lets go of what no view has used for a while.
pub(super) fn evict_unused(backend: Option<ResMut<HardwareBackend>>) {
    let Some(mut backend) = backend else { return };
    let backend = &mut *backend;
    let frame = backend.frame;
    let is_used = |used: u32| frame.wrapping_sub(used) <= KEPT_FRAMES;
    backend.views.retain(|_, view| is_used(view.used));
    backend.sets.retain(|_, set| is_used(set.used));
    backend.frame = frame.wrapping_add(1);
}
