//! Turns mesh assets into packed geometry and acceleration structures, off the main thread.

mod arrival;
pub(super) mod kept;
mod merged;
mod triangles;
pub(super) mod upload;

use super::{
    activity::SceneActivity,
    arena::{Arena, ArenaSlice},
    bvh::{Blas, Bounds, BvhQuality, ITEM_WORDS, Item, TopNode, build_blas, build_posable_blas},
    geometry::{BASE_ALIGNMENT, Deformation, GeometryError, MeshOffsets, PackedMesh, pack_mesh},
    instances::SceneInstances,
    tree_builds,
    waiting_room::WaitingRoom,
};
use crate::{
    device::{ChosenTracer, ReflectionTracer},
    settings::ReflectionUploadBudget,
};
use arrival::{ArrivalWorld, CopyBudget, Rank};
use bevy::{
    asset::{AssetEvent, AssetId, Assets, RenderAssetUsages},
    ecs::{prelude::*, system::SystemParam},
    log::warn,
    mesh::Mesh,
    platform::{
        collections::{HashMap, HashSet},
        time::Instant,
    },
    render::{
        mesh::RenderMesh,
        render_asset::ExtractedAssets,
        render_resource::BufferUsages,
        renderer::{RenderDevice, RenderQueue},
    },
};
use kept::{Found, RenderWorldMeshes};
use std::sync::Arc;

pub use triangles::MeshTriangles;

/// Meshes of more bytes aren't copied in the frame in which they change, since Bevy copies them in that frame.
const LARGE_BYTES: u64 = 2 << 20;

/// Maximum number of triangles of a merged tree: more would take seconds to build on a slow machine. Larger objects stay instances, since
/// merging would only give them a tree each.
pub(super) const CHUNK_TRIANGLES: u64 = 1 << 20;
/// Items of the root: a node that joins two trees, and their roots.
const ROOT_ITEMS: u32 = 3;

/// Outcome of an attempt to read the data of a mesh.
#[derive(PartialEq)]
enum Start {
    /// It is being built, or can't be.
    Done,
    /// To be retried in the next frame.
    Later,
    /// There is no data yet.
    Nowhere,
}

/// Source from which a mesh is built.
enum MeshSource {
    /// A copy of the asset.
    Copy(Box<Mesh>),
    /// Data that stays in memory after the build.
    Kept(Arc<PackedMesh>),
}

/// Result of a build task.
pub struct BuiltMesh {
    packed: Arc<PackedMesh>,
    /// [`SceneMesh::deformation`].
    deformation: Option<Deformation>,
    /// Only for the BVH tracer.
    blas: Option<Blas>,
    /// Only for the BVH tracer.
    triangles: Option<Arc<MeshTriangles>>,
    /// Empty for the BVH tracer.
    indices: Arc<[u32]>,
    milliseconds: f32,
}

/// A mesh that is being built.
struct MeshBuild {
    task: tree_builds::Build<Result<BuiltMesh, GeometryError>>,
    /// Size of the copy of the asset.
    copied_bytes: u64,
    rank: Rank,
}

/// A built mesh that is being uploaded.
struct MeshUpload {
    id: AssetId<Mesh>,
    built: BuiltMesh,
    geometry: ArenaSlice,
    /// Only with the BVH tracer.
    bvh: Option<ArenaSlice>,
    /// Number of words uploaded so far: first the geometry, then the tree.
    done: usize,
}

/// A mesh that rays can hit.
pub struct SceneMesh {
    /// Words of the geometry buffer.
    pub geometry: ArenaSlice,
    /// Only with the BVH tracer.
    pub bvh: Option<SceneBlas>,
    /// Number of vertices of the packed mesh.
    pub vertex_count: u32,
    /// Number of triangles of the packed mesh.
    pub triangle_count: u32,
    /// Arrays of the packed mesh.
    pub offsets: MeshOffsets,
    /// Joints, weights and morph targets, if the mesh has any. Empty for a mesh that only the app's shader poses.
    pub deformation: Option<Deformation>,
    /// Triangle indices to build ray-query structures with flipped winding; empty with the BVH tracer.
    pub indices: Arc<[u32]>,
    /// For merging and masks; `None` with ray queries.
    pub triangles: Option<Arc<MeshTriangles>>,
    /// Changes with every new version of the mesh.
    pub version: u64,
}

/// A BLAS in the BVH buffer.
pub struct SceneBlas {
    /// Nodes and triangles, in `u32` words.
    pub slice: ArenaSlice,
    /// The first node in the buffer.
    pub first_node: u32,
    /// The first triangle in the buffer.
    pub first_triangle: u32,
    /// Object space.
    pub bounds: Bounds,
    /// Nodes at which rays can start.
    pub top: Arc<[TopNode]>,
    /// [`Blas::groups`].
    pub groups: u32,
    /// [`Blas::levels`] of a mesh that can be posed.
    pub levels: Box<[u32]>,
}

/// All meshes of traced objects.
#[derive(Resource)]
pub struct SceneMeshes {
    /// Packed meshes.
    pub geometry: Arena,
    /// BLAS nodes and triangles, merged trees and the TLAS; empty with ray queries.
    pub bvh: Arena,
    /// The start of [`Self::bvh`], where rays begin; only with the BVH tracer.
    root: Option<ArenaSlice>,
    /// Merged trees in [`Self::bvh`] by unique name.
    merged: HashMap<u64, ArenaSlice>,
    next_merged: u64,
    /// The space of the merged trees was needed for something else.
    merged_lost: bool,
    ready: HashMap<AssetId<Mesh>, SceneMesh>,
    pending: HashMap<AssetId<Mesh>, MeshBuild>,
    /// Bytes of mesh copies in [`Self::pending`].
    copied_bytes: u64,
    /// Meshes that are being uploaded: the current one is last, after one that it might have interrupted. Until they are complete, rays
    /// hit their older version, if there is one.
    uploading: Vec<MeshUpload>,
    /// Meshes in use that aren't being built yet: their data is to be copied in one of the next frames, or isn't available yet.
    wanted: HashMap<AssetId<Mesh>, Rank>,
    /// `order` of the next mesh's [`Rank`].
    next_order: u64,
    /// Maximum number of bytes to upload in a frame.
    upload_bytes: u64,
    /// Number of wanted meshes with available data.
    waiting: usize,
    /// Large wanted meshes that changed a frame ago.
    late: HashSet<AssetId<Mesh>>,
    /// Meshes that can't be built, and meshes excluded from ray tracing (`Mesh::enable_raytracing`).
    failed: HashSet<AssetId<Mesh>>,
    /// Failed meshes that were logged.
    told: HashSet<AssetId<Mesh>>,
    /// Meshes that the app has dropped, while objects use them until their next ones are ready.
    unused: HashSet<AssetId<Mesh>>,
    /// Meshes that didn't fit.
    without_room: WaitingRoom<AssetId<Mesh>>,
    /// Meshes without joints and morph targets that some object poses nevertheless, by the app's shader.
    posable: HashSet<AssetId<Mesh>>,
    /// Meshes that changed while an older version was being built.
    stale: HashSet<AssetId<Mesh>>,
    /// Meshes that became ready, changed or vanished in this frame.
    pub changed: HashSet<AssetId<Mesh>>,
    tracer: ReflectionTracer,
    next_version: u64,
    triangles: u64,
    /// An arena was full, and a warning was logged.
    warned_full: bool,
}

impl FromWorld for SceneMeshes {
    fn from_world(world: &mut World) -> Self {
        Self::new(world.resource::<RenderDevice>(), world.resource::<ChosenTracer>().0)
    }
}

impl SceneMeshes {
    /// Meshes with a finished build. The last one is uploaded first.
    fn finished(&self) -> Vec<AssetId<Mesh>> {
        let finished = self.pending.iter().filter(|(_, build)| build.task.is_finished());
        let mut finished: Vec<_> = finished
            .map(|(id, build)| (!self.is_edited(*id), build.rank, *id))
            .collect();
        finished.sort_unstable_by(|a, b| b.cmp(a));
        finished.into_iter().map(|(.., id)| id).collect()
    }

    /// Returns whether rays hit an older version of a mesh until the new one is ready.
    fn is_edited(&self, id: AssetId<Mesh>) -> bool {
        self.ready.contains_key(&id)
    }

    /// Empty arenas for a tracer.
    pub fn new(device: &RenderDevice, tracer: ReflectionTracer) -> Self {
        let mut usages = BufferUsages::STORAGE;
        if tracer == ReflectionTracer::RayQuery {
            usages |= BufferUsages::BLAS_INPUT;
        }
        let mut bvh = Arena::new(device, "glint_bvh", BufferUsages::STORAGE, ITEM_WORDS, u64::MAX);
        // The first slice begins at 0.
        let root = (tracer == ReflectionTracer::Bvh).then(|| bvh.allocate(ROOT_ITEMS * ITEM_WORDS));
        Self {
            geometry: Arena::new(device, "glint_geometry", usages, BASE_ALIGNMENT, u64::MAX),
            bvh,
            root: root.flatten(),
            merged: HashMap::default(),
            next_merged: 0,
            merged_lost: false,
            ready: HashMap::default(),
            pending: HashMap::default(),
            copied_bytes: 0,
            uploading: Vec::new(),
            wanted: HashMap::default(),
            next_order: 0,
            upload_bytes: ReflectionUploadBudget::default().bytes(),
            waiting: 0,
            late: HashSet::default(),
            failed: HashSet::default(),
            told: HashSet::default(),
            unused: HashSet::default(),
            without_room: WaitingRoom::default(),
            posable: HashSet::default(),
            stale: HashSet::default(),
            changed: HashSet::default(),
            tracer,
            next_version: 1,
            triangles: 0,
            warned_full: false,
        }
    }

    /// A mesh that is ready.
    pub fn get(&self, id: AssetId<Mesh>) -> Option<&SceneMesh> {
        self.ready.get(&id)
    }

    /// Has a mesh built so that it can be posed, even if it has neither joints nor morph targets. Until then, the last version stays.
    pub fn make_posable(&mut self, id: AssetId<Mesh>) {
        if self.posable.insert(id) && self.is_known(id) && self.get(id).is_none_or(|mesh| mesh.deformation.is_none()) {
            self.stale.insert(id);
        }
    }

    /// The tracer that meshes are built for.
    pub fn tracer(&self) -> ReflectionTracer {
        self.tracer
    }

    fn is_known(&self, id: AssetId<Mesh>) -> bool {
        self.ready.contains_key(&id)
            || self.is_on_its_way(id)
            || self.failed.contains(&id)
            || self.without_room.contains(&id)
    }

    /// Returns whether objects that get another mesh can keep using this one for now. Skinned and morphed meshes can't: joints and weights
    /// would be those of the new mesh.
    pub fn may_show(&self, id: AssetId<Mesh>) -> bool {
        let is_plain = |deformation: &Deformation| deformation.joints.is_empty() && deformation.targets.is_empty();
        self.get(id)
            .is_some_and(|mesh| mesh.deformation.as_ref().is_none_or(is_plain))
    }

    /// Returns whether a mesh is ready, or never will be.
    pub fn is_settled(&self, id: AssetId<Mesh>) -> bool {
        self.is_known(id) && !(self.is_on_its_way(id) && self.get(id).is_none())
    }

    /// Returns whether a mesh that isn't ready might still become ready.
    pub fn expects(&self, id: AssetId<Mesh>) -> bool {
        self.get(id).is_none() && (self.is_on_its_way(id) || self.wanted.contains_key(&id))
    }

    /// Returns whether it is being built or uploaded.
    fn is_on_its_way(&self, id: AssetId<Mesh>) -> bool {
        self.pending.contains_key(&id) || self.uploading.iter().any(|upload| upload.id == id)
    }

    /// Number of meshes with current data that rays can't hit yet.
    fn on_their_way(&self) -> usize {
        let stale = self.stale.iter().filter(|id| !self.is_on_its_way(**id));
        self.pending.len() + self.uploading.len() + self.waiting + stale.count()
    }

    fn used_bytes(&self) -> u64 {
        self.geometry.used_bytes() + self.bvh.used_bytes()
    }

    /// Takes meshes that might fit now that `used` bytes are in use. Meshes with an older version in use become stale.
    fn take_ready_to_try(&mut self, used: u64) -> Vec<AssetId<Mesh>> {
        let again = self.geometry.may_ask_again() || self.bvh.may_ask_again();
        let mut ids = self.without_room.take(used, again);
        let shown = ids.extract_if(.., |id| self.ready.contains_key(id));
        self.stale.extend(shown);
        ids
    }

    /// Starts the build of a mesh if its data is available and ray tracing is enabled for it, and subtracts the copied bytes from the
    /// budget. `changed` are meshes that changed in this frame.
    fn start_from(
        &mut self,
        id: AssetId<Mesh>,
        kept: &mut RenderWorldMeshes,
        assets: &Assets<Mesh>,
        changed: &HashSet<AssetId<Mesh>>,
        budget: &mut CopyBudget,
    ) -> Start {
        let readable = assets.get(id).filter(|mesh| is_readable(mesh));
        let found = match readable {
            Some(mesh) if mesh.enable_raytracing && !mesh.primitive_topology().is_triangles() => {
                self.decline(id, &GeometryError::NotTriangles(mesh.primitive_topology()));
                return Start::Done;
            }
            Some(mesh) if mesh.enable_raytracing => {
                let bytes = bytes_of(mesh);
                // Bevy copies a mesh in the frame in which it changes, so a large one is copied in the next frame here.
                let is_large = bytes > LARGE_BYTES;
                if is_large && changed.contains(&id) && self.late.insert(id) || !budget.take(bytes) {
                    return Start::Later;
                }
                self.late.remove(&id);
                self.start(id, MeshSource::Copy(Box::new(mesh.clone())), bytes);
                return Start::Done;
            }
            Some(_) => Found::Unseen,
            None => kept.find(id),
        };
        match found {
            Found::Packed(packed) => self.start(id, MeshSource::Kept(packed), 0),
            Found::Unseen => {
                self.remove(id);
                self.failed.insert(id);
            }
            Found::Later => return Start::Later,
            Found::Nowhere => return Start::Nowhere,
        }
        Start::Done
    }

    fn start(&mut self, id: AssetId<Mesh>, source: MeshSource, copied_bytes: u64) {
        let with_bvh = self.tracer == ReflectionTracer::Bvh;
        let is_posable = self.posable.contains(&id);
        let task = tree_builds::spawn(async move {
            let begin = Instant::now();
            let (packed, is_kept) = match source {
                MeshSource::Copy(mesh) => (Arc::new(pack_mesh(&mesh)?), false),
                MeshSource::Kept(packed) => (packed, true),
            };
            let deformation = packed.deformation.clone().or_else(|| {
                is_posable.then(|| Deformation {
                    bounds: packed.bounds,
                    ..Deformation::default()
                })
            });
            let build = match &deformation {
                Some(_) => build_posable_blas,
                None => build_blas,
            };
            let blas = with_bvh
                .then(|| build(packed.positions(), packed.indices(), BvhQuality::default()))
                .flatten();
            let triangles = blas.is_some().then(|| {
                Arc::new(if is_kept {
                    MeshTriangles::shared(packed.clone())
                } else {
                    MeshTriangles::copied(&packed)
                })
            });
            let indices = if with_bvh {
                Arc::default()
            } else {
                packed.indices().into()
            };
            let milliseconds = begin.elapsed().as_secs_f32() * 1000.0;
            Ok(BuiltMesh {
                packed,
                deformation,
                blas,
                triangles,
                indices,
                milliseconds,
            })
        });
        self.failed.remove(&id);
        self.without_room.remove(&id);
        self.copied_bytes += copied_bytes;
        let build = MeshBuild {
            task,
            copied_bytes,
            rank: Rank::far(self.take_order()),
        };
        if let Some(replaced) = self.pending.insert(id, build) {
            self.copied_bytes -= replaced.copied_bytes;
        }
    }

    fn take_order(&mut self) -> u64 {
        self.next_order += 1;
        self.next_order
    }

    /// Call if a mesh can't be built as it is. Logs each mesh only once, however often it changes.
    fn decline(&mut self, id: AssetId<Mesh>, error: &GeometryError) {
        if self.told.insert(id) {
            warn!("mesh {id} is missing from reflections: {error}");
        }
        self.remove_for_next(id);
        self.failed.insert(id);
    }

    fn remove(&mut self, id: AssetId<Mesh>) {
        if let Some(build) = self.pending.remove(&id) {
            self.copied_bytes -= build.copied_bytes;
        }
        for upload in self.uploading.extract_if(.., |upload| upload.id == id) {
            self.geometry.free(upload.geometry);
            upload.bvh.into_iter().for_each(|slice| self.bvh.free(slice));
        }
        self.failed.remove(&id);
        self.without_room.remove(&id);
        self.stale.remove(&id);
        self.late.remove(&id);
        if let Some(mesh) = self.ready.remove(&id) {
            self.triangles -= u64::from(mesh.triangle_count);
            self.geometry.free(mesh.geometry);
            if let Some(bvh) = mesh.bvh {
                self.bvh.free(bvh.slice);
            }
            self.changed.insert(id);
        }
    }

    /// Frees everything.
    pub fn clear(&mut self, device: &RenderDevice) {
        self.wanted.clear();
        self.waiting = 0;
        let is_empty = self.ready.is_empty() && self.pending.is_empty() && self.uploading.is_empty();
        if !is_empty || !self.failed.is_empty() || !self.without_room.is_empty() {
            let next_merged = self.next_merged;
            *self = Self::new(device, self.tracer);
            self.next_merged = next_merged;
        }
    }

    /// Allocates a BLAS or a TLAS. If the buffer is full, merged trees are freed, since they only duplicate the contents of BLASes.
    pub(super) fn allocate_tree(&mut self, items: usize) -> Option<ArenaSlice> {
        let words = words_of(items)?;
        if let Some(slice) = self.bvh.allocate(words) {
            return Some(slice);
        }
        if self.merged.is_empty() {
            return None;
        }
        for (_, slice) in self.merged.drain() {
            self.bvh.free(slice);
        }
        self.merged_lost = true;
        self.bvh.allocate(words)
    }

    /// Writes the items at the start of the tree buffer.
    pub(super) fn write_root(&mut self, queue: &RenderQueue, items: &[Item]) {
        if let Some(root) = &self.root {
            self.bvh.write(queue, root, items.as_flattened().as_flattened());
        }
    }

    /// Meshes that keep a buffer large and should be rebuilt.
    fn stranded_meshes(&self) -> Vec<AssetId<Mesh>> {
        if !self.bvh.has_stranded_slices() && !self.geometry.has_stranded_slices() {
            return Vec::new();
        }
        let is_stranded = |mesh: &SceneMesh| {
            let bvh = mesh.bvh.as_ref();
            self.geometry.is_stranded(&mesh.geometry) || bvh.is_some_and(|bvh| self.bvh.is_stranded(&bvh.slice))
        };
        let ready = self.ready.iter();
        ready.filter(|(_, mesh)| is_stranded(mesh)).map(|(id, _)| *id).collect()
    }
}

fn words_of(items: usize) -> Option<u32> {
    u32::try_from(items).ok()?.checked_mul(ITEM_WORDS)
}

/// The mesh assets of the main world.
#[derive(SystemParam)]
pub struct MeshWorld<'w, 's> {
    arrival: ArrivalWorld<'w, 's>,
    assets: Res<'w, Assets<Mesh>>,
    events: MessageReader<'w, 's, AssetEvent<Mesh>>,
}

/// Reads the mesh assets of traced objects from the main world, and records which changed or vanished.
pub fn extract_meshes(
    world: &mut MeshWorld,
    active: bool,
    instances: &mut SceneInstances,
    meshes: &mut SceneMeshes,
    render_world: &mut RenderWorldMeshes,
    device: &RenderDevice,
) {
    let assets = &*world.assets;
    meshes.changed.clear();
    let mut changed = HashSet::new();
    for event in world.events.read() {
        match event {
            // Another mesh can be inserted under the id of a removed one.
            AssetEvent::Added { id } | AssetEvent::Modified { id } => _ = changed.insert(*id),
            AssetEvent::Unused { id } => _ = meshes.unused.insert(*id),
            _ => {}
        }
    }
    let mut unused = core::mem::take(&mut meshes.unused);
    for id in unused.extract_if(|id| !instances.keeps_for_now(*id)) {
        render_world.remove(id);
        meshes.remove(id);
        meshes.told.remove(&id);
        meshes.posable.remove(&id);
        let rank = Rank::far(meshes.take_order());
        meshes.wanted.insert(id, rank);
    }
    meshes.unused = unused;
    if !active {
        meshes.clear(device);
        return;
    }
    meshes.upload_bytes = world.arrival.bytes();
    let mut budget = CopyBudget::new(meshes.upload_bytes, meshes.copied_bytes);
    // A build in progress is finished first: otherwise, a mesh that changes in every frame would never appear.
    let mut stale = core::mem::take(&mut meshes.stale);
    let mut modified = changed.clone();
    modified.extend(stale.extract_if(|id| !meshes.is_on_its_way(*id)));
    modified.extend(meshes.stranded_meshes());
    meshes.stale = stale;
    for id in modified {
        let waits = meshes.is_on_its_way(id)
            || meshes.is_known(id)
                && meshes.start_from(id, render_world, assets, &changed, &mut budget) == Start::Later;
        if waits {
            meshes.stale.insert(id);
        }
    }
    let mut newcomers = instances.take_new_meshes();
    // They are forgotten, so that they are built again.
    let used = meshes.used_bytes();
    newcomers.extend(meshes.take_ready_to_try(used));
    if !newcomers.is_empty() {
        let viewers = world.arrival.viewers();
        for id in newcomers {
            let rank = Rank::of(id, meshes.take_order(), instances, &viewers);
            meshes.wanted.insert(id, rank);
        }
    }
    meshes.waiting = 0;
    let mut wanted = core::mem::take(&mut meshes.wanted);
    wanted.retain(|id, _| !meshes.is_known(*id) && instances.shows(*id));
    let mut in_order: Vec<_> = wanted.iter().map(|(id, rank)| (*rank, *id)).collect();
    in_order.sort_unstable();
    for (rank, id) in in_order {
        let start = meshes.start_from(id, render_world, assets, &changed, &mut budget);
        meshes.waiting += usize::from(start == Start::Later);
        if start == Start::Done {
            wanted.remove(&id);
            if let Some(build) = meshes.pending.get_mut(&id) {
                build.rank = rank;
            }
        }
    }
    meshes.wanted = wanted;
}

/// Size of a readable mesh asset.
fn bytes_of(mesh: &Mesh) -> u64 {
    let indices = mesh.get_index_buffer_bytes().map_or(0, <[u8]>::len);
    (mesh.get_vertex_buffer_size() + indices) as u64
}

fn is_readable(mesh: &Mesh) -> bool {
    mesh.asset_usage.contains(RenderAssetUsages::MAIN_WORLD) && mesh.try_attributes().is_ok()
}

/// Keeps the data of meshes that only exist in the render world, and only until they are prepared.
pub fn keep_render_world_meshes(
    extracted: Res<ExtractedAssets<RenderMesh>>,
    mut kept: ResMut<RenderWorldMeshes>,
    mut meshes: ResMut<SceneMeshes>,
    activity: Res<SceneActivity>,
) {
    for (id, mesh) in &extracted.extracted {
        if mesh.asset_usage.contains(RenderAssetUsages::MAIN_WORLD) {
            kept.remove(*id);
            continue;
        }
        kept.keep(*id, mesh);
        if !activity.active {
            continue;
        }
        if meshes.is_known(*id) {
            meshes.stale.insert(*id);
        }
        // It wasn't counted yet, since its data wasn't available when meshes were extracted.
        meshes.waiting += usize::from(meshes.wanted.contains_key(id));
    }
}
