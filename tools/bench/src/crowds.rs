//! Cost of crowds: of characters and fields, which are posed on the GPU in each frame, of particles and decals, and of lamps,
//! which hits sample.

use crate::{
    arguments::Plan,
    measure::tracer_word,
    table::{Csv, number, quantile},
    worlds::interval,
};
use bevy::{
    asset::RenderAssetUsages,
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    light::ClusteredDecal,
    material::OpaqueRendererMethod,
    math::UVec2,
    mesh::{
        VertexAttributeValues,
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    prelude::*,
    render::{
        diagnostic::RenderDiagnosticsPlugin,
        render_resource::{Extent3d, TextureDimension, TextureFormat},
    },
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectedParticle, ReflectedParticles, ReflectedPose,
    ReflectedVertexShader, ReflectedVertices, ReflectionStatus, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::collections::BTreeMap;

/// Lamps of the street.
const LAMPS: [usize; 2] = [10, 10_000];
/// Triangles around a character, and along it: 20,000 in all.
const AROUND: u32 = 100;
const ALONG: u32 = 100;
const JOINTS: usize = 8;
const PARTICLES: u16 = 10_000;
const DECALS: u16 = 1_000;
const FRAME_LIMIT: u32 = 20_000;
/// Warm-up frames.
const WARM_UP_FRAMES: u32 = 10;

/// Moves the vertices of the field.
const WIND: &str = "
    import bevy_glint::scene::pose::vertex::{VertexPoint, WorldVertex};

    fn reflected_vertex(vertex: WorldVertex, at: VertexPoint) -> WorldVertex {
        var moved = vertex;
        moved.position.x += 0.3 * (1.0 - at.uv.y) * sin(3.0 * at.seconds + vertex.position.x);
        return moved;
    }
";

/// Measures and prints.
///
/// # Errors
///
/// If rays can't be traced, or a world isn't ready in time.
pub fn measure(plan: &Plan, characters: usize, only: Option<&str>, csv: &mut Csv) -> Result<(), String> {
    let wants = |name: &str| only.is_none_or(|word| name.contains(word));
    let Plan { size, frames, .. } = *plan;
    for &tracer in &plan.tracers {
        let mut setup = Setup::new(tracer, size)?;
        let report = setup.report();
        let Some(word) = tracer_word(&report, tracer)? else {
            println!("{}.", report.reasons.join(". "));
            continue;
        };
        let adapter = &report.adapter;
        println!(
            "\nTracer {word} on {adapter}, {}x{}, {frames} frames.\n",
            size.x, size.y
        );
        println!("| case | posed | pose GPU ms | trace GPU ms | CPU ms of the plugin | 95 % interval | most of it |");
        println!("| --- | ---: | ---: | ---: | ---: | ---: | --- |");
        if wants("characters") {
            setup.spawn_characters(characters);
            for (name, pose, walks) in [
                ("characters, rigid", ReflectedPose::Rigid, true),
                ("characters, standing", ReflectedPose::Posed, false),
                ("characters, walking", ReflectedPose::Posed, true),
            ] {
                setup.set_pose(pose);
                let measured = setup.measure(frames, walks)?;
                measured.print(&format!("{characters} {name}"), word, csv);
            }
        }
        if wants("field") {
            let mut setup = Setup::new(tracer, size)?;
            setup.spawn_field();
            for (name, sways) in [("that stands", false), ("that sways", true)] {
                if sways {
                    setup.insert_wind();
                }
                let measured = setup.measure(frames, sways)?;
                measured.print(&format!("a field of 200,000 triangles {name}"), word, csv);
            }
        }
        if wants("particles") {
            let mut setup = Setup::new(tracer, size)?;
            setup.spawn_pond();
            for (name, count, fly) in [
                ("no particles", 0, false),
                ("10,000 particles that stay", PARTICLES, false),
                ("10,000 particles that fly", PARTICLES, true),
            ] {
                setup.set_particles(count);
                let measured = setup.measure(frames, fly)?;
                measured.print(name, word, csv);
            }
        }
        if wants("decals") {
            measure_decals(tracer, plan, word, csv)?;
        }
        if wants("lamps") {
            // The characters would be lit.
            let mut setup = Setup::new(tracer, size)?;
            setup.spawn_street();
            for count in LAMPS {
                let lamps = setup.spawn_lamps(count);
                let measured = setup.measure(frames, false)?;
                measured.print(&format!("{count} lamps"), word, csv);
                for lamp in lamps {
                    setup.app.world().despawn(lamp);
                }
            }
        }
    }
    Ok(())
}

fn measure_decals(tracer: ReflectionTracerChoice, plan: &Plan, word: &str, csv: &mut Csv) -> Result<(), String> {
    let mut setup = Setup::new(tracer, plan.size)?;
    setup.spawn_street();
    setup.app.world().spawn(DirectionalLight::default());
    for (name, count, moves) in [
        ("no decals", 0, false),
        ("1,000 decals", DECALS, false),
        ("1,000 decals, one of which moves", 0, true),
    ] {
        setup.spawn_decals(count);
        let measured = setup.measure(plan.frames, moves)?;
        measured.print(name, word, csv);
    }
    Ok(())
}

/// Milliseconds of each frame.
#[derive(Default)]
struct Measured {
    posed: usize,
    pose: Vec<f64>,
    trace: Vec<f64>,
    systems: Vec<f64>,
    /// Milliseconds of all frames by system.
    by_system: BTreeMap<String, f64>,
}

impl Measured {
    fn print(&self, case: &str, tracer: &str, csv: &mut Csv) {
        let [pose, trace] = [&self.pose, &self.trace].map(|times| quantile(times, 0.5));
        let (mean, half) = interval(&self.systems);
        let mut systems: Vec<_> = self.by_system.iter().collect();
        systems.sort_by(|a, b| b.1.total_cmp(a.1));
        let frames = self.systems.len() as f64;
        let short = |name: &str| name.rsplit("::").next().unwrap_or(name).to_owned();
        let most: Vec<String> = systems
            .iter()
            .take(6)
            .map(|(name, sum)| format!("{} {:.3}", short(name), *sum / frames))
            .collect();
        println!(
            "| {case} | {} | {} | {} | {mean:.3} | {:.3} to {:.3} | {} |",
            self.posed,
            number(pose, 4),
            number(trace, 4),
            mean - half,
            mean + half,
            most.join(", "),
        );
        for (measure, value) in [("pose_gpu", pose), ("trace_gpu", trace), ("plugin_cpu", Some(mean))] {
            if let Some(value) = value {
                csv.add(case, tracer, &format!("crowds_{measure}"), value, "ms");
            }
        }
    }
}

/// An app with a crowd.
struct Setup {
    app: HeadlessApp,
    clock: SystemClock,
    camera: Entity,
    characters: Vec<Entity>,
    joints: Vec<Entity>,
    particles: Option<Entity>,
    decals: Vec<Entity>,
    frame: u32,
}

impl Setup {
    fn new(tracer: ReflectionTracerChoice, size: UVec2) -> Result<Self, String> {
        let settings = HeadlessSettings { size, ..default() };
        let clock = SystemClock::default();
        let mut app = HeadlessApp::new(settings, |app| {
            app.add_plugins(RenderDiagnosticsPlugin);
            clock.add_plugin(app, RayTracedReflectionsPlugin { tracer, ..default() });
        })
        .map_err(|error| error.to_string())?;
        let eye = Transform::from_xyz(0.0, 1.7, 3.0).looking_at(Vec3::new(0.0, 1.0, -10.0), Vec3::Y);
        let reflections = RayTracedReflections {
            technique: ReflectionTechnique::Reference,
            roughness_cutoff: 1.0,
            roughness_fade: 0.0,
            ..default()
        };
        let camera = app.spawn_camera((eye, reflections));
        Ok(Self {
            app,
            clock,
            camera,
            characters: Vec::new(),
            joints: Vec::new(),
            particles: None,
            decals: Vec::new(),
            frame: 0,
        })
    }

    fn report(&mut self) -> ReflectionStatusReport {
        self.app.world().resource::<ReflectionStatus>().report()
    }

    fn spawn(&mut self, mesh: impl Into<Mesh>, color: Color, perceptual_roughness: f32, at: Transform) -> Entity {
        let world = self.app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
            base_color: color,
            perceptual_roughness,
            ..default()
        });
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
    }

    /// Characters on polished ground.
    fn spawn_characters(&mut self, count: usize) {
        let ground = Plane3d::new(Vec3::Y, Vec2::splat(60.0));
        self.spawn(ground, Color::srgb(0.3, 0.3, 0.3), 0.1, Transform::IDENTITY);
        let sun = Transform::default().looking_to(Vec3::new(0.3, -1.0, -0.4), Vec3::Y);
        let world = self.app.world();
        world.spawn((DirectionalLight::default(), sun));
        let mesh = world.resource_mut::<Assets<Mesh>>().add(character());
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(Color::srgb(0.7, 0.5, 0.4));
        let bind = |joint: usize| Mat4::from_translation(Vec3::Y * -joint_height(joint));
        let poses: Vec<Mat4> = (0..JOINTS).map(bind).collect();
        let mut all_poses = world.resource_mut::<Assets<SkinnedMeshInverseBindposes>>();
        let inverse_bindposes = all_poses.add(SkinnedMeshInverseBindposes::from(poses));
        for index in 0..count {
            let place = Vec3::new(1.2 * (index % 10) as f32 - 5.4, 0.0, -2.0 - 1.5 * (index / 10) as f32);
            let joint = |joint: usize| {
                let at = if joint == 0 { place } else { joint_height(1) * Vec3::Y };
                world
                    .spawn((Transform::from_translation(at), Visibility::default()))
                    .id()
            };
            let joints: Vec<Entity> = (0..JOINTS).map(joint).collect();
            for pair in joints.windows(2) {
                world.entity_mut(pair[0]).add_child(pair[1]);
            }
            let skin = SkinnedMesh {
                inverse_bindposes: inverse_bindposes.clone(),
                joints: joints.clone(),
            };
            let parts = (Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), skin);
            self.characters.push(world.spawn(parts).id());
            self.joints.extend(&joints[1..]);
        }
    }

    fn spawn_pond(&mut self) {
        let water = Plane3d::new(Vec3::Y, Vec2::splat(8.0));
        let at = Transform::from_xyz(0.0, 0.0, -4.0);
        self.spawn(water, Color::srgb(0.02, 0.05, 0.05), 0.05, at);
    }

    /// Unlit particles over the pond, in place of the last ones.
    fn set_particles(&mut self, count: u16) {
        if let Some(last) = self.particles.take() {
            self.app.world().despawn(last);
        }
        if count == 0 {
            return;
        }
        let world = self.app.world();
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
            alpha_mode: AlphaMode::Add,
            unlit: true,
            ..default()
        });
        let particles = (0..count).map(|index| particle(index, 0)).collect();
        self.particles = Some(world.spawn(ReflectedParticles { particles, material }).id());
    }

    /// A field before a pond, as one mesh.
    fn spawn_field(&mut self) {
        self.spawn_pond();
        let sheet = Plane3d::new(Vec3::Z, Vec2::new(8.0, 1.0)).mesh().subdivisions(315);
        let at = Transform::from_xyz(0.0, 1.0, -12.0);
        let field = self.spawn(sheet, Color::srgb(0.4, 0.5, 0.2), 0.9, at);
        self.app.world().entity_mut(field).insert(ReflectedVertices::default());
    }

    /// Has the app's shader move the field.
    fn insert_wind(&mut self) {
        let shader = Shader::from_wesl(WIND, "bench/wind.wesl");
        let shader = self.app.world().resource_mut::<Assets<Shader>>().add(shader);
        self.app
            .world()
            .insert_resource(ReflectedVertexShader { shader, ..default() });
        // Until it is compiled, nothing moves.
        for _ in 0..FRAME_LIMIT {
            if self.report().posed_instances > 0 {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
            self.app.step(1);
        }
    }

    fn set_pose(&mut self, pose: ReflectedPose) {
        for character in &self.characters {
            self.app.world().entity_mut(*character).insert(pose);
        }
    }

    /// Wet ground between houses.
    fn spawn_street(&mut self) {
        let at = Transform::from_xyz(0.0, -0.1, -35.0);
        self.spawn(Cuboid::new(9.0, 0.2, 90.0), Color::srgb(0.2, 0.2, 0.2), 0.25, at);
        for index in 0..20u32 {
            let side = if index.is_multiple_of(2) { -1.0 } else { 1.0 };
            let at = Transform::from_xyz(side * 6.5, 4.0, -8.0 * (index / 2) as f32);
            let size = Cuboid::new(4.0 + 0.2 * (index % 3) as f32, 8.0, 7.5);
            self.spawn(size, Color::srgb(0.6, 0.5, 0.4), 0.8, at);
        }
    }

    /// Spawns this number of decals on the walls along the street.
    fn spawn_decals(&mut self, count: u16) {
        let world = self.app.world();
        let paint = Image::new_fill(
            Extent3d {
                width: 4,
                height: 4,
                ..default()
            },
            TextureDimension::D2,
            &[200, 60, 30, 128],
            TextureFormat::Rgba8UnormSrgb,
            RenderAssetUsages::default(),
        );
        let paint = world.resource_mut::<Assets<Image>>().add(paint);
        // Bevy's G-buffer has no decals. The ground is deferred, and reflects.
        for (_, material) in world.resource_mut::<Assets<StandardMaterial>>().iter_mut() {
            if material.perceptual_roughness > 0.5 {
                material.opaque_render_method = OpaqueRendererMethod::Forward;
            }
        }
        for index in 0..count {
            let part = (f32::from(index) + 0.5) / f32::from(count);
            let side = if index.is_multiple_of(2) { -1.0 } else { 1.0 };
            let at = Vec3::new(side * 4.4, 0.3 + 6.0 * (part * 617.0).fract(), -75.0 * part);
            let place = Transform::from_translation(at).looking_to(side * Vec3::X, Vec3::Y);
            let decal = ClusteredDecal {
                base_color_texture: Some(paint.clone()),
                ..default()
            };
            let decal = world.spawn((decal, place.with_scale(Vec3::splat(0.8)))).id();
            self.decals.push(decal);
        }
    }

    /// Spawns this number of lamps along the street. They share its light.
    fn spawn_lamps(&mut self, count: usize) -> Vec<Entity> {
        let spawn = |index: usize| {
            let part = (index as f32 + 0.5) / count as f32;
            let at = Vec3::new(
                8.0 * (part * 617.0).fract() - 4.0,
                4.0 + (part * 1_237.0).fract(),
                -75.0 * part,
            );
            let lamp = PointLight {
                intensity: 3e6 / count as f32,
                range: if count > 100 { 6.0 } else { 20.0 },
                ..default()
            };
            self.app.world().spawn((lamp, Transform::from_translation(at))).id()
        };
        (0..count).map(spawn).collect()
    }

    /// Turns the camera a little to one side and back, since a static view does other work, and moves particles, a decal and the joints of
    /// walkers.
    fn shift(&mut self, walks: bool) {
        self.frame += 1;
        let turn = if self.frame.is_multiple_of(2) { 1e-4 } else { -1e-4 };
        let world = self.app.world();
        if let Some(mut transform) = world.get_mut::<Transform>(self.camera) {
            transform.rotate_y(turn);
        }
        if !walks {
            return;
        }
        if let Some(mut all) = self
            .particles
            .and_then(|entity| world.get_mut::<ReflectedParticles>(entity))
        {
            for (index, shown) in (0..PARTICLES).zip(&mut all.particles) {
                *shown = particle(index, self.frame);
            }
        }
        if let Some(mut transform) = self.decals.first().and_then(|decal| world.get_mut::<Transform>(*decal)) {
            transform.translation.y = 2.0 + (0.05 * self.frame as f32).sin();
        }
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mut transform) = world.get_mut::<Transform>(*joint) {
                transform.rotation = Quat::from_rotation_x(0.15 * (0.2 * self.frame as f32 + index as f32).sin());
            }
        }
    }

    fn measure(&mut self, frames: u32, walks: bool) -> Result<Measured, String> {
        self.app.step(2);
        self.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        let mut waited = 0;
        loop {
            let report = self.report();
            if report.ready && report.meshes_pending == 0 && !report.merges_pending {
                break;
            }
            waited += 1;
            if waited > FRAME_LIMIT {
                return Err(format!("not ready after {FRAME_LIMIT} frames: {report}"));
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
            self.app.step(1);
        }
        let mut measured = Measured::default();
        for frame in 0..WARM_UP_FRAMES + frames {
            self.shift(walks);
            self.clock.take();
            self.app.step(1);
            let systems = self.clock.take();
            self.app.wait_until_idle().map_err(|error| error.to_string())?;
            if frame < WARM_UP_FRAMES {
                continue;
            }
            measured
                .systems
                .push(systems.iter().map(|(_, milliseconds)| milliseconds).sum());
            for (name, milliseconds) in systems {
                *measured.by_system.entry(name).or_default() += milliseconds;
            }
            let store = self.app.world().resource::<DiagnosticsStore>();
            let latest = |path: &'static str| store.get(&DiagnosticPath::const_new(path))?.value();
            measured.trace.extend(latest("render/glint/trace/elapsed_gpu"));
            if walks {
                measured.pose.extend(latest("render/glint_pose/elapsed_gpu"));
            }
        }
        measured.posed = self.report().posed_instances;
        if measured.posed == 0 {
            measured.pose.clear();
        }
        Ok(measured)
    }
}

/// A particle that rises from the pond.
fn particle(index: u16, frame: u32) -> ReflectedParticle {
    let part = f32::from(index) / f32::from(PARTICLES);
    let rise = (part * 977.0 + 0.005 * frame as f32).fract();
    ReflectedParticle {
        position: Vec3::new(
            12.0 * (part * 617.0).fract() - 6.0,
            3.0 * rise,
            -1.0 - 8.0 * (part * 1_237.0).fract(),
        ),
        size: Vec2::splat(0.05),
        ..default()
    }
}

fn joint_height(joint: usize) -> f32 {
    1.8 * joint as f32 / JOINTS as f32
}

/// A cylinder of 20,000 triangles and its caps, with joints above each other.
fn character() -> Mesh {
    let mut mesh = Cylinder::new(0.3, 1.8)
        .mesh()
        .resolution(AROUND)
        .segments(ALONG)
        .build();
    mesh.asset_usage = RenderAssetUsages::default();
    mesh.translate_by(Vec3::Y * 0.9);
    let Some(VertexAttributeValues::Float32x3(places)) = mesh.attribute(Mesh::ATTRIBUTE_POSITION) else {
        return mesh;
    };
    let (mut joints, mut weights) = (Vec::new(), Vec::new());
    for [_, y, _] in places {
        let along = (y / joint_height(1)).clamp(0.0, (JOINTS - 1) as f32);
        let first = (along.floor() as u16).min(JOINTS as u16 - 2);
        let share = along - f32::from(first);
        joints.push([first, first + 1, 0, 0]);
        weights.push([1.0 - share, share, 0.0, 0.0]);
    }
    mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, VertexAttributeValues::Uint16x4(joints));
    mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights);
    mesh
}
