//! Small scenes of a few objects before a mirror.

use crate::pictures::apps_of_both;
use bevy::{
    camera::{ClearColorConfig, Viewport},
    math::UVec2,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::{
        RenderApp,
        render_resource::{AsBindGroup, PollType},
        renderer::RenderDevice,
    },
};
use bevy_glint::{ReflectionStatus, ReflectionStatusReport, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};

pub const SIZE: UVec2 = UVec2::new(96, 64);
pub const RED: [u8; 3] = [255, 0, 0];
pub const GREEN: [u8; 3] = [0, 255, 0];
pub const BLUE: [u8; 3] = [0, 0, 255];
/// Place of the camera before a mirror in the origin.
pub const BEFORE_THE_MIRROR: Transform = Transform::from_xyz(0.0, 0.0, 3.0);

pub fn unlit(color: [u8; 3]) -> StandardMaterial {
    let [r, g, b] = color;
    StandardMaterial {
        base_color: Color::srgb_u8(r, g, b),
        unlit: true,
        ..default()
    }
}

pub fn metal(perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        metallic: 1.0,
        perceptual_roughness,
        ..default()
    }
}

/// Smooth colourless glass, with only its reflections visible.
pub fn clear_glass() -> StandardMaterial {
    StandardMaterial {
        base_color: Color::NONE,
        alpha_mode: AlphaMode::Premultiplied,
        reflectance: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    }
}

/// An extension that no prepass draws.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
pub struct WithoutPrepass {}

impl MaterialExtension for WithoutPrepass {
    fn enable_prepass() -> bool {
        false
    }
}

pub type Unprepared = ExtendedMaterial<StandardMaterial, WithoutPrepass>;

/// Fills the image of a camera before the mirror.
pub fn wall() -> Rectangle {
    Rectangle::new(12.0, 12.0)
}

pub fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    let world = app.world();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// A camera in the surroundings of a scene.
pub fn spawn_camera(app: &mut HeadlessApp, at: Transform, surroundings: SceneName) -> Entity {
    let environment = environment(surroundings, app.world());
    let camera = app.spawn_camera(at);
    environment.insert(&mut app.world().entity_mut(camera));
    camera
}

/// A test of one tracer, in an app that others use before and after it.
pub type Case = fn(&mut HeadlessApp, ReflectionTracerChoice);

/// Runs tests one after the other in an app of each tracer, because starting one with all its shaders takes longer than most of them.
pub fn share_app(cases: &[Case]) {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        for case in cases {
            case(&mut app, tracer);
            clear(&mut app);
        }
    }
}

/// Removes everything that was spawned.
pub fn clear(app: &mut HeadlessApp) {
    let world = app.world();
    let mut placed = world.query_filtered::<Entity, With<Transform>>();
    let placed: Vec<Entity> = placed.iter(world).collect();
    for entity in placed {
        // Its parent might have removed it.
        _ = world.try_despawn(entity);
    }
    app.step(2);
}

/// Gives the left half of the image to the first camera, and the right half to the second.
pub fn share_picture(app: &mut HeadlessApp, cameras: [Entity; 2]) {
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    for (order, camera) in cameras.into_iter().enumerate() {
        let mut camera = app.world().get_mut::<Camera>(camera).unwrap();
        camera.order = order as isize;
        camera.viewport = Some(Viewport {
            physical_position: UVec2::new(order as u32 * half.x, 0),
            physical_size: half,
            ..default()
        });
        if order > 0 {
            camera.clear_color = ClearColorConfig::None;
        }
    }
}

pub fn report(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

/// Bytes of the textures that front layers have.
pub fn layer_bytes(app: &mut HeadlessApp) -> u64 {
    let memory = report(app).view_memory;
    let parts = memory.iter().flat_map(|view| &view.parts);
    parts
        .filter(|(label, _)| label.starts_with("glint_front_layer"))
        .map(|(_, bytes)| bytes)
        .sum()
}

/// Limit of frames for merging.
const PATIENCE: u32 = 20_000;

/// Waits until all merging is done, and masked objects have their micromaps.
#[track_caller]
pub fn until_at_rest(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.step(3);
    for _ in 0..PATIENCE {
        let report = report(app);
        if !report.merges_pending && !report.micromaps_pending {
            return report;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
        app.step(1);
    }
    panic!("merging goes on: {:?}", report(app));
}

/// Renders one frame and waits for the GPU, so that the next frame finds the report.
pub fn frame(app: &mut HeadlessApp) {
    app.step(1);
    let world = app.app().sub_app(RenderApp).world();
    let wait = PollType::Wait {
        submission_index: None,
        timeout: None,
    };
    world.resource::<RenderDevice>().poll(wait).unwrap();
}
