//! Meshes with vertices that a material's own shader moves.

use super::{LEVELS, LIMIT, Stage, blue};
use crate::{
    common::app_with,
    pictures::{any_tracer, differing_pixels, dump, flip},
    stage::{SIZE, frame, report},
};
use bevy::{
    asset::uuid_handle,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::{AsBindGroup, CachedPipeline, PipelineCache, PipelineDescriptor},
    shader::{Shader, ShaderRef},
};
use bevy_glint::{ReflectedMaterialPlugin, ReflectedVertexShader, ReflectedVertices, ReflectionTracerChoice};
use core::time::Duration;
use glint_scenes::{HeadlessApp, Output};
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
    let mut shaders = app.world().resource_mut::<Assets<Shader>>();
    for (id, source, name) in own {
        let path = format!("tests/{name}.wesl");
        shaders.insert(&id, Shader::from_wesl(source, path)).unwrap();
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

impl Stage<'_> {
    fn spawn_swaying(&mut self, material: StandardMaterial, at: Transform) -> Entity {
        let world = self.app.world();
        let sheet = Plane3d::new(Vec3::Z, Vec2::splat(0.5)).mesh().subdivisions(11);
        let mesh = world.resource_mut::<Assets<Mesh>>().add(sheet);
        let material = world.resource_mut::<Assets<Swaying>>().add(Swaying {
            base: material,
            extension: Wind {},
        });
        let entity = world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id();
        self.spawned.push(entity);
        entity
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

    /// Stops the clock or starts it. A pause would end when the app is warm.
    fn set_speed(&mut self, speed: f32) {
        self.app
            .world()
            .resource_mut::<Time<Virtual>>()
            .set_relative_speed(speed);
    }

    /// Vertices stay where they are while the shader has errors, and it can be edited.
    fn follow_edits(&mut self, tracer: ReflectionTracerChoice) {
        self.set_speed(0.0);
        let right = self.in_the_mirror();
        let mut edit = |from: &str, to: &str| {
            let source = IN_REFLECTIONS.replace(from, to);
            let shader = Shader::from_wesl(source, "tests/wind_in_reflections.wesl");
            let mut shaders = self.app.world().resource_mut::<Assets<Shader>>();
            shaders.insert(&REFLECTED, shader).unwrap();
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
        self.set_speed(1.0);
    }

    /// Both images of one moment.
    fn images_of_a_moment(&mut self) -> [Vec<u8>; 2] {
        self.set_speed(0.0);
        let actual = self.in_the_mirror();
        let expected = self.by_the_mirrored_camera();
        self.set_speed(1.0);
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

/// Waits until the flags sway in reflections.
fn await_flags(app: &mut HeadlessApp) {
    let start = Instant::now();
    while report(app).posed_instances < 3 {
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
        await_flags(stage.app);
        for moment in ["at once", "later"] {
            let [actual, expected] = stage.images_of_a_moment();
            let error = flip(SIZE, &expected, &actual).0;
            let apart = differing_pixels(&expected, &actual, LEVELS);
            println!("{tracer}, {moment}: FLIP {error:.4}, {apart} pixels apart");
            if error > LIMIT || std::env::var("GLINT_DUMP").is_ok() {
                let folder = dump(&format!("wind {moment}"), SIZE, &expected, &actual);
                assert!(
                    error <= LIMIT,
                    "{tracer}, {moment}: FLIP {error:.4}; see {}",
                    folder.display()
                );
            }
            stage.app.step(20);
        }

        stage.follow_edits(tracer);
        stage.app.world().remove_resource::<ReflectedVertexShader>();
        stage.app.step(3);
        assert_eq!(report(stage.app).posed_instances, 0, "all copies are freed");
    }
}
