//! From the lobe's radiance to the lit frame: albedo, fade, occlusion, fog, and the addition itself.

use crate::{
    denoise,
    extract::ReflectionView,
    scene::environment::layout_descriptor,
    targets::{REFLECTION_FORMAT, TILE_DISPATCH},
    trace::{GBufferBindings, PassContext, gbuffer_layout_entries},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    camera::CameraMainTextureUsages,
    core_pipeline::FullscreenShader,
    ecs::prelude::*,
    platform::collections::{HashMap, HashSet},
    render::{
        camera::ExtractedCamera,
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BlendComponent, BlendFactor,
            BlendOperation, BlendState, CachedComputePipelineId, CachedRenderPipelineId, ColorTargetState, ColorWrites,
            ComputePassDescriptor, ComputePipelineDescriptor, DynamicBindGroupLayoutEntries, FragmentState,
            PipelineCache, RenderPassDescriptor, RenderPipelineDescriptor, ShaderStages, StorageTextureAccess,
            TextureFormat, TextureFormatFeatureFlags, TextureSampleType, TextureUsages, TextureView, WgpuFeatures,
            binding_types,
        },
        renderer::{RenderAdapter, RenderContext, RenderDevice},
        view::{ExtractedView, ViewTarget},
    },
    shader::Shader,
    utils::default,
};
use core::num::NonZeroU64;

/// Where the result goes and which pixels are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Resolve {
    /// Every pixel, into a texture of ours.
    Apart,
    /// Every pixel of the frame.
    InPlace,
    /// The active tiles of the frame.
    InPlaceTiles,
}

/// Layouts and pipelines of the composite.
#[derive(Resource)]
pub struct CompositePipelines {
    resolve: HashMap<Resolve, (BindGroupLayoutDescriptor, CachedComputePipelineId)>,
    empty_layout: BindGroupLayoutDescriptor,
    add_layout: BindGroupLayoutDescriptor,
    add_shader: Handle<Shader>,
    fullscreen: FullscreenShader,
    add: HashMap<TextureFormat, CachedRenderPipelineId>,
    /// Compute shaders can read and write frames of the usual HDR format.
    in_place: bool,
}

impl CompositePipelines {
    /// Every pass can be used.
    pub(crate) fn are_ready(&self, cache: &PipelineCache) -> bool {
        self.resolve
            .values()
            .all(|(_, id)| cache.get_compute_pipeline(*id).is_some())
            && self.add.values().all(|&id| cache.get_render_pipeline(id).is_some())
    }

    /// The reflection of a view with frames of this format is added in place.
    pub(crate) fn is_in_place(&self, format: TextureFormat) -> bool {
        self.in_place && format == TextureFormat::Rgba16Float
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
    device: Res<RenderDevice>,
    adapter: Res<RenderAdapter>,
) {
    let format = TextureFormat::Rgba16Float;
    let in_place = device
        .features()
        .contains(WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES)
        && adapter
            .get_texture_format_features(format)
            .flags
            .contains(TextureFormatFeatureFlags::STORAGE_READ_WRITE);
    // Group 1 is the scene's in all other passes, and empty here.
    let empty_layout = BindGroupLayoutDescriptor::new("glint_empty_layout", &[]);
    let kinds: &[Resolve] = if in_place {
        &[Resolve::InPlace, Resolve::InPlaceTiles]
    } else {
        &[Resolve::Apart]
    };
    let mut resolve = HashMap::default();
    for &kind in kinds {
        let layout = resolve_layout(kind);
        let shader_defs = match kind {
            Resolve::Apart => vec![],
            Resolve::InPlace => vec!["IN_PLACE".into()],
            Resolve::InPlaceTiles => vec!["IN_PLACE".into(), "TILES".into()],
        };
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(format!("glint_resolve_{kind:?}").into()),
            layout: vec![layout.clone(), empty_layout.clone(), layout_descriptor()],
            shader: load_embedded_asset!(asset_server.as_ref(), "resolve.wesl"),
            shader_defs,
            entry_point: Some("resolve".into()),
            ..default()
        });
        resolve.insert(kind, (layout, id));
    }
    let unfiltered = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let add_layout = BindGroupLayoutDescriptor::new(
        "glint_add_layout",
        &BindGroupLayoutEntries::sequential(ShaderStages::FRAGMENT, (unfiltered,)),
    );
    commands.insert_resource(CompositePipelines {
        resolve,
        empty_layout,
        add_layout,
        add_shader: load_embedded_asset!(asset_server.as_ref(), "add.wesl"),
        fullscreen: fullscreen.clone(),
        add: HashMap::default(),
        in_place,
    });
}

fn resolve_layout(kind: Resolve) -> BindGroupLayoutDescriptor {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    let unfiltered = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
    let (format, access) = match kind {
        Resolve::Apart => (REFLECTION_FORMAT, StorageTextureAccess::WriteOnly),
        _ => (TextureFormat::Rgba16Float, StorageTextureAccess::ReadWrite),
    };
    let entries = DynamicBindGroupLayoutEntries::sequential(
        ShaderStages::COMPUTE,
        (
            view,
            settings,
            depth,
            gbuffer,
            normals,
            unfiltered,
            unfiltered,
            binding_types::texture_storage_2d(format, access),
        ),
    );
    let words = || binding_types::storage_buffer_read_only_sized(false, NonZeroU64::new(4));
    let entries = match kind {
        Resolve::InPlaceTiles => entries.extend_sequential((words(), words())),
        _ => entries,
    };
    BindGroupLayoutDescriptor::new(format!("glint_resolve_{kind:?}_layout"), &entries)
}

/// Queues the blend pipeline for targets that can't be written in place.
pub fn queue_composite_pipelines(
    views: Query<&ExtractedView, With<ReflectionView>>,
    mut pipelines: ResMut<CompositePipelines>,
    cache: Res<PipelineCache>,
    asset_server: Res<AssetServer>,
) {
    for view in &views {
        if pipelines.is_in_place(view.target_format) {
            continue;
        }
        pipelines.queue_add(&cache, view.target_format);
        if !pipelines.resolve.contains_key(&Resolve::Apart) {
            let layout = resolve_layout(Resolve::Apart);
            let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some("glint_resolve_Apart".into()),
                layout: vec![layout.clone(), pipelines.empty_layout.clone(), layout_descriptor()],
                shader: load_embedded_asset!(asset_server.as_ref(), "resolve.wesl"),
                entry_point: Some("resolve".into()),
                ..default()
            });
            pipelines.resolve.insert(Resolve::Apart, (layout, id));
        }
    }
}

/// Lets compute shaders write to the frames of reflecting cameras, and of all that draw to the same target: cameras share a
/// frame only if its usages are the same.
pub fn allow_writes_in_place(
    reflecting: Query<&ExtractedCamera, With<ReflectionView>>,
    mut cameras: Query<(&ExtractedCamera, &ExtractedView, &mut CameraMainTextureUsages)>,
    pipelines: Option<Res<CompositePipelines>>,
) {
    let Some(pipelines) = pipelines else { return };
    let targets: HashSet<_> = reflecting.iter().map(|camera| camera.target.clone()).collect();
    for (camera, view, mut usages) in &mut cameras {
        if pipelines.is_in_place(view.target_format) && targets.contains(&camera.target) {
            usages.0 |= TextureUsages::STORAGE_BINDING;
        }
    }
}

/// Adds the reflection to the lit frame.
pub(crate) fn composite_reflection(
    ctx: &mut RenderContext,
    pipelines: &CompositePipelines,
    context: &PassContext,
    target: &ViewTarget,
) {
    let targets = &context.textures.targets;
    let tiles = targets.pipeline.as_ref().map(|pipeline| &pipeline.tiles);
    let kind = match (&targets.reflection, tiles) {
        (Some(_), _) => Resolve::Apart,
        (None, Some(_)) => Resolve::InPlaceTiles,
        (None, None) => Resolve::InPlace,
    };
    if kind != Resolve::Apart && !target.main_texture().usage().contains(TextureUsages::STORAGE_BINDING) {
        return;
    }
    resolve_reflection(
        ctx,
        pipelines,
        context,
        kind,
        targets.reflection.as_ref().unwrap_or(target.main_texture_view()),
    );
    if let Some(reflection) = &targets.reflection {
        add_reflection(ctx, pipelines, context, target, reflection);
    }
}

/// What the composite reads: radiance of lobes over their albedo.
pub(crate) fn composited_radiance<'a>(context: &PassContext<'a>) -> Option<&'a TextureView> {
    let textures = context.textures;
    match &textures.targets.accumulation {
        Some(pair) => Some(&pair[textures.parity]),
        None => denoise::result(context),
    }
}

fn resolve_reflection(
    ctx: &mut RenderContext,
    pipelines: &CompositePipelines,
    context: &PassContext,
    kind: Resolve,
    output: &TextureView,
) {
    let (textures, cache) = (context.textures, context.cache);
    let targets = &textures.targets;
    let Some((layout, id)) = pipelines.resolve.get(&kind) else {
        return;
    };
    let (Some(pipeline), Some(radiance)) = (cache.get_compute_pipeline(*id), composited_radiance(context)) else {
        return;
    };
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    // Without SSAO something must be bound; the shader doesn't read it.
    let ssao = context.ssao.unwrap_or(radiance);
    let layout = cache.get_bind_group_layout(layout);
    let device = ctx.render_device().clone();
    let bind_group = match (kind, &targets.pipeline) {
        (Resolve::InPlaceTiles, Some(images)) => device.create_bind_group(
            "glint_resolve",
            &layout,
            &BindGroupEntries::sequential((
                view,
                settings,
                depth,
                gbuffer,
                normals,
                radiance,
                ssao,
                output,
                targets.arguments.as_entire_binding(),
                images.tiles.as_entire_binding(),
            )),
        ),
        _ => device.create_bind_group(
            "glint_resolve",
            &layout,
            &BindGroupEntries::sequential((view, settings, depth, gbuffer, normals, radiance, ssao, output)),
        ),
    };
    let empty = device.create_bind_group(
        "glint_empty",
        &cache.get_bind_group_layout(&pipelines.empty_layout),
        &[],
    );
    let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
        label: Some("glint_resolve"),
        timestamp_writes: None,
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[context.view_offset]);
    pass.set_bind_group(1, &empty, &[]);
    pass.set_bind_group(2, context.environment, &[]);
    match kind {
        Resolve::InPlaceTiles => pass.dispatch_workgroups_indirect(&targets.arguments, TILE_DISPATCH),
        _ => {
            let size = textures.size();
            pass.dispatch_workgroups(size.x.div_ceil(8), size.y.div_ceil(8), 1);
        }
    }
}

/// Adds what was resolved apart, inside of the view's rectangle only.
fn add_reflection(
    ctx: &mut RenderContext,
    pipelines: &CompositePipelines,
    context: &PassContext,
    target: &ViewTarget,
    reflection: &TextureView,
) {
    let (textures, cache) = (context.textures, context.cache);
    let pipeline = pipelines
        .add
        .get(&target.main_texture_format())
        .and_then(|&id| cache.get_render_pipeline(id));
    let Some(pipeline) = pipeline else { return };
    let bind_group = ctx.render_device().create_bind_group(
        "glint_add",
        &cache.get_bind_group_layout(&pipelines.add_layout),
        &BindGroupEntries::sequential((reflection,)),
    );
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("glint_add"),
        color_attachments: &[Some(target.get_unsampled_color_attachment())],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let (origin, size) = (textures.origin, textures.size());
    pass.set_viewport(origin.x as f32, origin.y as f32, size.x as f32, size.y as f32, 0.0, 1.0);
    pass.set_scissor_rect(origin.x, origin.y, size.x, size.y);
    pass.set_render_pipeline(pipeline);
    pass.set_bind_group(0, &bind_group, &[]);
    pass.draw(0..3, 0..1);
}
