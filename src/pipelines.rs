//! Compiles the passes of all views: modules request the variants that they can run, and run the best one that is compiled.
//!
//! A pass is a row ([`Pass`]) with everything that its pipelines and bind groups are created from. `pass_table.rs` has all rows.

mod pass;

pub(crate) use pass::{Failure, Groups, Kind, Options, Pass, Variant};

use crate::{
    gbuffer::{Contents, Group0, PassContext},
    scene::{Features, Fit, SceneDefinitions, environment},
};
use bevy::{
    asset::{AssetId, AssetServer, Handle},
    core_pipeline::FullscreenShader,
    ecs::prelude::*,
    log::error,
    platform::collections::{HashMap, HashSet},
    render::{
        render_resource::{
            BindGroup, BindGroupLayoutDescriptor, BindingResource, BlendComponent, BlendFactor, BlendOperation,
            BlendState, CachedComputePipelineId, CachedPipelineState, CachedRenderPipelineId, ColorTargetState,
            ColorWrites, ComputePass, ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, FragmentState,
            PipelineCache, RenderPassColorAttachment, RenderPassDescriptor, RenderPipelineDescriptor, VertexState,
        },
        renderer::{RenderContext, RenderDevice},
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};

/// Pipelines of all passes, in variants that are compiled on first request.
#[derive(Resource)]
pub(crate) struct Pipelines {
    passes: HashMap<&'static Pass, LoadedPass>,
    scene_layout: BindGroupLayoutDescriptor,
    definitions: SceneDefinitions,
    /// Definitions of all variants.
    common: Vec<ShaderDefVal>,
    fullscreen: FullscreenShader,
    /// Messages that were logged, each with the app's shader.
    logged: HashSet<(&'static str, Option<AssetId<Shader>>)>,
}

struct LoadedPass {
    shader: Handle<Shader>,
    group_0: Group0,
    queued: HashMap<Variant, PipelineId>,
}

#[derive(Clone, Copy)]
enum PipelineId {
    Compute(CachedComputePipelineId),
    Render(CachedRenderPipelineId),
}

impl PipelineId {
    fn state(self, cache: &PipelineCache) -> &CachedPipelineState {
        match self {
            Self::Compute(id) => cache.get_compute_pipeline_state(id),
            Self::Render(id) => cache.get_render_pipeline_state(id),
        }
    }

    fn is_compiled(self, cache: &PipelineCache) -> bool {
        matches!(self.state(cache), CachedPipelineState::Ok(_))
    }

    /// Modules that are still being loaded also cause errors, but only for a short time.
    fn lasting_error(self, cache: &PipelineCache) -> Option<&ShaderCacheError> {
        match self.state(cache) {
            CachedPipelineState::Err(
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
            ) => None,
            CachedPipelineState::Err(error) => Some(error),
            _ => None,
        }
    }
}

impl Pipelines {
    /// Loads the shaders of these passes. `common` are definitions of all variants.
    pub(crate) fn new(
        passes: &[&'static Pass],
        assets: &AssetServer,
        fullscreen: &FullscreenShader,
        scene: (&BindGroupLayoutDescriptor, SceneDefinitions),
        common: Vec<ShaderDefVal>,
    ) -> Self {
        let load = |pass: &Pass| LoadedPass {
            shader: assets.load(format!("embedded://bevy_glint/{}", pass.shader)),
            group_0: Group0::new(
                pass.label,
                pass.kind.stages(),
                pass.kind != Kind::Addition,
                (pass.bindings)(),
            ),
            queued: HashMap::default(),
        };
        Self {
            passes: passes.iter().map(|&pass| (pass, load(pass))).collect(),
            scene_layout: scene.0.clone(),
            definitions: scene.1,
            common,
            fullscreen: fullscreen.clone(),
            logged: HashSet::default(),
        }
    }

    /// Requests variants of passes, and logs errors of these. Call in each frame in which they can be used.
    pub(crate) fn want(&mut self, cache: &PipelineCache, variants: impl IntoIterator<Item = Variant>) {
        for variant in variants {
            let Some(id) = self.id(&variant) else {
                self.queue(variant, cache);
                continue;
            };
            if let Some(error) = id.lasting_error(cache) {
                self.log(&variant, error);
            }
        }
    }

    fn log(&mut self, variant: &Variant, error: &ShaderCacheError) {
        let Failure { library, own } = variant.pass.failure;
        let message = if variant.has_own_code() { own } else { library };
        let shader = variant.own.as_ref();
        if !message.is_empty() && self.logged.insert((message, shader.map(Handle::id))) {
            let shader = shader.map_or_else(String::new, |shader| format!("{shader:?}"));
            error!("{}: {error}", message.replace("{shader}", &shader));
        }
    }

    fn queue(&mut self, variant: Variant, cache: &PipelineCache) {
        let (layout, defs) = (self.layouts(&variant), self.definitions(&variant));
        let id = match variant.pass.kind {
            Kind::Compute => PipelineId::Compute(cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some(variant.pass.label.into()),
                layout,
                shader: self.module(&variant),
                shader_defs: defs,
                entry_point: variant.own.is_none().then(|| variant.pass.entry_point.into()),
                ..default()
            })),
            Kind::Fragments(_) | Kind::Addition => {
                PipelineId::Render(cache.queue_render_pipeline(self.render_descriptor(&variant, layout, defs)))
            }
        };
        if let Some(pass) = self.passes.get_mut(variant.pass) {
            pass.queued.insert(variant, id);
        }
    }

    fn render_descriptor(
        &self,
        variant: &Variant,
        layout: Vec<BindGroupLayoutDescriptor>,
        shader_defs: Vec<ShaderDefVal>,
    ) -> RenderPipelineDescriptor {
        let shader = self.module(variant);
        let one = BlendComponent {
            src_factor: BlendFactor::One,
            dst_factor: BlendFactor::One,
            operation: BlendOperation::Add,
        };
        let target = |format, blend, write_mask| {
            Some(ColorTargetState {
                format,
                blend,
                write_mask,
            })
        };
        let (vertex, targets) = match variant.pass.kind {
            Kind::Fragments(formats) => {
                let vertex = VertexState {
                    shader: shader.clone(),
                    shader_defs: shader_defs.clone(),
                    entry_point: Some("vertex".into()),
                    ..default()
                };
                let targets = formats.iter().map(|&format| target(format, None, ColorWrites::ALL));
                (vertex, targets.collect())
            }
            Kind::Compute | Kind::Addition => {
                let sum = Some(BlendState { color: one, alpha: one });
                let targets = variant.format.map(|format| target(format, sum, ColorWrites::COLOR));
                (self.fullscreen.to_vertex_state(), targets.into_iter().collect())
            }
        };
        RenderPipelineDescriptor {
            label: Some(variant.pass.label.into()),
            layout,
            vertex,
            fragment: Some(FragmentState {
                shader,
                shader_defs,
                entry_point: Some(variant.pass.entry_point.into()),
                targets,
                ..default()
            }),
            ..default()
        }
    }

    /// The module that contains the entry points of a variant.
    pub(crate) fn module(&self, variant: &Variant) -> Handle<Shader> {
        let own = variant.own.as_ref();
        own.map_or_else(|| self.passes[variant.pass].shader.clone(), Handle::clone)
    }

    /// Definitions of a variant's shader.
    pub(crate) fn definitions(&self, variant: &Variant) -> Vec<ShaderDefVal> {
        let mut definitions = self.common.clone();
        if variant.groups() == Groups::Scene {
            definitions.extend(self.definitions.of(variant.features));
        } else {
            definitions.extend(variant.features.definitions().map(ShaderDefVal::from));
        }
        definitions.extend(variant.options.iter_names().map(|(name, _)| name.into()));
        definitions
    }

    /// Layouts of all bind groups of a variant.
    pub(crate) fn layouts(&self, variant: &Variant) -> Vec<BindGroupLayoutDescriptor> {
        let group_1 = match variant.groups() {
            Groups::None => None,
            Groups::Environment => Some(empty_layout()),
            Groups::Scene => Some(self.scene_layout.clone()),
        };
        let group_0 = self.group_0(variant.pass).layout(variant.has_screen());
        let others = group_1.map(|group_1| [group_1, environment::layout_descriptor()]);
        [group_0.clone()]
            .into_iter()
            .chain(others.into_iter().flatten())
            .collect()
    }

    /// Group 0 of a pass.
    pub(crate) fn group_0(&self, pass: &Pass) -> &Group0 {
        &self.passes[pass].group_0
    }

    fn id(&self, variant: &Variant) -> Option<PipelineId> {
        self.passes.get(variant.pass)?.queued.get(variant).copied()
    }

    /// Returns whether a variant can run.
    pub(crate) fn is_compiled(&self, cache: &PipelineCache, variant: &Variant) -> bool {
        self.id(variant).is_some_and(|id| id.is_compiled(cache))
    }

    /// Returns whether all of these variants can run.
    pub(crate) fn are_compiled(&self, cache: &PipelineCache, variants: impl IntoIterator<Item = Variant>) -> bool {
        variants.into_iter().all(|variant| self.is_compiled(cache, &variant))
    }

    /// Returns whether a variant was requested and will never be compiled.
    pub(crate) fn has_failed(&self, cache: &PipelineCache, variant: &Variant) -> bool {
        self.id(variant).is_some_and(|id| id.lasting_error(cache).is_some())
    }

    /// Returns whether the library's code fails in any variant of a pass.
    pub(crate) fn has_errors(&self, cache: &PipelineCache, pass: &Pass) -> bool {
        let mut queued = self.passes[pass].queued.iter();
        queued.any(|(variant, id)| !variant.has_own_code() && id.lasting_error(cache).is_some())
    }

    /// Of the compiled variants that only differ in their features, the one that lacks the fewest: [`Features::best_of`].
    pub(crate) fn best(&self, cache: &PipelineCache, wanted: &Variant, spare: Features) -> Option<Fit> {
        let is_similar = |variant: &Variant| {
            (variant.options, &variant.own, variant.format) == (wanted.options, &wanted.own, wanted.format)
        };
        let queued = self.passes[wanted.pass].queued.iter();
        let compiled = queued.filter(|(variant, id)| is_similar(variant) && id.is_compiled(cache));
        wanted
            .features
            .best_of(compiled.map(|(variant, _)| variant.features), spare)
    }

    /// The pipeline of a compute pass; `None` until it is compiled.
    pub(crate) fn compute<'a>(&self, cache: &'a PipelineCache, variant: &Variant) -> Option<&'a ComputePipeline> {
        match self.id(variant)? {
            PipelineId::Compute(id) => cache.get_compute_pipeline(id),
            PipelineId::Render(_) => None,
        }
    }

    fn bind_group_0(
        &self,
        device: &RenderDevice,
        context: &PassContext,
        variant: &Variant,
        given: &[BindingResource],
    ) -> Option<BindGroup> {
        let has_screen = variant.has_screen();
        let contents = Contents { given, has_screen };
        self.group_0(variant.pass)
            .bind_group(variant.pass.label, device, context, contents)
    }

    /// Begins a compute pass with all groups set. It runs the first of these variants that is compiled; [`Self::best`] chooses its features.
    /// Returns `None` if none is compiled, or if the view lacks a target. `given` are the resources for bindings
    /// declared by [`Binding::given`](crate::gbuffer::Binding::given), in order.
    pub(crate) fn begin<'a>(
        &self,
        ctx: &'a mut RenderContext,
        context: &PassContext,
        variants: impl IntoIterator<Item = Variant>,
        given: &[BindingResource],
    ) -> Option<ComputePass<'a>> {
        let (pipeline, variant) = variants.into_iter().find_map(|variant| {
            let Fit { features, .. } = self.best(context.cache, &variant, Features::HARMLESS)?;
            let variant = Variant { features, ..variant };
            Some((self.compute(context.cache, &variant)?, variant))
        })?;
        let device = ctx.render_device();
        let group_0 = self.bind_group_0(device, context, &variant, given)?;
        let empty = (variant.groups() == Groups::Environment).then(|| {
            context.textures.groups.get("glint_empty", &[], || {
                let layout = context.cache.get_bind_group_layout(&empty_layout());
                device.create_bind_group("glint_empty", &layout, &[])
            })
        });
        let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
            label: Some(variant.pass.label),
            timestamp_writes: None,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group_0, &[context.view_offset]);
        if variant.groups() != Groups::None {
            pass.set_bind_group(1, empty.as_ref().unwrap_or(context.scene), &[]);
            pass.set_bind_group(2, context.environment, &[]);
        }
        Some(pass)
    }

    /// Begins a pass of fragments, with all its groups set; `None` until it is compiled, or if the view lacks a target.
    pub(crate) fn begin_fragments<'a>(
        &self,
        ctx: &'a mut RenderContext,
        context: &PassContext,
        variant: &Variant,
        targets: &[Option<RenderPassColorAttachment>],
    ) -> Option<wgpu::RenderPass<'a>> {
        let Some(PipelineId::Render(id)) = self.id(variant) else {
            return None;
        };
        let pipeline = context.cache.get_render_pipeline(id)?;
        let group_0 = self.bind_group_0(ctx.render_device(), context, variant, &[])?;
        let mut pass = ctx.command_encoder().begin_render_pass(&RenderPassDescriptor {
            label: Some(variant.pass.label),
            color_attachments: targets,
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(pipeline);
        if variant.pass.kind == Kind::Addition {
            pass.set_bind_group(0, &group_0, &[]);
        } else {
            pass.set_bind_group(0, &group_0, &[context.view_offset]);
        }
        if variant.groups() == Groups::Scene {
            pass.set_bind_group(1, context.scene, &[]);
            pass.set_bind_group(2, context.environment, &[]);
        }
        Some(pass)
    }
}

fn empty_layout() -> BindGroupLayoutDescriptor {
    BindGroupLayoutDescriptor::new("glint_empty_layout", &[])
}
