//! Decides which objects have a copy of their mesh, and which are posed in a frame.

use super::{
    bounds::{enlarged, posed_bounds},
    extract::{ExtractedPoses, PoseSource, Rows},
    job::{Batch, PoseJob},
    kernels::{KernelCache, MOST_JOBS, PosePass},
    vertex_shader::Motion,
};
use crate::{
    device::ReflectionTracer,
    scene::{
        acceleration::PosedVertices,
        arena::ArenaSlice,
        bvh::{Bounds, ITEM_WORDS},
        geometry::{HEADER_WORDS, MeshOffsets},
        instances::SceneInstances,
        meshes::{SceneMesh, SceneMeshes},
    },
};
use bevy::{
    asset::{AssetId, AssetServer},
    ecs::{entity::Entity, world::World},
    log::warn_once,
    math::Vec3,
    mesh::Mesh,
    platform::collections::{HashMap, hash_map::Entry},
    render::{
        diagnostic::DiagnosticsRecorder,
        render_resource::PipelineCache,
        renderer::{PendingCommandBuffers, RenderDevice, RenderQueue},
    },
};

/// Resources of the render world that poses depend on.
pub(in crate::scene) struct PoseInputs<'a> {
    pub extracted: &'a ExtractedPoses,
    /// Moves of objects between slots: from and to.
    pub relocated: &'a [[u32; 2]],
    pub cache: &'a PipelineCache,
    pub diagnostics: Option<&'a DiagnosticsRecorder>,
}

/// Slots of objects with a new pose.
#[derive(Default)]
pub(in crate::scene) struct PoseChanges {
    /// They switched to another mesh: to their posed copy, or back to the asset's mesh.
    pub switched: Vec<u32>,
    /// They were posed.
    pub posed: Vec<u32>,
}

/// The data of a posed object for the top level of the BVH tracer.
pub(in crate::scene) struct PosedTree {
    /// The first node in the buffer.
    pub first_node: u32,
    /// The first triangle in the buffer.
    pub first_triangle: u32,
    /// Object space.
    pub bounds: Bounds,
}

/// Versions of the inputs of the app's shader, and of its kernel.
type MovingVersion = [u64; 2];

/// The posed copy of a mesh.
struct Room {
    geometry: ArenaSlice,
    /// Only with the BVH tracer: the tree and the index of its first triangle.
    tree: Option<(ArenaSlice, u32)>,
    /// Number of poses, up to 2: vertices have moved from one to the next.
    poses: u8,
}

/// A posed object.
struct Posed {
    entity: Entity,
    mesh: AssetId<Mesh>,
    version: u64,
    /// `None` until it is first posed.
    room: Option<Room>,
    /// The last pose.
    matrices: Vec<Rows>,
    weights: Vec<f32>,
    /// What the app's shader got.
    motion: Option<(Motion, MovingVersion)>,
    bounds: Bounds,
    revision: u64,
    /// Number of frames since its pose changed.
    waiting: u32,
    /// Last frame in which it existed.
    seen: u64,
}

/// A pose that has changed.
struct Candidate {
    /// Index in [`ExtractedPoses::sources`].
    source: usize,
    vertices: u32,
    /// Lower ranks come first.
    rank: f32,
}

/// All posed objects.
pub(in crate::scene) struct Poses {
    kernels: KernelCache,
    pass: Option<PosePass>,
    /// Chosen by [`Self::follow`], but not recorded yet.
    batch: Batch,
    /// By slot.
    posed: HashMap<u32, Posed>,
    frame: u64,
    next_revision: u64,
}

impl Poses {
    pub fn new(world: &World, tracer: ReflectionTracer) -> Self {
        Self {
            kernels: KernelCache::new(world.resource::<AssetServer>(), tracer),
            pass: None,
            batch: Batch::default(),
            posed: HashMap::default(),
            frame: 0,
            next_revision: 0,
        }
    }

    /// Frees everything.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        for (_, posed) in self.posed.drain() {
            release(posed.room, meshes);
        }
        self.pass = None;
        self.batch = Batch::default();
    }

    /// Size in bytes, except for the buffers that all meshes share.
    pub fn bytes(&self) -> u64 {
        self.pass.as_ref().map_or(0, PosePass::bytes)
    }

    /// Number of posed objects.
    pub fn count(&self) -> usize {
        self.posed.values().filter(|posed| posed.room.is_some()).count()
    }

    /// Index of a posed object's header in the geometry buffer, in words.
    pub fn geometry_base(&self, slot: u32) -> Option<u32> {
        Some(self.room(slot)?.geometry.base())
    }

    /// The tree of a posed object.
    pub fn tree(&self, slot: u32) -> Option<PosedTree> {
        let (tree, first_triangle) = self.room(slot)?.tree.as_ref()?;
        Some(PosedTree {
            first_node: tree.base() / ITEM_WORDS,
            first_triangle: *first_triangle,
            bounds: self.posed.get(&slot)?.bounds,
        })
    }

    /// The vertices of a posed object.
    pub fn vertices(&self, slot: u32) -> Option<PosedVertices> {
        Some(PosedVertices {
            first_vertex: (self.room(slot)?.geometry.base() + HEADER_WORDS) / 3,
            revision: self.posed.get(&slot)?.revision,
        })
    }

    /// Returns whether the geometry of a posed object has the motion of each vertex.
    pub fn knows_motions(&self, slot: u32) -> bool {
        self.room(slot).is_some_and(|room| room.poses > 1)
    }

    fn room(&self, slot: u32) -> Option<&Room> {
        self.posed.get(&slot)?.room.as_ref()
    }

    /// Chooses the objects to pose in this frame, among the changed ones and within the budget. Removed objects, and objects that can't
    /// be posed, free their memory.
    pub fn follow(
        &mut self,
        inputs: &PoseInputs,
        instances: &SceneInstances,
        meshes: &mut SceneMeshes,
        (device, queue): (&RenderDevice, &RenderQueue),
    ) -> PoseChanges {
        let extracted = inputs.extracted;
        for [from, to] in inputs.relocated {
            // It keeps its pose.
            if let Some(posed) = self.posed.remove(from) {
                self.posed.insert(*to, posed);
            }
        }
        let mut changes = PoseChanges::default();
        if extracted.sources.is_empty() && self.posed.is_empty() {
            return changes;
        }
        self.frame += 1;
        let has_shader = extracted.inputs.is_some();
        let moving = extracted.inputs.as_ref().and_then(|shader| {
            let kernels = self.kernels.get(inputs.cache, true)?;
            kernels.moving.as_ref()?;
            Some([shader.version, kernels.moving_version])
        });
        let mut candidates = Vec::new();
        for (index, source) in extracted.sources.iter().enumerate() {
            let candidate = self.observe(source, extracted, moving, instances, meshes, &mut changes);
            candidates.extend(candidate.map(|(vertices, rank)| Candidate {
                source: index,
                vertices,
                rank,
            }));
        }
        self.release_unseen(meshes, &mut changes);
        if let Some(pass) = &mut self.pass {
            pass.forget_others([meshes.geometry.buffer(), meshes.bvh.buffer()]);
        }
        if candidates.is_empty() {
            return changes;
        }
        if self.kernels.get(inputs.cache, has_shader).is_none() {
            return changes;
        }
        select(&mut candidates, extracted.vertices_per_frame);
        let mut batch = Batch::new(extracted.inputs.as_ref());
        let pass = self.pass.get_or_insert_with(|| PosePass::new(device));
        for candidate in &candidates {
            let source = &extracted.sources[candidate.source];
            let Some(posed) = self.posed.get_mut(&source.slot) else {
                continue;
            };
            if posed.make_room(meshes, queue, source.slot, &mut changes)
                && let Some(mesh) = meshes.get(posed.mesh)
                && posed.add_job(source, extracted, moving, mesh, &mut batch)
            {
                self.next_revision += 1;
                posed.revision = self.next_revision;
                posed.waiting = 0;
                changes.posed.push(source.slot);
            }
        }
        // The headers of new copies are written, so rays can hit them from now on, even if their vertices aren't posed.
        if pass.reserve(&batch, device) {
            self.batch = batch;
        } else {
            warn_once!("meshes keep their pose in reflections, since the device has no memory left to pose them");
            for slot in changes.posed.drain(..) {
                if let Some(posed) = self.posed.get_mut(&slot) {
                    release(posed.room.take(), meshes);
                    changes.switched.push(slot);
                }
            }
        }
        changes
    }

    /// Records the passes that pose the objects chosen by [`Self::follow`], which returned their slots. They are submitted with the
    /// frame, since a separate submission takes as long as everything else. Until then, no buffer of meshes may be replaced.
    pub fn record(
        &mut self,
        posed: &[u32],
        inputs: &PoseInputs,
        meshes: &mut SceneMeshes,
        (device, queue): (&RenderDevice, &RenderQueue),
        commands: &mut PendingCommandBuffers,
    ) {
        let batch = core::mem::take(&mut self.batch);
        if batch.jobs.is_empty() {
            return;
        }
        let has_shader = inputs.extracted.inputs.is_some();
        let (Some(pass), Some(kernels)) = (&mut self.pass, self.kernels.get(inputs.cache, has_shader)) else {
            return;
        };
        for room in posed.iter().filter_map(|slot| self.posed.get(slot)?.room.as_ref()) {
            meshes.geometry.begin_gpu_write(queue, &room.geometry);
            if let Some((tree, _)) = &room.tree {
                meshes.bvh.begin_gpu_write(queue, tree);
            }
        }
        let buffers = [meshes.geometry.buffer(), meshes.bvh.buffer()];
        let encoder = pass.record(&batch, kernels, buffers, inputs.diagnostics, device, queue);
        commands.push_encoder(encoder, "glint_pose");
    }

    /// Records that an object exists. Returns the number of its vertices and its rank if its pose is outdated. `moving` is `None` if
    /// the app's shader can't run.
    fn observe(
        &mut self,
        source: &PoseSource,
        extracted: &ExtractedPoses,
        moving: Option<MovingVersion>,
        instances: &SceneInstances,
        meshes: &mut SceneMeshes,
        changes: &mut PoseChanges,
    ) -> Option<(u32, f32)> {
        let object = instances.get(source.slot)?;
        let mesh = meshes.get(object.mesh)?;
        mesh.deformation.as_ref()?;
        let (matrices, weights) = pose(source, extracted, mesh);
        let (vertices, version) = (mesh.vertex_count, mesh.version);
        let fresh = || Posed {
            entity: source.entity,
            mesh: object.mesh,
            version,
            room: None,
            matrices: Vec::new(),
            weights: Vec::new(),
            motion: None,
            bounds: Bounds::EMPTY,
            revision: 0,
            waiting: 0,
            seen: 0,
        };
        let posed = match self.posed.entry(source.slot) {
            Entry::Occupied(entry) => {
                let posed = entry.into_mut();
                if (posed.entity, posed.mesh, posed.version) != (source.entity, object.mesh, version) {
                    let last = core::mem::replace(posed, fresh());
                    if release(last.room, meshes) {
                        changes.switched.push(source.slot);
                    }
                }
                posed
            }
            Entry::Vacant(entry) => entry.insert(fresh()),
        };
        posed.seen = self.frame;
        if source.is_unknown {
            return None;
        }
        let motion = motion(source, moving);
        let has_changed = if posed.room.is_some() {
            posed.matrices != matrices || posed.weights != weights || posed.motion != motion
        } else {
            // As long as nothing moves its vertices, the asset's mesh is correct.
            !matrices.is_empty() || weights.iter().any(|weight| *weight != 0.0) || motion.is_some()
        };
        if !has_changed {
            posed.waiting = 0;
            return None;
        }
        posed.waiting = posed.waiting.saturating_add(1);
        let distance = |camera: &Vec3| camera.distance(source.position);
        let nearest = extracted.cameras.iter().map(distance).fold(f32::INFINITY, f32::min);
        Some((vertices, nearest / posed.waiting as f32))
    }

    fn release_unseen(&mut self, meshes: &mut SceneMeshes, changes: &mut PoseChanges) {
        let frame = self.frame;
        for (slot, posed) in self.posed.extract_if(|_, posed| posed.seen != frame) {
            if release(posed.room, meshes) {
                changes.switched.push(slot);
            }
        }
        if self.posed.is_empty() {
            self.pass = None;
        }
    }
}

impl Posed {
    /// Allocates the posed copy of the mesh, if there is none. Returns false if it doesn't fit.
    fn make_room(
        &mut self,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
        slot: u32,
        changes: &mut PoseChanges,
    ) -> bool {
        if self.room.is_none() {
            self.room = take_room(self.mesh, meshes, queue);
            if self.room.is_some() {
                changes.switched.push(slot);
            } else {
                warn_once!(
                    "a mesh is reflected at rest or in its bind pose, since meshes leave no room in the largest buffer of this device; \
                     use fewer or smaller meshes, or keep some out with `NotReflected`"
                );
            }
        }
        self.room.is_some()
    }

    /// Adds the pose of this frame to the batch.
    fn add_job(
        &mut self,
        source: &PoseSource,
        extracted: &ExtractedPoses,
        moving: Option<MovingVersion>,
        mesh: &SceneMesh,
        batch: &mut Batch,
    ) -> bool {
        let (Some(room), Some(deformation)) = (&mut self.room, &mesh.deformation) else {
            return false;
        };
        room.poses = (room.poses + 1).min(2);
        let (matrices, weights) = pose(source, extracted, mesh);
        self.matrices.clear();
        self.matrices.extend_from_slice(matrices);
        self.weights.clear();
        self.weights.extend_from_slice(weights);
        self.motion = motion(source, moving);
        self.bounds = posed_bounds(deformation, matrices, weights);
        if let Some((motion, _)) = &self.motion {
            self.bounds = enlarged(self.bounds, motion.reach());
        }
        let mut job = PoseJob {
            bounds_min: self.bounds.min,
            bounds_max: self.bounds.max,
            source: mesh.geometry.base(),
            posed: room.geometry.base(),
            matrices: batch.add(bytemuck::cast_slice(matrices)),
            joint_count: matrices.len() as u32,
            weights: batch.add(bytemuck::cast_slice(weights)),
            target_count: weights.len() as u32,
            vertex_count: mesh.vertex_count,
            ..PoseJob::default()
        };
        if let (Some((motion, _)), Some(inputs)) = (&self.motion, &extracted.inputs) {
            batch.move_vertices(&mut job, &motion.words(inputs.seconds));
        }
        if let (Some((tree, first_triangle)), Some(source)) = (&room.tree, &mesh.bvh) {
            job.source_node = source.first_node;
            job.posed_node = tree.base() / ITEM_WORDS;
            job.node_count = first_triangle - job.posed_node;
            job.triangle_count = source.slice.words() / ITEM_WORDS - job.node_count;
            job.levels = batch.add(&source.levels);
            job.level_count = source.levels.len() as u32 - 1;
            job.boxes = batch.boxes;
            batch.boxes += job.node_count;
        }
        batch.jobs.push(job);
        true
    }
}

/// Matrices and weights that apply to a mesh.
fn pose<'a>(source: &PoseSource, extracted: &'a ExtractedPoses, mesh: &SceneMesh) -> (&'a [Rows], &'a [f32]) {
    let matrices = &extracted.matrices[source.matrices.clone()];
    let weights = &extracted.weights[source.weights.clone()];
    let targets = mesh
        .deformation
        .as_ref()
        .map_or(0, |deformation| deformation.targets.len());
    let has_joints = mesh.offsets.joints != 0;
    (
        if has_joints { matrices } else { &[] },
        &weights[..weights.len().min(targets)],
    )
}

/// What the app's shader gets of an object, if it runs.
fn motion(source: &PoseSource, moving: Option<MovingVersion>) -> Option<(Motion, MovingVersion)> {
    source.motion.zip(moving)
}

/// Keeps the first candidates within the budget, and at least one unless the budget is 0.
fn select(candidates: &mut Vec<Candidate>, vertices_per_frame: u32) {
    if vertices_per_frame == 0 {
        candidates.clear();
        return;
    }
    let all: u64 = candidates.iter().map(|candidate| u64::from(candidate.vertices)).sum();
    if all > u64::from(vertices_per_frame) || candidates.len() > MOST_JOBS {
        candidates.sort_by(|a, b| a.rank.total_cmp(&b.rank));
        let mut sum = 0;
        let fitting = candidates.iter().take(MOST_JOBS).take_while(|candidate| {
            sum += u64::from(candidate.vertices);
            sum <= u64::from(vertices_per_frame)
        });
        let count = fitting.count().max(1);
        candidates.truncate(count);
    }
}

/// Returns whether there was anything to release.
fn release(room: Option<Room>, meshes: &mut SceneMeshes) -> bool {
    let Some(room) = room else { return false };
    meshes.geometry.free(room.geometry);
    if let Some((tree, _)) = room.tree {
        meshes.bvh.free(tree);
    }
    true
}

/// Allocates the vertices of a posed mesh and its tree, and writes the header.
fn take_room(mesh: AssetId<Mesh>, meshes: &mut SceneMeshes, queue: &RenderQueue) -> Option<Room> {
    let mesh = meshes.get(mesh)?;
    let (source, offsets) = (mesh.geometry.base(), mesh.offsets);
    let (vertices, triangles, words) = (mesh.vertex_count, mesh.triangle_count, posed_words(mesh)?);
    let tree = mesh.bvh.as_ref().map(|tree| {
        let items = tree.slice.words() / ITEM_WORDS;
        (items as usize, tree.first_triangle - tree.first_node)
    });
    let geometry = meshes.geometry.allocate(words)?;
    let tree = match tree {
        Some((items, node_count)) => match meshes.allocate_tree(items) {
            Some(slice) => {
                let first_triangle = slice.base() / ITEM_WORDS + node_count;
                Some((slice, first_triangle))
            }
            None => {
                meshes.geometry.free(geometry);
                return None;
            }
        },
        None => None,
    };
    let header = posed_header(geometry.base(), source, offsets, [vertices, triangles]);
    meshes.geometry.write(queue, &geometry, &header);
    Some(Room {
        geometry,
        tree,
        poses: 0,
    })
}

/// Words of the arrays that a posed mesh doesn't share.
fn posed_words(mesh: &SceneMesh) -> Option<u32> {
    let own = [mesh.offsets.normals, mesh.offsets.tangents]
        .into_iter()
        .filter(|offset| *offset != 0);
    // Positions and motions.
    let per_vertex = 4 + own.count() as u32;
    mesh.vertex_count.checked_mul(per_vertex)?.checked_add(HEADER_WORDS)
}

/// The header of a posed mesh. It shares all arrays that posing doesn't change with the asset's mesh: the offsets to them wrap around,
/// like additions in shaders.
pub(super) fn posed_header(base: u32, source: u32, offsets: MeshOffsets, [vertices, triangles]: [u32; 2]) -> [u32; 12] {
    let shared = |offset: u32| match offset {
        0 => 0,
        offset => source.wrapping_add(offset).wrapping_sub(base),
    };
    let mut end = HEADER_WORDS + 3 * vertices;
    let mut take = || {
        let first = end;
        end += vertices;
        first
    };
    let mut own = |offset: u32| if offset == 0 { 0 } else { take() };
    let offsets = MeshOffsets {
        positions: HEADER_WORDS,
        indices: shared(offsets.indices),
        normals: own(offsets.normals),
        tangents: own(offsets.tangents),
        uv0: shared(offsets.uv0),
        uv1: shared(offsets.uv1),
        colors: shared(offsets.colors),
        // Motions.
        joints: take(),
        morphs: 0,
    };
    offsets.header([vertices, triangles, 0])
}
