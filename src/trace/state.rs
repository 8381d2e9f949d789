//! The passes that views trace rays with, for the features of the scene; and the tables that they read.

use super::{
    blocks::with_kept_rays,
    directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo},
    inline::INLINE,
    kept_rays::KEPT_RAYS,
    plan::{Plan, passes},
    surface_shader::SurfaceShader,
    variant::{Demand, PASSES, features_of},
};
use crate::{
    pipelines::{Options, Pass, Pipelines, Variant},
    scene::{Change, Features, SceneBindings},
    settings::{ClampedSettings, ReflectionView, ReflectionWarmUp},
    vrs::PipelineRequest,
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    pbr::Bluenoise,
    platform::collections::HashSet,
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
    shader::Shader,
    utils::default,
};

/// Number of storage buffers in the pass that shades hits and traces mirror rays: the same as in the pass over the list of rays
/// (`device/support.rs`), plus the other list and light probes.
const JOINED_STORAGE_BUFFERS: u32 = 11;
/// The same with kept rays.
const SHARED_STORAGE_BUFFERS: u32 = JOINED_STORAGE_BUFFERS + 1;

/// Features that the tracing passes are compiled for, and their tables. A GPU resource.
#[derive(Resource)]
pub struct TraceState {
    /// Creates shading-rate attachments.
    attachment_shader: Handle<Shader>,
    /// Table for `albedo.wesl`.
    pub(super) albedo_table: TextureView,
    /// Spatio-temporal blue noise, once its image is loaded.
    pub(super) noise: Option<TextureView>,
    /// Whether the device has enough storage buffers for the pass that shades hits and traces mirror rays.
    can_join: bool,
    /// Whether it has enough of them for kept rays in the passes over blocks.
    can_share: bool,
    /// Demands of settings that wait for their passes.
    wanted: HashSet<Demand>,
    /// Features of the scene and of the app.
    pub(super) features: Features,
    /// Features that the app will need later.
    warm: Features,
    /// Shaders with these features are compiled.
    is_warm: bool,
    missing: Missing,
    /// Version of the scene in the last frame.
    scene: u32,
    /// Number of frames in which it changed, up to [`SOME_CHANGES`].
    changes: u32,
}

/// Number of changes of the scene before rays are kept: their shaders aren't compiled for scenes that appear at once and stay. A higher number
/// lets the first changes lag behind.
const SOME_CHANGES: u32 = 8;

/// Features that the passes of views lack.
#[derive(Clone, Copy, Default, PartialEq)]
struct Missing {
    all: Features,
    /// Missing features with shaders that are being compiled.
    expected: Features,
}

/// Pipelines, and which of them are compiled.
type Compiled<'a> = (&'a Pipelines, &'a PipelineCache);

impl TraceState {
    /// Requests the passes of a view. Call in each frame.
    pub(crate) fn request(&mut self, settings: &ClampedSettings) {
        self.wanted.insert(Demand::of(settings));
    }

    /// The passes that trace the rays of a view in this frame; `None` until they are compiled.
    pub(super) fn plan(&self, demand: Demand, compiled: Compiled) -> Option<Plan> {
        plan(self.features, demand, compiled, |pass| pass)
    }

    /// The same passes with kept rays; `None` until they are compiled with the features that `plan` has.
    pub(super) fn plan_with_kept_rays(&self, demand: Demand, plan: &Plan, compiled: Compiled) -> Option<Plan> {
        let kept = self
            .can_share(demand)
            .then(|| self::plan(self.features, demand, compiled, with_kept_rays));
        kept.flatten().filter(|kept| plan.missing().contains(kept.missing()))
    }

    /// The variant that traces kept rays in a pass of their own; `None` until one is compiled.
    pub(super) fn kept_rays(&self, demand: Demand, (pipelines, cache): Compiled) -> Option<Variant> {
        let wanted = variant(KEPT_RAYS, features_of(KEPT_RAYS, self.features | demand.asked));
        let fit = pipelines.best(cache, &wanted, Features::HARMLESS)?;
        Some(variant(KEPT_RAYS, fit.features))
    }

    /// Features of the scene that the passes of views lack.
    fn missing(&self, features: Features, demands: &HashSet<Demand>, (pipelines, cache): Compiled) -> Missing {
        let mut found = Missing::default();
        for demand in demands {
            let wanted = features | demand.asked;
            let missing = plan(features, *demand, (pipelines, cache), |pass| pass);
            let missing = missing.map_or(Features::all(), Plan::missing);
            found.all |= missing;
            // Waiting for a shader that doesn't compile would never end.
            let mut variants = self.variants(*demand, wanted);
            if !variants.any(|variant| pipelines.has_failed(cache, &variant)) {
                found.expected |= missing;
            }
        }
        found
    }

    /// The passes for a view in a scene with these features.
    fn variants(&self, demand: Demand, wanted: Features) -> impl Iterator<Item = Variant> + use<> {
        passes(demand, wanted, self.can_join).map(move |pass| variant(pass, features_of(pass, wanted)))
    }

    /// Requests shaders that the app will need later. In scenes with few lights, variants that sample lights don't work.
    fn warm_up(&mut self, demands: &HashSet<Demand>, pipelines: &mut Pipelines, cache: &PipelineCache) {
        let warm = (self.features - Features::SURFACE_SHADER) | self.warm | Features::MASKED;
        let few = warm - (self.warm & Features::LIGHT_SAMPLING);
        let is_named = !self.warm.is_empty();
        for features in [few, warm].into_iter().filter(|_| is_named) {
            for demand in demands {
                pipelines.want(cache, self.variants(*demand, features | demand.asked));
            }
        }
        let lacks = |features| !self.missing(features, demands, (pipelines, cache)).expected.is_empty();
        self.is_warm = !is_named || !lacks(few) && !lacks(warm);
    }

    /// Returns whether everything that a view's settings need is ready.
    pub(crate) fn is_ready(&self, pipelines: &Pipelines, cache: &PipelineCache, settings: &ClampedSettings) -> bool {
        self.noise.is_some() && self.plan(Demand::of(settings), (pipelines, cache)).is_some()
    }

    /// Returns whether the passes of views have all features of the scene, and of [`ReflectionWarmUp`].
    pub(crate) fn is_complete(&self) -> bool {
        self.missing.expected.is_empty() && self.is_warm
    }

    /// Returns whether kept rays can be traced and shaded among those of blocks.
    fn can_share(&self, demand: Demand) -> bool {
        self.can_share && demand.may_share
    }

    /// The variants that trace kept rays again. If one of the shared passes fails, they get their own.
    fn kept_ray_variants(&self, demand: Demand, (pipelines, cache): Compiled) -> Vec<Variant> {
        let library = self.features - Features::SURFACE_SHADER;
        let all = [library, self.features].map(|features| features | demand.asked);
        let shared = all.into_iter().flat_map(|wanted| {
            let passes = passes(demand, wanted, self.can_join).map(with_kept_rays);
            passes.map(move |pass| variant(pass, features_of(pass, wanted)))
        });
        let shared: Vec<_> = shared.filter(|_| self.can_share(demand)).collect();
        let has_failed = |variant: &Variant| !variant.has_own_code() && pipelines.has_failed(cache, variant);
        if shared.is_empty() || shared.iter().any(has_failed) {
            return all
                .map(|wanted| variant(KEPT_RAYS, features_of(KEPT_RAYS, wanted)))
                .into();
        }
        shared
    }

    /// Returns whether the scene changed in some frames.
    pub(crate) fn has_changes(&self) -> bool {
        self.changes == SOME_CHANGES
    }

    /// Counts the frames in which the scene changes.
    fn count_changes(&mut self, version: u32) {
        let changed = core::mem::replace(&mut self.scene, version) != version;
        self.changes = (self.changes + u32::from(changed)).min(SOME_CHANGES);
    }

    /// The pipeline of the raw Vulkan pass, which works for any scene.
    pub(crate) fn vrs_request(&self, pipelines: &Pipelines, scene: &SceneBindings) -> PipelineRequest {
        let features = Features::MASKED | Features::DEEP_TREES | (Features::OF_VRS & scene.possible_features());
        let variant = INLINE.variant(features, Options::ONE_TLAS);
        PipelineRequest {
            shader: pipelines.module(&variant),
            defs: pipelines.definitions(&variant),
            layouts: pipelines.layouts(&variant),
            attachment_shader: self.attachment_shader.clone(),
        }
    }
}

/// The best passes that are compiled, or of their twins.
fn plan(
    features: Features,
    demand: Demand,
    (pipelines, cache): Compiled,
    twin: fn(&'static Pass) -> &'static Pass,
) -> Option<Plan> {
    Plan::new(demand, features | demand.asked, &|pass, wanted, spare| {
        pipelines.best(cache, &variant(twin(pass), wanted), spare)
    })
}

fn variant(pass: &'static Pass, features: Features) -> Variant {
    pass.variant(features, Options::empty())
}

impl FromWorld for TraceState {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let storage_buffers = device.limits().max_storage_buffers_per_shader_stage;
        Self {
            attachment_shader: load_embedded_asset!(world.resource::<AssetServer>(), "vrs.wesl"),
            albedo_table: create_albedo_table(device, world.resource::<RenderQueue>()),
            noise: None,
            can_join: storage_buffers >= JOINED_STORAGE_BUFFERS,
            can_share: storage_buffers >= SHARED_STORAGE_BUFFERS,
            wanted: HashSet::default(),
            features: Features::MASKED,
            warm: Features::empty(),
            is_warm: true,
            missing: Missing::default(),
            scene: 0,
            changes: 0,
        }
    }
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
    state: Option<ResMut<TraceState>>,
    scene: Option<Res<SceneBindings>>,
) {
    let (Some(mut state), Some(scene)) = (state, scene) else {
        return;
    };
    let named = own.as_ref().map_or(Features::empty(), |own| Features::of_warm_up(own));
    let warm = named & scene.possible_features();
    if state.warm != warm {
        state.warm = warm;
    }
}

/// Requests the passes of all views, with the features of the scene.
pub(crate) fn request_trace_passes(
    (mut state, mut pipelines): (ResMut<TraceState>, ResMut<Pipelines>),
    cache: Res<PipelineCache>,
    mut scene: ResMut<SceneBindings>,
    mut surface_shader: ResMut<SurfaceShader>,
    views: Query<&ReflectionView>,
    noise: Option<Res<Bluenoise>>,
    images: Res<RenderAssets<GpuImage>>,
) {
    let state = &mut *state;
    state.features = scene.features();
    state.features.set(Features::SURFACE_SHADER, surface_shader.is_there());
    if surface_shader.take_change() {
        scene.version.note(Change::Unmarked);
    }
    let failed = PASSES.iter().any(|pass| pipelines.has_errors(&cache, pass));
    // A view that waits for other settings continues with its current ones.
    let mut demands = core::mem::take(&mut state.wanted);
    demands.extend(views.iter().map(|view| Demand::of(&view.settings)));
    for demand in &demands {
        let wanted = state.features | demand.asked;
        let library = wanted - Features::SURFACE_SHADER;
        let plain = (wanted & (Features::MASKED | Features::DEEP_TREES)) | demand.asked;
        // The variant that works for scenes with and without masks comes first.
        let all = [
            Some(library | Features::MASKED),
            Some(library),
            Some(wanted),
            failed.then_some(plain),
        ];
        for features in all.into_iter().flatten() {
            pipelines.want(&cache, state.variants(*demand, features));
        }
    }
    state.count_changes(scene.version.all);
    if state.has_changes() {
        for view in views.iter().filter(|view| view.settings.follows_light()) {
            let kept = state.kept_ray_variants(Demand::of(&view.settings), (&pipelines, &cache));
            pipelines.want(&cache, kept);
        }
    }
    state.warm_up(&demands, &mut pipelines, &cache);
    let missing = state.missing(state.features, &demands, (&pipelines, &cache));
    // Converged views restart, since their accumulated frames have other features.
    if missing.all != state.missing.all {
        scene.version.note(Change::Unmarked);
    }
    state.missing = missing;
    if state.noise.is_none() {
        let image = noise.and_then(|noise| images.get(&noise.texture));
        state.noise = image.map(array_view);
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
