//! Reads the settings of cameras and decides which views can trace.

use super::{
    hook::{HookOfAView, OursOfAView, left_out},
    problems::{Problem, Warnings},
};
use crate::{
    deferred::is_deferred,
    device::RealTime,
    prepasses::WaitingView,
    ready::Readiness,
    settings::{
        ClampedSettings, LightingHook, PrepassRequest, RateSettings, RayTracedReflections, ReflectionBackend,
        ReflectionDebugCounters, ReflectionDebugSplit, ReflectionDebugView, ReflectionEffort, ReflectionGuides,
        ReflectionRetention, ReflectionTechnique, ReflectionView, ShadingRateHeuristic, ShadingRateTileSize, ViewDebug,
        WantsReflections,
    },
    status::ReflectionStatus,
    targets::LARGEST_TRACE_SIZE,
    trace::{Fallbacks, VrsPass, choose},
    view::{ReflectionTextures, RefusedViews, ViewCulling},
};
use bevy::{
    camera::{Camera, Hdr, MainPassResolutionOverride, Projection},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    ecs::{
        entity::{EntityHashMap, EntityHashSet},
        name::NameOrEntity,
        prelude::*,
        query::{QueryData, QueryState},
        system::SystemParam,
    },
    math::UVec2,
    pbr::ScreenSpaceReflections,
    render::{MainWorld, renderer::RenderDevice, sync_world::RenderEntity, view::Msaa},
};
use core::{mem, time::Duration};

/// The components of a camera that extraction reads.
#[derive(QueryData)]
#[query_data(mutable)]
pub(super) struct CameraQuery {
    entity: Entity,
    label: NameOrEntity,
    render_entity: RenderEntity,
    camera: &'static Camera,
    reflections: Option<&'static mut RayTracedReflections>,
    heuristic: Option<&'static ShadingRateHeuristic>,
    tile_size: Option<&'static ShadingRateTileSize>,
    effort: Option<&'static ReflectionEffort>,
    hdr: Has<Hdr>,
    depth: Has<DepthPrepass>,
    deferred: Has<DeferredPrepass>,
    normal: Has<NormalPrepass>,
    motion: Has<MotionVectorPrepass>,
    request: Option<&'static mut PrepassRequest>,
    screen_space: Has<ScreenSpaceReflections>,
    msaa: Option<&'static Msaa>,
    debug_view: Option<&'static ReflectionDebugView>,
    debug_split: Option<&'static ReflectionDebugSplit>,
    debug_counters: Has<ReflectionDebugCounters>,
    guides: Has<ReflectionGuides>,
    resolution: Option<&'static MainPassResolutionOverride>,
    projection: Option<&'static Projection>,
}

impl CameraQueryItem<'_, '_> {
    /// Returns whether its view has everything that the hook in Bevy's lighting needs, whether it reflects or not.
    fn can_have_hook(&self) -> bool {
        let has_prepasses = self.depth && self.deferred && self.normal;
        has_prepasses && self.hdr && !self.screen_space && self.msaa.is_none_or(|msaa| *msaa == Msaa::Off)
    }

    /// Returns whether its target has pixels. A minimised window has none.
    fn has_pixels(&self) -> bool {
        self.camera
            .physical_target_size()
            .is_some_and(|size| size.cmpgt(UVec2::ZERO).all())
    }

    /// Returns whether the camera waits for its prepasses, while Bevy compiles what it shows.
    fn awaits_prepasses(&self) -> bool {
        self.request.is_some() && !(self.hdr && self.depth && self.deferred && self.normal)
    }

    /// All problems, each with whether the camera has it.
    fn problems(&self, forward: bool, reflections: &RayTracedReflections, limits: &mut Limits) -> [(Problem, bool); 8] {
        let waits = self.awaits_prepasses();
        [
            (Problem::ScreenSpace, self.screen_space),
            (Problem::Prepass, !(waits || self.depth && self.deferred && self.normal)),
            (Problem::LowRange, !waits && !self.hdr),
            (
                Problem::Multisampling,
                !waits && self.msaa.is_some_and(|msaa| *msaa != Msaa::Off),
            ),
            (
                Problem::TooLarge,
                !fits(self.size(), reflections.technique, limits.most_texels()),
            ),
            (Problem::NoMemory, limits.refused.contains(self.render_entity)),
            (Problem::Forward, forward && !reflections.forward),
            (
                Problem::ShortRays,
                self.projection
                    .is_some_and(|projection| has_short_rays(projection, reflections)),
            ),
        ]
    }

    fn debug(&self) -> ViewDebug {
        ViewDebug::new(self.debug_view, self.debug_split, self.debug_counters)
    }

    /// Rendered pixels; zero if unknown.
    fn size(&self) -> UVec2 {
        let viewport = self.camera.physical_viewport_size().unwrap_or_default();
        self.resolution
            .map_or(viewport, |resolution| resolution.0.min(viewport))
    }
}

/// Limits of the device, and the retention of unused resources.
#[derive(SystemParam)]
pub(super) struct Limits<'w> {
    device: Res<'w, RenderDevice>,
    refused: ResMut<'w, RefusedViews>,
    time: Res<'w, RealTime>,
    retention: ResMut<'w, ReflectionRetention>,
}

impl Limits<'_> {
    fn most_texels(&self) -> u32 {
        self.device.limits().max_texture_dimension_2d
    }
}

/// Returns whether a view of this size can be traced, given the maximum texture size of the device.
fn fits(size: UVec2, technique: ReflectionTechnique, most_texels: u32) -> bool {
    let most_trace_pixels = match technique {
        ReflectionTechnique::Converged => most_texels,
        // Hits take two texels in each direction.
        _ => LARGEST_TRACE_SIZE.min(most_texels / 2),
    };
    size.max_element().div_ceil(technique.trace_scale()) <= most_trace_pixels
}

/// Returns whether the projection reaches farther than rays of the default length. Another length is the app's choice, and an infinite
/// projection says nothing about the scene.
fn has_short_rays(projection: &Projection, reflections: &RayTracedReflections) -> bool {
    let far = projection.far();
    let length = RayTracedReflections::default().max_ray_length;
    reflections.max_ray_length == length && far > length && far.is_finite()
}

/// A view of the render world that extraction might have to change.
#[derive(QueryData)]
#[query_data(mutable)]
pub(super) struct ExistingView {
    entity: Entity,
    active: Option<&'static mut ReflectionView>,
    culling: Option<&'static mut ViewCulling>,
    wants: Has<WantsReflections>,
    has_textures: Has<ReflectionTextures>,
    has_hook: Has<LightingHook>,
    waiting: Option<&'static mut WaitingView>,
}

type IsOurs = Or<(
    With<ReflectionView>,
    With<WantsReflections>,
    With<ReflectionTextures>,
    With<LightingHook>,
    With<WaitingView>,
)>;

/// State that extraction keeps from frame to frame.
#[derive(Default)]
pub(super) struct ExtractionState {
    query: Option<QueryState<CameraQuery>>,
    warnings: Warnings,
    fallbacks: Fallbacks,
    /// Views of inactive cameras, with the time since they were active.
    idle: EntityHashMap<Duration>,
}

/// Results for all cameras of one frame.
#[derive(Default)]
struct Findings {
    /// Views of the render world that might reflect.
    wanting: EntityHashSet,
    /// Views of the render world that have the hook, or can keep it since nothing is drawn into them.
    hooked: EntityHashSet,
    /// Views with screen-space reflections, which need all components of the hook except ours.
    screen_space: EntityHashSet,
    /// Views of inactive cameras.
    idle: EntityHashSet,
    /// Views with a camera that waits for its prepasses.
    incomplete: EntityHashSet,
    /// Cameras of the main world with the component.
    present: EntityHashSet,
    waiting: usize,
    active_backends: Vec<(Entity, ReflectionBackend)>,
    declined: Vec<(Entity, &'static str)>,
    culled_views: usize,
}

/// Clamped settings of a camera, with the back end that traces its rays.
#[derive(Clone)]
struct Request {
    settings: ClampedSettings,
    rate: RateSettings,
}

impl Request {
    /// Also returns the reason why another pass than the requested one traces the rays.
    fn new(camera: &CameraQueryItem, reflections: &RayTracedReflections, vrs: &VrsPass) -> (Self, Option<String>) {
        let mut settings = ClampedSettings::from(reflections);
        let heuristic = camera.heuristic.cloned().unwrap_or_default();
        let tile_size = camera.tile_size.copied().unwrap_or_default().trace_pixels();
        let reason = choose(&mut settings, vrs.fragment_rays(), || vrs.available(tile_size));
        let mut rate = RateSettings::new(&heuristic, settings.technique);
        if camera.tile_size.is_some() || settings.backend == ReflectionBackend::HardwareVrs {
            rate.tile_size = tile_size;
        }
        let has_motion = camera.motion || camera.awaits_prepasses();
        settings.separate_denoiser = camera.debug().views().any(|view| view.shows_reconstruction()) || !has_motion;
        if let Some(effort) = camera.effort {
            effort.apply(&mut settings, &mut rate);
        }
        if settings.backend == ReflectionBackend::HardwareVrs {
            rate.limit(|code| vrs.supports(code));
        }
        (Self { settings, rate }, reason)
    }

    /// Returns whether the view has other settings now.
    fn differs_from(&self, active: Option<&ReflectionView>) -> bool {
        active.is_none_or(|view| view.settings != self.settings || view.rate != self.rate)
    }
}

/// Tells a camera that waits for its prepasses what its view has compiled. Returns false if there is no such view.
fn hand_over(camera: &mut CameraQueryItem, existing: &Query<ExistingView, IsOurs>) -> bool {
    let waiting = existing.get(camera.render_entity).ok().and_then(|view| view.waiting);
    let waiting = waiting.filter(|waiting| !waiting.is_over);
    let (Some(waiting), Some(request)) = (waiting, &mut camera.request) else {
        return false;
    };
    request.is_warm = waiting.is_warm;
    request.compiles = waiting.compiles;
    true
}

/// The extraction of one frame.
struct Extraction<'w, 's> {
    readiness: Readiness<'w>,
    commands: Commands<'w, 's>,
    found: Findings,
}

impl Extraction<'_, '_> {
    /// Makes the lighting of a view omit the light that these settings replace.
    fn hook(&mut self, view: Entity, shown: Option<&ClampedSettings>) {
        self.found.hooked.insert(view);
        let hook = (LightingHook::default(), left_out(shown));
        self.commands.entity(view).insert(hook);
    }

    /// Requests the pipelines of a view.
    fn request(&mut self, view: Entity, request: Request, is_ready: bool) -> EntityCommands<'_> {
        self.found.waiting += usize::from(!is_ready);
        let Request { settings, rate } = request;
        let mut view = self.commands.entity(view);
        view.insert(WantsReflections { settings, rate });
        view
    }

    /// Requests the same for later. The view might have reflected before it lost a prepass.
    fn suspend(&mut self, view: Entity, request: Request) {
        self.request(view, request, false).remove::<ReflectionView>();
    }

    /// Has Bevy compile the pipelines of a view before its camera gets its prepasses.
    fn await_prepasses(&mut self, camera: &mut CameraQueryItem, existing: &Query<ExistingView, IsOurs>) {
        if !camera.awaits_prepasses() {
            return;
        }
        let view = camera.render_entity;
        self.found.incomplete.insert(view);
        if !hand_over(camera, existing) {
            self.commands.entity(view).insert(WaitingView::new(!camera.hdr));
        }
    }

    /// Applies the settings of a camera to its view. Returns whether the view traces in this frame: a new view keeps Bevy's environment
    /// map until its pipelines are compiled, and an active one its old settings.
    fn update_view(
        &mut self,
        camera: &CameraQueryItem,
        request: Request,
        reset: bool,
        existing: Option<ExistingViewItem>,
    ) -> bool {
        let (mut active, culling) = existing.map_or((None, None), |view| (view.active, view.culling));
        let ready = self.readiness.is_ready(&request.settings, &request.rate);
        let shown = if ready {
            Some(request.settings)
        } else {
            active.as_ref().map(|view| view.settings)
        };
        let debug = camera.debug();
        // Earlier frames don't predict the content of this one, or a debug view shows the output of all passes.
        let invalid = reset
            || debug != ViewDebug::default()
            || request.settings.technique == ReflectionTechnique::Converged
            || request.differs_from(active.as_deref());
        let culled = culling.is_some_and(|mut culling| culling.begin_frame(invalid));

        self.found.culled_views += usize::from(culled);
        let backends = shown.as_ref().map(|settings| (camera.entity, settings.backend));
        self.found.active_backends.extend(backends);
        self.hook(camera.render_entity, shown.as_ref().filter(|_| !culled));
        let mut view = self.request(camera.render_entity, request.clone(), ready);
        if ready {
            let Request { settings, rate } = request;
            view.insert(ReflectionView {
                reset,
                settings,
                rate,
                debug,
                guides: camera.guides,
            });
        } else if let Some(active) = &mut active {
            (active.reset, active.debug, active.guides) = (reset, debug, camera.guides);
        }
        ready || active.is_some()
    }

    /// Removes reflections from views that don't want them any more. Views of inactive cameras keep their textures for a time, unless
    /// memory is short.
    fn retire_views(
        &mut self,
        existing: &mut Query<ExistingView, IsOurs>,
        idle: &mut EntityHashMap<Duration>,
        (delta, kept): (Duration, Duration),
        refused: &mut RefusedViews,
    ) {
        let found = &self.found;
        idle.retain(|view, _| found.idle.contains(view));
        let is_short = refused.take_shortage();
        for view in existing {
            let mut commands = self.commands.entity(view.entity);
            if let Some(mut waiting) = view.waiting
                && !found.incomplete.contains(&view.entity)
                && mem::replace(&mut waiting.is_over, true)
            {
                commands.remove::<WaitingView>();
            }
            if view.has_hook && !found.hooked.contains(&view.entity) {
                if found.screen_space.contains(&view.entity) {
                    commands.remove::<LightingHook>();
                } else {
                    commands.remove::<HookOfAView>();
                }
            }
            if found.wanting.contains(&view.entity) {
                continue;
            }
            if !found.idle.contains(&view.entity) {
                if view.wants || view.has_textures || view.active.is_some() {
                    commands.remove::<(OursOfAView, WantsReflections)>();
                }
                continue;
            }
            let unused = idle.entry(view.entity).or_default();
            *unused = unused.saturating_add(delta);
            if *unused < kept && !is_short {
                commands.remove::<ReflectionView>();
            } else if view.has_textures || view.active.is_some() {
                commands.remove::<OursOfAView>();
                refused.retry();
            }
        }
    }
}

/// Extracts settings, decides whether a view can trace and whether it is culled, and sets the range of roughness for which Bevy's
/// deferred lighting omits environment specular.
pub(super) fn extract_cameras(
    mut main_world: ResMut<MainWorld>,
    readiness: Readiness,
    status: Res<ReflectionStatus>,
    mut existing: Query<ExistingView, IsOurs>,
    vrs: VrsPass,
    mut limits: Limits,
    mut state: Local<ExtractionState>,
    commands: Commands,
) {
    let ExtractionState {
        query,
        warnings,
        fallbacks,
        idle,
    } = &mut *state;
    let retention = main_world.get_resource::<ReflectionRetention>().copied();
    limits.retention.set_if_neq(retention.unwrap_or_default());
    let forward = !main_world.get_resource().is_some_and(is_deferred);
    let query = query.get_or_insert_with(|| main_world.query::<CameraQuery>());
    let mut extraction = Extraction {
        readiness,
        commands,
        found: Findings::default(),
    };
    limits.refused.begin_frame();
    for mut camera in query.iter_mut(&mut main_world) {
        let found = &mut extraction.found;
        if camera.screen_space {
            found.screen_space.insert(camera.render_entity);
        }
        let reflections = camera.reflections.take();
        if reflections.is_some() {
            found.present.insert(camera.entity);
        }
        if !camera.camera.is_active {
            // What was compiled in its last frame, in case it draws every other frame.
            hand_over(&mut camera, &existing);
            found.hooked.insert(camera.render_entity);
            found.idle.extend(reflections.map(|_| camera.render_entity));
            continue;
        }
        extraction.await_prepasses(&mut camera, &existing);
        if camera.can_have_hook() {
            extraction.hook(camera.render_entity, None);
        }
        let Some(mut reflections) = reflections else { continue };
        let problems = camera.problems(forward, &reflections, &mut limits);
        warnings.note(&camera.label, &problems);
        let fatal = problems
            .iter()
            .find(|(problem, is_present)| *is_present && problem.is_fatal());
        if let Some((problem, _)) = fatal {
            extraction.found.declined.push((camera.entity, problem.remedy()));
            continue;
        }
        extraction.found.wanting.insert(camera.render_entity);
        let (request, reason) = Request::new(&camera, &reflections, &vrs);
        fallbacks.note(&camera.label, reason);
        if camera.awaits_prepasses() {
            extraction.suspend(camera.render_entity, request);
            continue;
        }
        let view = existing.get_mut(camera.render_entity).ok();
        let reset = reflections.reset;
        // Without pixels, no frame begins anew.
        if extraction.update_view(&camera, request, reset, view) && reset && camera.has_pixels() {
            reflections.bypass_change_detection().reset = false;
        }
    }
    let times = (limits.time.delta(), limits.retention.0);
    extraction.retire_views(&mut existing, idle, times, &mut limits.refused);
    let is_complete = extraction.readiness.is_complete();
    let Findings {
        wanting,
        present,
        waiting,
        active_backends,
        declined,
        culled_views,
        ..
    } = extraction.found;
    status.update(|report| {
        report.ready = waiting == 0 && !wanting.is_empty() && is_complete;
        report.hardware_vrs = vrs.status();
        report.active_backends = active_backends;
        report.declined = declined;
        report.culled_views = culled_views;
    });
    fallbacks.publish(&present, &status);
    warnings.retain(&present);
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::camera::PerspectiveProjection;

    #[test]
    fn views_that_no_list_or_texture_could_hold_are_declined() {
        use ReflectionTechnique::{Converged, Quarter, Reference};
        let fits_in = |most_texels, technique, width| fits(UVec2::new(width, 9), technique, most_texels);
        for (technique, most_texels, widest) in [
            (Reference, 16_384, 8_192),
            (Reference, 32_768, 8_192),
            (Reference, 8_192, 4_096),
            (Quarter, 16_384, 16_384),
            (Quarter, 32_768, 16_384),
            (Converged, 16_384, 16_384),
        ] {
            assert!(fits_in(most_texels, technique, widest), "{technique:?}");
            assert!(!fits_in(most_texels, technique, widest + 1), "{technique:?}");
        }
        assert!(fits(UVec2::ZERO, Reference, 16_384), "its size isn't known yet");
    }

    #[test]
    fn rays_are_short_if_only_the_projection_was_adapted_to_the_world() {
        let is_short = |far, max_ray_length| {
            let projection = Projection::Perspective(PerspectiveProjection {
                far,
                ..Default::default()
            });
            let reflections = RayTracedReflections {
                max_ray_length,
                ..Default::default()
            };
            has_short_rays(&projection, &reflections)
        };
        assert!(is_short(100_000.0, 10_000.0), "centimetres");
        assert!(!is_short(100_000.0, 100_000.0), "adapted");
        assert!(!is_short(100_000.0, 20.0), "the app wants short ones");
        assert!(!is_short(1000.0, 10_000.0), "Bevy's default");
        assert!(!is_short(f32::INFINITY, 10_000.0), "no limit");
    }
}
