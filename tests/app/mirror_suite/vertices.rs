//! Meshes with vertices that a material's own shader moves.

use super::{LEVELS, LIMIT, Stage, blue};
use crate::{
    common::app_with,
    pictures::{any_tracer, differing_pixels, dump, flip, warm_up},
    stage::{SIZE, add, denoised, frame, metal, report, set_shader, spawn_camera, spawn_mesh, spawn_of},
};
use bevy::{
    asset::uuid_handle,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::{AsBindGroup, CachedPipeline, PipelineCache, PipelineDescriptor},
    shader::{Shader, ShaderRef},
};
use bevy_glint::{
    RayTracedReflections, ReflectedMaterialPlugin, ReflectedVertexShader, ReflectedVertices, ReflectionDenoiser,
    ReflectionTechnique, ReflectionTracerChoice,
};
use core::time::Duration;
use glint_scenes::{HeadlessApp, Output, SceneName};
use std::time::Instant;

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Wind {}

impl MaterialExtension for Wind {
    fn vertex_shader() -> ShaderRef {
        MATERIAL.into()
    }

    fn prepass_vertex_shader() -> ShaderRef {
        MATERIAL.into()
    }

    fn deferred_vertex_shader() -> ShaderRef {
        MATERIAL.into()
    }
}

type Swaying = ExtendedMaterial<StandardMaterial, Wind>;

const MATERIAL: Handle<Shader> = uuid_handle!("7c1e5d0a-93b4-4f6e-8a27-51d0c6e4b901");
const REFLECTED: Handle<Shader> = uuid_handle!("7c1e5d0a-93b4-4f6e-8a27-51d0c6e4b902");
const WIND: Handle<Shader> = uuid_handle!("7c1e5d0a-93b4-4f6e-8a27-51d0c6e4b903");
const IN_REFLECTIONS: &str = include_str!("../../../assets/shaders/wind_in_reflections.wesl");

/// The shaders of the example `wind`. Both import the first one.
fn add_shaders(app: &mut HeadlessApp) {
    let own = [
        (WIND, include_str!("../../../assets/shaders/wind.wesl"), "wind"),
        (
            MATERIAL,
            include_str!("../../../assets/shaders/wind_material.wesl"),
            "wind_material",
        ),
        (REFLECTED, IN_REFLECTIONS, "wind_in_reflections"),
    ];
    for (id, source, name) in own {
        set_shader(app, &id, source, &format!("tests/{name}.wesl"));
    }
}

fn swaying_app(tracer: ReflectionTracerChoice) -> Option<HeadlessApp> {
    let mut app = app_with(SIZE, Output::Picture, tracer, |app| {
        app.add_plugins((
            ReflectedMaterialPlugin::<Swaying>::default().with_vertices(ReflectedVertices {
                reach: 0.7,
                ..default()
            }),
            MaterialPlugin::<Swaying>::default(),
        ));
    })?;
    add_shaders(&mut app);
    Some(app)
}

fn insert_shader(app: &mut HeadlessApp) {
    app.world().insert_resource(ReflectedVertexShader {
        shader: REFLECTED,
        ..default()
    });
}

/// A square sheet with its root at the bottom.
fn spawn_swaying(app: &mut HeadlessApp, material: StandardMaterial, at: Transform) -> Entity {
    let sheet = Plane3d::new(Vec3::Z, Vec2::splat(0.5)).mesh().subdivisions(11);
    let material = Swaying {
        base: material,
        extension: Wind {},
    };
    spawn_of(app, sheet, material, at)
}

/// Stops the clock or starts it. A pause would end when the app is warm.
fn set_speed(app: &mut HeadlessApp, speed: f32) {
    app.world().resource_mut::<Time<Virtual>>().set_relative_speed(speed);
}

impl Stage<'_> {
    fn spawn_swaying(&mut self, material: StandardMaterial, at: Transform) {
        let entity = spawn_swaying(self.app, material, at);
        self.spawned.push(entity);
    }

    /// A flag, a turned and stretched one, and one with holes.
    fn spawn_flags(&mut self) {
        self.light_and_spawn(StandardMaterial {
            base_color: Color::WHITE,
            ..blue()
        });
        let sheet = StandardMaterial {
            base_color: Color::linear_rgb(0.8, 0.2, 0.05),
            perceptual_roughness: 0.8,
            double_sided: true,
            cull_mode: None,
            ..default()
        };
        let facing = Transform::default().looking_to(Vec3::Z, Vec3::Y);
        let holes = self.checkers([255, 255, 255, 255], [255, 0, 0, 0], true);
        self.spawn_swaying(
            sheet.clone(),
            facing
                .with_translation(Vec3::new(-1.8, -0.4, 6.2))
                .with_scale(Vec3::splat(1.8)),
        );
        let turned = Transform::from_xyz(0.4, 0.7, 6.4)
            .with_rotation(Quat::from_euler(EulerRot::YXZ, 2.6, 0.3, 0.2))
            .with_scale(Vec3::new(1.0, 2.2, 0.7));
        self.spawn_swaying(sheet.clone(), turned);
        let masked = StandardMaterial {
            base_color_texture: Some(holes),
            alpha_mode: AlphaMode::Mask(0.5),
            ..sheet
        };
        self.spawn_swaying(
            masked,
            facing
                .with_translation(Vec3::new(1.9, -0.3, 6.6))
                .with_scale(Vec3::splat(1.5)),
        );
    }

    /// Vertices stay where they are while the shader has errors, and it can be edited.
    fn follow_edits(&mut self, tracer: ReflectionTracerChoice) {
        set_speed(self.app, 0.0);
        let right = self.in_the_mirror();
        let mut edit = |from: &str, to: &str| {
            let source = IN_REFLECTIONS.replace(from, to);
            set_shader(self.app, &REFLECTED, source, "tests/wind_in_reflections.wesl");
            // Failures are reported late.
            for _ in 0..20 {
                frame(self.app);
                std::thread::sleep(Duration::from_millis(5));
            }
            differing_pixels(&right, &self.app.capture().unwrap(), LEVELS)
        };
        let faulty = edit("return moved;", "return no_such_thing;");
        let other = edit("1.0 - at.uv.y", "at.uv.y");
        let mended = edit("", "");
        println!(
            "{tracer}: pixels apart with a faulty shader {faulty}, another one {other}, the first one again {mended}"
        );
        assert_eq!((faulty, mended), (0, 0), "{tracer}");
        assert!(other > 50, "{tracer}: {other}");
        set_speed(self.app, 1.0);
    }

    /// Sheets that get another mesh are seen with their last one until the new one is built.
    fn swap_meshes(&mut self, tracer: ReflectionTracerChoice) {
        let count = |stage: &Self| {
            let picture = stage.app.capture().unwrap();
            picture
                .chunks_exact(4)
                .filter(|pixel| pixel[0] > pixel[2].saturating_add(60))
                .count()
        };
        let before = count(self);
        let finer = Plane3d::new(Vec3::Z, Vec2::splat(0.5)).mesh().subdivisions(40);
        let finer = add(self.app, Mesh::from(finer));
        let world = self.app.world();
        let mut meshes = world.query_filtered::<&mut Mesh3d, With<ReflectedVertices>>();
        meshes.iter_mut(world).for_each(|mut mesh| mesh.0 = finer.clone());
        for frames in 0..60 {
            frame(self.app);
            let now = count(self);
            assert!(
                10 * now > 7 * before,
                "{tracer}: {now} of {before} pixels after {frames} frames"
            );
        }
        assert_eq!(report(self.app).posed_instances, 3);
    }

    /// Both images of one moment.
    fn images_of_a_moment(&mut self) -> [Vec<u8>; 2] {
        set_speed(self.app, 0.0);
        let actual = self.in_the_mirror();
        let expected = self.by_the_mirrored_camera();
        set_speed(self.app, 1.0);
        [actual, expected]
    }
}

/// Kernels that pose meshes: compiled ones, and those that are being compiled.
fn kernels(app: &HeadlessApp) -> usize {
    let cache = app.render_world().unwrap().resource::<PipelineCache>();
    let is_ours = |pipeline: &&CachedPipeline| {
        matches!(&pipeline.descriptor, PipelineDescriptor::ComputePipelineDescriptor(kernel)
            if kernel.label.as_deref().is_some_and(|label| label.starts_with("glint_pose")))
    };
    cache.pipelines().filter(is_ours).count()
}

/// Waits until this number of sheets sways in reflections.
fn await_swaying(app: &mut HeadlessApp, count: usize) {
    let start = Instant::now();
    while report(app).posed_instances < count {
        assert!(
            start.elapsed() < Duration::from_secs(120),
            "the shader is never compiled"
        );
        frame(app);
    }
}

#[test]
fn swaying_meshes_in_a_mirror_look_like_themselves() {
    for tracer in any_tracer() {
        let Some(mut app) = swaying_app(tracer) else { return };
        let mut stage = Stage::new(&mut app);
        stage.spawn_flags();
        let [still, moved] = stage.images_of_a_moment();
        let error = flip(SIZE, &moved, &still).0;
        println!("{tracer}, without the shader: FLIP {error:.4}");
        assert!(error > 2.0 * LIMIT, "{tracer}: the wind isn't seen: {error}");
        assert_eq!(report(stage.app).posed_instances, 0);
        assert_eq!(kernels(stage.app), 0, "without the shader nothing is compiled");

        insert_shader(stage.app);
        stage.in_the_mirror();
        await_swaying(stage.app, 3);
        for moment in ["at once", "later"] {
            let [actual, expected] = stage.images_of_a_moment();
            let error = flip(SIZE, &expected, &actual).0;
            let apart = differing_pixels(&expected, &actual, LEVELS);
            println!("{tracer}, {moment}: FLIP {error:.4}, {apart} pixels apart");
            if error > LIMIT {
                let folder = dump(&format!("wind {moment}"), SIZE, &expected, &actual);
                panic!("{tracer}, {moment}: FLIP {error:.4}; see {}", folder.display());
            }
            stage.app.step(20);
        }

        stage.follow_edits(tracer);
        stage.swap_meshes(tracer);
        stage.app.world().remove_resource::<ReflectedVertexShader>();
        stage.app.step(3);
        assert_eq!(report(stage.app).posed_instances, 0, "all copies are freed");
    }
}

/// How much worse the reflection of swaying sheets is than that of still ones.
const WORSE: f32 = 1.5;

#[test]
#[ignore = "long: hundreds of frames"]
fn a_rough_floor_under_swaying_sheets_keeps_its_quality() {
    let Some(mut app) = swaying_app(ReflectionTracerChoice::Bvh) else {
        return;
    };
    let floor = Plane3d::new(Vec3::Y, Vec2::splat(12.0));
    let dark = StandardMaterial {
        base_color: Color::linear_rgb(0.6, 0.6, 0.6),
        ..metal(0.3)
    };
    spawn_mesh(&mut app, floor, dark, Transform::IDENTITY);
    let eye = Transform::from_xyz(0.0, 1.6, 3.0).looking_at(Vec3::new(0.0, 0.0, -1.0), Vec3::Y);
    let camera = spawn_camera(&mut app, eye, SceneName::MirrorRoom);
    for index in 0..9_u8 {
        let [x, z] = [index % 3, index / 3].map(f32::from);
        let sheet = StandardMaterial {
            base_color: Color::linear_rgb(0.9, 0.2 * x, 0.3 * z),
            unlit: true,
            cull_mode: None,
            ..default()
        };
        let at = Transform::from_xyz(1.4 * x - 1.4, 0.5, -0.5 - 0.9 * z);
        spawn_swaying(&mut app, sheet, at);
    }
    insert_shader(&mut app);
    let trace = |app: &mut HeadlessApp, technique, frames| {
        app.world().entity_mut(camera).insert(RayTracedReflections {
            denoiser: ReflectionDenoiser {
                converge_static_views: false,
                ..default()
            },
            ..denoised(technique)
        });
        app.step(frames);
        app.capture().unwrap()
    };
    trace(&mut app, ReflectionTechnique::Converged, 1);
    warm_up(&mut app);
    trace(&mut app, ReflectionTechnique::Variable, 1);
    warm_up(&mut app);
    await_swaying(&mut app, 9);
    let (mut moving, mut resting) = (0.0, 0.0);
    for _ in 0..4 {
        set_speed(&mut app, 1.0);
        let swaying = trace(&mut app, ReflectionTechnique::Variable, 40);
        set_speed(&mut app, 0.0);
        let still = trace(&mut app, ReflectionTechnique::Variable, 40);
        let truth = trace(&mut app, ReflectionTechnique::Converged, 128);
        moving += flip(SIZE, &truth, &swaying).0;
        resting += flip(SIZE, &truth, &still).0;
    }
    println!(
        "FLIP in the wind {moving:.4}, at rest {resting:.4}: {:.2}",
        moving / resting
    );
    assert!(moving < WORSE * resting, "{moving} in the wind, {resting} at rest");
}
