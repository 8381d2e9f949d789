//! An app with a tracer that answers lists of rays.

use super::scenes::Scene;
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
    render::{
        RenderApp,
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BufferDescriptor,
            BufferInitDescriptor, BufferUsages, CachedComputePipelineId, CommandEncoderDescriptor,
            ComputePassDescriptor, ComputePipelineDescriptor, PipelineCache, ShaderStages, binding_types,
        },
        renderer::{RenderDevice, RenderQueue},
    },
    shader::{Shader, ShaderDefVal},
};
use bevy_glint::{
    NotReflected, RayTracedReflections, ReflectionStatus, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracerChoice,
    internals::{SceneBindings, bvh::TraceRay, instances::SceneInstances},
};
use bytemuck::{Pod, Zeroable};
use core::num::NonZeroU64;
use glint_scenes::{HeadlessApp, Output, read_buffer};
use std::{collections::HashMap, time::Duration};

/// Limit of frames for compiling, building and merging.
const PATIENCE: u32 = 20_000;
const NO_HIT: u32 = u32::MAX;

/// `Answer` of `oracle.wesl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct GpuAnswer {
    t: f32,
    instance: u32,
    primitive: u32,
    flags: u32,
    barycentrics: [f32; 2],
    _padding: [f32; 2],
}

/// The surface that a ray hits first.
#[derive(Debug)]
pub struct Hit {
    pub t: f32,
    /// Index among the objects of the scene that are not opted out.
    pub instance: u32,
    pub primitive: u32,
    pub front_face: bool,
    pub barycentrics: [f32; 2],
}

/// The tracer's answer for a ray.
#[derive(Debug)]
pub struct Answer {
    pub hit: Option<Hit>,
    /// Something that casts shadows is in the way.
    pub blocked: bool,
}

/// An app with a camera that reflects, but looks away from everything.
pub struct OracleApp {
    app: HeadlessApp,
    layout: BindGroupLayoutDescriptor,
    shader: Handle<Shader>,
    /// By their definitions.
    pipelines: Vec<(Vec<ShaderDefVal>, CachedComputePipelineId)>,
    /// Entities without a parent.
    roots: Vec<Entity>,
    /// Entities that rays can hit.
    objects: Vec<Entity>,
}

fn render_world(app: &mut HeadlessApp) -> &World {
    let render = app.app().get_sub_app(RenderApp);
    render.expect("there is a renderer").world()
}

impl OracleApp {
    /// Returns `None` (with the reason printed) if this machine lacks the tracer.
    pub fn new(tracer: ReflectionTracerChoice) -> Option<Self> {
        let mut app = common::app(UVec2::splat(16), Output::Picture, tracer)?;
        // Nothing is drawn, since all scenes are behind it.
        app.spawn_camera((
            Transform::from_xyz(0.0, 0.0, 1e5).looking_to(Vec3::Z, Vec3::Y),
            RayTracedReflections {
                technique: ReflectionTechnique::Quarter,
                ..default()
            },
        ));
        let shader = Shader::from_wesl(include_str!("oracle.wesl"), "embedded://bevy_glint_oracle/oracle.wesl");
        let shader = app.world().resource_mut::<Assets<Shader>>().add(shader);
        for _ in 0..PATIENCE {
            app.step(1);
            if render_world(&mut app).contains_resource::<SceneBindings>() {
                break;
            }
        }

        let storage = NonZeroU64::new(size_of::<GpuAnswer>() as u64);
        let layout = BindGroupLayoutDescriptor::new(
            "oracle_layout",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    binding_types::storage_buffer_read_only_sized(false, storage),
                    binding_types::storage_buffer_sized(false, storage),
                ),
            ),
        );
        Some(Self {
            app,
            layout,
            shader,
            pipelines: Vec::new(),
            roots: Vec::new(),
            objects: Vec::new(),
        })
    }

    /// The kernel for the current scene.
    fn pipeline(&mut self) -> CachedComputePipelineId {
        let defs = render_world(&mut self.app).resource::<SceneBindings>().shader_defs();
        if let Some((_, id)) = self.pipelines.iter().find(|(known, _)| *known == defs) {
            return *id;
        }
        let world = render_world(&mut self.app);
        let (cache, scene) = (world.resource::<PipelineCache>(), world.resource::<SceneBindings>());
        let id = cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some("oracle".into()),
            layout: vec![self.layout.clone(), scene.layout.clone()],
            shader: self.shader.clone(),
            shader_defs: defs.clone(),
            entry_point: Some("trace_rays".into()),
            ..default()
        });
        self.pipelines.push((defs, id));
        self.wait("the kernel is not compiled", |oracle| {
            let cache = render_world(&mut oracle.app).resource::<PipelineCache>();
            cache.get_compute_pipeline(id).is_some()
        });
        id
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
        let pipelines = self.pipelines.clone();
        let report = self.report();
        let cache = render_world(&mut self.app).resource::<PipelineCache>();
        let states: Vec<_> = pipelines
            .iter()
            .map(|(_, id)| cache.get_compute_pipeline_state(*id))
            .collect();
        panic!("{complaint}: {report:?}, {states:?}");
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
        let pipeline = self.pipeline();
        let objects = self.objects.iter().copied();
        let indices: HashMap<Entity, u32> = objects.zip(0..).collect();
        let world = render_world(&mut self.app);
        let (device, queue) = (world.resource::<RenderDevice>(), world.resource::<RenderQueue>());
        let (cache, scene) = (world.resource::<PipelineCache>(), world.resource::<SceneBindings>());

        let list: Vec<[f32; 8]> = rays
            .iter()
            .map(|ray| {
                let (o, d) = (ray.origin, ray.direction);
                [o.x, o.y, o.z, ray.t_min, d.x, d.y, d.z, ray.t_max]
            })
            .collect();
        let input = device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("oracle_rays"),
            contents: bytemuck::cast_slice(&list),
            usage: BufferUsages::STORAGE,
        });
        let output = device.create_buffer(&BufferDescriptor {
            label: Some("oracle_answers"),
            size: (rays.len() * size_of::<GpuAnswer>()) as u64,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let lists = device.create_bind_group(
            "oracle",
            &cache.get_bind_group_layout(&self.layout),
            &BindGroupEntries::sequential((input.as_entire_binding(), output.as_entire_binding())),
        );

        let pipeline = cache.get_compute_pipeline(pipeline);
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor { label: Some("oracle") });
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("oracle"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline.expect("the kernel is compiled"));
            pass.set_bind_group(0, &lists, &[]);
            pass.set_bind_group(1, scene.bind_group.as_ref().expect("a camera reflects"), &[]);
            pass.dispatch_workgroups(rays.len().div_ceil(64) as u32, 1, 1);
        }
        queue.submit([encoder.finish()]);
        let bytes = read_buffer(world, &output).expect("the answers can be read");
        let answers: Vec<GpuAnswer> = bytemuck::pod_collect_to_vec(&bytes);

        let slots = world.resource::<SceneInstances>().slots();
        let instance_of = |answer: &GpuAnswer| {
            let source = slots.get(answer.instance as usize)?.as_ref()?;
            indices.get(&source.entity).copied()
        };
        answers
            .iter()
            .map(|answer| Answer {
                hit: (answer.instance != NO_HIT).then(|| Hit {
                    t: answer.t,
                    instance: instance_of(answer).expect("only what is reflected can be hit"),
                    primitive: answer.primitive,
                    front_face: answer.flags & 1 != 0,
                    barycentrics: answer.barycentrics,
                }),
                blocked: answer.flags & 2 != 0,
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
