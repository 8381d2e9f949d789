//! From pixels to rays: which rays are traced, and with what pipelines.

pub mod directional_albedo;

use crate::{
    composite::{CompositePipelines, add_reflection, resolve_reflection},
    extract::ReflectionView,
    scene::{
        SceneBindings,
        environment::{EnvironmentBindings, layout_descriptor},
    },
    settings::Technique,
    status::{ReflectionStatus, Tracer},
    view::{ACCUMULATION_FORMAT, GpuReflectionView, RADIANCE_FORMAT, ReflectionTextures},
};
use bevy::{
    asset::Handle,
    asset::{AssetServer, load_embedded_asset},
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::prelude::*,
    pbr::{ScreenSpaceReflectionsPipelineId, ViewScreenSpaceReflectionsUniformOffset},
    platform::collections::{HashMap, HashSet},
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BindingResource, Buffer,
            CachedComputePipelineId, CachedPipelineState, ComputePassDescriptor, ComputePipelineDescriptor, Extent3d,
            PipelineCache, ShaderStages, StorageTextureAccess, TextureDataOrder, TextureDescriptor, TextureDimension,
            TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor, binding_types,
        },
        renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery},
        view::{ViewTarget, ViewUniform, ViewUniformOffset, ViewUniforms},
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};
use core::num::NonZeroU64;
use directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo};

/// Layouts and pipelines of the tracing passes.
#[derive(Resource)]
pub struct ReflectionPipelines {
    shader: Handle<Shader>,
    defs: Vec<ShaderDefVal>,
    layouts: [BindGroupLayoutDescriptor; 2],
    scene_layout: BindGroupLayoutDescriptor,
    environment_layout: BindGroupLayoutDescriptor,
    /// Table for `albedo.wesl`.
    pub(crate) albedo_table: TextureView,
    traced: HashMap<Technique, CachedComputePipelineId>,
    wanted: HashSet<Technique>,
    /// Techniques whose passes are all compiled.
    ready: HashSet<Technique>,
}

impl ReflectionPipelines {
    /// Asks for a technique's pipelines; they are compiled from the next frame on.
    pub(crate) fn request(&mut self, technique: Technique) {
        self.wanted.insert(technique);
    }

    fn layout(&self, technique: Technique) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(technique == Technique::Converged)]
    }

    /// The pipelines of a technique can be used.
    pub(crate) fn is_ready(&self, technique: Technique) -> bool {
        self.ready.contains(&technique)
    }
}

/// Entries that every pass over the G-buffer starts with: `gbuffer.wesl`.
pub(crate) fn gbuffer_layout_entries() -> [bevy::render::render_resource::BindGroupLayoutEntryBuilder; 5] {
    [
        binding_types::uniform_buffer::<ViewUniform>(true),
        binding_types::uniform_buffer::<GpuReflectionView>(false),
        binding_types::texture_depth_2d(),
        binding_types::texture_2d(TextureSampleType::Uint),
        binding_types::texture_2d(TextureSampleType::Float { filterable: false }),
    ]
}

/// Makes layouts and the albedo table.
pub fn init_reflection_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    scene: Res<SceneBindings>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let unfiltered = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let counters = || binding_types::storage_buffer_sized(false, NonZeroU64::new(8));
    let radiance = || binding_types::texture_storage_2d(RADIANCE_FORMAT, StorageTextureAccess::WriteOnly);
    let reference = BindGroupLayoutDescriptor::new(
        "glint_reference_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                view,
                settings,
                depth,
                gbuffer,
                normals,
                unfiltered,
                radiance(),
                counters(),
            ),
        ),
    );
    let converged = BindGroupLayoutDescriptor::new(
        "glint_converged_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                view,
                settings,
                depth,
                gbuffer,
                normals,
                unfiltered,
                radiance(),
                counters(),
                unfiltered,
                binding_types::texture_storage_2d(ACCUMULATION_FORMAT, StorageTextureAccess::WriteOnly),
            ),
        ),
    );
    let table = DirectionalAlbedo::new();
    let size = ALBEDO_TABLE_SIZE as u32;
    let albedo_table = device
        .create_texture_with_data(
            &queue,
            &TextureDescriptor {
                label: Some("glint_albedo_table"),
                size: Extent3d {
                    width: size,
                    height: size,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: TextureFormat::Rg32Float,
                usage: TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
            TextureDataOrder::LayerMajor,
            bytemuck::cast_slice(table.texels()),
        )
        .create_view(&TextureViewDescriptor::default());
    commands.insert_resource(ReflectionPipelines {
        shader: load_embedded_asset!(asset_server.as_ref(), "reference.wesl"),
        defs: scene.shader_defs(),
        layouts: [reference, converged],
        scene_layout: scene.layout.clone(),
        environment_layout: layout_descriptor(),
        albedo_table,
        traced: HashMap::default(),
        wanted: HashSet::default(),
        ready: HashSet::default(),
    });
}

/// Queues what cameras asked for and reports when all is compiled.
pub fn queue_reflection_pipelines(
    mut pipelines: ResMut<ReflectionPipelines>,
    composite: Res<CompositePipelines>,
    cache: Res<PipelineCache>,
    status: Res<ReflectionStatus>,
) {
    let pipelines = &mut *pipelines;
    for technique in pipelines.wanted.iter().copied() {
        if pipelines.traced.contains_key(&technique) {
            continue;
        }
        let mut shader_defs = pipelines.defs.clone();
        if technique == Technique::Converged {
            shader_defs.push("CONVERGED".into());
        }
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(format!("glint_trace_{technique:?}").into()),
            layout: vec![
                pipelines.layout(technique).clone(),
                pipelines.scene_layout.clone(),
                pipelines.environment_layout.clone(),
            ],
            shader: pipelines.shader.clone(),
            shader_defs,
            entry_point: Some("trace".into()),
            ..default()
        });
        pipelines.traced.insert(technique, id);
    }
    pipelines.ready.clear();
    if composite.are_ready(&cache) {
        let compiled = pipelines
            .traced
            .iter()
            .filter(|(_, id)| cache.get_compute_pipeline(**id).is_some());
        pipelines.ready.extend(compiled.map(|(technique, _)| *technique));
    }
    let ready = !pipelines.wanted.is_empty() && pipelines.wanted.is_subset(&pipelines.ready);
    for &id in pipelines.traced.values() {
        // Modules that are still being loaded are errors, too, but not for long.
        if let CachedPipelineState::Err(error) = cache.get_compute_pipeline_state(id)
            && !matches!(
                error,
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable
            )
        {
            bevy::log::error_once!("ray-traced reflections stay off, since their shader failed: {error}");
        }
    }
    status.update(|report| report.ready = ready);
}

/// Keeps Bevy's screen-space pass from running on views that only carry its uniform to suppress environment specular.
pub fn drop_ssr_pass(
    views: Query<Entity, (With<ReflectionView>, With<ScreenSpaceReflectionsPipelineId>)>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<ScreenSpaceReflectionsPipelineId>();
    }
}

/// Traces, resolves and composites the reflections of one view.
pub fn ray_traced_reflections(
    view: ViewQuery<(
        &ReflectionView,
        &ReflectionTextures,
        &ViewTarget,
        &ViewPrepassTextures,
        &ViewUniformOffset,
        &ViewScreenSpaceReflectionsUniformOffset,
        Option<&bevy::pbr::ScreenSpaceAmbientOcclusionResources>,
    )>,
    pipelines: Option<Res<ReflectionPipelines>>,
    composite: Option<Res<CompositePipelines>>,
    scene: Option<Res<SceneBindings>>,
    environments: Res<EnvironmentBindings>,
    view_uniforms: Res<ViewUniforms>,
    cache: Res<PipelineCache>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, textures, target, prepass, view_offset, _, ssao) = view.into_inner();
    let (Some(pipelines), Some(composite), Some(scene)) = (pipelines, composite, scene) else {
        return;
    };
    let technique = view.settings.technique;
    let (
        Some(trace),
        Some(scene_bind_group),
        Some(environment),
        Some(view_binding),
        Some(settings),
        Some(depth),
        Some(gbuffer),
        Some(normals),
    ) = (
        pipelines
            .traced
            .get(&technique)
            .and_then(|&id| cache.get_compute_pipeline(id)),
        scene.bind_group.as_ref(),
        environments.bind_group(entity),
        view_uniforms.uniforms.binding(),
        textures.uniform.binding(),
        prepass.depth_only_view(),
        prepass.deferred_view(),
        prepass.normal_view(),
    )
    else {
        return;
    };
    let gbuffer = GBufferBindings {
        view: view_binding,
        settings,
        depth,
        gbuffer,
        normals,
    };

    let device = ctx.render_device().clone();
    let layout = cache.get_bind_group_layout(pipelines.layout(technique));
    let counters = textures.counters.as_entire_binding();
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer: words,
        normals,
    } = gbuffer.clone();
    let table = &pipelines.albedo_table;
    let bind_group = match &textures.accumulation {
        None => device.create_bind_group(
            "glint_trace",
            &layout,
            &BindGroupEntries::sequential((
                view,
                settings,
                depth,
                words,
                normals,
                table,
                &textures.radiance,
                counters,
            )),
        ),
        Some(pair) => device.create_bind_group(
            "glint_trace",
            &layout,
            &BindGroupEntries::sequential((
                view,
                settings,
                depth,
                words,
                normals,
                table,
                &textures.radiance,
                counters,
                &pair[1 - textures.parity],
                &pair[textures.parity],
            )),
        ),
    };

    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let total = diagnostics.time_span(ctx.command_encoder(), "glint");
    let span = diagnostics.time_span(ctx.command_encoder(), "trace");
    ctx.command_encoder().clear_buffer(&textures.counters, 0, None);
    {
        let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
            label: Some("glint_trace"),
            timestamp_writes: None,
        });
        pass.set_pipeline(trace);
        pass.set_bind_group(0, &bind_group, &[view_offset.offset]);
        pass.set_bind_group(1, scene_bind_group, &[]);
        pass.set_bind_group(2, environment, &[]);
        pass.dispatch_workgroups(textures.size.x.div_ceil(8), textures.size.y.div_ceil(8), 1);
    }
    span.end(ctx.command_encoder());
    record_counter(diagnostics, &mut ctx, &textures.counters, 0, "reflection_rays");
    record_counter(diagnostics, &mut ctx, &textures.counters, 4, "reflection_hits");

    let span = diagnostics.time_span(ctx.command_encoder(), "composite");
    let radiance = textures
        .accumulation
        .as_ref()
        .map_or(&textures.radiance, |pair| &pair[textures.parity]);
    resolve_reflection(
        &mut ctx,
        &cache,
        &composite,
        gbuffer,
        view_offset.offset,
        radiance,
        ssao,
        environment,
        textures,
    );
    add_reflection(&mut ctx, &cache, &composite, target, textures);
    span.end(ctx.command_encoder());
    total.end(ctx.command_encoder());
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
