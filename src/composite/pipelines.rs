//! The passes of the composite: which of them a view needs, and how they are compiled and run.

use super::{
    add::AddPass,
    resolve::{Resolve, ResolveVariant, Surfaces},
    screen::{self, screen_pass},
};
use crate::{
    denoise,
    device::{FRAME_FORMAT, WritesInPlace},
    gbuffer::{GBufferPass, OtherGroups, PassContext, PassShader},
    scene::{Features, SceneBindings},
    settings::{ClampedSettings, ReflectionTechnique, ReflectionView},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    camera::CameraMainTextureUsages,
    core_pipeline::FullscreenShader,
    ecs::prelude::*,
    log::error_once,
    platform::collections::{HashMap, HashSet},
    render::{
        camera::ExtractedCamera,
        render_resource::{PipelineCache, TextureFormat, TextureUsages},
        renderer::RenderContext,
        view::{ExtractedView, ViewTarget},
    },
    shader::Shader,
};

/// Pipelines of the composite.
#[derive(Resource)]
pub struct CompositePipelines {
    shader: Handle<Shader>,
    resolve: HashMap<Resolve, GBufferPass<ResolveVariant>>,
    /// Variants for scenes with reflection probes that affect transparent surfaces.
    probed: HashMap<Resolve, GBufferPass<ResolveVariant>>,
    has_probes: bool,
    /// The scene has opaque surfaces drawn in the forward pass.
    has_forward: bool,
    add: AddPass,
    screen_shader: Handle<Shader>,
    screen: GBufferPass,
    /// A view has requested it since pipelines were last queued.
    keeps_screen: bool,
    /// Passes requested since then, each with its frame format.
    wanted: HashSet<(Resolve, ResolveVariant, TextureFormat)>,
}

/// The pass that resolves the reflection of a view with these settings.
fn resolve_of(settings: &ClampedSettings, format: TextureFormat, in_place: WritesInPlace) -> Resolve {
    Resolve::new(
        in_place.allows(format),
        settings.technique != ReflectionTechnique::Converged,
    )
}

impl CompositePipelines {
    /// Requests the passes of a view with frames of this format. Call in each frame.
    pub(crate) fn request(&mut self, settings: &ClampedSettings, format: TextureFormat, in_place: WritesInPlace) {
        let resolve = resolve_of(settings, format, in_place);
        self.keeps_screen |= settings.reuses_screen();
        self.wanted
            .extend(ResolveVariant::of(settings).map(|variant| (resolve, variant, format)));
    }

    /// Returns whether everything for the opaque surfaces of a view with this frame format is ready.
    pub(crate) fn is_ready(
        &self,
        cache: &PipelineCache,
        settings: &ClampedSettings,
        format: TextureFormat,
        in_place: WritesInPlace,
    ) -> bool {
        let resolve = resolve_of(settings, format, in_place);
        let variant = ResolveVariant {
            surfaces: Surfaces::Opaque,
            blurs: denoise::blurs(settings),
            forward: false,
        };
        self.resolve[&resolve].pipeline(&variant, cache).is_some()
            && (resolve != Resolve::Apart || self.add.is_ready(format, cache))
            && (!settings.reuses_screen() || self.screen.pipeline(&(), cache).is_some())
    }
}

/// Declares the bindings of the passes.
pub(super) fn init_composite_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    fullscreen: Res<FullscreenShader>,
    scene: Res<SceneBindings>,
) {
    let assets = asset_server.as_ref();
    let with_scene = || OtherGroups::SceneAndEnvironment(scene.layout.clone());
    commands.insert_resource(CompositePipelines {
        shader: load_embedded_asset!(assets, "resolve.wesl"),
        resolve: Resolve::ALL
            .map(|kind| (kind, kind.pass(OtherGroups::Environment)))
            .into(),
        probed: Resolve::ALL.map(|kind| (kind, kind.pass(with_scene()))).into(),
        has_probes: false,
        has_forward: false,
        add: AddPass::new(assets, &fullscreen),
        screen_shader: load_embedded_asset!(assets, "screen.wesl"),
        screen: screen_pass(),
        keeps_screen: false,
        wanted: HashSet::default(),
    });
}

/// Queues the passes that cameras requested.
pub(super) fn queue_composite_pipelines(
    mut pipelines: ResMut<CompositePipelines>,
    scene: Res<SceneBindings>,
    cache: Res<PipelineCache>,
) {
    let CompositePipelines {
        shader,
        resolve,
        probed,
        has_probes,
        has_forward,
        add,
        screen_shader,
        screen,
        keeps_screen,
        wanted,
    } = &mut *pipelines;
    let features = scene.features();
    *has_probes = features.contains(Features::LIGHT_PROBES) && scene.has_layer_surfaces();
    *has_forward = features.contains(Features::FORWARD_SURFACES);
    for (kind, variant, format) in core::mem::take(wanted) {
        let variant = ResolveVariant {
            forward: variant.forward && *has_forward,
            ..variant
        };
        let defs = [kind.shader_defs(), variant.shader_defs()].concat();
        let queue = |pass: Option<&mut GBufferPass<ResolveVariant>>, defs| {
            if let Some(pass) = pass {
                pass.queue(variant, &cache, || PassShader {
                    shader: shader.clone(),
                    defs,
                    entry_point: Some("resolve"),
                });
            }
        };
        if *has_probes && variant.surfaces == Surfaces::FrontLayer {
            let of_scene = scene.definitions(Features::LIGHT_PROBES);
            queue(probed.get_mut(&kind), [&defs[..], &of_scene].concat());
        }
        queue(resolve.get_mut(&kind), defs);
        if kind == Resolve::Apart {
            add.queue(format, &cache);
        }
    }
    if core::mem::take(keeps_screen) {
        screen.queue((), &cache, || PassShader {
            shader: screen_shader.clone(),
            defs: vec![],
            entry_point: None,
        });
    }
    let screen_error = screen.errors(&cache).next().map(|(_, error)| error);
    let mut passes = resolve.values().chain(probed.values());
    let error = passes.find_map(|pass| pass.errors(&cache).next());
    if let Some(error) = error.map(|(_, error)| error).or(screen_error) {
        error_once!(
            "a composite of ray-traced reflections failed; cameras that need it get simpler reflections, or none: {error}"
        );
    }
}

/// Allows compute shaders to write to the frames of reflecting cameras if the composite or a debug view does, and to the frames of all
/// cameras with the same target: cameras share a frame only if its usages are the same.
pub(super) fn allow_writes_in_place(
    reflecting: Query<(&ExtractedCamera, &ExtractedView, &ReflectionView)>,
    mut cameras: Query<(&ExtractedCamera, &ExtractedView, &mut CameraMainTextureUsages)>,
    in_place: Option<Res<WritesInPlace>>,
) {
    let Some(in_place) = in_place else { return };
    let targets: HashSet<_> = reflecting
        .iter()
        .filter(|(_, view, reflections)| {
            let has_debug_view = reflections.debug.views().next().is_some();
            in_place.allows(view.target_format) || has_debug_view && view.target_format == FRAME_FORMAT
        })
        .map(|(camera, ..)| camera.target.clone())
        .collect();
    for (camera, view, mut usages) in &mut cameras {
        if view.target_format == FRAME_FORMAT && targets.contains(&camera.target) {
            usages.0 |= TextureUsages::STORAGE_BINDING;
        }
    }
}

/// Copies the camera's light, for views with rays that reuse it.
pub(crate) fn keep_screen(ctx: &mut RenderContext, pipelines: &CompositePipelines, context: &PassContext) {
    screen::run(ctx, &pipelines.screen, context);
}

/// Adds the reflection of some surfaces to the lit frame.
pub(crate) fn composite_reflection(
    ctx: &mut RenderContext,
    pipelines: &CompositePipelines,
    context: &PassContext,
    target: &ViewTarget,
    surfaces: Surfaces,
) {
    let kind = Resolve::new(context.targets().reflection.is_none(), context.images().is_some());
    if kind != Resolve::Apart && !target.main_texture().usage().contains(TextureUsages::STORAGE_BINDING) {
        return;
    }
    let is_probed = pipelines.has_probes && surfaces == Surfaces::FrontLayer;
    let forward = pipelines.has_forward;
    let runs = is_probed && kind.run(ctx, &pipelines.probed[&kind], context, surfaces, forward)
        || kind.run(ctx, &pipelines.resolve[&kind], context, surfaces, forward);
    if runs && kind == Resolve::Apart {
        pipelines.add.run(ctx, context, target);
    }
}
