//! An app with a tracer that answers lists of rays.

use super::{
    kernel::{self, Hit},
    scenes::Scene,
};
use crate::{
    common,
    tracer::soup::{self, Packed, Packing},
};
use bevy::{
    asset::RenderAssetUsages,
    light::NotShadowCaster,
    math::UVec2,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
    render::render_resource::{CachedPipelineState, PipelineCache},
};
use bevy_glint::{
    NotReflected, RayTracedReflections, ReflectionStatus, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracerChoice, internals::bvh::TraceRay,
};
use glint_scenes::{HeadlessApp, Output};
use std::time::Duration;

/// Limit of frames for compiling, building and merging.
const PATIENCE: u32 = 20_000;

/// The tracer's answer for a ray.
#[derive(Debug)]
pub struct Answer {
    /// The surface that the ray hits first, and the index of its object among those of the scene that are not opted out.
    pub hit: Option<(u32, Hit)>,
    /// Something that casts shadows is in the way.
    pub blocked: bool,
}

impl Answer {
    /// Distance, instance and triangle of the hit.
    pub fn named(&self) -> Option<(f32, u32, u32)> {
        self.hit.map(|(instance, hit)| (hit.t, instance, hit.primitive))
    }
}

/// An app with a camera that reflects, but looks away from everything.
pub struct OracleApp {
    app: HeadlessApp,
    camera: Entity,
    /// Entities without a parent.
    roots: Vec<Entity>,
    /// Entities that rays can hit.
    objects: Vec<Entity>,
}

impl OracleApp {
    /// Returns `None` (with the reason printed) if this machine lacks the tracer.
    pub fn new(tracer: ReflectionTracerChoice) -> Option<Self> {
        let mut app = common::app(UVec2::splat(16), Output::Picture, tracer)?;
        // Nothing is drawn, since all scenes are behind it.
        let camera = app.spawn_camera((
            Transform::from_xyz(0.0, 0.0, 1e5).looking_to(Vec3::Z, Vec3::Y),
            RayTracedReflections {
                technique: ReflectionTechnique::Quarter,
                ..default()
            },
        ));
        Some(Self {
            app,
            camera,
            roots: Vec::new(),
            objects: Vec::new(),
        })
    }

    /// Renders frames until a condition is true.
    fn wait(&mut self, complaint: &str, mut done: impl FnMut(&mut Self) -> bool) {
        for _ in 0..PATIENCE {
            self.app.step(1);
            if done(self) {
                return;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let report = self.report();
        let cache = self
            .app
            .render_world()
            .ok()
            .and_then(World::get_resource::<PipelineCache>);
        let states = cache
            .into_iter()
            .flat_map(PipelineCache::pipelines)
            .map(|one| &one.state);
        let failed: Vec<_> = states
            .filter(|state| matches!(state, CachedPipelineState::Err(_)))
            .collect();
        panic!("{complaint}: {report:?}, {failed:?}");
    }

    pub fn report(&mut self) -> ReflectionStatusReport {
        self.app.world().resource::<ReflectionStatus>().report()
    }

    /// Replaces the current scene, and waits until rays can hit all of it.
    pub fn place(&mut self, scene: &Scene) {
        let world = self.app.world();
        for root in self.roots.drain(..) {
            world.entity_mut(root).despawn();
        }
        self.objects.clear();
        let meshes: Vec<Handle<Mesh>> = scene
            .meshes
            .iter()
            .map(|mesh| world.resource_mut::<Assets<Mesh>>().add(asset(mesh)))
            .collect();
        for object in &scene.objects {
            let mesh = meshes[object.mesh].clone();
            let material = world.resource_mut::<Assets<StandardMaterial>>().add(object.material());
            let mut entity = world.spawn((Mesh3d(mesh), MeshMaterial3d(material), object.transform));
            if !object.casts_shadow {
                entity.insert(NotShadowCaster);
            }
            if !object.reflected {
                entity.insert(NotReflected);
            }
            let entity = entity.id();
            let root = match object.parent {
                Some(transform) => {
                    let parent = world.spawn((transform, Visibility::default())).id();
                    world.entity_mut(entity).insert(ChildOf(parent));
                    parent
                }
                None => entity,
            };
            self.roots.push(root);
            if object.reflected {
                self.objects.push(entity);
            }
        }
        let expected = self.objects.len();
        self.wait("the scene can't be hit", |oracle| {
            let report = oracle.report();
            report.meshes_pending == 0 && report.instances == expected
        });
        self.app.step(1);
    }

    /// The world of the app.
    pub fn world(&mut self) -> &mut World {
        self.app.world()
    }

    /// Renders frames.
    pub fn step(&mut self, frames: u32) {
        self.app.step(frames);
    }

    /// The entities of the objects that rays can hit, in the order of the scene.
    pub fn entities(&mut self) -> &mut [Entity] {
        &mut self.objects
    }

    /// Waits until all possible objects are merged.
    pub fn rest(&mut self) -> ReflectionStatusReport {
        self.app.step(3);
        self.wait("merging goes on", |oracle| {
            let report = oracle.report();
            !report.merges_pending && !report.micromaps_pending
        });
        self.report()
    }

    /// The same scene for brute force, in the tracer's current form of it.
    pub fn packed(&mut self, scene: &Scene) -> Packed {
        let report = self.report();
        let merged = report.merged_instances > 0;
        if merged && report.merged_instances < report.instances {
            self.rest();
        }
        self.packed_as(scene, merged)
    }

    /// Like [`Self::packed`], in the form of instances or of a merged tree.
    pub fn packed_as(&mut self, scene: &Scene, merged: bool) -> Packed {
        let world = self.app.world();
        let (mut instances, mut flags) = (Vec::new(), Vec::new());
        let reflected = scene.objects.iter().filter(|object| object.reflected);
        for (object, entity) in reflected.zip(&self.objects) {
            let transform = world.get::<GlobalTransform>(*entity);
            let transform = transform.expect("the entity has a place");
            instances.push((object.mesh, transform.affine()));
            flags.push(object.flags());
        }
        Packed::with(scene.meshes.clone(), instances, 0, |i| Packing {
            flags: flags[i],
            tree: merged.then_some(0),
        })
    }

    /// Has the app's tracer answer.
    pub fn trace(&mut self, rays: &[TraceRay]) -> Vec<Answer> {
        if kernel::compiled(&mut self.app).is_none() {
            self.wait("the kernel is not compiled", |oracle| {
                kernel::compiled(&mut oracle.app).is_some()
            });
        }
        let answers = kernel::trace(&mut self.app, self.camera, rays).expect("the scene is on the GPU");
        let instance = |hit: &Hit| self.objects.iter().position(|entity| Some(*entity) == hit.entity);
        let named = |hit: Hit| (instance(&hit).expect("only what is reflected can be hit") as u32, hit);
        answers
            .into_iter()
            .map(|answer| Answer {
                hit: answer.hit.map(named),
                blocked: answer.blocked.is_some(),
            })
            .collect()
    }
}

/// The alpha of vertices that triangles don't share is that of [`soup::alpha_test`]; solid materials ignore it.
fn asset(mesh: &soup::Mesh) -> Mesh {
    let count = mesh.positions.len();
    let is_solid = |vertex: usize| soup::alpha_test(0, vertex as u32 / 3, [0.0; 2]);
    let colors: Vec<[f32; 4]> = (0..count)
        .map(|vertex| [1.0, 1.0, 1.0, if is_solid(vertex) { 1.0 } else { 0.0 }])
        .collect();
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, mesh.positions.clone())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, vec![Vec3::Y.to_array(); count])
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, colors)
        .with_inserted_indices(Indices::U32(mesh.indices.clone()))
}
