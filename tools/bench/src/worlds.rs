//! Time of the plugin on the render thread and in extraction, in worlds that are large or that change.
//!
//! Each system of the plugin is timed separately, so neither Bevy's own work nor the GPU's is counted. Images are tiny, and the GPU is
//! idle when a frame begins, so that a CPU driver doesn't render during the measurement.

use crate::table::{Csv, number};
use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    math::UVec2,
    prelude::*,
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionStatusReport, ReflectionTracer,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::collections::BTreeMap;

pub const SIZE: UVec2 = UVec2::new(16, 16);
const INSTANCES: usize = 100_000;
const MOVERS: usize = 10_000;
const LIGHTS: usize = 1_000;
const MOVING_LIGHTS: usize = 100;
const MATERIALS: usize = 10_000;
/// Meshes and materials that objects share.
const KINDS: usize = 16;
/// Subdivisions of the spheres of large worlds: 320 triangles each. Merged trees have room for a small part of them.
const FINE: u32 = 3;
/// Subdivisions of the spheres that fill one merged tree: 80 triangles each.
const COARSE: u32 = 1;
const IN_A_CHUNK: usize = 13_100;
/// Spheres of 20 triangles each, all of which share one merged tree.
const MERGED: usize = 40_000;
const TINY: u32 = 0;
/// Objects with a level of detail.
const RANGED: usize = 50_000;
const SEE_THROUGH: usize = 20_000;
const FLICKERING_LIGHTS: usize = 10;
/// Frames of a round. The means of rounds are practically independent.
const FRAMES: u32 = 20;
/// Frames in which a touched object shows its cost.
const AFTERMATH: u32 = 4;
/// Consecutive frames without builds after which the world is static.
const QUIET_FRAMES: u32 = 40;
const FRAME_LIMIT: u32 = 20_000;

/// One row of the table.
struct Case {
    name: &'static str,
    world: World,
    change: Change,
    /// Milliseconds.
    limit: Option<f64>,
}

#[derive(Clone, Copy, PartialEq)]
enum World {
    /// This number of spheres with this number of subdivisions.
    Spheres(usize, u32),
    /// This number of spheres, each with its own material.
    Materials(usize),
    /// With a few spheres.
    Lights,
    /// This number of spheres, and a ghost with a mesh and a blended material of its own.
    Haunted(usize),
    /// This number of spheres with a visibility range.
    Ranged(usize),
    /// This number of blended spheres.
    SeeThrough(usize),
}

#[derive(Clone, Copy, PartialEq)]
enum Change {
    Nothing,
    /// This number of objects, the same in each frame.
    Objects(usize),
    /// This number of lights, the same in each frame.
    Lights(usize),
    /// The first material, which many objects can share.
    Material,
    /// An object that was static so far, a different one in each round.
    Touch,
    /// All objects and the camera move by one vector, once in each round.
    Shift,
    /// This number of objects each move by their own vector, once in each round.
    Explosion(usize),
    /// The alpha of the ghost.
    Fade,
    /// The mesh of the ghost.
    Edit,
    /// This number of lights go dark and come back.
    Flicker(usize),
    /// A light with render layers comes or goes.
    Flash,
    /// The camera moves by a centimetre.
    Camera,
}

impl Change {
    /// It happens once in each round.
    fn is_rare(self) -> bool {
        matches!(self, Self::Touch | Self::Shift | Self::Explosion(_))
    }
}

const CASES: [Case; 17] = [
    Case {
        name: "one static instance",
        world: World::Spheres(1, FINE),
        change: Change::Nothing,
        limit: None,
    },
    Case {
        name: "100,000 static instances",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Nothing,
        limit: Some(0.1),
    },
    Case {
        name: "one of 100,000 moves",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Objects(1),
        limit: Some(0.3),
    },
    Case {
        name: "10,000 of 100,000 move",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Objects(MOVERS),
        limit: Some(2.5),
    },
    Case {
        name: "the material of 6,250 of 100,000 changes",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Material,
        limit: None,
    },
    Case {
        name: "one of 10,000 materials changes",
        world: World::Materials(MATERIALS),
        change: Change::Material,
        limit: None,
    },
    Case {
        name: "first touch of an object in a chunk of 1 M triangles",
        world: World::Spheres(IN_A_CHUNK, COARSE),
        change: Change::Touch,
        limit: Some(1.0),
    },
    Case {
        name: "1,000 lights, 100 of them moving",
        world: World::Lights,
        change: Change::Lights(MOVING_LIGHTS),
        limit: Some(0.3),
    },
    Case {
        name: "1,000 lights, 10 of them flickering",
        world: World::Lights,
        change: Change::Flicker(FLICKERING_LIGHTS),
        limit: Some(0.3),
    },
    Case {
        name: "a light with layers comes or goes among 100,000",
        world: World::Spheres(INSTANCES, FINE),
        change: Change::Flash,
        limit: Some(0.3),
    },
    Case {
        name: "one blended material of 100,000 fades",
        world: World::Haunted(INSTANCES),
        change: Change::Fade,
        limit: Some(0.3),
    },
    Case {
        name: "one mesh of 100,000 is edited",
        world: World::Haunted(INSTANCES),
        change: Change::Edit,
        limit: Some(0.3),
    },
    Case {
        name: "the camera moves among 50,000 levels of detail",
        world: World::Ranged(RANGED),
        change: Change::Camera,
        limit: Some(0.3),
    },
    Case {
        name: "20,000 see-through objects out of sight",
        world: World::SeeThrough(SEE_THROUGH),
        change: Change::Nothing,
        limit: Some(0.3),
    },
    Case {
        name: "10,000 merged objects are shifted by one vector",
        world: World::Spheres(MERGED / 4, TINY),
        change: Change::Shift,
        limit: Some(5.0),
    },
    Case {
        name: "40,000 merged objects are shifted by one vector",
        world: World::Spheres(MERGED, TINY),
        change: Change::Shift,
        limit: Some(5.0),
    },
    Case {
        name: "an explosion moves 10,000 of 40,000 merged objects",
        world: World::Spheres(MERGED, TINY),
        change: Change::Explosion(MERGED / 4),
        limit: Some(5.0),
    },
];

/// Measures and prints the cases with `only` in their names.
///
/// # Errors
///
/// If rays can't be traced, or a world doesn't become static.
pub fn measure(
    tracers: &[ReflectionTracerChoice],
    rounds: u32,
    only: Option<&str>,
    csv: &mut Csv,
) -> Result<(), String> {
    for &tracer in tracers {
        // Several cases use a world one after the other, since large ones take long to load.
        let mut last: Option<(World, Setup)> = None;
        let mut heading = false;
        for case in CASES
            .iter()
            .filter(|case| only.is_none_or(|word| case.name.contains(word)))
        {
            let mut setup = match last.take() {
                Some((world, setup)) if world == case.world => setup,
                _ => Setup::new(tracer, case.world)?,
            };
            let word = match setup.report().tracer {
                Some(ReflectionTracer::RayQuery) => "ray-query",
                Some(ReflectionTracer::Bvh) => "bvh",
                None => return Err(format!("rays can't be traced: {}", setup.report().reasons.join(". "))),
            };
            if tracer == ReflectionTracerChoice::RayQuery && word != "ray-query" {
                println!("{}.", setup.report().reasons.join(". "));
                break;
            }
            if !heading {
                heading = true;
                let adapter = setup.report().adapter;
                println!("\nTracer {word} on {adapter}: CPU time of the plugin's systems, mean of {rounds} rounds.\n");
                println!(
                    "| case | scene ms | 95 % interval | all ms | 95 % interval | worst frame | at most | most of it |"
                );
                println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |");
            }
            let measured = setup.measure(case.change, rounds)?;
            print_row(case, word, &measured, csv);
            last = Some((case.world, setup));
        }
    }
    Ok(())
}

fn print_row(case: &Case, tracer: &str, rounds: &[Round], csv: &mut Csv) {
    let measures: [(&str, fn(&Round) -> f64); 2] = [("scene", |round| round.scene), ("all", |round| round.all)];
    let mut cells = Vec::new();
    for (word, of) in measures {
        let (mean, half) = interval(&rounds.iter().map(of).collect::<Vec<_>>());
        cells.push(format!("{mean:.3} | {:.3} to {:.3}", mean - half, mean + half));
        csv.add(case.name, tracer, &format!("worlds_{word}"), mean, "ms");
        csv.add(case.name, tracer, &format!("worlds_{word}_half_interval"), half, "ms");
    }
    let worst = rounds.iter().fold(0.0, |worst: f64, round| worst.max(round.worst));
    csv.add(case.name, tracer, "worlds_worst_frame", worst, "ms");
    let mut systems = BTreeMap::<&str, f64>::new();
    for (name, milliseconds) in rounds.iter().flat_map(|round| &round.systems) {
        *systems.entry(name).or_default() += milliseconds / rounds.len() as f64;
    }
    let mut systems: Vec<_> = systems.into_iter().collect();
    systems.sort_by(|a, b| b.1.total_cmp(&a.1));
    let short = |name: &str| name.rsplit("::").next().unwrap_or(name).to_owned();
    let most: Vec<String> = systems
        .iter()
        .take(4)
        .map(|(name, milliseconds)| format!("{} {milliseconds:.3}", short(name)))
        .collect();
    println!(
        "| {} | {} | {worst:.3} | {} | {} |",
        case.name,
        cells.join(" | "),
        number(case.limit, 1),
        most.join(", "),
    );
    for (name, milliseconds) in systems {
        csv.add(
            case.name,
            tracer,
            &format!("worlds_{}", short(name)),
            milliseconds,
            "ms",
        );
    }
}

/// Mean, and half of its 95 % interval by Student's distribution.
pub fn interval(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let freedom = count - 1.0;
    if freedom < 1.0 {
        return (mean, f64::INFINITY);
    }
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / freedom;
    // The quantile of the normal distribution, and the first terms of its expansion for few degrees of freedom.
    let z: f64 = 1.959_964;
    let t = z
        + (z.powi(3) + z) / (4.0 * freedom)
        + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * freedom * freedom);
    (mean, t * (variance / count).sqrt())
}

/// Milliseconds of a frame, on average.
struct Round {
    /// Systems that extract the world and maintain its trees.
    scene: f64,
    /// All systems of the plugin, including the systems of a camera's passes.
    all: f64,
    /// The frame that took longest.
    worst: f64,
    systems: Vec<(String, f64)>,
}

/// An app with a world.
struct Setup {
    app: HeadlessApp,
    clock: SystemClock,
    objects: Vec<Entity>,
    materials: Vec<Handle<StandardMaterial>>,
    lights: Vec<Entity>,
    camera: Entity,
    /// The mesh and the material of the ghost.
    ghost: Option<(Handle<Mesh>, Handle<StandardMaterial>)>,
    flash: Option<Entity>,
    frame: u32,
}

impl Setup {
    fn new(tracer: ReflectionTracerChoice, world: World) -> Result<Self, String> {
        let settings = HeadlessSettings {
            size: SIZE,
            ..default()
        };
        let clock = SystemClock::default();
        let mut app = HeadlessApp::new(settings, |app| {
            clock.add_plugin(app, RayTracedReflectionsPlugin { tracer, ..default() });
        })
        .map_err(|error| error.to_string())?;
        // The world lies behind the camera, because drawing it isn't the plugin's work.
        let camera = app.spawn_camera((RayTracedReflections::default(), Transform::default()));
        let mut setup = Self {
            app,
            clock,
            objects: Vec::new(),
            materials: Vec::new(),
            lights: Vec::new(),
            camera,
            ghost: None,
            flash: None,
            frame: 0,
        };
        match world {
            World::Spheres(count, subdivisions) => setup.spawn(count, subdivisions, KINDS),
            World::Materials(count) => setup.spawn(count, COARSE, count),
            World::Lights => {
                setup.spawn(100, FINE, KINDS);
                setup.spawn_lights();
            }
            World::Haunted(count) => {
                setup.spawn(count, FINE, KINDS);
                setup.spawn_ghost();
            }
            World::Ranged(count) => {
                setup.spawn(count, COARSE, KINDS);
                let range = VisibilityRange::abrupt(20.0, 60.0);
                let world = setup.app.world();
                for object in &setup.objects {
                    world.entity_mut(*object).insert(range.clone());
                }
            }
            World::SeeThrough(count) => {
                setup.spawn(count, COARSE, KINDS);
                let mut materials = setup.app.world().resource_mut::<Assets<StandardMaterial>>();
                for material in &setup.materials {
                    if let Some(mut material) = materials.get_mut(material) {
                        material.alpha_mode = AlphaMode::Blend;
                    }
                }
            }
        }
        setup.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        Ok(setup)
    }

    fn report(&mut self) -> ReflectionStatusReport {
        self.app.world().resource::<ReflectionStatus>().report()
    }

    /// Spheres on a grid of cells of three metres, which share this number of materials.
    fn spawn(&mut self, count: usize, subdivisions: u32, materials: usize) {
        let world = self.app.world();
        let meshes: Vec<_> = (0..KINDS)
            .map(|kind| {
                let radius = 0.5 + kind as f32 / KINDS as f32;
                let builder = Sphere::new(radius).mesh();
                let mesh = builder.ico(subdivisions).unwrap_or_else(|_| Sphere::new(radius).into());
                Mesh3d(world.resource_mut::<Assets<Mesh>>().add(mesh))
            })
            .collect();
        self.materials = (0..materials)
            .map(|kind| {
                let color = Color::hsl(360.0 * kind as f32 / materials as f32, 0.5, 0.5);
                world.resource_mut::<Assets<StandardMaterial>>().add(color)
            })
            .collect();
        let edge = (count as f64).cbrt().ceil() as usize;
        for index in 0..count {
            let cell = [index % edge, index / edge % edge, index / (edge * edge)].map(|cell| 3.0 * cell as f32);
            let place = Vec3::from(cell) + Vec3::new(0.0, 0.0, 10.0);
            let mesh = meshes[index * 7 % KINDS].clone();
            let material = MeshMaterial3d(self.materials[index * 7 % materials].clone());
            let object = world.spawn((mesh, material, Transform::from_translation(place)));
            self.objects.push(object.id());
        }
    }

    fn spawn_ghost(&mut self) {
        let world = self.app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::default());
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
            alpha_mode: AlphaMode::Blend,
            ..default()
        });
        let place = Transform::from_xyz(0.0, 0.0, 5.0);
        let ghost = world.spawn((Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), place));
        self.objects.push(ghost.id());
        self.ghost = Some((mesh, material));
    }

    fn spawn_lights(&mut self) {
        for index in 0..LIGHTS {
            let place = Vec3::new((index % 32) as f32, 5.0, 20.0 + (index / 32) as f32);
            let light = self
                .app
                .world()
                .spawn((PointLight::default(), Transform::from_translation(place)));
            self.lights.push(light.id());
        }
    }

    /// Renders until rays can hit every mesh, and merging is done although objects move.
    fn settle(&mut self, change: Change) -> Result<(), String> {
        let mut quiet = 0;
        for _ in 0..FRAME_LIMIT {
            self.shift(change);
            self.step();
            let report = self.report();
            let pending = report.meshes_pending > 0 || report.merges_pending || report.micromaps_pending;
            // Some levels of detail are out of their range.
            let is_there = report.instances == self.objects.len() || change == Change::Camera;
            let is_edited = change == Change::Edit && report.meshes_pending < 2 && !report.merges_pending;
            let complete = report.ready && (!pending || is_edited) && is_there;
            quiet = if complete { quiet + 1 } else { 0 };
            if quiet >= QUIET_FRAMES {
                return Ok(());
            }
        }
        let report = self.report();
        Err(format!(
            "the world has not come to rest after {FRAME_LIMIT} frames: {report:?}"
        ))
    }

    /// One frame, and the plugin's part of it.
    fn step(&mut self) -> Vec<(String, f64)> {
        self.clock.take();
        self.app.step(1);
        self.frame += 1;
        let spans = self.clock.take();
        // Fails only if the device is lost, which the next frame reports.
        _ = self.app.wait_until_idle();
        spans
    }

    /// Moves objects that are spread evenly over all.
    fn shift(&mut self, change: Change) {
        let (list, count) = match change {
            Change::Nothing | Change::Touch | Change::Shift | Change::Explosion(_) => return,
            Change::Fade | Change::Edit => return self.haunt(change),
            Change::Flicker(count) => return self.flicker(count),
            Change::Flash => return self.flash(),
            Change::Camera => {
                if let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera) {
                    transform.translation.z += 0.01;
                }
                return;
            }
            Change::Material => {
                let roughness = 0.5 + 0.001 * (self.frame % 100) as f32;
                let mut materials = self.app.world().resource_mut::<Assets<StandardMaterial>>();
                for material in self.materials.iter().take(1) {
                    if let Some(mut material) = materials.get_mut(material) {
                        material.perceptual_roughness = roughness;
                    }
                }
                return;
            }
            Change::Objects(count) => (&self.objects, count),
            Change::Lights(count) => (&self.lights, count),
        };
        let phase = self.frame as f32 * 0.1;
        let stride = (list.len() / count).max(1);
        let world = self.app.world();
        for (index, entity) in list.iter().step_by(stride).take(count).enumerate() {
            if let Some(mut transform) = world.get_mut::<Transform>(*entity) {
                transform.translation.y += 0.05 * (phase + index as f32).sin();
                transform.rotate_y(0.02);
            }
        }
    }

    fn haunt(&mut self, change: Change) {
        let Some((mesh, material)) = self.ghost.clone() else {
            return;
        };
        let phase = 0.5 + 0.004 * (self.frame % 100) as f32;
        let world = self.app.world();
        if change == Change::Edit {
            if let Some(mut mesh) = world.resource_mut::<Assets<Mesh>>().get_mut(&mesh) {
                *mesh = Cuboid::new(1.0, phase, 1.0).into();
            }
        } else if let Some(mut material) = world.resource_mut::<Assets<StandardMaterial>>().get_mut(&material) {
            material.base_color.set_alpha(phase);
        }
    }

    fn flicker(&mut self, count: usize) {
        let is_on = self.frame.is_multiple_of(2);
        let stride = (self.lights.len() / count).max(1);
        for light in self.lights.iter().step_by(stride).take(count) {
            if let Some(mut light) = self.app.world().get_mut::<PointLight>(*light) {
                light.intensity = if is_on { 100_000.0 } else { 0.0 };
            }
        }
    }

    fn flash(&mut self) {
        let world = self.app.world();
        match self.flash.take() {
            Some(flash) => _ = world.despawn(flash),
            None => {
                let light = PointLight {
                    shadow_maps_enabled: true,
                    ..default()
                };
                let flash = (light, RenderLayers::from_layers(&[0, 1]), Transform::default());
                self.flash = Some(world.spawn(flash).id());
            }
        }
    }

    fn measure(&mut self, change: Change, rounds: u32) -> Result<Vec<Round>, String> {
        self.settle(change)?;
        if change.is_rare() {
            return (1..=rounds as usize)
                .map(|round| self.disturb(change, round, rounds))
                .collect();
        }
        let round = |_| {
            let frames = (0..FRAMES).map(|_| {
                self.shift(change);
                self.step()
            });
            Round::of(&frames.collect::<Vec<_>>())
        };
        Ok((0..rounds).map(round).collect())
    }

    /// Moves objects that haven't moved lately. The longest frame counts.
    fn disturb(&mut self, change: Change, round: usize, rounds: u32) -> Result<Round, String> {
        let (first, stride) = match change {
            Change::Shift => (0, 1),
            Change::Explosion(count) => (0, self.objects.len() / count),
            // In each round, an object that never moved.
            _ => (round * self.objects.len() / (rounds as usize + 1), self.objects.len()),
        };
        for (index, object) in self.objects.iter().enumerate().skip(first).step_by(stride) {
            if let Some(mut transform) = self.app.world().get_mut::<Transform>(*object) {
                let own = if change == Change::Shift {
                    0.0
                } else {
                    0.1 * (index % 7) as f32
                };
                transform.translation += Vec3::new(own, 0.5, own);
            }
        }
        if change == Change::Shift
            && let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera)
        {
            transform.translation.y += 0.5;
        }
        let frames = (0..AFTERMATH).map(|_| Round::of(&[self.step()]));
        let slowest = frames.max_by(|a, b| a.all.total_cmp(&b.all));
        self.settle(Change::Nothing)?;
        slowest.ok_or_else(|| "no frame was measured".to_owned())
    }
}

impl Round {
    fn of(frames: &[Vec<(String, f64)>]) -> Self {
        let count = frames.len() as f64;
        let mut systems = BTreeMap::<String, f64>::new();
        for (name, milliseconds) in frames.iter().flatten() {
            *systems.entry(name.clone()).or_default() += milliseconds / count;
        }
        let total = |frame: &[(String, f64)]| frame.iter().map(|(_, milliseconds)| milliseconds).sum::<f64>();
        let of_scene = systems.iter().filter(|(name, _)| name.contains("::scene::"));
        Self {
            scene: of_scene.map(|(_, milliseconds)| milliseconds).sum(),
            all: systems.values().sum(),
            worst: frames.iter().fold(0.0, |worst: f64, frame| worst.max(total(frame))),
            systems: systems.into_iter().collect(),
        }
    }
}
