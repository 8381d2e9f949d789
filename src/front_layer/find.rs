//! The pass that finds the front layer of a view: one ray for each pixel of its rectangles.

use super::{
    rects::GpuRects,
    textures::{DEPTH_FORMAT, LayerTextures, MOTION_FORMAT, WORDS_FORMAT},
};
use crate::{
    common::MAX_WORKGROUPS,
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext, PassShader},
    rate::RatePipelines,
    scene::{Features, Passes, SceneBindings},
    settings::{ClampedSettings, FrontLayerShader, ReflectionView},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    camera::Camera3d,
    ecs::prelude::*,
    log::error_once,
    platform::collections::HashSet,
    render::{
        Extract,
        globals::{GlobalsBuffer, GlobalsUniform},
        render_resource::{
            BindingResource, IntoBinding, PipelineCache, StorageTextureAccess, TextureFormat, TextureSampleType,
            TextureUsages, TextureView, UniformBuffer, binding_types,
        },
        renderer::RenderContext,
        view::ViewDepthStencilTexture,
    },
    shader::Shader,
};
use core::num::NonZeroU64;

/// A variant of the pass.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct FindVariant {
    /// `FORWARD_SURFACES` is set if the view wants them and the scene has some.
    features: Features,
    /// The app's shader, instead of `find.wesl`.
    own: Option<Handle<Shader>>,
}

/// The pass in its variants.
#[derive(Resource)]
pub(super) struct FindPass {
    shader: Handle<Shader>,
    pass: GBufferPass<FindVariant>,
    /// Features of the scene.
    features: Features,
    /// The app's shader.
    own: Option<Handle<Shader>>,
}

/// Updates the app's shader.
pub(super) fn extract_shader(own: Extract<Option<Res<FrontLayerShader>>>, find: Option<ResMut<FindPass>>) {
    let own = own.as_ref().map(|own| &own.0);
    if let Some(mut find) = find
        && find.own.as_ref() != own
    {
        find.own = own.cloned();
    }
}

/// Declares the bindings of the pass.
pub(super) fn init_find_pass(mut commands: Commands, asset_server: Res<AssetServer>, scene: Res<SceneBindings>) {
    let written = |format: TextureFormat| {
        Binding::given(binding_types::texture_storage_2d(
            format,
            StorageTextureAccess::WriteOnly,
        ))
    };
    let bindings = vec![
        written(WORDS_FORMAT),
        written(MOTION_FORMAT),
        written(DEPTH_FORMAT),
        Binding::given(binding_types::storage_buffer_sized(false, NonZeroU64::new(4))),
        Binding::given(binding_types::uniform_buffer::<GpuRects>(false)),
        Binding::given(binding_types::uniform_buffer::<GlobalsUniform>(false)),
        // Nothing is accumulated without motion vectors, and the motion output is never read.
        Binding::floats(|context| context.motion.or(Some(context.gbuffer.normals))),
        Binding::given(binding_types::texture_2d(TextureSampleType::Float {
            filterable: false,
        })),
    ];
    let groups = OtherGroups::SceneAndEnvironment(scene.layout.clone());
    commands.insert_resource(FindPass {
        shader: load_embedded_asset!(asset_server.as_ref(), "find.wesl"),
        pass: GBufferPass::new("glint_find_front_layer", bindings, groups),
        features: Features::empty(),
        own: None,
    });
}

/// Returns whether a view needs a layer for objects of the scene.
fn wants_layer(view: &ReflectionView, scene: &SceneBindings) -> bool {
    let has_glass = scene.see_through.entities().next().is_some();
    (view.settings.transparent && has_glass) || (view.settings.forward && scene.has_forward_surfaces())
}

/// Requests rates of parts of a view as soon as a camera needs the layer in a scene with such objects.
pub(super) fn request_rates(views: Query<&ReflectionView>, mut rate: ResMut<RatePipelines>, scene: Res<SceneBindings>) {
    for view in views.iter().filter(|view| wants_layer(view, &scene)) {
        rate.request_parts(&view.rate);
    }
}

/// Makes the depth of views readable for shaders if their layer can contain opaque surfaces, since objects without a prepass can cover
/// these.
pub(super) fn keep_depth_readable(mut views: Query<(&ReflectionView, &mut Camera3d)>, scene: Res<SceneBindings>) {
    if !scene.has_forward_surfaces() {
        return;
    }
    for (_, mut camera) in views.iter_mut().filter(|(view, _)| view.settings.forward) {
        camera.depth_texture_usages.0 |= TextureUsages::TEXTURE_BINDING.bits();
    }
}

/// Depth of all opaque surfaces of a view, if shaders can read it.
fn readable_depth(depth: Option<&ViewDepthStencilTexture>) -> Option<&TextureView> {
    let texture = &depth?.attachment.texture;
    let is_readable =
        texture.texture.usage().contains(TextureUsages::TEXTURE_BINDING) && texture.texture.sample_count() == 1;
    is_readable.then_some(&texture.default_view)
}

/// Queues the pass under the same conditions.
pub(super) fn queue_find_pass(
    views: Query<&ReflectionView>,
    mut find: ResMut<FindPass>,
    scene: Res<SceneBindings>,
    cache: Res<PipelineCache>,
) {
    find.features = scene.features();
    let views = views.iter().filter(|view| wants_layer(view, &scene));
    let wanted: HashSet<_> = views
        .flat_map(|view| {
            let features = find.features_of(&view.settings);
            [find.own.clone(), None].map(|own| FindVariant { features, own })
        })
        .collect();
    let FindPass {
        shader,
        pass,
        own: current,
        ..
    } = &mut *find;
    for wanted in wanted {
        let FindVariant { features, own } = wanted.clone();
        pass.queue(wanted, &cache, || {
            let mut defs = scene.definitions(features);
            defs.push("FRONT_LAYER".into());
            PassShader {
                entry_point: own.is_none().then_some("find"),
                shader: own.unwrap_or_else(|| shader.clone()),
                defs,
            }
        });
    }
    for (failed, error) in pass.errors(&cache) {
        if failed.own.is_none() {
            error_once!(
                "transparent and forward surfaces show no ray-traced reflections, since the shader that finds them failed: {error}"
            );
        } else if failed.own == *current {
            error_once!(
                "the shader of `FrontLayerShader` failed, so that reflections follow normal maps alone: {error}"
            );
        }
    }
}

impl FindPass {
    /// The features for a view with these settings.
    fn features_of(&self, settings: &ClampedSettings) -> Features {
        // See-through surfaces need the alpha test.
        let mut features = self.features.seen_by(Passes::FRONT_LAYER) | Features::MASKED;
        if !settings.forward {
            features -= Features::FORWARD_SURFACES;
        }
        features
    }

    /// The compiled variant that lacks the fewest requested features: the app's shader if that is compiled, and forward surfaces only for
    /// views that also want glass. If the stack is too small, some surfaces are missed, and without layers, too many are found: better than
    /// nothing.
    fn variant_of(&self, settings: &ClampedSettings, cache: &PipelineCache) -> Option<FindVariant> {
        let wanted = self.features_of(settings);
        // For a view without forward surfaces, the pass must find none.
        let mut spare = Features::HARMLESS;
        spare.set(Features::FORWARD_SURFACES, settings.forward);
        let variants = [self.own.as_ref(), None].into_iter().filter_map(|own| {
            let compiled = self.pass.compiled(cache).filter(|variant| variant.own.as_ref() == own);
            let compiled = compiled.map(|variant| variant.features);
            let fit = wanted.best_of(compiled, spare)?;
            Some((fit, own))
        });
        let (fit, own) = variants.min_by_key(|(fit, _)| fit.loss())?;
        let finds = settings.transparent || fit.features.contains(Features::FORWARD_SURFACES);
        finds.then(|| FindVariant {
            features: fit.features,
            own: own.cloned(),
        })
    }

    /// Returns whether the app modifies the surfaces, which can change at any time.
    pub fn is_own(&self) -> bool {
        self.own.is_some()
    }

    /// Finds the layer of a view. `context` belongs to its opaque surfaces, and its main passes draw `depth`. Returns false if the pass
    /// isn't compiled.
    pub fn run(
        &self,
        ctx: &mut RenderContext,
        context: &PassContext,
        layer: &LayerTextures,
        gpu_rects: &UniformBuffer<GpuRects>,
        globals: &GlobalsBuffer,
        depth: Option<&ViewDepthStencilTexture>,
    ) -> bool {
        let (Some(binding), Some(globals)) = (gpu_rects.binding(), globals.buffer.binding()) else {
            return false;
        };
        let given: [BindingResource; 7] = [
            layer.words.into_binding(),
            layer.motion.into_binding(),
            layer.depth.into_binding(),
            layer.packed_normals.as_entire_binding(),
            binding,
            globals,
            readable_depth(depth).unwrap_or(context.gbuffer.depth).into_binding(),
        ];
        let settings = &context.view.settings;
        let variant = self.variant_of(settings, context.cache);
        let Some(mut pass) = self.pass.begin(ctx, context, variant, &given) else {
            return false;
        };
        let groups = gpu_rects.get().groups();
        pass.dispatch_workgroups(groups.min(MAX_WORKGROUPS), groups.div_ceil(MAX_WORKGROUPS), 1);
        true
    }
}
