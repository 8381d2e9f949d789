//! Random lives of two cameras before a mirror: they come and go, change their settings, sizes and targets, and jump. The mirror shows
//! boxes and a character, which bends its arm.
//!
//! In each frame, what was shown must still be shown, and no pixel may be dark. A pause builds nothing again. At the end of a life, images
//! without noise must be those of new textures; back in the first state, the image must be that of a new app, and the memory that of one
//! camera. No warning comes twice in all lives. `GLINT_SEED=7` begins with that life, and `GLINT_LIVES=500` makes the long test live that many.

use super::{FOREVER, plain, spawn_reflecting, spawn_scene};
use crate::{
    common::app_of,
    pictures::{any_tracer, differing_pixels, red_pixels, warm_up},
    poses::{ELBOW, arm, spawn_arm},
    stage::{BEFORE_THE_MIRROR, RED, clear_glass, frame, report, spawn_camera, spawn_mesh, unlit},
};
use bevy::{
    camera::{MainPassResolutionOverride, RenderTarget, Viewport},
    log::{
        tracing::{Event, Level, Subscriber, field::Field, field::Visit, subscriber},
        tracing_subscriber::{
            filter::LevelFilter,
            layer::{Context, Layer, SubscriberExt},
            registry,
        },
    },
    math::{URect, UVec2},
    pbr::{DistanceFog, FogFalloff},
    prelude::*,
    render::{RenderApp, render_resource::PipelineCache, sync_world::RenderEntity},
};
use bevy_glint::{
    RayTracedReflections, ReflectionDenoiser, ReflectionQuality, ReflectionRetention, ReflectionTechnique,
    ReflectionTracerChoice, ReflectionsOff,
};
use core::{fmt, time::Duration};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, Random, SceneName, is_alone};
use std::sync::{Mutex, PoisonError};

const SIZE: UVec2 = UVec2::new(96, 64);
/// Sizes of the other targets.
const OTHERS: [UVec2; 2] = [UVec2::new(64, 48), UVec2::new(80, 72)];
const ACTS: usize = 14;
/// Least value of the brightest channel of a pixel: everything in the scene is red, white or fog.
const DARKEST: u8 = 90;
/// Maximum number of pipelines after any number of lives; 500 lives have 93. A higher number hides more that are compiled again.
const MOST_PIPELINES: usize = 150;

/// Something that happens to a game's cameras. The number is that of a camera.
#[derive(Clone, Copy, Debug)]
enum Act {
    Activate(usize, bool),
    /// The cameras change places.
    Swap,
    Insert(usize, usize),
    Remove(usize),
    Quality(usize, ReflectionQuality),
    Viewport(usize, Option<URect>),
    Override(usize, Option<UVec2>),
    /// The viewport slides.
    Slide(usize),
    /// The second camera draws into another target.
    Retarget,
    /// The character bends its arm by this angle.
    Bend(f32),
    /// No camera is active for some frames.
    Pause(u32),
    /// No camera is active for longer than the scene is retained.
    LongPause,
    Teleport(usize, f32),
    Fog(usize, bool),
    /// A pane of glass comes or goes.
    Glass(bool),
    Wait,
}

impl Act {
    fn random(random: &mut Random) -> Self {
        let camera = random.below(2);
        // What fits into all targets of the camera.
        let size = [SIZE, OTHERS[0].min(OTHERS[1])][camera];
        let part = |random: &mut Random, full: u32| {
            let from = random.below(full as usize / 3) as u32;
            (from, from + full / 2 + random.below((full / 2 - from) as usize) as u32)
        };
        match random.below(18) {
            0 | 1 => Self::Activate(camera, random.chance(0.6)),
            2 => Self::Swap,
            3 | 4 => Self::Insert(camera, random.below(SETTINGS.len())),
            5 => Self::Remove(camera),
            6 => Self::Quality(
                camera,
                random.pick(&[
                    ReflectionQuality::Off,
                    ReflectionQuality::Low,
                    ReflectionQuality::Medium,
                    ReflectionQuality::High,
                ]),
            ),
            7 => {
                let ((left, right), (top, bottom)) = (part(random, size.x), part(random, size.y));
                Self::Viewport(camera, random.chance(0.7).then(|| URect::new(left, top, right, bottom)))
            }
            8 => {
                let share = random.range(0.6, 1.0);
                let inside = (size.as_vec2() * share).as_uvec2();
                Self::Override(camera, random.chance(0.7).then_some(inside))
            }
            9 => Self::Slide(camera),
            10 => Self::Retarget,
            11 => Self::Pause(1 + random.below(4) as u32),
            12 => Self::LongPause,
            13 => Self::Teleport(camera, random.range(-1.5, 1.5)),
            14 => Self::Fog(camera, random.chance(0.5)),
            15 => Self::Glass(random.chance(0.5)),
            16 => Self::Bend(random.range(-1.5, 1.5)),
            _ => Self::Wait,
        }
    }
}

/// Settings with which a smooth mirror shows red objects as red.
static SETTINGS: [fn() -> RayTracedReflections; 5] = [
    plain,
    RayTracedReflections::default,
    || RayTracedReflections {
        technique: ReflectionTechnique::Reference,
        ..default()
    },
    || {
        let mut settings = RayTracedReflections::default();
        settings.denoiser.half_resolution = true;
        settings.denoiser.follow_light_changes = false;
        settings
    },
    || RayTracedReflections {
        transparent: false,
        ..plain()
    },
];

/// Both cameras, and what is expected of them.
struct Life {
    cameras: [Entity; 2],
    targets: [RenderTarget; 3],
    /// Index of each camera's target.
    drawn_into: [usize; 2],
    /// A camera has shown reflections, and nothing happened since then that can take them away.
    shows: [bool; 2],
    glass: Option<Entity>,
    /// The upper joint of the character's arm.
    elbow: Entity,
}

impl Life {
    fn new(app: &mut HeadlessApp) -> Self {
        let targets = [
            app.target(),
            app.add_target(OTHERS[0], Output::Picture),
            app.add_target(OTHERS[1], Output::Picture),
        ];
        let first = spawn_reflecting(app);
        let second = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        app.world().entity_mut(second).insert(targets[1].clone());
        let elbow = spawn_arm(app, arm(), unlit(RED)).joints[1];
        let mut life = Self {
            cameras: [first, second],
            targets,
            drawn_into: [0, 1],
            shows: [false; 2],
            glass: None,
            elbow,
        };
        life.bend(app, 0.0);
        life.activate(app, 1, false);
        life
    }

    fn target_size(&self, camera: usize) -> UVec2 {
        [SIZE, OTHERS[0], OTHERS[1]][self.drawn_into[camera]]
    }

    fn is_active(&self, app: &mut HeadlessApp, camera: usize) -> bool {
        app.world().get::<Camera>(self.cameras[camera]).unwrap().is_active
    }

    fn activate(&mut self, app: &mut HeadlessApp, camera: usize, active: bool) {
        super::activate(app, self.cameras[camera], active);
    }

    fn bend(&mut self, app: &mut HeadlessApp, angle: f32) {
        let bent = Transform::from_translation(ELBOW).with_rotation(Quat::from_rotation_z(angle));
        app.world().entity_mut(self.elbow).insert(bent);
    }

    fn has_settings(&self, app: &mut HeadlessApp, camera: usize) -> bool {
        app.world().get::<RayTracedReflections>(self.cameras[camera]).is_some()
    }

    fn set_viewport(&mut self, app: &mut HeadlessApp, camera: usize, viewport: Option<URect>) {
        app.world().get_mut::<Camera>(self.cameras[camera]).unwrap().viewport = viewport.map(|rect| Viewport {
            physical_position: rect.min,
            physical_size: rect.size(),
            ..default()
        });
    }

    fn set_override(&mut self, app: &mut HeadlessApp, camera: usize, size: Option<UVec2>) {
        let view = app.world().get::<RenderEntity>(self.cameras[camera]).unwrap().id();
        let render_world = app.app().sub_app_mut(RenderApp).world_mut();
        let Ok(mut view) = render_world.get_entity_mut(view) else {
            return;
        };
        match size {
            Some(size) => view.insert(MainPassResolutionOverride(size)),
            None => view.remove::<MainPassResolutionOverride>(),
        };
    }

    /// Draws a frame and looks at it.
    fn frame(&mut self, app: &mut HeadlessApp) -> Result<(), String> {
        frame(app);
        for camera in 0..2 {
            if !self.is_active(app, camera) {
                continue;
            }
            let picture = self.picture(app, camera);
            let dark = |pixel: &&[u8]| pixel[..3].iter().all(|channel| *channel < DARKEST);
            let dark = picture.chunks_exact(4).filter(dark).count();
            if dark > 0 {
                let pixels = picture.len() / 4;
                return Err(format!("camera {camera}: {dark} of {pixels} pixels are dark"));
            }
            let red = red_pixels(&picture);
            if self.has_settings(app, camera) {
                if self.shows[camera] && red == 0 {
                    return Err(format!("camera {camera}: its reflections vanished"));
                }
                self.shows[camera] |= red > 0;
            } else {
                self.shows[camera] = false;
            }
        }
        Ok(())
    }

    /// The part of its target that a camera draws.
    fn picture(&self, app: &mut HeadlessApp, camera: usize) -> Vec<u8> {
        let target = self.targets[self.drawn_into[camera]].clone();
        let bytes = app.read_target(&target).unwrap();
        let size = self.target_size(camera);
        let world = app.world();
        let viewport = world.get::<Camera>(self.cameras[camera]).unwrap().viewport.clone();
        let (min, extent) = viewport.map_or((UVec2::ZERO, size), |part| (part.physical_position, part.physical_size));
        let view = world.get::<RenderEntity>(self.cameras[camera]).unwrap().id();
        let render_world = app.app().sub_app(RenderApp).world();
        let inside = render_world.get::<MainPassResolutionOverride>(view);
        // Without an upscaler, the frame is in a corner.
        let extent = inside.map_or(extent, |inside| extent.min(inside.0));
        let rows = bytes.chunks_exact(4 * size.x as usize);
        rows.skip(min.y as usize)
            .take(extent.y as usize)
            .flat_map(|row| &row[4 * min.x as usize..4 * (min.x + extent.x) as usize])
            .copied()
            .collect()
    }

    fn act(&mut self, app: &mut HeadlessApp, act: Act) -> Result<(), String> {
        match act {
            Act::Activate(camera, active) => self.activate(app, camera, active),
            Act::Swap => {
                let active = [0, 1].map(|camera| self.is_active(app, camera));
                self.activate(app, 0, active[1]);
                self.activate(app, 1, active[0]);
            }
            Act::Viewport(camera, viewport) => self.set_viewport(app, camera, viewport),
            Act::Override(camera, size) => self.set_override(app, camera, size),
            Act::Slide(camera) => {
                let size = self.target_size(camera);
                for step in 0..4 {
                    let rect = URect::from_corners(UVec2::new(3 * step, step), size - UVec2::new(12 - 3 * step, 4));
                    self.set_viewport(app, camera, Some(rect));
                    self.frame(app)?;
                }
            }
            Act::Bend(angle) => self.bend(app, angle),
            Act::Retarget => {
                self.drawn_into[1] = 3 - self.drawn_into[1];
                let target = self.targets[self.drawn_into[1]].clone();
                self.set_viewport(app, 1, None);
                let mut camera = app.world().entity_mut(self.cameras[1]);
                camera.insert(target);
                // Bevy 0.20 doesn't notice another target: the camera would keep the size of the last one.
                camera.get_mut::<Projection>().unwrap().set_changed();
            }
            Act::Pause(frames) => {
                // One more for changes before it.
                self.frame(app)?;
                let before = report(app);
                self.pause(app, frames)?;
                self.frame(app)?;
                let built = report(app).blas_builds - before.blas_builds;
                if before.meshes > 0 && built > 0 {
                    return Err(format!("{built} meshes are built again after a pause"));
                }
            }
            Act::LongPause => self.begin_anew(app)?,
            Act::Wait => (0..6).try_for_each(|_| self.frame(app))?,
            _ => self.dress(app, act),
        }
        (0..2).try_for_each(|_| self.frame(app))
    }

    /// Acts that change components of a camera, or the scene.
    fn dress(&mut self, app: &mut HeadlessApp, act: Act) {
        if let Act::Insert(camera, _) | Act::Remove(camera) | Act::Quality(camera, _) = act
            && !self.is_active(app, camera)
        {
            // It has shown other settings than those that it comes back with.
            self.shows[camera] = false;
        }
        let cameras = self.cameras;
        let world = app.world();
        match act {
            Act::Insert(camera, settings) => {
                world
                    .entity_mut(cameras[camera])
                    .remove::<(ReflectionQuality, ReflectionsOff)>()
                    .insert(SETTINGS[settings]());
            }
            Act::Remove(camera) => {
                world
                    .entity_mut(cameras[camera])
                    .remove::<(ReflectionQuality, ReflectionsOff, RayTracedReflections)>();
            }
            Act::Quality(camera, quality) => {
                world.entity_mut(cameras[camera]).insert(quality);
            }
            Act::Teleport(camera, x) => {
                let mut camera = world.entity_mut(cameras[camera]);
                camera.get_mut::<Transform>().unwrap().translation.x = x;
                if let Some(mut settings) = camera.get_mut::<RayTracedReflections>() {
                    settings.reset = true;
                }
            }
            Act::Fog(camera, true) => {
                world.entity_mut(cameras[camera]).insert(DistanceFog {
                    color: Color::srgb(0.7, 0.7, 0.7),
                    falloff: FogFalloff::Linear {
                        start: 0.0,
                        end: 1_000.0,
                    },
                    ..default()
                });
            }
            Act::Fog(camera, false) => {
                world.entity_mut(cameras[camera]).remove::<DistanceFog>();
            }
            Act::Glass(exists) => {
                if let Some(glass) = self.glass.take() {
                    world.despawn(glass);
                }
                let at = Transform::from_xyz(2.0, 0.0, 1.0);
                self.glass = exists.then(|| spawn_mesh(app, Rectangle::new(1.0, 4.0), clear_glass(), at));
            }
            _ => {}
        }
    }

    /// Frees everything.
    fn begin_anew(&mut self, app: &mut HeadlessApp) -> Result<(), String> {
        app.world().insert_resource(ReflectionRetention(Duration::ZERO));
        self.pause(app, 2)?;
        app.world().insert_resource(FOREVER);
        self.shows = [false; 2];
        Ok(())
    }

    /// Compares images without noise with those of new textures and a new scene.
    fn compare(&mut self, app: &mut HeadlessApp) -> Result<(), String> {
        let is_plain = |settings: &RayTracedReflections| {
            settings.technique == ReflectionTechnique::Reference && settings.denoiser == ReflectionDenoiser::OFF
        };
        let mut pictures = Vec::new();
        for camera in 0..2 {
            let settings = app.world().get::<RayTracedReflections>(self.cameras[camera]);
            if settings.is_some_and(is_plain) && self.is_active(app, camera) && self.shows[camera] {
                pictures.push((camera, self.picture(app, camera)));
            }
        }
        if pictures.is_empty() {
            return Ok(());
        }
        self.begin_anew(app)?;
        warm_up(app);
        frame(app);
        for (camera, before) in pictures {
            let apart = differing_pixels(&before, &self.picture(app, camera), 2);
            if apart > 0 {
                return Err(format!("camera {camera}: {apart} pixels aren't those of new textures"));
            }
        }
        Ok(())
    }

    fn pause(&mut self, app: &mut HeadlessApp, frames: u32) -> Result<(), String> {
        let active = [0, 1].map(|camera| self.is_active(app, camera));
        [0, 1].into_iter().for_each(|camera| self.activate(app, camera, false));
        (0..frames).try_for_each(|_| self.frame(app))?;
        for (camera, active) in active.into_iter().enumerate() {
            self.activate(app, camera, active);
        }
        Ok(())
    }

    /// Lives one life, and returns to the state of a new app.
    fn live(&mut self, app: &mut HeadlessApp, acts: &[Act], expected: &Expected) -> Result<(), String> {
        for (index, act) in acts.iter().enumerate() {
            self.act(app, *act)
                .map_err(|what| format!("{what}, after act {index}, {act:?}"))?;
        }
        self.compare(app)?;
        self.act(app, Act::Glass(false))?;
        self.act(app, Act::Bend(0.0))?;
        for camera in 0..2 {
            self.set_override(app, camera, None);
            self.set_viewport(app, camera, None);
            app.world()
                .get_mut::<Transform>(self.cameras[camera])
                .unwrap()
                .translation
                .x = 0.0;
            self.act(app, Act::Fog(camera, false))?;
            self.act(app, Act::Remove(camera))?;
        }
        self.activate(app, 0, true);
        self.activate(app, 1, false);
        app.world().entity_mut(self.cameras[0]).insert(plain());
        // What cameras that are away retain goes, too.
        app.world().insert_resource(ReflectionRetention(Duration::ZERO));
        warm_up(app);
        (0..2).for_each(|_| frame(app));
        app.world().insert_resource(FOREVER);
        self.shows = [false; 2];
        let now = Expected::of(app);
        let apart = differing_pixels(&now.picture, &expected.picture, 2);
        if apart > 0 {
            return Err(format!("{apart} pixels of the last image aren't those of a new app"));
        }
        if now.bytes > expected.bytes {
            return Err(format!(
                "{} bytes at the end, {} in a new app",
                now.bytes, expected.bytes
            ));
        }
        if now.pipelines > MOST_PIPELINES {
            return Err(format!("{} pipelines", now.pipelines));
        }
        Ok(())
    }
}

/// What a new app shows and takes.
struct Expected {
    picture: Vec<u8>,
    bytes: u64,
    pipelines: usize,
}

impl Expected {
    fn of(app: &mut HeadlessApp) -> Self {
        let report = report(app);
        let views = report.view_memory.iter().flat_map(|view| &view.parts);
        Self {
            picture: app.capture().unwrap(),
            bytes: views.map(|(_, bytes)| bytes).sum(),
            pipelines: app
                .render_world()
                .unwrap()
                .resource::<PipelineCache>()
                .pipelines()
                .count(),
        }
    }
}

/// Warnings and errors of the plugin.
static LOG: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct KeepLog;

impl<S: Subscriber> Layer<S> for KeepLog {
    fn on_event(&self, event: &Event, _: Context<S>) {
        let metadata = event.metadata();
        if *metadata.level() <= Level::WARN && metadata.target().starts_with("bevy_glint") {
            let mut message = Message::default();
            event.record(&mut message);
            LOG.lock().unwrap_or_else(PoisonError::into_inner).push(message.0);
        }
    }
}

#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

/// Lives this number of lives with each tracer, as the test of this name.
fn live(test: &str, lives: u64) {
    // The log is that of the process.
    if !is_alone(&format!("lives::random::{test}")) {
        return;
    }
    subscriber::set_global_default(registry().with(LevelFilter::WARN).with(KeepLog)).unwrap();
    warn!(target: "bevy_glint", "heard");
    assert_eq!(core::mem::take(&mut *LOG.lock().unwrap()), ["heard"]);
    let seed = std::env::var("GLINT_SEED").ok().and_then(|seed| seed.parse().ok());
    let first = seed.unwrap_or(1_u64);
    for tracer in any_tracer() {
        let mut failures = Vec::new();
        let mut theatre = None;
        for seed in first..first + lives {
            let Some((app, life, expected)) = theatre.get_or_insert_with(|| begin(tracer)).as_mut() else {
                return;
            };
            let mut random = Random::new(seed);
            let acts: Vec<_> = (0..ACTS).map(|_| Act::random(&mut random)).collect();
            if let Err(what) = life.live(app, &acts, expected) {
                println!("{tracer}, seed {seed}: {what}; the acts were {acts:?}");
                failures.push(format!("seed {seed}: {what}"));
                // Others shouldn't suffer from it.
                theatre = None;
            }
        }
        if let Some(Some((app, ..))) = &mut theatre {
            println!("{tracer}: {lives} lives, {} pipelines", Expected::of(app).pipelines);
        }
        assert!(failures.is_empty(), "{tracer}: {failures:#?}");
        drop(theatre);
        let mut log = core::mem::take(&mut *LOG.lock().unwrap());
        println!("{tracer}: {} warnings: {log:#?}", log.len());
        log.sort();
        let repeated: Vec<_> = log.windows(2).filter(|pair| pair[0] == pair[1]).collect();
        assert!(repeated.is_empty(), "{tracer}: said more than once: {repeated:#?}");
    }
}

fn begin(tracer: ReflectionTracerChoice) -> Option<(HeadlessApp, Life, Expected)> {
    // Systems run in parallel, as in a game.
    let settings = HeadlessSettings {
        size: SIZE,
        ..default()
    };
    let mut app = app_of(settings, tracer, |_| {}, |_| {})?;
    app.world().insert_resource(FOREVER);
    spawn_scene(&mut app);
    let life = Life::new(&mut app);
    warm_up(&mut app);
    (0..2).for_each(|_| frame(&mut app));
    let expected = Expected::of(&mut app);
    assert!(red_pixels(&expected.picture) > 100, "the mirror shows something");
    Some((app, life, expected))
}

#[test]
fn random_lives_lose_nothing() {
    live("random_lives_lose_nothing", 7);
}

#[test]
#[ignore = "long: a hundred lives"]
fn many_random_lives_lose_nothing() {
    let lives = std::env::var("GLINT_LIVES").map_or(100, |lives| lives.parse().unwrap());
    live("many_random_lives_lose_nothing", lives);
}
