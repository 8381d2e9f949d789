//! From the cameras of the main world to the views of the render world.

use crate::{
    composite::CompositePipelines,
    debug::{DebugCounters, DebugSplit, DebugView, ViewDebug},
    denoise::DenoisePipelines,
    idle::ViewActivity,
    rate::{RatePipelines, RateSettings, RateTileSize, ShadingRateHeuristic},
    scene::environment::ViewEnvironment,
    settings::{Backend, RayTracedReflections, SafeSettings, Technique},
    status::ReflectionStatus,
    trace::{
        TracePipelines,
        back_end::{Fallbacks, choose},
        hardware::HardwareTracer,
    },
    view::ReflectionTextures,
};
use bevy::{
    camera::{Camera, Hdr},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, NormalPrepass},
    ecs::{
        entity::{EntityHashMap, EntityHashSet},
        prelude::*,
        query::{QueryData, QueryState},
    },
    log::warn,
    math::{Mat4, UVec4, Vec4},
    pbr::{
        DefaultOpaqueRendererMethod, MeshPipelineKey, ScreenSpaceReflections, ScreenSpaceReflectionsPipelineId,
        ScreenSpaceReflectionsUniform, ViewKeyCache, ViewScreenSpaceReflectionsUniformOffset,
        deferred::DeferredLightingLayout,
    },
    platform::collections::HashSet,
    reflect::PartialReflect,
    render::{
        MainWorld,
        render_resource::{PipelineCache, SpecializedRenderPipelines},
        sync_world::RenderEntity,
        view::{ExtractedView, Msaa},
    },
    transform::components::GlobalTransform,
};

/// A view that traces reflections, in the render world.
#[derive(Component, Clone, Debug)]
pub struct ReflectionView {
    pub(crate) settings: SafeSettings,
    pub(crate) rate: RateSettings,
    /// History must be forgotten.
    pub(crate) reset: bool,
    pub(crate) debug: ViewDebug,
}

/// A view whose camera asks for reflections, whether they can be traced yet or not.
#[derive(Component)]
pub struct WantsReflections {
    settings: SafeSettings,
    rate: RateSettings,
}

impl WantsReflections {
    /// The hardware back end traces its rays, or will once it can.
    pub(crate) fn uses_hardware(&self) -> bool {
        self.settings.backend == Backend::Hardware
    }
}

type PipelineKey = (Technique, [bool; 4], RateSettings);

/// Decides which pipelines a view needs; other settings can change without a new compilation.
fn pipeline_key(settings: &SafeSettings, rate: &RateSettings) -> PipelineKey {
    let denoiser = &settings.denoiser;
    let rate = RateSettings {
        thresholds: Vec4::ZERO,
        options: UVec4::ZERO,
        ..rate.clone()
    };
    let flags = [
        settings.full_resolution_mirrors,
        denoiser.temporal,
        denoiser.blur_radius > 0.0,
        settings.backend == Backend::Hardware,
    ];
    (settings.technique, flags, rate)
}

/// Views for which everything is compiled, and for which settings.
#[derive(Resource, Default)]
pub struct ReadyViews(EntityHashMap<PipelineKey>);

/// Views for which Bevy has compiled the lighting that leaves out environment specular. Switching a view over earlier would
/// leave it unlit until the compiler is done.
#[derive(Resource, Default)]
pub struct WarmLighting(EntityHashSet);

/// What a reflecting view holds of ours.
type OursOfAView = (ReflectionView, ReflectionTextures, ViewActivity);

/// The above, and what we borrow from Bevy's screen-space reflections; the environment's specular term comes back with its
/// removal.
pub(crate) type AllOfAView = (
    ReflectionView,
    ReflectionTextures,
    ViewActivity,
    ScreenSpaceReflectionsUniform,
    ViewScreenSpaceReflectionsUniformOffset,
    ScreenSpaceReflectionsPipelineId,
);

/// What extraction reads of a camera.
#[derive(QueryData)]
#[query_data(mutable)]
pub struct CameraQuery {
    entity: Entity,
    render_entity: RenderEntity,
    camera: &'static Camera,
    reflections: Option<&'static mut RayTracedReflections>,
    heuristic: Option<&'static ShadingRateHeuristic>,
    tile_size: Option<&'static RateTileSize>,
    transform: &'static GlobalTransform,
    hdr: Has<Hdr>,
    depth: Has<DepthPrepass>,
    deferred: Has<DeferredPrepass>,
    normal: Has<NormalPrepass>,
    screen_space: Has<ScreenSpaceReflections>,
    msaa: Option<&'static Msaa>,
    debug_view: Option<&'static DebugView>,
    debug_split: Option<&'static DebugSplit>,
    debug_counters: Has<DebugCounters>,
}

/// Why a camera shows no reflections, or few.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Problem {
    ScreenSpace,
    Prepass,
    LowRange,
    Multisampling,
    Forward,
}

impl Problem {
    fn remedy(self) -> &'static str {
        match self {
            Self::ScreenSpace => {
                "it shows no ray-traced reflections, since it also has `ScreenSpaceReflections`, which use the same hook in \
                 Bevy's lighting: remove one of the two"
            }
            Self::Prepass => {
                "it shows no ray-traced reflections, since it lacks the `DepthPrepass`, the `DeferredPrepass` or the \
                 `NormalPrepass`: insert them"
            }
            Self::LowRange => {
                "it shows no ray-traced reflections, since without `Hdr` colours are tone-mapped before anything can be \
                 added: insert `Hdr`"
            }
            Self::Multisampling => {
                "it shows no ray-traced reflections, since deferred rendering can't do multisampling: set `Msaa::Off`"
            }
            Self::Forward => {
                "only materials whose `opaque_render_method` is `Deferred` reflect: for all opaque materials, insert the \
                 resource `DefaultOpaqueRendererMethod::deferred()`"
            }
        }
    }
}

/// What was true of a camera in the last frame.
#[derive(Clone, PartialEq)]
pub struct CameraState {
    world_from_view: Mat4,
    clip_from_view: Mat4,
    settings: SafeSettings,
    environment: Option<ViewEnvironment>,
}

/// What extraction remembers.
#[derive(Default)]
pub struct ExtractionState {
    query: Option<QueryState<CameraQuery>>,
    cameras: EntityHashMap<CameraState>,
    warned: HashSet<(Entity, Problem)>,
    fallbacks: Fallbacks,
}

/// The range of roughness whose environment specular Bevy's lighting leaves out: none for a view at rest, which replaces nothing.
/// Only numbers change: without the uniform Bevy would switch to other pipelines.
fn left_out(settings: &SafeSettings, resting: bool) -> ScreenSpaceReflectionsUniform {
    let greatest = if resting { -1.0 } else { settings.cutoff };
    ScreenSpaceReflectionsUniform::from(ScreenSpaceReflections {
        min_perceptual_roughness: 0.0..0.0,
        max_perceptual_roughness: greatest..greatest,
        ..Default::default()
    })
}

/// Mirrors settings, decides whether a view may trace and whether it rests, and hands Bevy's deferred lighting the range of
/// roughness whose environment specular we replace.
///
/// Bevy leaves that term out for views that carry the uniform of its screen-space reflections; we give it ours, and
/// [`drop_ssr_pass`](crate::trace::drop_ssr_pass) keeps the screen-space pass itself from running.
pub fn extract_cameras(
    mut main_world: ResMut<MainWorld>,
    ready_views: Res<ReadyViews>,
    status: Res<ReflectionStatus>,
    warm: Res<WarmLighting>,
    mut existing: Query<
        (
            Entity,
            Option<&ReflectionView>,
            Option<&ViewEnvironment>,
            Option<&mut ViewActivity>,
        ),
        Or<(With<ReflectionView>, With<WantsReflections>)>,
    >,
    hardware: HardwareTracer,
    mut state: Local<ExtractionState>,
    mut commands: Commands,
) {
    let ExtractionState {
        query,
        cameras,
        warned,
        fallbacks,
    } = &mut *state;
    let deferred = DefaultOpaqueRendererMethod::deferred();
    let forward = main_world
        .get_resource::<DefaultOpaqueRendererMethod>()
        .is_none_or(|method| method.reflect_partial_eq(&deferred) != Some(true));
    let query = query.get_or_insert_with(|| main_world.query::<CameraQuery>());
    let mut wanting = EntityHashSet::default();
    let mut present = EntityHashSet::default();
    let mut all_ready = true;
    let mut active_backends = Vec::new();
    let mut resting_views = 0;
    for mut camera in query.iter_mut(&mut main_world) {
        let Some(reflections) = camera.reflections.as_mut() else {
            continue;
        };
        present.insert(camera.entity);
        if !camera.camera.is_active {
            continue;
        }
        let problems = [
            (Problem::ScreenSpace, camera.screen_space),
            (Problem::Prepass, !(camera.depth && camera.deferred && camera.normal)),
            (Problem::LowRange, !camera.hdr),
            (
                Problem::Multisampling,
                camera.msaa.is_some_and(|msaa| *msaa != Msaa::Off),
            ),
            (Problem::Forward, forward),
        ];
        for (problem, present) in problems {
            if !present {
                warned.remove(&(camera.entity, problem));
            } else if warned.insert((camera.entity, problem)) {
                warn!("camera {}: {}", camera.entity, problem.remedy());
            }
        }
        if problems
            .iter()
            .any(|(problem, present)| *present && *problem != Problem::Forward)
        {
            if camera.screen_space && existing.contains(camera.render_entity) {
                // The uniform on the view is Bevy's own now.
                commands.entity(camera.render_entity).remove::<OursOfAView>();
                wanting.insert(camera.render_entity);
            }
            continue;
        }
        wanting.insert(camera.render_entity);
        let mut settings = SafeSettings::from(&**reflections);
        let tile_size = camera.tile_size.copied().unwrap_or_default().trace_pixels();
        let (backend, reason) = choose(&settings, || hardware.available(tile_size));
        settings.backend = backend;
        fallbacks.note(camera.entity, reason);
        let (active, environment, activity) = existing
            .get_mut(camera.render_entity)
            .map_or((None, None, None), |(_, view, environment, activity)| {
                (view, environment.cloned(), activity)
            });
        let heuristic = camera.heuristic.cloned().unwrap_or_default();
        let mut rate = RateSettings {
            tile_size,
            ..RateSettings::new(&heuristic, settings.technique)
        };
        if backend == Backend::Hardware {
            rate.limit(|code| hardware.supports(code));
        }
        let ready = ready_views.0.get(&camera.render_entity) == Some(&pipeline_key(&settings, &rate))
            && (active.is_some() || warm.0.contains(&camera.render_entity));
        let shown = if ready {
            Some(&settings)
        } else {
            active.map(|view| &view.settings)
        };
        active_backends.extend(shown.map(|settings| (camera.entity, settings.backend)));
        let debug = ViewDebug::new(camera.debug_view, camera.debug_split, camera.debug_counters);
        // Earlier frames don't tell what this one sees, or somebody looks at what all passes write.
        let disturbed = reflections.reset
            || debug != ViewDebug::default()
            || settings.technique == Technique::Converged
            || active.is_none_or(|view| view.settings != settings || view.rate != rate);
        let resting = activity.is_some_and(|mut activity| activity.begin_frame(disturbed));
        resting_views += usize::from(resting);
        let mut view = commands.entity(camera.render_entity);
        view.insert(WantsReflections {
            settings,
            rate: rate.clone(),
        });
        if let Some(shown) = shown {
            view.insert(left_out(shown, resting));
        }
        if !ready {
            // A new view keeps Bevy's environment map until then, an active one its old settings.
            all_ready = false;
            continue;
        }
        let state = CameraState {
            world_from_view: camera.transform.to_matrix(),
            clip_from_view: camera.camera.clip_from_view(),
            settings,
            environment,
        };
        let changed = cameras.get(&camera.entity) != Some(&state);
        if changed {
            cameras.insert(camera.entity, state);
        }
        let reset = reflections.reset || (changed && settings.technique == Technique::Converged);
        if reflections.reset {
            reflections.bypass_change_detection().reset = false;
        }
        commands.entity(camera.render_entity).insert(ReflectionView {
            settings,
            rate,
            reset,
            debug,
        });
    }
    let ready = all_ready && !wanting.is_empty();
    status.update(|report| {
        report.ready = ready;
        report.hardware_rates = hardware.status();
        report.active_backends = active_backends;
        report.resting_views = resting_views;
    });
    fallbacks.publish(&present, &status);
    cameras.retain(|entity, _| present.contains(entity));
    warned.retain(|(entity, _)| present.contains(entity));
    for (view, active, ..) in &existing {
        if !wanting.contains(&view) {
            let mut view = commands.entity(view);
            view.remove::<WantsReflections>();
            if active.is_some() {
                view.remove::<AllOfAView>();
            }
        }
    }
}

/// Asks for the pipelines of all views and notes which of them can start.
pub fn prepare_pipelines(
    views: Query<(Entity, &WantsReflections)>,
    mut trace: ResMut<TracePipelines>,
    mut rates: ResMut<RatePipelines>,
    mut denoise: ResMut<DenoisePipelines>,
    composite: Res<CompositePipelines>,
    cache: Res<PipelineCache>,
    mut hardware: HardwareTracer,
    mut ready: ResMut<ReadyViews>,
) {
    ready.0.clear();
    for (entity, WantsReflections { settings, rate }) in &views {
        let hardware_is_ready = hardware.is_ready(settings, &trace, &cache);
        trace.request(settings);
        rates.request(rate);
        denoise.request(settings);
        if trace.is_ready(&cache, settings)
            && rates.is_ready(&cache, rate)
            && denoise.is_ready(&cache, settings)
            && composite.are_ready(&cache)
            && hardware_is_ready
        {
            ready.0.insert(entity, pipeline_key(settings, rate));
        }
    }
}

/// Has Bevy compile the lighting without environment specular before a view switches over to it.
pub fn warm_lighting(
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
