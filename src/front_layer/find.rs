//! The pass that finds the front layer of a view: one ray for each pixel of its rectangles.

use super::{
    rects::GpuRects,
    textures::{DEPTH_FORMAT, LayerTextures, MOTION_FORMAT, WORDS_FORMAT},
};
use crate::{
    common::MAX_WORKGROUPS,
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext, PassShader},
    rate::RatePipelines,
    scene::SceneBindings,
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
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct FindVariant {
    /// The scene's trees need a larger stack.
    deep_trees: bool,
    /// Cameras draw different layers.
    layers: bool,
    /// The view wants opaque surfaces that are drawn forward, and the scene has some.
    forward: bool,
    /// The app's shader, in place of `find.wesl`.
    own: Option<Handle<Shader>>,
}

impl FindVariant {
    /// Variants that do until this one is compiled. A stack that is too small misses some surfaces, without layers too many are
    /// found, without the app's shader they lack its waves, and without forward surfaces those of glass are there: better than nothing,
    /// if the view wants glass.
    fn or_simpler(&self, wants_glass: bool) -> impl Iterator<Item = Self> + use<> {
        let library = Self {
            own: None,
            ..self.clone()
        };
        let without_layers = Self {
            layers: false,
            ..library.clone()
        };
        let without_forward = Self {
            forward: false,
            ..self.clone()
        };
        [self.clone(), library, without_forward, without_layers, Self::default()]
            .into_iter()
            .filter(move |variant| variant.forward || wants_glass)
    }
}

/// The pass in its variants.
#[derive(Resource)]
pub(super) struct FindPass {
    shader: Handle<Shader>,
    pass: GBufferPass<FindVariant>,
    /// The one that views want without forward surfaces.
    variant: FindVariant,
    /// The scene has forward surfaces.
    has_forward: bool,
}

/// Takes the app's shader over.
pub(super) fn extract_shader(own: Extract<Option<Res<FrontLayerShader>>>, find: Option<ResMut<FindPass>>) {
    let own = own.as_ref().map(|own| &own.0);
    if let Some(mut find) = find
        && find.variant.own.as_ref() != own
    {
        find.variant.own = own.cloned();
    }
}

/// Declares what the pass binds.
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
        // Without motion vectors nothing is accumulated, and nobody reads what the pass writes of them.
        Binding::floats(|context| context.motion.or(Some(context.gbuffer.normals))),
        Binding::given(binding_types::texture_2d(TextureSampleType::Float {
            filterable: false,
        })),
    ];
    let groups = OtherGroups::SceneAndEnvironment(scene.layout.clone());
    commands.insert_resource(FindPass {
        shader: load_embedded_asset!(asset_server.as_ref(), "find.wesl"),
        pass: GBufferPass::new("glint_find_front_layer", bindings, groups),
        variant: FindVariant::default(),
        has_forward: false,
    });
}

/// Returns whether a view wants a layer of what the scene has.
fn wants_layer(view: &ReflectionView, scene: &SceneBindings) -> bool {
    let has_glass = scene.see_through.entities().next().is_some();
    (view.settings.transparent && has_glass) || (view.settings.forward && scene.has_forward_surfaces())
}

/// Asks for rates of parts of a view as soon as a camera wants the layer in a scene with such objects.
pub(super) fn request_rates(views: Query<&ReflectionView>, mut rate: ResMut<RatePipelines>, scene: Res<SceneBindings>) {
    for view in views.iter().filter(|view| wants_layer(view, &scene)) {
        rate.request_parts(&view.rate);
    }
}

/// Lets shaders read the depth of views in whose layer opaque surfaces may lie: objects without a prepass cover some.
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

/// Has the pass compiled under the same conditions.
pub(super) fn queue_find_pass(
    views: Query<&ReflectionView>,
    mut find: ResMut<FindPass>,
    scene: Res<SceneBindings>,
    cache: Res<PipelineCache>,
) {
    find.has_forward = scene.has_forward_surfaces();
    find.variant.deep_trees = scene.has_deep_trees();
    find.variant.layers = scene.has_render_layers();
    let views = views.iter().filter(|view| wants_layer(view, &scene));
    let wanted: HashSet<_> = views
        .flat_map(|view| {
            let variant = find.variant_of(&view.settings);
            let library = FindVariant {
                own: None,
                ..variant.clone()
            };
            [variant, library]
        })
        .collect();
    let FindPass {
        shader, pass, variant, ..
    } = &mut *find;
    for wanted in wanted {
        let FindVariant {
            layers, forward, own, ..
        } = wanted.clone();
        pass.queue(wanted, &cache, || {
            // See-through surfaces need the alpha test.
            let mut defs = scene.shader_defs_for(true);
            defs.push("FRONT_LAYER".into());
            defs.extend(layers.then(|| "RENDER_LAYERS".into()));
            defs.extend(forward.then(|| "FORWARD_SURFACES".into()));
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
        } else if failed.own == variant.own {
            error_once!(
                "the shader of `FrontLayerShader` failed, so that reflections follow normal maps alone: {error}"
            );
        }
    }
}

impl FindPass {
    /// The variant that a view with these settings wants.
    fn variant_of(&self, settings: &ClampedSettings) -> FindVariant {
        FindVariant {
            forward: settings.forward && self.has_forward,
            ..self.variant.clone()
        }
    }

    /// The app changes what is found, and nobody tells when.
    pub fn is_own(&self) -> bool {
        self.variant.own.is_some()
    }

    /// Finds the layer of a view, whose context is that of its opaque surfaces and whose main passes draw `depth`. Returns false where
    /// the pass isn't compiled.
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
        let variants = self.variant_of(settings).or_simpler(settings.transparent);
        let Some(mut pass) = self.pass.begin(ctx, context, variants, &given) else {
            return false;
        };
        let groups = gpu_rects.get().groups();
        pass.dispatch_workgroups(groups.min(MAX_WORKGROUPS), groups.div_ceil(MAX_WORKGROUPS), 1);
        true
    }
}
