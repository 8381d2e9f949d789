//! Which views have all that they need compiled: a view switches over in one frame, and never too early.

use crate::{
    composite::CompositePipelines,
    denoise::DenoisePipelines,
    device::{WritesInPlace, tracing_app},
    rate::RatePipelines,
    schedule::ReflectionSystems,
    settings::{ClampedSettings, RateSettings, RateVariant, ReflectionBackend, ReflectionTechnique, WantsReflections},
    trace::{TracePipelines, VrsPass},
};
use bevy::{
    app::{App, Plugin},
    asset::AssetId,
    ecs::{
        entity::{EntityHashMap, EntityHashSet},
        prelude::*,
        system::SystemParam,
    },
    image::Image,
    pbr::{
        MeshPipelineKey, ViewKeyCache,
        deferred::{DeferredLightingLayout, prepare_deferred_lighting_pipelines},
    },
    render::{
        Render, RenderSystems,
        render_resource::{PipelineCache, SpecializedRenderPipelines},
        view::ExtractedView,
    },
};

/// Adds the systems that ask for pipelines.
pub(crate) struct ReadyPlugin;

impl Plugin for ReadyPlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_resource::<WarmLighting>()
            .init_resource::<ReadyViews>()
            .add_systems(
                Render,
                (
                    request_pipelines.in_set(ReflectionSystems::RequestPipelines),
                    warm_lighting
                        .after(prepare_deferred_lighting_pipelines)
                        .in_set(RenderSystems::Prepare),
                ),
            );
    }
}

/// Settings that decide which pipelines a view needs.
pub(crate) type PipelineKey = (ReflectionTechnique, [bool; 8], RateVariant, Option<AssetId<Image>>, u32);

/// The key of a view's pipelines; other settings can change without a new compilation.
pub(crate) fn pipeline_key(settings: &ClampedSettings, rate: &RateSettings) -> PipelineKey {
    let denoiser = &settings.denoiser;
    let flags = [
        settings.full_resolution_mirrors,
        denoiser.temporal,
        denoiser.blur_radius > 0.0,
        settings.backend == ReflectionBackend::HardwareVrs,
        settings.has_bounces(),
        settings.reuses_screen(),
        settings.marches_screen(),
        settings.denoises_in_one_pass(),
    ];
    let image = rate.image.as_ref().map(|image| image.id());
    (settings.technique, flags, rate.variant.clone(), image, rate.tile_size)
}

/// Views for which everything is compiled, and for which settings.
#[derive(Resource, Default)]
struct ReadyViews(EntityHashMap<PipelineKey>);

/// Views for which Bevy has compiled the lighting that leaves out environment specular. Switching a view over earlier would
/// leave it unlit until the compiler is done.
#[derive(Resource, Default)]
struct WarmLighting(EntityHashSet);

/// Tells which views can start.
#[derive(SystemParam)]
pub struct Readiness<'w> {
    views: Res<'w, ReadyViews>,
    warm: Res<'w, WarmLighting>,
}

impl Readiness<'_> {
    /// A view can be traced with such settings. `active`: it is traced already, perhaps with others.
    pub(crate) fn is_ready(&self, view: Entity, key: &PipelineKey, active: bool) -> bool {
        self.views.0.get(&view) == Some(key) && (active || self.warm.0.contains(&view))
    }
}

/// Pipelines of all passes that a view waits for.
#[derive(SystemParam)]
struct AllPipelines<'w> {
    trace: ResMut<'w, TracePipelines>,
    rates: ResMut<'w, RatePipelines>,
    denoise: ResMut<'w, DenoisePipelines>,
    composite: ResMut<'w, CompositePipelines>,
    vrs: VrsPass<'w>,
    in_place: Res<'w, WritesInPlace>,
    cache: Res<'w, PipelineCache>,
}

impl AllPipelines<'_> {
    /// Asks for what a view needs. Returns whether all of that is compiled.
    fn request(&mut self, wants: &WantsReflections, view: &ExtractedView) -> bool {
        let WantsReflections { settings, rate } = wants;
        let (format, in_place) = (view.target_format, *self.in_place);
        let vrs_is_ready = self.vrs.is_ready(settings, &self.trace, &self.cache);
        self.trace.request(settings);
        self.rates.request(rate);
        self.denoise.request(settings);
        self.composite.request(settings, format, in_place);
        vrs_is_ready
            && self.trace.is_ready(&self.cache, settings)
            && self.rates.is_ready(&self.cache, rate)
            && self.denoise.is_ready(&self.cache, settings)
            && self.composite.is_ready(&self.cache, settings, format, in_place)
    }
}

/// Asks for the pipelines of all views and notes which of them can start.
fn request_pipelines(
    views: Query<(Entity, &WantsReflections, &ExtractedView)>,
    mut pipelines: AllPipelines,
    mut ready: ResMut<ReadyViews>,
) {
    ready.0.clear();
    for (entity, wants, view) in &views {
        if pipelines.request(wants, view) {
            ready.0.insert(entity, pipeline_key(&wants.settings, &wants.rate));
        }
    }
}

/// Has Bevy compile the lighting without environment specular before a view switches over to it.
fn warm_lighting(
    views: Query<(Entity, &ExtractedView), With<WantsReflections>>,
    keys: Res<ViewKeyCache>,
    layout: Res<DeferredLightingLayout>,
    mut pipelines: ResMut<SpecializedRenderPipelines<DeferredLightingLayout>>,
    cache: Res<PipelineCache>,
    mut warm: ResMut<WarmLighting>,
) {
    warm.0.clear();
    for (entity, view) in &views {
        let Some(&key) = keys.get(&view.retained_view_entity) else {
            continue;
        };
        let key = key | MeshPipelineKey::SCREEN_SPACE_REFLECTIONS;
        let pipeline = pipelines.specialize(&cache, &layout, key);
        if cache.get_render_pipeline(pipeline).is_some() {
            warm.0.insert(entity);
        }
    }
}
