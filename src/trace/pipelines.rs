//! Pipelines of the passes that trace rays, and the tables that they read.

use super::{
    blocks,
    converged::converged_pass,
    directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo},
    inline::InlinePass,
    plan::{Plan, kernels},
    surface_shader::SurfaceShader,
    variant::{Demand, Kernel},
};
use crate::{
    diagnostics::CountInvocations,
    gbuffer::{GBufferPass, PassShader},
    scene::{Change, Features, Fit, SceneBindings},
    settings::{ClampedSettings, ReflectionView, ReflectionWarmUp},
    vrs::PipelineRequest,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    log::error_once,
    pbr::Bluenoise,
    platform::collections::{HashMap, HashSet},
    render::{
        Extract,
        render_asset::RenderAssets,
        render_resource::{
            Extent3d, PipelineCache, TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat,
            TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};

/// Number of storage buffers in the pass that shades hits and traces mirror rays: the same as in the pass over the list of rays
/// (`device/support.rs`), plus the other list and light probes.
const JOINED_STORAGE_BUFFERS: u32 = 11;

/// Pipelines of the tracing passes.
#[derive(Resource)]
pub struct TracePipelines {
    /// The compute passes, and their shaders.
    compute: HashMap<Kernel, (GBufferPass<Features>, Handle<Shader>)>,
    pub(super) inline: InlinePass,
    /// Creates shading-rate attachments.
    attachment_shader: Handle<Shader>,
    /// Table for `albedo.wesl`.
    pub(super) albedo_table: TextureView,
    /// Spatio-temporal blue noise, once its image is loaded.
    pub(super) noise: Option<TextureView>,
    /// Whether the device has enough storage buffers for the pass that shades hits and traces mirror rays.
    can_join: bool,
    /// Definitions of all variants.
    common_defs: Vec<ShaderDefVal>,
    /// Definitions of the raw Vulkan pass, which work for any scene.
    vrs_defs: Vec<ShaderDefVal>,
    /// Passes requested since pipelines were last queued.
    wanted: HashSet<Demand>,
    /// Features of the scene and of the app.
    pub(super) features: Features,
    /// Features that the app will need later.
    warm: Features,
    /// Shaders with these features are compiled.
    is_warm: bool,
    missing: Missing,
}

/// Features that the passes of views lack.
#[derive(Clone, Copy, Default, PartialEq)]
struct Missing {
    all: Features,
    /// Missing features with shaders that are being compiled.
    expected: Features,
}

impl TracePipelines {
    /// Requests the passes of a view. Call in each frame.
    pub(crate) fn request(&mut self, settings: &ClampedSettings) {
        self.wanted.insert(Demand::of(settings));
    }

    /// The passes that trace the rays of a view in this frame; `None` until they are compiled.
    pub(super) fn plan(&self, demand: Demand, cache: &PipelineCache) -> Option<Plan> {
        self.plan_for(self.features, demand, cache)
    }

    fn plan_for(&self, features: Features, demand: Demand, cache: &PipelineCache) -> Option<Plan> {
        Plan::new(demand, features | demand.asked, &|kernel, wanted, spare| {
            self.best(kernel, wanted, spare, cache)
        })
    }

    /// Features of the scene that the passes of views lack.
    fn missing(&self, features: Features, demands: &HashSet<Demand>, cache: &PipelineCache) -> Missing {
        let mut found = Missing::default();
        for demand in demands {
            let wanted = features | demand.asked;
            let missing = self.plan_for(features, *demand, cache);
            let missing = missing.map_or(Features::all(), Plan::missing);
            found.all |= missing;
            let mut kernels = kernels(*demand, wanted, self.can_join);
            if !kernels.any(|kernel| self.has_failed(kernel, kernel.features(wanted), cache)) {
                found.expected |= missing;
            }
        }
        found
    }

    /// The shader of a pass doesn't compile with these features. Waiting for it would never end.
    fn has_failed(&self, kernel: Kernel, wanted: Features, cache: &PipelineCache) -> bool {
        let is_it = |(features, _): (&Features, _)| *features == wanted;
        match self.compute(kernel) {
            Some(pass) => pass.errors(cache).any(is_it),
            None => self.inline.errors(cache).any(is_it),
        }
    }

    /// Queues shaders that the app will need later. In scenes with few lights, variants that sample lights don't work.
    fn warm_up(&mut self, demands: &HashSet<Demand>, scene: &SceneBindings, cache: &PipelineCache) {
        let warm = (self.features - Features::SURFACE_SHADER) | self.warm | Features::MASKED;
        let few = warm - (self.warm & Features::LIGHT_SAMPLING);
        let is_named = !self.warm.is_empty();
        for features in [few, warm].into_iter().filter(|_| is_named) {
            for demand in demands {
                self.queue(*demand, features | demand.asked, scene, cache);
            }
        }
        let lacks = |features: Features| !self.missing(features, demands, cache).expected.is_empty();
        self.is_warm = !is_named || !lacks(few) && !lacks(warm);
    }

    fn best(&self, kernel: Kernel, wanted: Features, spare: Features, cache: &PipelineCache) -> Option<Fit> {
        match self.compute(kernel) {
            Some(pass) => wanted.best_of(pass.compiled(cache).copied(), spare),
            None => wanted.best_of(self.inline.compiled(cache), spare),
        }
    }

    /// A compute pass.
    pub(super) fn compute(&self, kernel: Kernel) -> Option<&GBufferPass<Features>> {
        self.compute.get(&kernel).map(|(pass, _)| pass)
    }

    /// Returns whether everything that a view's settings need is ready.
    pub(crate) fn is_ready(&self, cache: &PipelineCache, settings: &ClampedSettings) -> bool {
        self.noise.is_some() && self.plan(Demand::of(settings), cache).is_some()
    }

    /// Returns whether the passes of views have all features of the scene, and of [`ReflectionWarmUp`].
    pub(crate) fn is_complete(&self) -> bool {
        self.missing.expected.is_empty() && self.is_warm
    }

    /// Requests the pipeline of the raw Vulkan pass, which uses the shader of [`Kernel::Inline`].
    pub(super) fn vrs_request(&self) -> PipelineRequest {
        PipelineRequest {
            shader: self.inline.shader.clone(),
            defs: self.vrs_defs.clone(),
            layouts: self.inline.layouts(),
            attachment_shader: self.attachment_shader.clone(),
        }
    }

    /// Queues the passes that a view needs in a scene with these features.
    fn queue(&mut self, demand: Demand, wanted: Features, scene: &SceneBindings, cache: &PipelineCache) {
        for kernel in kernels(demand, wanted, self.can_join) {
            let features = kernel.features(wanted);
            let common = &self.common_defs;
            let defs = || {
                let mut defs = scene.definitions(features);
                defs.extend_from_slice(common);
                defs.extend(kernel.definition().map(ShaderDefVal::from));
                defs
            };
            match self.compute.get_mut(&kernel) {
                Some((pass, shader)) => pass.queue(features, cache, || PassShader {
                    shader: shader.clone(),
                    defs: defs(),
                    entry_point: Some("trace"),
                }),
                None => self.inline.queue(features, cache, defs),
            }
        }
    }

    /// The first error of a pipeline, with or without the app's shader.
    fn error<'a>(&'a self, cache: &'a PipelineCache, is_own: bool) -> Option<&'a ShaderCacheError> {
        let compute = self.compute.values().flat_map(|(pass, _)| pass.errors(cache));
        compute
            .chain(self.inline.errors(cache))
            .find(|(features, _)| features.contains(Features::SURFACE_SHADER) == is_own)
            .map(|(_, error)| error)
    }
}

/// Creates layouts and the albedo table.
pub(super) fn init_trace_pipelines(
    mut commands: Commands,
    asset_server: Res<AssetServer>,
    scene: Res<SceneBindings>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    count: Option<Res<CountInvocations>>,
) {
    let assets = asset_server.as_ref();
    let blocks: Handle<Shader> = load_embedded_asset!(assets, "blocks.wesl");
    let shading: Handle<Shader> = load_embedded_asset!(assets, "shade.wesl");
    let converged = load_embedded_asset!(assets, "converged.wesl");
    let layout = &scene.layout;
    let common_defs: Vec<ShaderDefVal> = count.map(|_| "COUNT_INVOCATIONS".into()).into_iter().collect();
    let of_vrs = Features::MASKED | Features::DEEP_TREES | (Features::OF_VRS & scene.possible_features());
    let mut vrs_defs = scene.definitions(of_vrs);
    // Its address replaces a binding.
    vrs_defs.push("ONE_TLAS".into());
    vrs_defs.extend_from_slice(&common_defs);
    commands.insert_resource(TracePipelines {
        compute: HashMap::from_iter([
            (Kernel::Rays, (blocks::ray_pass(layout), blocks.clone())),
            (Kernel::Shading, (blocks::shading_pass(layout), shading.clone())),
            (
                Kernel::ShadingAndMirrors,
                (blocks::shading_and_mirrors_pass(layout), shading),
            ),
            (Kernel::Mirrors, (blocks::mirror_ray_pass(layout), blocks)),
            (Kernel::Converged, (converged_pass(layout), converged)),
        ]),
        inline: InlinePass::new(load_embedded_asset!(assets, "inline.wesl"), layout),
        attachment_shader: load_embedded_asset!(assets, "vrs.wesl"),
        albedo_table: create_albedo_table(&device, &queue),
        noise: None,
        can_join: device.limits().max_storage_buffers_per_shader_stage >= JOINED_STORAGE_BUFFERS,
        common_defs,
        vrs_defs,
        wanted: HashSet::default(),
        features: Features::MASKED,
        warm: Features::empty(),
        is_warm: true,
        missing: Missing::default(),
    });
}

fn create_albedo_table(device: &RenderDevice, queue: &RenderQueue) -> TextureView {
    let size = ALBEDO_TABLE_SIZE as u32;
    let texture = device.create_texture_with_data(
        queue,
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
            // The shader loads and blends texels itself, so no filtering is needed, and weights aren't limited to the 8 bits of texture
            // units.
            format: TextureFormat::Rg32Float,
            usage: TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(DirectionalAlbedo::new().texels()),
    );
    texture.create_view(&TextureViewDescriptor::default())
}

/// Updates the features that the app will need later, as far as the device supports them.
pub(super) fn extract_warm_up(
    own: Extract<Option<Res<ReflectionWarmUp>>>,
    pipelines: Option<ResMut<TracePipelines>>,
    scene: Option<Res<SceneBindings>>,
) {
    let (Some(mut pipelines), Some(scene)) = (pipelines, scene) else {
        return;
    };
    let named = own.as_ref().map_or(Features::empty(), |own| Features::of_warm_up(own));
    let warm = named & scene.possible_features();
    if pipelines.warm != warm {
        pipelines.warm = warm;
    }
}

/// Queues the passes of all views, with the features of the scene.
pub(super) fn queue_trace_pipelines(
    mut pipelines: ResMut<TracePipelines>,
    cache: Res<PipelineCache>,
    mut scene: ResMut<SceneBindings>,
    mut surface_shader: ResMut<SurfaceShader>,
    views: Query<&ReflectionView>,
    noise: Option<Res<Bluenoise>>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let pipelines = &mut *pipelines;
    pipelines.features = scene.features();
    pipelines
        .features
        .set(Features::SURFACE_SHADER, surface_shader.is_there());
    if surface_shader.take_change() {
        scene.version.note(Change::Unmarked);
    }
    let failed = pipelines.error(&cache, false).is_some();
    // A view that waits for other settings continues with its current ones.
    let mut demands = core::mem::take(&mut pipelines.wanted);
    demands.extend(views.iter().map(|view| Demand::of(&view.settings)));
    for demand in &demands {
        let wanted = pipelines.features | demand.asked;
        let library = wanted - Features::SURFACE_SHADER;
        // The variant that works for scenes with and without masks comes first.
        for features in [library | Features::MASKED, library, wanted] {
            pipelines.queue(*demand, features, &scene, &cache);
        }
        if failed {
            let plain = (wanted & (Features::MASKED | Features::DEEP_TREES)) | demand.asked;
            pipelines.queue(*demand, plain, &scene, &cache);
        }
    }
    pipelines.warm_up(&demands, &scene, &cache);
    let missing = pipelines.missing(pipelines.features, &demands, &cache);
    // Converged views restart, since their accumulated frames have other features.
    if missing.all != pipelines.missing.all {
        scene.version.note(Change::Unmarked);
    }
    pipelines.missing = missing;
    if pipelines.noise.is_none() {
        let image = noise.and_then(|noise| images.get(&noise.texture));
        pipelines.noise = image.map(array_view);
    }
    if let Some(error) = pipelines.error(&cache, false) {
        error_once!("ray-traced reflections stay off, since their shader failed: {error}");
    }
    if pipelines.features.contains(Features::SURFACE_SHADER)
        && let Some(error) = pipelines.error(&cache, true)
    {
        error_once!(
            "the shader of `ReflectedSurfaceShader` failed, so that reflections show materials without it: {error}"
        );
    }
}

/// Bevy has a single texel, which is no array, without its feature `bluenoise_texture`.
fn array_view(image: &GpuImage) -> TextureView {
    image.texture.create_view(&TextureViewDescriptor {
        label: Some("glint_noise"),
        dimension: Some(TextureViewDimension::D2Array),
        ..default()
    })
}
