//! From the lobe's radiance to the lit frame: albedo, fade, occlusion, fog, and the addition itself.

use crate::{
    extract::ReflectionView,
    scene::environment::layout_descriptor,
    trace::{GBufferBindings, gbuffer_layout_entries},
    view::{REFLECTION_FORMAT, ReflectionTextures},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    core_pipeline::FullscreenShader,
    ecs::prelude::*,
    pbr::ScreenSpaceAmbientOcclusionResources,
    platform::collections::HashMap,
    render::{
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BlendComponent,
            BlendFactor, BlendOperation, BlendState, CachedComputePipelineId, CachedRenderPipelineId, ColorTargetState,
            ColorWrites, ComputePassDescriptor, ComputePipelineDescriptor, FragmentState, PipelineCache,
            RenderPassDescriptor, RenderPipelineDescriptor, ShaderStages, StorageTextureAccess, TextureFormat,
            TextureSampleType, TextureView, binding_types,
        },
        renderer::RenderContext,
        view::{ExtractedView, ViewTarget},
    },
    shader::Shader,
    utils::default,
};

/// Layouts and pipelines of the composite.
#[derive(Resource)]
pub struct CompositePipelines {
    resolve_layout: BindGroupLayoutDescriptor,
    empty_layout: BindGroupLayoutDescriptor,
    resolve: CachedComputePipelineId,
    add_layout: BindGroupLayoutDescriptor,
    add_shader: Handle<Shader>,
    fullscreen: FullscreenShader,
    add: HashMap<TextureFormat, CachedRenderPipelineId>,
}

impl CompositePipelines {
    /// Both passes can be used for the usual HDR target.
    pub(crate) fn are_ready(&self, cache: &PipelineCache) -> bool {
        cache.get_compute_pipeline(self.resolve).is_some()
            && self.add.values().all(|&id| cache.get_render_pipeline(id).is_some())
            && !self.add.is_empty()
    }

    fn queue_add(&mut self, cache: &PipelineCache, format: TextureFormat) {
        if self.add.contains_key(&format) {
            return;
        }
        let one = BlendComponent {
            src_factor: BlendFactor::One,
            dst_factor: BlendFactor::One,
            operation: BlendOperation::Add,
        };
        let id = cache.queue_render_pipeline(RenderPipelineDescriptor {
            label: Some("glint_add".into()),
            layout: vec![self.add_layout.clone()],
            vertex: self.fullscreen.to_vertex_state(),
            fragment: Some(FragmentState {
                shader: self.add_shader.clone(),
                entry_point: Some("add".into()),
                targets: vec![Some(ColorTargetState {
                    format,
                    blend: Some(BlendState { color: one, alpha: one }),
                    write_mask: ColorWrites::COLOR,
                })],
                ..default()
            }),
            ..default()
        });
        self.add.insert(format, id);
    }
}

/// Makes layouts and queues the pipelines.
pub fn init_composite_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    cache: Res<PipelineCache>,
    fullscreen: Res<FullscreenShader>,
) {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let unfiltered = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let resolve_layout = BindGroupLayoutDescriptor::new(
        "glint_resolve_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                view,
                settings,
                depth,
                gbuffer,
                normals,
                unfiltered,
                unfiltered,
                binding_types::texture_storage_2d(REFLECTION_FORMAT, StorageTextureAccess::WriteOnly),
            ),
        ),
    );
    // Group 1 is the scene's in all other passes, and empty here.
    let empty_layout = BindGroupLayoutDescriptor::new("glint_empty_layout", &[]);
    let resolve = cache.queue_compute_pipeline(ComputePipelineDescriptor {
        label: Some("glint_resolve".into()),
        layout: vec![resolve_layout.clone(), empty_layout.clone(), layout_descriptor()],
        shader: load_embedded_asset!(asset_server.as_ref(), "resolve.wesl"),
        entry_point: Some("resolve".into()),
        ..default()
    });
    let add_layout = BindGroupLayoutDescriptor::new(
        "glint_add_layout",
        &BindGroupLayoutEntries::sequential(ShaderStages::FRAGMENT, (unfiltered,)),
    );
    let mut pipelines = CompositePipelines {
        resolve_layout,
        empty_layout,
        resolve,
        add_layout,
        add_shader: load_embedded_asset!(asset_server.as_ref(), "add.wesl"),
        fullscreen: fullscreen.clone(),
        add: HashMap::default(),
    };
    pipelines.queue_add(&cache, TextureFormat::Rgba16Float);
    commands.insert_resource(pipelines);
}

/// Queues the blend pipeline for targets of unusual formats.
pub fn queue_composite_pipelines(
    views: Query<&ExtractedView, With<ReflectionView>>,
    mut pipelines: ResMut<CompositePipelines>,
    cache: Res<PipelineCache>,
) {
    for view in &views {
        if !pipelines.add.contains_key(&view.target_format) {
            pipelines.queue_add(&cache, view.target_format);
        }
    }
}

/// Writes what is to be added.
#[expect(clippy::too_many_arguments, reason = "everything that one pass binds")]
pub(crate) fn resolve_reflection(
    ctx: &mut RenderContext,
    cache: &PipelineCache,
    pipelines: &CompositePipelines,
    gbuffer: GBufferBindings,
    view_offset: u32,
    radiance: &TextureView,
    ssao: Option<&ScreenSpaceAmbientOcclusionResources>,
    environment: &BindGroup,
    textures: &ReflectionTextures,
) {
    let Some(pipeline) = cache.get_compute_pipeline(pipelines.resolve) else {
        return;
    };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = gbuffer;
    // Without SSAO something must be bound; the shader doesn't read it.
    let ssao = ssao.map_or(radiance, |ssao| {
        &ssao.screen_space_ambient_occlusion_texture.default_view
    });
    let bind_group = ctx.render_device().create_bind_group(
        "glint_resolve",
        &cache.get_bind_group_layout(&pipelines.resolve_layout),
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            radiance,
            ssao,
            &textures.reflection,
        )),
    );
    let empty = ctx.render_device().create_bind_group(
        "glint_empty",
        &cache.get_bind_group_layout(&pipelines.empty_layout),
        &[],
    );
    let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some("glint_resolve"),
        timestamp_writes: None,
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[view_offset]);
    pass.set_bind_group(1, &empty, &[]);
    pass.set_bind_group(2, environment, &[]);
    pass.dispatch_workgroups(textures.size.x.div_ceil(8), textures.size.y.div_ceil(8), 1);
}

/// Adds it to the lit frame, inside of the view's rectangle only.
pub(crate) fn add_reflection(
    ctx: &mut RenderContext,
    cache: &PipelineCache,
    pipelines: &CompositePipelines,
    target: &ViewTarget,
    textures: &ReflectionTextures,
) {
    let pipeline = pipelines
        .add
        .get(&target.main_texture_format())
        .and_then(|&id| cache.get_render_pipeline(id));
    let Some(pipeline) = pipeline else { return };
    let bind_group = ctx.render_device().create_bind_group(
        "glint_add",
        &cache.get_bind_group_layout(&pipelines.add_layout),
        &BindGroupEntries::sequential((&textures.reflection,)),
    );
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("glint_add"),
        color_attachments: &[Some(target.get_unsampled_color_attachment())],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let (origin, size) = (textures.origin.as_vec2(), textures.size.as_vec2());
    pass.set_viewport(origin.x, origin.y, size.x, size.y, 0.0, 1.0);
    pass.set_scissor_rect(textures.origin.x, textures.origin.y, textures.size.x, textures.size.y);
    pass.set_render_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[]);
    pass.draw(0..3, 0..1);
}
