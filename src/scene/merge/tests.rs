//! Tests the bookkeeping of merged objects.

use super::{scheduler::gains_micromaps, *};
use crate::scene::{bvh::Bounds, gpu_types::INSTANCE_ALPHA_MASKED};
use bevy::{asset::AssetId, ecs::entity::Entity};

const QUIET: u64 = 4;
const LIMITS: Limits = Limits {
    quiet_frames: QUIET,
    chunk_triangles: 1000,
    cheap_triangles: 300,
    budget_triangles: 4000,
};

/// A scheduler with plans that are built at once.
struct Scene {
    scheduler: MergeScheduler,
    /// Triangles of each object; 0 if it can't be merged.
    sizes: Vec<u64>,
    /// Vector by which objects were shifted.
    shift: Vec3A,
    plans: usize,
    next_name: u64,
}

fn entity(index: u32) -> Entity {
    Entity::from_raw_u32(index).unwrap()
}

fn placed(slot: u32) -> Option<Placement> {
    Some(Placement {
        entity: entity(slot),
        mesh: AssetId::default(),
        version: 1,
        flags: 0,
        masks: 0,
        micromaps: 0,
    })
}

fn tree(name: u64) -> Tree {
    Tree {
        name,
        first_node: 0,
        first_triangle: 5,
        bounds: Bounds::EMPTY,
        offset: Vec3A::ZERO,
        groups: 0,
    }
}

impl Scene {
    /// Objects with these numbers of triangles, at x = 0, 1, 2 ...
    fn new(sizes: &[u64]) -> Self {
        let mut scene = Self {
            scheduler: MergeScheduler::new(LIMITS),
            sizes: sizes.to_vec(),
            shift: Vec3A::ZERO,
            plans: 0,
            next_name: 0,
        };
        for slot in 0..sizes.len() as u32 {
            scene.scheduler.observe(slot, placed(slot), false);
        }
        scene
    }

    fn advance(&mut self) {
        let (sizes, shift) = (&self.sizes, self.shift);
        let measure = |slot: u32, _: &Placement| {
            let triangles = sizes[slot as usize];
            (triangles > 0).then_some(Extent {
                triangles,
                centre: Vec3A::X * slot as f32 + shift,
            })
        };
        self.scheduler.advance(measure);
    }

    /// Runs a frame. Returns its plan, which stays unfinished.
    fn plan(&mut self) -> Option<Vec<u32>> {
        self.advance();
        let plan = self.scheduler.plan()?;
        self.plans += 1;
        Some(plan.into_iter().map(|(slot, _)| slot).collect())
    }

    fn finish(&mut self) {
        self.scheduler.finish(tree(self.next_name));
        self.next_name += 1;
    }

    /// Runs this number of frames, in which plans are built at once.
    fn run(&mut self, frames: u64) {
        for _ in 0..frames {
            if self.plan().is_some() {
                self.finish();
            }
        }
    }

    fn merged(&self) -> Vec<u32> {
        (0..self.sizes.len() as u32)
            .filter(|slot| self.scheduler.is_merged(*slot))
            .collect()
    }

    /// Removes an object. Returns its tree, if that stays.
    fn tree_of(&mut self, slot: u32) -> Option<u64> {
        self.scheduler.observe(slot, None, false);
        let cuts = self.scheduler.take_cuts();
        cuts.first().map(|(name, _)| *name)
    }

    fn trees(&self) -> usize {
        self.scheduler.trees().count()
    }
}

/// Objects that appeared late, and disappeared while they were waiting to be at rest or about to be merged.
#[test]
fn tables_end_behind_the_last_object() {
    let mut scene = Scene::new(&[10; 4]);
    scene.run(3 * QUIET);
    for slot in [0, 3] {
        scene.scheduler.observe(slot, placed(slot), true);
    }
    (1..4).for_each(|slot| scene.scheduler.observe(slot, None, false));
    scene.scheduler.truncate(1);
    assert_eq!(scene.scheduler.len(), 1);
    // Another object takes the slot while the last one's entry is due.
    scene.scheduler.observe(3, placed(8), true);
    scene.run(200 * QUIET);
    assert!(scene.merged().contains(&3) && !scene.scheduler.is_pending());
    assert!(scene.plan().is_none());

    scene.scheduler.observe(3, placed(8), true);
    let planned = (0..200 * QUIET).any(|_| {
        let plan = scene.plan();
        if plan.as_ref().is_some_and(|members| !members.contains(&3)) {
            scene.finish();
        }
        plan.is_some_and(|members| members.contains(&3))
    });
    assert!(planned, "it is merged again");
    scene.scheduler.observe(3, None, false);
    scene.scheduler.truncate(1);
    assert_eq!(scene.scheduler.len(), 4, "a build knows the slot");
    scene.scheduler.abandon();
    scene.scheduler.truncate(1);
    assert_eq!(scene.scheduler.len(), 1);
    scene.run(QUIET);
}

#[test]
fn an_object_that_moves_rests_once_it_stops() {
    let mut scene = Scene::new(&[10]);
    let stop = 2 * QUIET;
    let planned = (1..5 * QUIET).find(|frame| {
        // Nothing reports that it stops.
        if *frame <= stop {
            scene.scheduler.observe_move(0);
        }
        scene.plan().is_some()
    });
    let planned = planned.expect("it rests");
    assert!(planned >= stop + QUIET, "planned in frame {planned}");
    // From now on, a movement makes the build stale.
    scene.scheduler.observe_move(0);
    assert!(scene.scheduler.is_stale());
}

#[test]
fn a_still_scene_is_merged_once() {
    let mut scene = Scene::new(&[10, 20, 0, 30]);
    assert!(!scene.scheduler.is_pending());
    scene.run(2);
    assert!(scene.scheduler.is_pending() && scene.merged().is_empty());
    scene.run(3 * QUIET);
    assert_eq!(scene.merged(), [0, 1, 3]);
    assert_eq!((scene.trees(), scene.scheduler.merged()), (1, (3, 60)));
    assert!(scene.scheduler.take_changed());
    scene.run(100);
    assert_eq!(scene.plans, 1);
    assert!(!scene.scheduler.is_pending() && !scene.scheduler.take_changed());
    assert!(scene.scheduler.take_released().is_empty());
}

#[test]
fn a_moved_object_drops_out_and_comes_back() {
    let mut scene = Scene::new(&[10, 20, 30]);
    scene.run(3 * QUIET);
    scene.scheduler.take_changed();
    scene.scheduler.observe(1, placed(1), true);
    assert!(scene.merged().is_empty() && scene.scheduler.take_changed());
    assert_eq!(scene.scheduler.take_released(), [0]);
    scene.run(QUIET - 1);
    assert!(scene.merged().is_empty(), "waits for quiet frames");
    scene.run(2);
    assert_eq!(scene.merged(), [0, 2], "the others don't wait for it");
    scene.run(20 * QUIET);
    assert_eq!((scene.merged(), scene.trees()), (vec![0, 1, 2], 1));
    assert_eq!(scene.scheduler.take_released(), [1]);
    assert_eq!(scene.plans, 3);
}

#[test]
fn a_moved_object_is_cut_out_of_its_chunk() {
    // Two chunks along x.
    let mut scene = Scene::new(&[300, 300, 300, 300, 300, 300]);
    scene.run(4 * QUIET);
    assert_eq!((scene.merged().len(), scene.trees()), (6, 2));
    scene.scheduler.take_crossed();
    scene.scheduler.observe(5, placed(5), true);
    assert_eq!((scene.merged(), scene.trees()), (vec![0, 1, 2, 3, 4], 2));
    assert_eq!(scene.scheduler.take_cuts(), [(1, 5)]);
    assert_eq!(scene.scheduler.take_crossed(), [5]);
    // The chunk isn't worth its memory with less than half of its triangles.
    scene.scheduler.observe(4, placed(4), true);
    assert_eq!((scene.merged(), scene.trees()), (vec![0, 1, 2], 1));
    assert!(scene.scheduler.take_cuts().is_empty());
    assert_eq!(scene.scheduler.take_crossed(), [3, 4]);
    assert_eq!(scene.scheduler.take_released(), [1]);
}

/// An explosion: a third of a chunk moves in one frame, then the rest.
#[test]
fn cutting_many_objects_out_walks_over_each_a_few_times() {
    const CROWD: usize = 3_000;
    let mut scene = Scene::new(&[1; CROWD]);
    scene.scheduler = MergeScheduler::new(Limits {
        chunk_triangles: CROWD as u64,
        ..LIMITS
    });
    (0..CROWD as u32).for_each(|slot| scene.scheduler.observe(slot, placed(slot), false));
    scene.run(4 * QUIET);
    assert_eq!((scene.merged().len(), scene.trees()), (CROWD, 1));
    scene.scheduler.take_crossed();
    let (first, rest) = (0..CROWD as u32 / 3, CROWD as u32 / 3..CROWD as u32);
    first
        .clone()
        .for_each(|slot| scene.scheduler.observe(slot, placed(slot), true));
    assert_eq!((scene.merged().len(), scene.trees()), (CROWD * 2 / 3, 1));
    assert_eq!(scene.scheduler.merged().0, CROWD * 2 / 3);
    assert!(
        scene
            .scheduler
            .take_cuts()
            .into_iter()
            .map(|(_, slot)| slot)
            .eq(first.clone())
    );
    assert!(scene.scheduler.take_crossed().into_iter().eq(first));
    rest.for_each(|slot| scene.scheduler.observe(slot, placed(slot), true));
    assert_eq!((scene.merged().len(), scene.trees()), (0, 0));
    assert!(scene.scheduler.take_cuts().is_empty(), "the tree is gone");
    assert!(
        scene.scheduler.visited() <= 2 * CROWD,
        "{} members were looked at",
        scene.scheduler.visited()
    );
}

#[test]
fn a_tree_that_nothing_can_be_cut_out_of_dissolves() {
    let mut scene = Scene::new(&[300, 300, 300]);
    scene.run(4 * QUIET);
    scene.scheduler.observe(1, placed(1), true);
    scene.scheduler.dissolve_tree(0);
    assert!(scene.merged().is_empty());
    assert_eq!(scene.scheduler.take_released(), [0]);
}

#[test]
fn hidden_changed_and_despawned_objects_drop_out() {
    let changes: [fn(Placement) -> Option<Placement>; 5] = [
        |_| None,
        |placement| {
            Some(Placement {
                version: 2,
                ..placement
            })
        },
        |placement| {
            Some(Placement {
                flags: INSTANCE_ALPHA_MASKED,
                ..placement
            })
        },
        |placement| {
            Some(Placement {
                entity: entity(77),
                ..placement
            })
        },
        |placement| {
            Some(Placement {
                mesh: AssetId::Uuid {
                    uuid: bevy::asset::uuid::Uuid::from_u128(7),
                },
                ..placement
            })
        },
    ];
    for (i, change) in changes.into_iter().enumerate() {
        let mut scene = Scene::new(&[10, 20]);
        scene.run(3 * QUIET);
        let placement = placed(0).unwrap();
        scene.scheduler.observe(0, Some(placement), false);
        assert_eq!(scene.merged(), [0, 1], "nothing changed");
        scene.scheduler.observe(0, change(placement), false);
        assert!(scene.merged().is_empty(), "change {i}");
        scene.run(30 * QUIET);
        let expected: &[u32] = if i == 0 { &[1] } else { &[0, 1] };
        assert_eq!(scene.merged(), expected, "change {i}");
        scene.scheduler.observe(0, Some(placement), false);
        scene.run(100 * QUIET);
        assert_eq!(scene.merged(), [0, 1], "change {i} undone");
    }
}

#[test]
fn the_budget_holds_for_small_objects_first() {
    let mut scene = Scene::new(&[900, 900, 900, 900, 900, 100, 1001]);
    scene.run(20 * QUIET);
    assert_eq!(scene.merged(), [0, 1, 2, 3, 5], "the largest is larger than a chunk");
    assert_eq!(scene.scheduler.merged().1, 3700);
    let plans = scene.plans;
    scene.run(50 * QUIET);
    assert_eq!(scene.plans, plans);
    assert!(!scene.scheduler.is_pending());
    // Space for another object.
    scene.scheduler.observe(2, None, false);
    scene.run(20 * QUIET);
    assert_eq!(scene.merged(), [0, 1, 3, 4, 5]);
}

#[test]
fn large_scenes_are_split_in_space() {
    let mut scene = Scene::new(&[100; 32]);
    scene.run(20 * QUIET);
    assert_eq!((scene.merged().len(), scene.trees()), (32, 4));
    // Neighbours share a chunk.
    scene.scheduler.observe(0, None, false);
    assert_eq!(scene.merged(), (1..32).collect::<Vec<_>>());
    assert_eq!(scene.trees(), 4);
}

#[test]
fn objects_in_motion_are_left_alone() {
    let mut scene = Scene::new(&[10, 20, 30]);
    let mut seen = 0;
    for _ in 0..1000 {
        scene.scheduler.observe(1, placed(1), true);
        scene.run(1);
        seen += usize::from(scene.merged() == [0, 2]);
    }
    assert_eq!(scene.plans, 1);
    assert!(seen > 980, "{seen}");
}

/// Objects that move now and then are merged ever more rarely.
#[test]
fn restless_objects_wait_longer_each_time() {
    let mut scene = Scene::new(&[10, 20, 30]);
    for _ in 0..2000 {
        scene.scheduler.observe(1, placed(1), true);
        scene.run(10 * QUIET);
    }
    assert!(scene.plans < 10, "{} plans in 20,000 quiet times", scene.plans);
    assert_eq!(scene.merged(), [0, 2]);
}

#[test]
fn long_rest_makes_up_for_disturbances() {
    let mut scene = Scene::new(&[10, 20, 30]);
    for step in 0..50 {
        scene.run(50 * QUIET);
        assert_eq!(scene.merged(), [0, 1, 2], "{step}");
        scene.scheduler.observe(1, placed(1), true);
    }
}

/// A steady trickle of objects delays others only for a while, and causes few builds.
#[test]
fn a_trickle_of_objects_is_merged_in_lots() {
    let mut scene = Scene::new(&[]);
    scene.sizes = vec![1; 500];
    for slot in 0..500 {
        scene.scheduler.observe(slot, placed(slot), false);
        scene.run(QUIET / 2);
    }
    assert!(scene.merged().len() > 400);
    assert!(scene.plans < 100, "{}", scene.plans);
}

#[test]
fn changes_during_a_build_make_it_stale() {
    let mut scene = Scene::new(&[10, 20]);
    let plan = (0..20).find_map(|_| scene.plan());
    assert_eq!(plan, Some(vec![0, 1]));
    assert!(scene.plan().is_none(), "one build at a time");
    scene.scheduler.observe(1, placed(1), true);
    assert!(scene.scheduler.is_stale());
    scene.finish();
    assert!(scene.merged().is_empty());
    assert_eq!(scene.scheduler.take_released(), [0], "its room is given back");
    scene.run(30 * QUIET);
    assert_eq!(scene.merged(), [0, 1]);
}

#[test]
fn what_can_not_be_built_is_not_tried_again() {
    let mut scene = Scene::new(&[10, 20]);
    assert!((0..20).find_map(|_| scene.plan()).is_some());
    scene.scheduler.fail();
    scene.run(100);
    assert_eq!((scene.plans, scene.trees()), (1, 0));
    assert!(!scene.scheduler.is_pending());
    scene.scheduler.observe(0, placed(0), true);
    scene.run(100);
    assert_eq!(scene.merged(), [0]);
}

#[test]
fn lost_trees_are_built_again_after_a_while() {
    let mut scene = Scene::new(&[10, 20]);
    scene.run(3 * QUIET);
    for (plans, pause) in [(1, 600), (2, 1200), (3, 2400)] {
        scene.scheduler.take_changed();
        scene.scheduler.lose_trees();
        assert!(scene.merged().is_empty() && scene.scheduler.take_changed());
        assert!(
            scene.scheduler.take_released().is_empty(),
            "their rooms are gone already"
        );
        scene.run(pause - 1);
        assert_eq!(scene.plans, plans, "before the pause of {pause} frames is over");
        assert!(!scene.scheduler.is_pending());
        scene.run(3 * QUIET);
        assert_eq!(scene.plans, plans + 1, "after the pause of {pause} frames");
        assert_eq!(scene.merged().len(), 2);
    }
}

#[test]
fn trees_without_room_are_built_once_something_gave_it_back() {
    let mut scene = Scene::new(&[10, 20]);
    assert!((0..20).find_map(|_| scene.plan()).is_some());
    scene.scheduler.refuse(1_000);
    let run = |scene: &mut Scene, used: u64, frames: u64| {
        for _ in 0..frames {
            scene.scheduler.note_used(used, false);
            scene.run(1);
        }
    };
    run(&mut scene, 1_000, 2_000);
    assert_eq!((scene.plans, scene.trees()), (1, 0), "nothing was given back");
    assert!(!scene.scheduler.is_pending());
    run(&mut scene, 900, 3 * QUIET);
    assert_eq!((scene.plans, scene.merged().len()), (2, 2));
}

#[test]
fn micromaps_are_no_disturbance() {
    let with = |name: u64| {
        placed(0).map(|placement| Placement {
            micromaps: name,
            ..placement
        })
    };
    assert!(gains_micromaps(with(0), with(3)));
    assert!(!gains_micromaps(with(3), with(0)), "the material changed");
    assert!(!gains_micromaps(with(3), with(4)));
    assert!(!gains_micromaps(None, with(3)) && !gains_micromaps(with(0), None));
    let mut scheduler = MergeScheduler::new(LIMITS);
    let extent = Extent {
        triangles: 10,
        centre: Vec3A::ZERO,
    };
    let plan = |scheduler: &mut MergeScheduler, frames: u64| {
        for _ in 0..frames {
            scheduler.advance(|_, _| Some(extent));
            if let Some(members) = scheduler.plan() {
                return Some(members[0].1.micromaps);
            }
        }
        None
    };
    scheduler.observe(0, with(0), false);
    assert_eq!(plan(&mut scheduler, 3 * QUIET), Some(0));
    scheduler.observe(0, with(3), false);
    assert!(scheduler.is_stale(), "the tree would lack them");
    scheduler.abandon();
    assert_eq!(plan(&mut scheduler, 3 * QUIET), Some(3), "it needn't rest anew");
    scheduler.finish(tree(1));
    scheduler.observe(0, with(0), false);
    assert!(scheduler.take_changed() && scheduler.take_released() == [1]);
    assert_eq!(
        plan(&mut scheduler, 3 * QUIET),
        None,
        "it changed, and has to rest for longer"
    );
    let mut scheduler = MergeScheduler::new(LIMITS);
    scheduler.observe(0, with(0), false);
    assert_eq!(plan(&mut scheduler, 3 * QUIET), Some(0));
    scheduler.observe(0, with(3), true);
    scheduler.abandon();
    assert_eq!(plan(&mut scheduler, 3 * QUIET), None, "it moved, too");
}

const SHIFT: Vec3A = Vec3A::new(-64.0, 0.0, 32.0);

fn offsets(scene: &Scene) -> Vec<Vec3A> {
    scene.scheduler.trees().map(|tree| tree.offset).collect()
}

#[test]
fn shifts_of_the_world_disturb_nothing() {
    let mut scene = Scene::new(&[300; 6]);
    scene.run(4 * QUIET);
    for _ in 0..10 {
        scene.scheduler.take_changed();
        scene.scheduler.take_crossed();
        scene.scheduler.shift(SHIFT, [].into_iter());
        assert_eq!(offsets(&scene), [SHIFT; 2]);
        assert!(scene.scheduler.take_changed() && scene.scheduler.is_pending());
        assert!(scene.scheduler.take_crossed().is_empty() && scene.scheduler.take_cuts().is_empty());
        for _ in 0..4 * QUIET {
            scene.run(1);
            assert_eq!(scene.merged().len(), 6);
        }
        assert_eq!(offsets(&scene), [Vec3A::ZERO; 2], "built again at their present places");
        assert!(!scene.scheduler.is_pending());
    }
    // Trees of a world that moves all the time aren't built again.
    let plans = scene.plans;
    for _ in 0..2 * QUIET {
        scene.scheduler.shift(SHIFT, [].into_iter());
        scene.run(1);
    }
    assert_eq!((scene.plans, scene.merged().len()), (plans, 6));
}

#[test]
fn objects_that_are_not_shifted_are_cut_out() {
    let mut scene = Scene::new(&[300; 6]);
    scene.run(4 * QUIET);
    scene.scheduler.take_crossed();
    scene.scheduler.shift(SHIFT, [5].into_iter());
    assert_eq!(scene.merged(), [0, 1, 2, 3, 4]);
    assert_eq!(scene.scheduler.take_cuts(), [(1, 5)]);
    assert_eq!(scene.scheduler.take_crossed(), [5]);
}

/// Objects that came to rest before a shift and after it, which have neighbours among each other.
#[test]
fn large_scenes_are_split_in_space_across_a_shift() {
    let mut scene = Scene::new(&[]);
    scene.sizes = vec![100; 32];
    let come = |scene: &mut Scene, slots: core::ops::Range<u32>| {
        slots.for_each(|slot| scene.scheduler.observe(slot, placed(slot), false));
    };
    come(&mut scene, 0..16);
    scene.run(QUIET + 1);
    assert_eq!(scene.plans, 0);
    scene.shift = Vec3A::X * -20.0;
    scene.scheduler.shift(scene.shift, [].into_iter());
    come(&mut scene, 16..32);
    scene.run(20 * QUIET);
    assert_eq!((scene.merged().len(), scene.trees()), (32, 4));
    // The second half of a chunk dissolves it.
    let trees: Vec<_> = (0..32).filter_map(|slot| scene.tree_of(slot)).collect();
    assert!(trees.is_sorted() || trees.iter().rev().is_sorted(), "{trees:?}");
}

#[test]
fn objects_that_stay_behind_before_they_are_merged_get_other_neighbours() {
    let mut scene = Scene::new(&[100; 16]);
    scene.run(QUIET + 1);
    assert_eq!(scene.plans, 0);
    // The first four are at 0, 1, 2 and 3; the others from -16 to -5.
    scene.scheduler.shift(Vec3A::X * -20.0, 0..4);
    scene.run(20 * QUIET);
    assert_eq!((scene.merged().len(), scene.trees()), (16, 2));
    let [first, fifth, last] = [0, 4, 15].map(|slot| scene.tree_of(slot));
    assert!(
        first.is_some() && first == last && first != fifth,
        "{first:?} {fifth:?} {last:?}"
    );
}

#[test]
fn a_shift_during_a_build_moves_its_tree() {
    let mut scene = Scene::new(&[300; 3]);
    while scene.plan().is_none() {}
    scene.scheduler.shift(SHIFT, [].into_iter());
    assert!(!scene.scheduler.is_stale());
    scene.finish();
    assert_eq!((scene.merged().len(), offsets(&scene)), (3, vec![SHIFT]));
    // Without one of its objects, it is stale.
    let mut scene = Scene::new(&[300; 3]);
    while scene.plan().is_none() {}
    scene.scheduler.shift(SHIFT, [1].into_iter());
    assert!(scene.scheduler.is_stale());
}
