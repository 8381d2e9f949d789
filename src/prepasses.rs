//! Gives cameras what reflections need: HDR, and all prepasses.
//!
//! Both are part of the key of every pipeline that draws into the view, and Bevy doesn't draw objects until their pipelines are compiled.
//! So a camera that already draws gets them later: meanwhile, Bevy specializes the pipelines of everything that it shows for a second view
//! with the new key. That view exists between two systems of each frame, and nothing is drawn into it.

use crate::{
    device::{NoMotionVectors, tracing_app},
    settings::{PrepassRequest, RayTracedReflections, ReflectionQuality},
};
use bevy::{
    app::{App, Plugin, PostUpdate},
    camera::{Camera, Hdr},
    core_pipeline::{
        core_3d::{Opaque3d, check_msaa},
        prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass, Opaque3dPrepass},
    },
    ecs::{entity::EntityHashSet, prelude::*, system::SystemParam},
    log::warn,
    pbr::{
        MeshPipelineKey, SpecializedMaterialPipelineCache, SpecializedPrepassMaterialPipelineCache, ViewKeyCache,
        ViewKeyPrepassCache,
        deferred::{DeferredLightingLayout, insert_deferred_lighting_pass_id_component},
    },
    platform::time::Instant,
    render::{
        Render, RenderSystems,
        batching::gpu_preprocessing::GpuPreprocessingMode,
        camera::{DirtySpecializations, ExtractedCamera, camera_system},
        render_phase::ViewBinnedRenderPhases,
        render_resource::{
            CachedPipelineState, CachedRenderPipelineId, PipelineCache, PipelineDescriptor, SpecializedRenderPipelines,
            TextureFormat,
        },
        renderer::{RenderAdapter, RenderDevice},
        view::{ExtractedView, Msaa, RenderVisibleEntities, RetainedViewEntity},
    },
    shader::ShaderCacheError,
    time::{Real, Time},
};
use core::time::Duration;

/// Time without compilation after which a camera gets its prepasses although some pipelines still wait, such as those of a shader that
/// never loads. A longer time keeps such a camera without reflections for longer. With a shorter one, objects vanish for a while if their
/// shaders load late. Not tuned.
const PATIENCE: Duration = Duration::from_secs(30);
/// Frames for which a pipeline counts as waiting after it lacked its shader. Bevy tries again, which takes three frames or more if its threads
/// are busy: with a lower number, these tries count as compilation. With a higher one, a shader that was late counts as missing for longer.
const RETRY_FRAMES: u32 = 8;
/// Longest wait in the frame in which a camera becomes HDR. A shorter one shows frames without tone mapping or sky on devices that compile
/// slowly: one second was too short on two busy cores without caches. A longer one freezes that frame for longer. Not tuned.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// No other view of a camera has this number.
const AHEAD: u32 = u32::MAX;

pub(crate) struct PrepassesPlugin;

/// Present if the render world reports when pipelines are compiled.
#[derive(Resource)]
struct CompilesAhead;

impl Plugin for PrepassesPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            PostUpdate,
            give_prepasses
                .before(camera_system)
                .before(check_msaa)
                .before(insert_deferred_lighting_pass_id_component),
        );
    }

    fn finish(&self, app: &mut App) {
        let world = app.world();
        let device = world
            .get_resource::<RenderDevice>()
            .zip(world.get_resource::<RenderAdapter>());
        let no_motion = device.and_then(|(device, adapter)| NoMotionVectors::detect(device, adapter));
        if let Some(no_motion) = no_motion {
            app.insert_resource(no_motion);
        }
        let Some(render_app) = tracing_app(app) else { return };
        if let Some(no_motion) = no_motion {
            warn!(
                "cameras get no motion vectors, so that reflections smear or get noisy where objects move: Bevy can't make them on a device \
                 without `TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES`, so add this to the features of `WgpuSettings`"
            );
            render_app.insert_resource(no_motion);
        }
        render_app.add_systems(
            Render,
            (
                look_ahead
                    .after(RenderSystems::PrepareAssets)
                    .before(RenderSystems::PrepareMeshes)
                    .run_if(any_with_component::<WaitingView>),
                note_compiled
                    .after(RenderSystems::Specialize)
                    .before(RenderSystems::PrepareViews)
                    .run_if(any_with_component::<AheadOf>),
                // Others that use the pipelines there only see them earlier.
                finish_switches
                    .after(RenderSystems::Prepare)
                    .before(RenderSystems::Render)
                    .run_if(any_with_component::<WaitingView>)
                    .ambiguous_with_all(),
            ),
        );
        app.insert_resource(CompilesAhead);
    }
}

/// A camera that waits for its prepasses.
type Requesting = (
    Entity,
    &'static mut PrepassRequest,
    Has<RayTracedReflections>,
    Has<ReflectionQuality>,
);
/// What a camera can't trace without. Without motion vectors it can, if the app removed them or the device has none.
type HasAll = (
    With<Hdr>,
    With<DepthPrepass>,
    With<DeferredPrepass>,
    With<NormalPrepass>,
);

/// Gives new cameras their prepasses at once, and those that have already drawn as soon as the pipelines for them are compiled. That goes on
/// only in frames in which they draw.
fn give_prepasses(
    mut cameras: Query<Requesting>,
    complete: Query<(), HasAll>,
    all: Query<(Entity, &Camera)>,
    (ahead, no_motion): (Option<Res<CompilesAhead>>, Option<Res<NoMotionVectors>>),
    time: Option<Res<Time<Real>>>,
    mut drawn: Local<EntityHashSet>,
    mut commands: Commands,
) {
    for (entity, mut request, reflects, has_quality) in &mut cameras {
        let mut commands = commands.entity(entity);
        if complete.contains(entity) || !(reflects || has_quality) {
            commands.try_remove::<PrepassRequest>();
            continue;
        }
        let is_active = all.get(entity).is_ok_and(|(_, camera)| camera.is_active);
        if is_active && !request.compiles {
            request.waited += time.as_ref().map_or(Duration::ZERO, |time| time.delta());
        }
        let draws = drawn.contains(&entity) && ahead.is_some();
        if !draws || request.is_warm || request.waited > PATIENCE {
            commands
                .try_insert_if_new((Hdr, DepthPrepass, DeferredPrepass, NormalPrepass))
                .try_remove::<PrepassRequest>();
            if no_motion.is_none() {
                commands.try_insert_if_new(MotionVectorPrepass);
            }
        }
    }
    // A camera that pauses will draw the same objects again.
    drawn.retain(|camera| all.contains(*camera));
    drawn.extend(
        all.iter()
            .filter(|(_, camera)| camera.is_active)
            .map(|(camera, _)| camera),
    );
}

/// A view of the render world whose camera waits for its prepasses.
#[derive(Component)]
pub(crate) struct WaitingView {
    /// Whether the camera isn't HDR yet.
    pub gets_hdr: bool,
    /// Whether all pipelines are compiled.
    pub is_warm: bool,
    /// Whether some are being compiled, and none of them waits for a shader that isn't loaded.
    pub compiles: bool,
    /// Whether the camera has everything now, or stopped waiting. The component lasts for this one frame then.
    pub is_over: bool,
    /// The key for which they were specialized.
    key: Option<MeshPipelineKey>,
    /// Number of frames since a pipeline lacked its shader.
    since_lack: u32,
}

impl WaitingView {
    pub fn new(gets_hdr: bool) -> Self {
        Self {
            gets_hdr,
            is_warm: false,
            compiles: false,
            is_over: false,
            key: None,
            since_lack: RETRY_FRAMES,
        }
    }

    /// Notes what the pipelines wait for in this frame.
    fn note(&mut self, pending: Pending) {
        self.is_warm = pending == Pending::Nothing;
        self.since_lack = match pending {
            Pending::Shader => 0,
            _ => self.since_lack.saturating_add(1),
        };
        self.compiles = !self.is_warm && self.since_lack >= RETRY_FRAMES;
    }

    /// The key of the view once its camera has everything.
    fn key(&self, now: MeshPipelineKey, has_motion: bool) -> MeshPipelineKey {
        // Bevy draws no deferred materials with multisampling.
        let mut key = now.difference(MeshPipelineKey::MSAA_RESERVED_BITS)
            | MeshPipelineKey::from_msaa_samples(Msaa::Off.samples())
            | MeshPipelineKey::DEPTH_PREPASS
            | MeshPipelineKey::DEFERRED_PREPASS
            | MeshPipelineKey::NORMAL_PREPASS
            // Of the hook in Bevy's lighting.
            | MeshPipelineKey::SCREEN_SPACE_REFLECTIONS;
        key.set(MeshPipelineKey::MOTION_VECTOR_PREPASS, has_motion);
        if self.gets_hdr {
            key.remove(
                MeshPipelineKey::COLOR_TARGET_FORMAT_RESERVED_BITS
                    | MeshPipelineKey::TONEMAP_METHOD_RESERVED_BITS
                    | MeshPipelineKey::TONEMAP_IN_SHADER
                    | MeshPipelineKey::DEBAND_DITHER,
            );
            key |= MeshPipelineKey::from_target_format(TextureFormat::Rgba16Float);
        }
        key
    }
}

/// The second view of a waiting one, with the keys that the latter will have.
#[derive(Component)]
struct AheadOf(Entity);

/// What Bevy specializes pipelines by.
#[derive(SystemParam)]
struct Keys<'w> {
    main: ResMut<'w, ViewKeyCache>,
    prepass: ResMut<'w, ViewKeyPrepassCache>,
    dirty: ResMut<'w, DirtySpecializations>,
    main_phases: ResMut<'w, ViewBinnedRenderPhases<Opaque3d>>,
    prepass_phases: ResMut<'w, ViewBinnedRenderPhases<Opaque3dPrepass>>,
}

impl Keys<'_> {
    /// Adds a view for which the pipelines of new objects are specialized in this frame, or those of all objects.
    fn add(&mut self, view: RetainedViewEntity, key: MeshPipelineKey, all: bool) {
        let of_prepass = MeshPipelineKey::MSAA_RESERVED_BITS
            | MeshPipelineKey::DEPTH_PREPASS
            | MeshPipelineKey::NORMAL_PREPASS
            | MeshPipelineKey::MOTION_VECTOR_PREPASS;
        self.main.insert(view, key);
        self.prepass.insert(view, key & of_prepass);
        if all {
            self.dirty.views.insert(view);
        }
        // Bevy passes by views without phases.
        let mode = GpuPreprocessingMode::None;
        self.main_phases.prepare_for_new_frame(view, mode);
        self.prepass_phases.prepare_for_new_frame(view, mode);
    }

    fn remove(&mut self, view: RetainedViewEntity) {
        self.main.remove(&view);
        self.prepass.remove(&view);
        self.dirty.views.remove(&view);
        self.main_phases.remove(&view);
        self.prepass_phases.remove(&view);
    }
}

/// Adds the second views.
fn look_ahead(
    mut waiting: Query<(Entity, &mut WaitingView, &ExtractedView, &RenderVisibleEntities)>,
    no_motion: Option<Res<NoMotionVectors>>,
    mut keys: Keys,
    mut commands: Commands,
) {
    let has_motion = no_motion.is_none();
    for (entity, mut waiting, view, visible) in &mut waiting {
        waiting.compiles = false;
        let key = keys.main.get(&view.retained_view_entity);
        let Some(key) = key.filter(|_| !waiting.is_over) else {
            continue;
        };
        let key = waiting.key(*key, has_motion);
        let retained_view_entity = RetainedViewEntity::new(view.retained_view_entity.main_entity, None, AHEAD);
        let is_new = waiting.key.replace(key) != Some(key);
        keys.add(retained_view_entity, key, is_new);
        let ahead = ExtractedView {
            retained_view_entity,
            clip_from_view: view.clip_from_view,
            world_from_view: view.world_from_view,
            clip_from_world: view.clip_from_world,
            target_format: key.target_format(),
            viewport: view.viewport,
            color_grading: view.color_grading.clone(),
            invert_culling: view.invert_culling,
        };
        let prepasses = (DepthPrepass, DeferredPrepass, NormalPrepass);
        let mut ahead = commands.spawn((AheadOf(entity), ahead, visible.clone(), Msaa::Off, prepasses));
        if has_motion {
            ahead.insert(MotionVectorPrepass);
        }
    }
}

/// Pipelines of views.
#[derive(SystemParam)]
struct Specialized<'w> {
    main: Res<'w, SpecializedMaterialPipelineCache>,
    prepass: Res<'w, SpecializedPrepassMaterialPipelineCache>,
    // An app can do without Bevy's deferred lighting.
    lighting: Option<ResMut<'w, SpecializedRenderPipelines<DeferredLightingLayout>>>,
    lighting_layout: Option<Res<'w, DeferredLightingLayout>>,
    cache: Res<'w, PipelineCache>,
}

impl Specialized<'_> {
    /// What the pipelines of a view wait for. Those with errors are never compiled, unless their shader is still being loaded.
    fn pending(&mut self, view: RetainedViewEntity, key: MeshPipelineKey) -> Pending {
        let lighting = self.lighting.as_mut().zip(self.lighting_layout.as_ref());
        let lighting = lighting.map(|(pipelines, layout)| pipelines.specialize(&self.cache, layout, key));
        let main = self.main.get(&view).into_iter().flat_map(|view| view.values().copied());
        let prepass = self.prepass.get(&view).into_iter().flat_map(|view| view.values());
        let pending = |id: CachedRenderPipelineId| {
            use ShaderCacheError::{ShaderImportNotYetAvailable, ShaderNotLoaded};
            match self.cache.get_render_pipeline_state(id) {
                CachedPipelineState::Queued | CachedPipelineState::Creating(_) => Pending::Compilation,
                CachedPipelineState::Err(ShaderNotLoaded(_) | ShaderImportNotYetAvailable) => Pending::Shader,
                CachedPipelineState::Ok(_) | CachedPipelineState::Err(_) => Pending::Nothing,
            }
        };
        let all = main.chain(prepass.map(|(_, id, _)| *id)).chain(lighting);
        all.map(pending).max().unwrap_or_default()
    }
}

/// What pipelines wait for: a shader, if any of them does, or else compilation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Pending {
    #[default]
    Nothing,
    Compilation,
    Shader,
}

/// Removes the second views, and notes which views are warm.
fn note_compiled(
    ahead: Query<(Entity, &AheadOf, &ExtractedView)>,
    mut waiting: Query<&mut WaitingView>,
    mut specialized: Specialized,
    mut keys: Keys,
    mut commands: Commands,
) {
    for (entity, of, view) in &ahead {
        let view = view.retained_view_entity;
        if let (Some(key), Ok(mut waiting)) = (keys.main.get(&view).copied(), waiting.get_mut(of.0)) {
            waiting.note(specialized.pending(view, key));
        }
        keys.remove(view);
        commands.entity(entity).despawn();
    }
}

/// Waits for the pipelines that draw into views which become HDR in this frame: tone mapping, sky and user interface don't draw without
/// theirs, and Bevy requests these in the frame in which it needs them. Ours come later (`ready.rs`), so that these don't queue behind them.
fn finish_switches(views: Query<(&WaitingView, &ExtractedCamera)>, mut cache: ResMut<PipelineCache>) {
    let becomes_hdr = |(view, camera): (&WaitingView, &ExtractedCamera)| view.is_over && view.gets_hdr && camera.hdr;
    if !views.iter().any(becomes_hdr) {
        return;
    }
    let start = Instant::now();
    cache.process_queue();
    // Browsers compile at once, and their threads can't sleep.
    while !cfg!(target_arch = "wasm32") && draws_wait(&cache) && start.elapsed() < LONGEST_WAIT {
        std::thread::sleep(Duration::from_millis(1));
        cache.process_queue();
    }
}

/// Whether a pipeline that draws is being compiled.
fn draws_wait(cache: &PipelineCache) -> bool {
    cache.pipelines().any(|pipeline| {
        let draws = matches!(pipeline.descriptor, PipelineDescriptor::RenderPipelineDescriptor(_));
        draws
            && matches!(
                pipeline.state,
                CachedPipelineState::Queued | CachedPipelineState::Creating(_)
            )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However long pipelines are compiled, nothing vanishes; and a shader that never loads doesn't keep a camera without reflections.
    #[test]
    fn patience_ends_while_nothing_is_compiled() {
        let mut app = App::new();
        app.insert_resource(CompilesAhead)
            .init_resource::<Time<Real>>()
            .add_systems(PostUpdate, give_prepasses);
        let camera = app.world_mut().spawn(Camera::default()).id();
        app.update();
        app.world_mut()
            .entity_mut(camera)
            .insert(RayTracedReflections::default());
        let mut seconds = |compiles: bool, seconds: u32| {
            for _ in 0..seconds {
                let world = app.world_mut();
                let mut time = world.resource_mut::<Time<Real>>();
                time.advance_by(Duration::from_secs(1));
                let mut camera = world.entity_mut(camera);
                if let Some(mut request) = camera.get_mut::<PrepassRequest>() {
                    request.compiles = compiles;
                }
                app.update();
            }
            app.world().entity(camera).contains::<DeferredPrepass>()
        };
        assert!(!seconds(true, 300), "pipelines are being compiled");
        assert!(!seconds(false, 29));
        assert!(seconds(false, 3), "nothing happens");
    }

    /// Reflections that a menu switches on while its own camera draws.
    #[test]
    fn a_camera_that_has_drawn_gets_its_prepasses_while_it_draws() {
        let mut app = App::new();
        app.insert_resource(CompilesAhead)
            .init_resource::<Time<Real>>()
            .add_systems(PostUpdate, give_prepasses);
        let camera = app.world_mut().spawn(Camera::default()).id();
        let mut seconds = |is_active: bool, change: fn(EntityWorldMut)| {
            change(app.world_mut().entity_mut(camera));
            app.world_mut().get_mut::<Camera>(camera).unwrap().is_active = is_active;
            for _ in 0..60 {
                let mut time = app.world_mut().resource_mut::<Time<Real>>();
                time.advance_by(Duration::from_millis(if is_active { 100 } else { 1_000 }));
                app.update();
            }
            app.world().entity(camera).contains::<DeferredPrepass>()
        };
        assert!(!seconds(true, |_| {}));
        assert!(!seconds(false, |mut camera| _ = camera.insert(RayTracedReflections::default())));
        assert!(!seconds(true, |_| {}));
        let warm = |mut camera: EntityWorldMut| camera.get_mut::<PrepassRequest>().unwrap().is_warm = true;
        assert!(seconds(true, warm));
    }

    /// Bevy tries a shader that isn't loaded again every few frames.
    #[test]
    fn a_shader_that_never_loads_is_no_compilation() {
        let mut view = WaitingView::new(false);
        let mut note = |pending| {
            view.note(pending);
            [view.is_warm, view.compiles]
        };
        assert_eq!(note(Pending::Compilation), [false, true]);
        for _ in 0..9 {
            assert_eq!(note(Pending::Shader), [false, false]);
            assert_eq!(note(Pending::Compilation), [false, false]);
            assert_eq!(note(Pending::Compilation), [false, false]);
        }
        (0..RETRY_FRAMES).for_each(|_| _ = note(Pending::Compilation));
        assert_eq!(note(Pending::Compilation), [false, true]);
        assert_eq!(note(Pending::Nothing), [true, false]);
    }
}
