//! From rates to rays: which rays are traced, by which back end, and the order of a view's passes.

pub(crate) mod back_end;
pub mod directional_albedo;
// The platforms are those on which wgpu has Vulkan; `Cargo.toml` has the same list.
#[cfg(all(
    feature = "hardware-vrs",
    any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
))]
pub mod hardware;
#[cfg(not(all(
    feature = "hardware-vrs",
    any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
)))]
#[path = "no_hardware.rs"]
pub(crate) mod hardware;
mod pipelines;
#[cfg(feature = "hardware-vrs")]
mod shading_rates;

pub(crate) use pipelines::gbuffer_layout_entries;
pub use pipelines::{TracePipelines, init_trace_pipelines, queue_trace_pipelines};

use crate::{
    composite::{CompositePipelines, composite_reflection},
    denoise::{self, DenoisePipelines},
    extract::ReflectionView,
    idle::ViewActivity,
    inspect::TotalTimeOnly,
    rate::{RatePipelines, determine_rates},
    scene::{SceneBindings, environment::EnvironmentBindings},
    settings::{Backend, Technique},
    status::Tracer,
    targets::{BLOCK_COUNT, BLOCK_DISPATCH, MIRROR_DISPATCH, PipelineTargets},
    view::ReflectionTextures,
};
use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::{prelude::*, system::SystemParam},
    pbr::{
        ScreenSpaceAmbientOcclusionResources, ScreenSpaceReflectionsPipelineId, ViewScreenSpaceReflectionsUniformOffset,
    },
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroup, BindGroupEntries, BindingResource, Buffer, ComputePassDescriptor, LoadOp, Operations,
            PipelineCache, RenderPassColorAttachment, RenderPassDescriptor, StoreOp, TextureView,
        },
        renderer::{RenderContext, ViewQuery},
        view::{ViewTarget, ViewUniformOffset, ViewUniforms},
    },
    shader::ShaderDefVal,
};
use hardware::{HardwareGroup, HardwareTracer};
use pipelines::TracePass;

/// Keeps Bevy's screen-space pass from running on views that only carry its uniform to suppress environment specular.
pub fn drop_ssr_pass(
    views: Query<Entity, (With<ReflectionView>, With<ScreenSpaceReflectionsPipelineId>)>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<ScreenSpaceReflectionsPipelineId>();
    }
}

/// What `gbuffer.wesl` binds.
#[derive(Clone)]
pub(crate) struct GBufferBindings<'a> {
    pub view: BindingResource<'a>,
    pub settings: BindingResource<'a>,
    pub depth: &'a TextureView,
    pub gbuffer: &'a TextureView,
    pub normals: &'a TextureView,
}

/// What all passes of a view share.
pub(crate) struct PassContext<'a> {
    /// The view in the render world.
    pub entity: Entity,
    pub gbuffer: GBufferBindings<'a>,
    /// Dynamic offset of the view's uniform.
    pub view_offset: u32,
    pub motion: Option<&'a TextureView>,
    pub view: &'a ReflectionView,
    pub textures: &'a ReflectionTextures,
    pub cache: &'a PipelineCache,
    pub scene: &'a BindGroup,
    pub environment: &'a BindGroup,
    /// What `scene` and `environment` are made of, while the view uses the hardware back end.
    pub contents: [&'a HardwareGroup; 2],
    pub ssao: Option<&'a TextureView>,
    /// Table for `albedo.wesl`.
    pub albedo_table: &'a TextureView,
    pub noise: &'a TextureView,
}

/// What every pass of a view needs of the world.
#[derive(SystemParam)]
pub struct PassResources<'w> {
    pipelines: Option<Res<'w, TracePipelines>>,
    scene: Option<Res<'w, SceneBindings>>,
    environments: Res<'w, EnvironmentBindings>,
    view_uniforms: Res<'w, ViewUniforms>,
    cache: Res<'w, PipelineCache>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
}

impl PassResources<'_> {
    /// What all passes of a view share; `None` as long as something is missing and the view shows no reflections.
    pub(crate) fn context<'a>(
        &'a self,
        entity: Entity,
        view: &'a ReflectionView,
        textures: &'a ReflectionTextures,
        prepass: &'a ViewPrepassTextures,
        view_offset: &ViewUniformOffset,
        ssao: Option<&'a ScreenSpaceAmbientOcclusionResources>,
    ) -> Option<PassContext<'a>> {
        let pipelines = self.pipelines.as_deref()?;
        if !pipelines.is_ready(&self.cache, &view.settings) {
            return None;
        }
        let scene = self.scene.as_deref()?;
        Some(PassContext {
            entity,
            gbuffer: GBufferBindings {
                view: self.view_uniforms.uniforms.binding()?,
                settings: textures.uniform.binding()?,
                depth: prepass.depth_only_view()?,
                gbuffer: prepass.deferred_view()?,
                normals: prepass.normal_view()?,
            },
            view_offset: view_offset.offset,
            motion: prepass.motion_vectors_view(),
            view,
            textures,
            cache: &self.cache,
            scene: scene.bind_group.as_ref()?,
            environment: self.environments.bind_group(entity)?,
            contents: [&scene.contents, self.environments.contents(entity)?],
            ssao: ssao.map(|ssao| &ssao.screen_space_ambient_occlusion_texture.default_view),
            albedo_table: &pipelines.albedo_table,
            noise: pipelines.noise.as_ref()?,
        })
    }
}

/// Rates, rays, denoising and composite of one view; of a view at rest, the rates now and then.
pub fn ray_traced_reflections(
    view: ViewQuery<(
        &ReflectionView,
        &ReflectionTextures,
        &ViewActivity,
        &ViewTarget,
        &ViewPrepassTextures,
        &ViewUniformOffset,
        &ViewScreenSpaceReflectionsUniformOffset,
        Option<&ScreenSpaceAmbientOcclusionResources>,
    )>,
    resources: PassResources,
    rate: Option<Res<RatePipelines>>,
    denoise: Option<Res<DenoisePipelines>>,
    composite: Option<Res<CompositePipelines>>,
    mut hardware: HardwareTracer,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, textures, activity, target, prepass, view_offset, _, ssao) = view.into_inner();
    let (Some(rate), Some(denoise), Some(composite), Some(pipelines), Some(context)) = (
        rate,
        denoise,
        composite,
        resources.pipelines.as_deref(),
        resources.context(entity, view, textures, prepass, view_offset, ssao),
    ) else {
        return;
    };

    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let total = diagnostics.time_span(ctx.command_encoder(), "glint");
    let stages = diagnostics.filter(|_| resources.total_only.is_none());
    let (arguments, counters) = (&textures.targets.arguments, &textures.targets.counters);
    let converged = view.settings.technique == Technique::Converged;
    let (looks, resting) = (activity.looks(), activity.is_resting());
    if !resting {
        ctx.command_encoder().clear_buffer(counters, 0, None);
    }
    if looks {
        ctx.command_encoder().clear_buffer(arguments, 0, None);
        if !converged {
            let span = stages.time_span(ctx.command_encoder(), "rate");
            determine_rates(&mut ctx, &rate, &context);
            span.end(ctx.command_encoder());
        }
    }
    if !resting {
        let span = stages.time_span(ctx.command_encoder(), "trace");
        if converged {
            trace_converged(&mut ctx, pipelines, &context);
        } else {
            trace_rays(&mut ctx, pipelines, &context, &mut hardware);
        }
        span.end(ctx.command_encoder());
        if !converged {
            denoise::denoise(&mut ctx, &denoise, &context, stages);
        }
        let span = stages.time_span(ctx.command_encoder(), "composite");
        composite_reflection(&mut ctx, &composite, &context, target);
        span.end(ctx.command_encoder());
    }
    if looks {
        activity.report(ctx.command_encoder(), arguments);
    }
    total.end(ctx.command_encoder());
    if looks {
        for (counts, offset, name) in [
            (arguments, BLOCK_COUNT, "reflection_rays"),
            (arguments, BLOCK_COUNT + 4, "reflection_mirror_rays"),
            (arguments, BLOCK_COUNT + 8, "reflection_tiles"),
            (counters, 0, "reflection_hits"),
        ] {
            record_counter(diagnostics, &mut ctx, counts, offset, name);
        }
    }
}

fn trace_converged(ctx: &mut RenderContext, pipelines: &TracePipelines, context: &PassContext) {
    let textures = context.textures;
    let (Some(pipeline), Some(pair)) = (
        pipelines.compute(context.cache, TracePass::Converged),
        &textures.targets.accumulation,
    ) else {
        return;
    };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let bind_group = ctx.render_device().create_bind_group(
        "glint_trace_converged",
        &context
            .cache
            .get_bind_group_layout(pipelines.layout(TracePass::Converged)),
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            context.albedo_table,
            textures.targets.arguments.as_entire_binding(),
            textures.targets.counters.as_entire_binding(),
            &pair[1 - textures.parity],
            &pair[textures.parity],
        )),
    );
    let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some("glint_trace_converged"),
        timestamp_writes: None,
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[context.view_offset]);
    pass.set_bind_group(1, context.scene, &[]);
    pass.set_bind_group(2, context.environment, &[]);
    let size = textures.size();
    pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
}

fn trace_rays(
    ctx: &mut RenderContext,
    pipelines: &TracePipelines,
    context: &PassContext,
    hardware: &mut HardwareTracer,
) {
    let settings = &context.view.settings;
    for pass in TracePass::of(settings) {
        match pass {
            TracePass::Inline => trace_inline(ctx, pipelines, context),
            // Where the hardware gives up, this frame's rays come from the list.
            TracePass::Blocks if settings.backend == Backend::Hardware && hardware.trace(ctx, pipelines, context) => {}
            _ => trace_list(ctx, pipelines, context, pass),
        }
    }
}

/// Rays of a list.
fn trace_list(ctx: &mut RenderContext, pipelines: &TracePipelines, context: &PassContext, pass: TracePass) {
    let targets = &context.textures.targets;
    let (Some(pipeline), Some(images)) = (pipelines.compute(context.cache, pass), &targets.pipeline) else {
        return;
    };
    let (list, first, second, dispatch) = if pass == TracePass::Mirrors {
        (
            &images.mirrors,
            &images.reconstructed,
            &images.reconstructed_pair,
            MIRROR_DISPATCH,
        )
    } else {
        (&images.blocks, &images.ray_radiance, &images.ray_record, BLOCK_DISPATCH)
    };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let bind_group = ctx.render_device().create_bind_group(
        "glint_trace_list",
        &context.cache.get_bind_group_layout(pipelines.layout(pass)),
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            context.albedo_table,
            context.noise,
            targets.arguments.as_entire_binding(),
            targets.counters.as_entire_binding(),
            list.as_entire_binding(),
            first,
            second,
        )),
    );
    let mut compute = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some("glint_trace_list"),
        timestamp_writes: None,
    });
    compute.set_pipeline(pipeline);
    compute.set_bind_group(0, &bind_group, &[context.view_offset]);
    compute.set_bind_group(1, context.scene, &[]);
    compute.set_bind_group(2, context.environment, &[]);
    compute.dispatch_workgroups_indirect(&targets.arguments, dispatch);
}

/// Group 0 of `inline.wesl`.
fn inline_entries<'a>(context: &'a PassContext, images: &'a PipelineTargets) -> BindGroupEntries<'a, 8> {
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    let textures = context.textures;
    BindGroupEntries::sequential((
        view,
        settings,
        depth,
        gbuffer,
        normals,
        context.noise,
        &images.rate[textures.parity],
        textures.targets.counters.as_entire_binding(),
    ))
}

/// Rays of a full-screen pass over the trace target.
fn trace_inline(ctx: &mut RenderContext, pipelines: &TracePipelines, context: &PassContext) {
    let (Some(pipeline), Some(images)) = (pipelines.inline(context.cache), &context.textures.targets.pipeline) else {
        return;
    };
    let bind_group = ctx.render_device().create_bind_group(
        "glint_trace_inline",
        &context.cache.get_bind_group_layout(pipelines.layout(TracePass::Inline)),
        &inline_entries(context, images),
    );
    // Every texel is written.
    let attachment = |view| {
        Some(RenderPassColorAttachment {
            view,
            depth_slice: None,
            resolve_target: None,
            ops: Operations {
                load: LoadOp::Load,
                store: StoreOp::Store,
            },
        })
    };
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("glint_trace_inline"),
        color_attachments: &[attachment(&images.ray_radiance), attachment(&images.ray_record)],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    pass.set_render_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[context.view_offset]);
    pass.set_bind_group(1, context.scene, &[]);
    pass.set_bind_group(2, context.environment, &[]);
    pass.draw(0..3, 0..1);
}

fn record_counter(
    diagnostics: Option<&bevy::render::diagnostic::DiagnosticsRecorder>,
    ctx: &mut RenderContext,
    counters: &Buffer,
    offset: u64,
    name: &'static str,
) {
    diagnostics.record_u32(ctx.command_encoder(), &counters.slice(offset..offset + 4), name);
}

/// The tracer as a shader definition.
pub(crate) fn tracer_defs(tracer: Tracer) -> Vec<ShaderDefVal> {
    match tracer {
        Tracer::RayQuery => vec!["RAY_QUERY".into()],
        Tracer::Bvh => vec![],
    }
}
