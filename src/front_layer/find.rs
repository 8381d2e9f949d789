//! The pass that finds the front layer of a view: one ray for each pixel of its rectangles.

use super::{
    rects::GpuRects,
    textures::{DEPTH_FORMAT, LayerTextures, MOTION_FORMAT, WORDS_FORMAT},
};
use crate::{
    common::MAX_WORKGROUPS,
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Groups, Options, Pass, Pipelines, Variant},
    rate,
    scene::{Features, Passes, SceneBindings},
    settings::{ClampedSettings, FrontLayerShader, ReflectionView},
};
use bevy::{
    asset::Handle,
    camera::Camera3d,
    ecs::prelude::*,
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

/// The pass. Its variants have the feature `FORWARD_SURFACES` if the view wants them and the scene has some.
pub(crate) const FIND: &Pass = &Pass {
    label: "glint_find_front_layer",
    shader: "front_layer/find.wesl",
    sees: Passes::FRONT_LAYER,
    entry_point: "find",
    bindings,
    groups: Groups::Scene,
    options: Options::FRONT_LAYER,
    ..Pass::new(Failure::FRONT_LAYER)
};

fn bindings() -> Vec<Binding> {
    let written = |format: TextureFormat| {
        Binding::given(binding_types::texture_storage_2d(
            format,
            StorageTextureAccess::WriteOnly,
        ))
    };
    vec![
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
    ]
}

/// The app's shader, which modifies the surfaces.
#[derive(Resource, Default)]
pub(super) struct OwnShader(Option<Handle<Shader>>);

impl OwnShader {
    /// Returns whether the app modifies the surfaces, which can change at any time.
    pub fn is_there(&self) -> bool {
        self.0.is_some()
    }
}

/// Updates the app's shader.
pub(super) fn extract_shader(own: Extract<Option<Res<FrontLayerShader>>>, mut known: ResMut<OwnShader>) {
    let own = own.as_ref().map(|own| &own.0);
    if known.0.as_ref() != own {
        known.0 = own.cloned();
    }
}

/// Returns whether a view needs a layer for objects of the scene.
fn wants_layer(view: &ReflectionView, scene: &SceneBindings) -> bool {
    let has_glass = scene.see_through.entities().next().is_some();
    (view.settings.transparent && has_glass) || (view.settings.forward && scene.has_forward_surfaces())
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

/// Requests the pass, and rates of parts of a view, for cameras that need the layer in a scene with such objects.
pub(super) fn request_find_pass(
    views: Query<&ReflectionView>,
    mut pipelines: ResMut<Pipelines>,
    own: Res<OwnShader>,
    scene: Res<SceneBindings>,
    cache: Res<PipelineCache>,
) {
    for view in views.iter().filter(|view| wants_layer(view, &scene)) {
        pipelines.want(&cache, rate::variants_of_parts(&view.rate));
        pipelines.want(&cache, variants(&view.settings, scene.features(), &own));
    }
}

/// The pass for a view in a scene with these features: with the app's shader, and without it.
fn variants(settings: &ClampedSettings, scene: Features, own: &OwnShader) -> impl Iterator<Item = Variant> + use<> {
    // See-through surfaces need the alpha test.
    let mut features = scene.seen_by(FIND.sees) | Features::MASKED;
    if !settings.forward {
        features -= Features::FORWARD_SURFACES;
    }
    let library = FIND.variant(features, Options::empty());
    let own = own.0.clone().map(|own| Variant {
        own: Some(own),
        ..library.clone()
    });
    own.into_iter().chain([library])
}

/// The compiled variant that lacks the fewest requested features: the app's shader if that is compiled, and forward surfaces only for
/// views that also want glass. If the stack is too small, some surfaces are missed, and without layers, too many are found: better than
/// nothing.
fn best_variant(pipelines: &Pipelines, context: &PassContext, own: &OwnShader) -> Option<Variant> {
    let settings = &context.view.settings;
    // For a view without forward surfaces, the pass must find none.
    let mut spare = Features::HARMLESS;
    spare.set(Features::FORWARD_SURFACES, settings.forward);
    let fits = variants(settings, context.features, own).filter_map(|variant| {
        let fit = pipelines.best(context.cache, &variant, spare)?;
        Some((fit, variant))
    });
    let (fit, variant) = fits.min_by_key(|(fit, _)| fit.loss())?;
    let finds = settings.transparent || fit.features.contains(Features::FORWARD_SURFACES);
    finds.then_some(Variant {
        features: fit.features,
        ..variant
    })
}

/// Finds the layer of a view. `context` belongs to its opaque surfaces, and its main passes draw `depth`. Returns false if the pass isn't
/// compiled.
pub(super) fn find(
    ctx: &mut RenderContext,
    (pipelines, own): (&Pipelines, &OwnShader),
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
    let variant = best_variant(pipelines, context, own);
    let Some(mut pass) = pipelines.begin(ctx, context, variant, &given) else {
        return false;
    };
    let groups = gpu_rects.get().groups();
    pass.dispatch_workgroups(groups.min(MAX_WORKGROUPS), groups.div_ceil(MAX_WORKGROUPS), 1);
    true
}
