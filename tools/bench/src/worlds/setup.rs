//! An app with a world of the table, and changes in it.

use bevy::{
    asset::uuid_handle,
    camera::visibility::{RenderLayers, VisibilityRange},
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::ShaderRef,
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionStatusReport, ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, SystemClock};
use std::collections::BTreeMap;

pub const SIZE: UVec2 = UVec2::new(16, 16);
/// Subdivisions of the spheres of large worlds: 320 triangles each. Merged trees have room for a small part of them.
pub const FINE: u32 = 3;
/// Subdivisions of the spheres that fill one merged tree: 80 triangles each.
pub const COARSE: u32 = 1;
const LIGHTS: usize = 1_000;
/// Meshes and materials that objects share.
const KINDS: usize = 16;
/// Frames of a round. The means of rounds are practically independent.
const FRAMES: u32 = 20;
/// Frames in which a touched object shows its cost.
const AFTERMATH: u32 = 4;
/// Consecutive frames without builds after which the world is static.
const QUIET_FRAMES: u32 = 40;
const FRAME_LIMIT: u32 = 20_000;

#[derive(Clone, Copy, PartialEq)]
pub enum World {
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
    /// This number of spheres, each with its own material, and one with a material that has a shader of its own.
    Stylised(usize),
}

#[derive(Clone, Copy, PartialEq)]
pub enum Change {
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
    /// The frames after a shift in which everything is merged anew.
    Merge,
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
        matches!(self, Self::Touch | Self::Explosion(_)) || self.shifts()
    }

    /// Everything moves by one vector.
    fn shifts(self) -> bool {
        matches!(self, Self::Shift | Self::Merge)
    }
}

/// Milliseconds of a frame, on average.
pub struct Round {
    /// Systems that extract the world and maintain its trees.
    pub scene: f64,
    /// All systems of the plugin, including the systems of a camera's passes.
    pub all: f64,
    /// The frame that took longest.
    pub worst: f64,
    pub systems: Vec<(String, f64)>,
}

/// A material that the G-buffer would show without its shader.
type Stylised = ExtendedMaterial<StandardMaterial, OwnShader>;

/// Never added to the assets, since the camera sees nothing of the world.
const OWN_SHADER: Handle<Shader> = uuid_handle!("0b3f6f0e-52b4-4a57-8a93-7d5f0e2f9a44");

#[derive(Asset, AsBindGroup, TypePath, Clone)]
struct OwnShader {}

impl MaterialExtension for OwnShader {
    fn fragment_shader() -> ShaderRef {
        OWN_SHADER.into()
    }
}

/// An app with a world.
pub struct Setup {
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
    pub fn new(tracer: ReflectionTracerChoice, world: World) -> Result<Self, String> {
        let settings = HeadlessSettings {
            size: SIZE,
            ..default()
        };
        let clock = SystemClock::default();
        let mut app = HeadlessApp::new(settings, |app| {
            app.add_plugins(MaterialPlugin::<Stylised>::default());
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
            World::Stylised(count) => {
                setup.spawn(count, COARSE, count);
                setup.spawn_stylised();
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

    pub fn report(&mut self) -> ReflectionStatusReport {
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

    fn spawn_stylised(&mut self) {
        let world = self.app.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::default());
        let material = world.resource_mut::<Assets<Stylised>>().add(Stylised {
            base: StandardMaterial::default(),
            extension: OwnShader {},
        });
        let place = Transform::from_xyz(0.0, 0.0, 5.0);
        // Rays don't hit it, so that it isn't one of the objects.
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material), place));
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

    /// Renders until rays can hit every mesh, and merging is done although objects move. Returns the longest frame.
    fn settle(&mut self, change: Change) -> Result<Round, String> {
        let mut quiet = 0;
        let mut slowest = Round::of(&[]);
        for _ in 0..FRAME_LIMIT {
            self.shift(change);
            let frame = Round::of(&[self.step()]);
            if frame.all > slowest.all {
                slowest = frame;
            }
            let report = self.report();
            let pending = report.meshes_pending > 0 || report.merges_pending || report.micromaps_pending;
            // Some levels of detail are out of their range.
            let is_there = report.instances == self.objects.len() || change == Change::Camera;
            let is_edited = change == Change::Edit && report.meshes_pending < 2 && !report.merges_pending;
            let complete = report.ready && (!pending || is_edited) && is_there;
            quiet = if complete { quiet + 1 } else { 0 };
            if quiet >= QUIET_FRAMES {
                return Ok(slowest);
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
            Change::Nothing | Change::Touch | Change::Shift | Change::Merge | Change::Explosion(_) => return,
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

    pub fn measure(&mut self, change: Change, rounds: u32) -> Result<Vec<Round>, String> {
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
            Change::Shift | Change::Merge => (0, 1),
            Change::Explosion(count) => (0, self.objects.len() / count),
            // In each round, an object that never moved.
            _ => (round * self.objects.len() / (rounds as usize + 1), self.objects.len()),
        };
        for (index, object) in self.objects.iter().enumerate().skip(first).step_by(stride) {
            if let Some(mut transform) = self.app.world().get_mut::<Transform>(*object) {
                let own = if change.shifts() { 0.0 } else { 0.1 * (index % 7) as f32 };
                transform.translation += Vec3::new(own, 0.5, own);
            }
        }
        if change.shifts()
            && let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera)
        {
            transform.translation.y += 0.5;
        }
        let frames = (0..AFTERMATH).map(|_| Round::of(&[self.step()]));
        let slowest = frames.max_by(|a, b| a.all.total_cmp(&b.all));
        let later = self.settle(Change::Nothing)?;
        if change == Change::Merge {
            return Ok(later);
        }
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
