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
    settings::ReflectionView,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    log::error_once,
    math::URect,
    render::{
        render_resource::{
            BindingResource, IntoBinding, PipelineCache, StorageTextureAccess, TextureFormat, UniformBuffer,
            binding_types,
        },
        renderer::RenderContext,
    },
    shader::Shader,
};
use core::num::NonZeroU64;

/// A variant of the pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct FindVariant {
    /// The scene's trees need a larger stack.
    deep_trees: bool,
    /// Reflecting cameras draw different layers.
    layers: bool,
}

/// The pass in all its variants.
#[derive(Resource)]
pub(super) struct FindPass {
    shader: Handle<Shader>,
    pass: GBufferPass<FindVariant>,
    /// The one that the scene needs.
    variant: FindVariant,
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
    ];
    let groups = OtherGroups::SceneAndEnvironment(scene.layout.clone());
    commands.insert_resource(FindPass {
        shader: load_embedded_asset!(asset_server.as_ref(), "find.wesl"),
        pass: GBufferPass::new("glint_find_front_layer", bindings, groups),
        variant: FindVariant::default(),
    });
}

/// Asks for rates of parts of a view as soon as a camera wants the layer in a scene with see-through objects.
pub(super) fn request_rates(views: Query<&ReflectionView>, mut rate: ResMut<RatePipelines>, scene: Res<SceneBindings>) {
    if scene.see_through.entities().next().is_none() {
        return;
    }
    for view in views.iter().filter(|view| view.settings.transparent) {
        rate.request_parts(&view.rate);
    }
}

/// Has the pass compiled under the same conditions.
pub(super) fn queue_find_pass(
    views: Query<&ReflectionView>,
    mut find: ResMut<FindPass>,
    scene: Res<SceneBindings>,
    cache: Res<PipelineCache>,
) {
    let is_wanted = views.iter().any(|view| view.settings.transparent);
    if !is_wanted || scene.see_through.entities().next().is_none() {
        return;
    }
    let FindPass { shader, pass, variant } = &mut *find;
    *variant = FindVariant {
        deep_trees: scene.has_deep_trees(),
        layers: scene.has_render_layers(),
    };
    pass.queue(*variant, &cache, || {
        // See-through surfaces need the alpha test.
        let mut defs = scene.shader_defs_for(true);
        defs.push("FRONT_LAYER".into());
        defs.extend(variant.layers.then(|| "RENDER_LAYERS".into()));
        PassShader {
            shader: shader.clone(),
            defs,
            entry_point: Some("find"),
        }
    });
    if let Some((_, error)) = pass.errors(&cache).next() {
        error_once!(
            "transparent surfaces show no ray-traced reflections, since the shader that finds them failed: {error}"
        );
    }
}

impl FindPass {
    /// Finds the layer of a view, whose context is that of its opaque surfaces. Returns false where the pass isn't compiled.
    pub fn run(
        &self,
        ctx: &mut RenderContext,
        context: &PassContext,
        layer: &LayerTextures,
        rects: &[URect],
        gpu_rects: &UniformBuffer<GpuRects>,
    ) -> bool {
        let Some(binding) = gpu_rects.binding() else {
            return false;
        };
        let given: [BindingResource; 5] = [
            layer.words.into_binding(),
            layer.motion.into_binding(),
            layer.depth.into_binding(),
            layer.packed_normals.as_entire_binding(),
            binding,
        ];
        // A stack that is too small misses some surfaces, and without layers too many are found: better than nothing while the right
        // variant is compiled.
        let without_layers = FindVariant {
            layers: false,
            ..self.variant
        };
        let variants = [self.variant, without_layers, FindVariant::default()];
        let Some(mut pass) = self.pass.begin(ctx, context, variants, &given) else {
            return false;
        };
        let groups = gpu_rects.get().groups();
        pass.dispatch_workgroups(groups.min(MAX_WORKGROUPS), groups.div_ceil(MAX_WORKGROUPS), 1);
        drop(pass);
        layer.copy_normals(ctx, context, rects);
        true
    }
}
