//! Tracks which settings have all of their pipelines compiled, so that a view switches over in one frame, and never too early.

use crate::{
    composite, denoise,
    device::{RealTime, WritesInPlace, tracing_app},
    pipelines::Pipelines,
    prepasses::WaitingView,
    rate::{self, RateImages},
    scene::SceneBindings,
    schedule::ReflectionSystems,
    settings::{
        ClampedSettings, RateSettings, RateVariant, ReflectionBackend, ReflectionTechnique, ReflectionView,
        WantsReflections,
    },
    trace::{TraceState, VrsPass},
};
use bevy::{
    app::{App, Plugin},
    ecs::{prelude::*, system::SystemParam},
    platform::collections::HashMap,
    render::{
        Render,
        render_resource::{PipelineCache, TextureFormat},
        view::ExtractedView,
    },
};
use core::{mem, time::Duration};

/// Time for which pipelines of unused settings are tracked. With a shorter time, a camera that replaces another one has to wait;
/// a longer one tracks settings that were only tried out.
const REMEMBERED: Duration = Duration::from_secs(10);

/// Adds the system that requests pipelines.
pub(crate) struct ReadyPlugin;

impl Plugin for ReadyPlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_resource::<KnownSettings>()
            .add_systems(Render, request_pipelines.in_set(ReflectionSystems::RequestPipelines));
    }
}

/// Settings that determine the pipelines of a view.
pub(crate) type PipelineKey = (ReflectionTechnique, [bool; 10], RateVariant, u32);

/// The key of a view's pipelines; other settings can change without a new compilation.
pub(crate) fn pipeline_key(settings: &ClampedSettings, rate: &RateSettings) -> PipelineKey {
    let denoiser = &settings.denoiser;
    let flags = [
        settings.full_resolution_mirrors,
        denoiser.temporal,
        denoiser.blur_radius > 0.0,
        denoiser.half_resolution,
        settings.backend == ReflectionBackend::HardwareVrs,
        settings.has_bounces(),
        settings.reuses_screen(),
        settings.marches_screen(),
        settings.denoises_in_one_pass(),
        settings.follows_light(),
    ];
    (settings.technique, flags, rate.variant.clone(), rate.tile_size)
}

/// Settings that cameras have or had lately, and their frame format.
struct Known {
    settings: ClampedSettings,
    rate: RateSettings,
    format: TextureFormat,
    /// Everything is compiled.
    is_ready: bool,
    /// A camera has them in this frame. Others get no variants for new features.
    is_used: bool,
    /// Time since a camera had them.
    unused: Duration,
}

/// All such settings, from any view: the first frame of a camera shows reflections if another one has shown them.
#[derive(Resource, Default)]
struct KnownSettings(HashMap<PipelineKey, Known>);

impl KnownSettings {
    fn note(&mut self, settings: &ClampedSettings, rate: &RateSettings, format: Option<TextureFormat>) {
        let known = self.0.entry(pipeline_key(settings, rate));
        let known = known.or_insert_with(|| Known {
            settings: *settings,
            rate: rate.clone(),
            // All cameras that reflect are HDR.
            format: TextureFormat::Rgba16Float,
            is_ready: false,
            is_used: true,
            unused: Duration::ZERO,
        });
        known.is_used = true;
        known.unused = Duration::ZERO;
        known.format = format.unwrap_or(known.format);
    }
}

/// Checks which settings views can start with.
#[derive(SystemParam)]
pub struct Readiness<'w> {
    known: Res<'w, KnownSettings>,
    trace: Option<Res<'w, TraceState>>,
}

impl Readiness<'_> {
    /// Returns whether reflections are complete, with no shaders of missing features being compiled.
    pub(crate) fn is_complete(&self) -> bool {
        self.trace.as_ref().is_none_or(|trace| trace.is_complete())
    }

    /// Returns whether all pipelines for such settings were compiled at the last request.
    pub(crate) fn is_ready(&self, settings: &ClampedSettings, rate: &RateSettings) -> bool {
        let known = self.known.0.get(&pipeline_key(settings, rate));
        known.is_some_and(|known| known.is_ready)
    }
}

/// Pipelines of all passes that a view waits for.
#[derive(SystemParam)]
struct AllPipelines<'w> {
    pipelines: ResMut<'w, Pipelines>,
    trace: ResMut<'w, TraceState>,
    rate_images: ResMut<'w, RateImages>,
    vrs: VrsPass<'w>,
    scene: Res<'w, SceneBindings>,
    in_place: Res<'w, WritesInPlace>,
    cache: Res<'w, PipelineCache>,
}

impl AllPipelines<'_> {
    /// Requests the pipelines of a view.
    fn request(&mut self, known: &Known) {
        let Known {
            settings, rate, format, ..
        } = known;
        self.trace.request(settings);
        let variants = rate::variants(rate)
            .chain(denoise::variants(
                settings,
                self.scene.knows_motions(),
                self.trace.has_changes(),
            ))
            .chain(composite::variants(settings, *format, *self.in_place, &self.scene));
        self.pipelines.want(&self.cache, variants);
    }

    /// Returns whether all pipelines of a view are compiled.
    fn are_ready(&mut self, known: &Known) -> bool {
        let Known {
            settings, rate, format, ..
        } = known;
        let needed = rate::needed(rate)
            .chain(denoise::needed(settings))
            .chain(composite::needed(settings, *format, *self.in_place));
        let vrs_request = || self.trace.vrs_request(&self.pipelines, &self.scene);
        self.vrs.is_ready(settings, &self.cache, vrs_request)
            && self.trace.is_ready(&self.pipelines, &self.cache, settings)
            && self.pipelines.are_compiled(&self.cache, needed)
    }
}

/// Requests the pipelines of all settings and records which of them views can start with.
fn request_pipelines(
    wanting: Query<(&WantsReflections, Option<&ExtractedView>, Option<&WaitingView>)>,
    active: Query<(&ReflectionView, &ExtractedView)>,
    time: Res<RealTime>,
    mut pipelines: AllPipelines,
    mut known: ResMut<KnownSettings>,
) {
    if wanting.iter().all(|(_, view, _)| view.is_none()) {
        return;
    }
    for (wants, view, waiting) in &wanting {
        // Until the view is HDR, Bevy's pipelines for it come first.
        if waiting.is_some_and(|waiting| waiting.gets_hdr) {
            continue;
        }
        known.note(&wants.settings, &wants.rate, view.map(|view| view.target_format));
        pipelines.rate_images.request(&wants.rate);
    }
    // While other settings are compiled, views keep theirs.
    for (active, view) in &active {
        known.note(&active.settings, &active.rate, Some(view.target_format));
        pipelines.rate_images.request(&active.rate);
    }
    known.0.retain(|_, known| {
        let is_used = known.unused <= REMEMBERED;
        known.unused += time.delta();
        is_used
    });
    for known in known.0.values_mut() {
        if mem::take(&mut known.is_used) {
            pipelines.request(known);
        }
        known.is_ready = pipelines.are_ready(known);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{RayTracedReflections, ShadingRateHeuristic};
    use bevy::platform::collections::HashSet;

    /// All combinations of the settings that change passes.
    fn all_settings() -> impl Iterator<Item = RayTracedReflections> {
        let switches = (0..1u32 << 7).map(|bits| move |bit: u32| bits & (1 << bit) != 0);
        switches.flat_map(|is_set| {
            ReflectionTechnique::ALL.map(|technique| {
                let mut reflections = RayTracedReflections {
                    technique,
                    full_resolution_mirrors: is_set(0),
                    max_bounces: if is_set(1) { 2 } else { 1 },
                    ..Default::default()
                };
                let denoiser = &mut reflections.denoiser;
                denoiser.temporal = is_set(2);
                denoiser.half_resolution = is_set(3);
                denoiser.blur_radius = if is_set(4) { 3.0 } else { 0.0 };
                denoiser.converge_static_views = is_set(5);
                denoiser.follow_light_changes = is_set(6);
                reflections
            })
        })
    }

    #[test]
    fn settings_with_other_pipelines_have_other_keys() {
        let format = TextureFormat::Rgba16Float;
        let mut pipelines_of = HashMap::<PipelineKey, HashSet<String>>::default();
        for reflections in all_settings() {
            let settings = ClampedSettings::from(&reflections);
            let rate = RateSettings::new(&ShadingRateHeuristic::default(), settings.technique);
            let variants = rate::variants(&rate)
                .chain(denoise::variants(&settings, true, true))
                .chain(composite::needed(&settings, format, WritesInPlace::NEVER));
            let names: HashSet<_> = variants.map(|variant| format!("{variant:?}")).collect();
            let others = pipelines_of
                .entry(pipeline_key(&settings, &rate))
                .or_insert_with(|| names.clone());
            assert_eq!(*others, names, "{reflections:?}");
        }
    }
}
