//! Builds a static tree in a task, and then uploads it in parts.

use super::{
    object::Object,
    static_tree::{Members, StaticTree},
};
use crate::scene::{
    arena::ArenaSlice,
    bvh::{BvhQuality, ITEM_WORDS, Tlas, TlasInstance, build_tlas_of, opening_budget},
    meshes::SceneMeshes,
    tree_builds,
};
use bevy::render::renderer::RenderQueue;
use std::sync::Arc;

/// Items that are uploaded in one frame: a megabyte.
const UPLOAD_ITEMS_PER_FRAME: usize = 20_000;

/// An object of the moving tree that has settled.
pub(super) struct Mover {
    pub slot: u32,
    /// Frame of its last change.
    pub changed: u64,
    pub object: Object,
}

/// An object that is about to join the static tree.
pub(super) struct Joining {
    /// Index in the members.
    pub member: u32,
    pub slot: u32,
    /// Frame of its last change.
    pub changed: u64,
}

/// Result of a build task.
struct Built {
    tlas: Tlas,
    members: Members,
    first: Vec<u32>,
    free: Vec<u32>,
    joining: Vec<Joining>,
}

enum Stage {
    Building(tree_builds::Build<Built>),
    Uploading {
        built: Box<Built>,
        slice: ArenaSlice,
        /// Number of items uploaded so far.
        done: usize,
    },
}

/// The next static tree.
pub(super) struct StaticBuild {
    stage: Stage,
    /// Frame in which the build began.
    pub since: u64,
    /// Members that have left during the build.
    pub dead: Vec<u32>,
}

/// State of a build after a frame.
pub(super) enum Progress {
    /// To be continued.
    Unfinished(StaticBuild),
    /// The tree doesn't fit: its objects stay in the moving one.
    Failed,
    /// The tree is in the buffer. It still contains members that have left during the build.
    Finished {
        tree: Box<StaticTree>,
        joining: Vec<Joining>,
        dead: Vec<u32>,
    },
}

impl StaticBuild {
    /// Starts to build a tree of the last one's members and of further objects.
    pub fn start(last: Option<&StaticTree>, joining: Vec<Mover>, frame: u64) -> Self {
        let (members, mut free, dead) = last.map_or_else(Default::default, |last| {
            (last.members.clone(), last.free.clone(), last.dead.clone())
        });
        let task = tree_builds::spawn(async move {
            let mut members = members.as_ref().clone();
            for member in dead {
                members[member as usize] = None;
                free.push(member);
            }
            let joining = joining.into_iter().map(|mover| {
                let member = free.pop().unwrap_or_else(|| {
                    members.push(None);
                    members.len() as u32 - 1
                });
                members[member as usize] = Some(mover.object);
                Joining {
                    member,
                    slot: mover.slot,
                    changed: mover.changed,
                }
            });
            let joining = joining.collect();
            build(members, free, joining)
        });
        Self {
            stage: Stage::Building(task),
            since: frame,
            dead: Vec::new(),
        }
    }

    /// Advances the build; call once per frame.
    pub fn advance(mut self, meshes: &mut SceneMeshes, queue: &RenderQueue) -> Progress {
        let (built, slice, done) = match self.stage {
            Stage::Building(task) if !task.is_finished() => {
                self.stage = Stage::Building(task);
                return Progress::Unfinished(self);
            }
            Stage::Building(mut task) => {
                let Some(mut built) = task.take().map(Box::new) else {
                    return Progress::Failed;
                };
                let Some(slice) = meshes.allocate_tree(built.tlas.items.len()) else {
                    return Progress::Failed;
                };
                built.tlas.relocate(slice.base() / ITEM_WORDS);
                (built, slice, 0)
            }
            Stage::Uploading { built, slice, done } => (built, slice, done),
        };
        let items = &built.tlas.items;
        let mut end = done;
        if meshes.bvh.is_in_reach(&slice) {
            end = items.len().min(done + UPLOAD_ITEMS_PER_FRAME);
            let words = items[done..end].as_flattened().as_flattened();
            meshes.bvh.write_from(queue, &slice, done * ITEM_WORDS as usize, words);
        }
        if end < items.len() {
            self.stage = Stage::Uploading {
                built,
                slice,
                done: end,
            };
            return Progress::Unfinished(self);
        }
        let tree = StaticTree {
            slice,
            tlas: built.tlas,
            members: built.members,
            first: built.first,
            dead: Vec::new(),
            free: built.free,
            emptied: Vec::new(),
        };
        Progress::Finished {
            tree: Box::new(tree),
            joining: built.joining,
            dead: self.dead,
        }
    }

    /// Cancels the build. Returns its slice of the buffer, if it has one already.
    pub fn cancel(self) -> Option<ArenaSlice> {
        match self.stage {
            Stage::Building(_) => None,
            Stage::Uploading { slice, .. } => Some(slice),
        }
    }
}

fn build(members: Vec<Option<Object>>, free: Vec<u32>, joining: Vec<Joining>) -> Built {
    let present: Vec<u32> = (0..members.len() as u32)
        .filter(|member| members[*member as usize].is_some())
        .collect();
    let list: Vec<TlasInstance> = members.iter().flatten().map(Object::instance).collect();
    let mut tlas = build_tlas_of(BvhQuality::Medium, &list, opening_budget(list.len()));
    for (instance, _) in &mut tlas.places {
        *instance = present[*instance as usize];
    }
    tlas.places.sort_unstable();
    let mut first = vec![0; members.len() + 1];
    for (member, _) in &tlas.places {
        first[*member as usize + 1] += 1;
    }
    for member in 0..members.len() {
        first[member + 1] += first[member];
    }
    Built {
        tlas,
        members: Arc::new(members),
        first,
        free,
        joining,
    }
}
