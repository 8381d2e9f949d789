//! Answers that are right, nearly right, and wrong.

use super::*;
use bevy::{math::Vec3, prelude::Transform};

const FRONT: Entity = Entity::from_raw_u32(1).unwrap();
const BACK: Entity = Entity::from_raw_u32(2).unwrap();
const ELSEWHERE: Entity = Entity::from_raw_u32(3).unwrap();

/// A triangle that faces the viewer from a distance.
fn object(entity: Entity, distance: f32) -> Object {
    let place = Transform::from_xyz(0.0, 0.0, -distance).compute_affine();
    let corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]].map(DVec3::from);
    Object::new(entity, &place, vec![corners]).unwrap()
}

fn scene() -> Objects {
    Objects {
        known: vec![object(FRONT, 2.0), object(BACK, 5.0)],
        unknown: [ELSEWHERE].into_iter().collect(),
    }
}

fn ray(x: f32) -> TraceRay {
    TraceRay {
        origin: Vec3::new(x, 0.0, 0.0),
        direction: Vec3::NEG_Z,
        t_min: 0.0,
        t_max: f32::MAX,
    }
}

fn hit_at(t: f32, entity: Entity) -> Hit {
    let entity = Some(entity);
    Hit {
        t,
        entity,
        ..Hit::default()
    }
}

fn closest(objects: &Objects, x: f32, hit: Option<(f32, Entity)>) -> Judgement {
    let hit = hit.map(|(t, entity)| hit_at(t, entity));
    objects.along(&ray(x)).judge_closest(&Answer { hit, blocked: None })
}

#[test]
fn closest_hits_are_judged() {
    let mut objects = scene();
    assert_eq!(closest(&objects, 0.0, Some((2.0, FRONT))), Judgement::Exact);
    assert_eq!(closest(&objects, 0.9, None), Judgement::Exact);
    for wrong in [
        None,
        Some((5.0, BACK)),
        Some((2.1, FRONT)),
        Some((2.0, BACK)),
        Some((5.0, ELSEWHERE)),
    ] {
        assert_eq!(closest(&objects, 0.0, wrong), Judgement::Wrong, "{wrong:?}");
    }
    assert_eq!(closest(&objects, 0.9, Some((2.0, FRONT))), Judgement::Wrong, "past it");
    // The edge on the right.
    for hit in [Some((2.0, FRONT)), Some((5.0, BACK)), None] {
        assert_ne!(closest(&objects, 0.5, hit), Judgement::Wrong, "{hit:?}");
    }
    for hit in [Some((5.0, BACK)), None] {
        assert_eq!(closest(&objects, 0.5, hit), Judgement::Border, "{hit:?}");
    }
    assert_eq!(closest(&objects, 0.0, Some((1.0, ELSEWHERE))), Judgement::Excused);
    objects.known[0].see_through = true;
    for hit in [(2.0, FRONT), (5.0, BACK)] {
        assert_eq!(closest(&objects, 0.0, Some(hit)), Judgement::Excused, "{hit:?}");
    }
    assert_eq!(closest(&objects, 0.0, None), Judgement::Wrong, "the other one is solid");
}

#[test]
fn faces_that_are_culled_let_rays_pass() {
    let mut objects = scene();
    objects.known[0].culled = Some(Face::Back);
    assert_eq!(closest(&objects, 0.0, Some((2.0, FRONT))), Judgement::Exact);
    objects.known[0].culled = Some(Face::Front);
    assert_eq!(closest(&objects, 0.0, Some((5.0, BACK))), Judgement::Exact);
    assert_eq!(closest(&objects, 0.0, Some((2.0, FRONT))), Judgement::Wrong);
}

#[test]
fn shadows_are_judged() {
    let by = |objects: &Objects, x: f32, blocked: Option<Option<Entity>>| {
        objects.along(&ray(x)).judge_shadow(&Answer { hit: None, blocked })
    };
    let mut objects = scene();
    for any in [FRONT, BACK] {
        assert_eq!(by(&objects, 0.0, Some(Some(any))), Judgement::Exact, "{any}");
        assert_eq!(by(&objects, 0.9, Some(Some(any))), Judgement::Wrong, "{any}");
    }
    assert_eq!(by(&objects, 0.0, None), Judgement::Wrong);
    assert_eq!(by(&objects, 0.9, None), Judgement::Exact);
    for x in [0.0, 0.9] {
        assert_eq!(by(&objects, x, Some(Some(ELSEWHERE))), Judgement::Excused);
        assert_eq!(
            by(&objects, x, Some(Entity::from_raw_u32(4))),
            Judgement::Wrong,
            "unheard of"
        );
        assert_eq!(by(&objects, x, Some(None)), Judgement::Wrong, "an empty slot");
    }
    objects.known[0].culled = Some(Face::Back);
    let judged = by(&objects, 0.0, Some(Some(FRONT)));
    assert_eq!(judged, Judgement::Wrong, "the light sees its back");
    objects.known[0].culled = Some(Face::Front);
    assert_eq!(by(&objects, 0.0, Some(Some(FRONT))), Judgement::Exact);
    objects.known[0].culled = None;
    objects.known[0].see_through = true;
    assert_eq!(
        by(&objects, 0.0, Some(Some(FRONT))),
        Judgement::Exact,
        "the other one is solid"
    );
    objects.known[1].see_through = true;
    for blocker in [Some(Some(FRONT)), None] {
        assert_eq!(by(&objects, 0.0, blocker), Judgement::Excused, "{blocker:?}");
    }
    objects.known[0].casts_shadow = false;
    assert_eq!(by(&objects, 0.0, Some(Some(FRONT))), Judgement::Wrong);
}

#[test]
fn triangles_without_area_may_be_seen() {
    let mut objects = scene();
    let corners = [DVec3::NEG_X, DVec3::X, DVec3::ZERO];
    objects.known[0].triangles = vec![corners];
    assert_eq!(closest(&objects, 0.0, Some((5.0, BACK))), Judgement::Exact);
    assert_eq!(closest(&objects, 0.0, Some((2.0, FRONT))), Judgement::Excused);
    assert_eq!(
        closest(&objects, 1.1, Some((2.0, FRONT))),
        Judgement::Wrong,
        "past its end"
    );
}

#[test]
fn hairs_are_not_counted_as_edges() {
    // Long and thin, and small on all sides.
    for size in [[1.0, 1e-5], [3e-5; 2]] {
        let mut objects = scene();
        let [x, y] = size;
        objects.known[0].triangles = vec![[[-x, -y, 0.0], [x, -y, 0.0], [0.0, y, 0.0]].map(DVec3::from)];
        assert_eq!(closest(&objects, 0.0, Some((2.0, FRONT))), Judgement::Exact, "{size:?}");
        assert_eq!(
            closest(&objects, 0.0, Some((5.0, BACK))),
            Judgement::Excused,
            "{size:?}"
        );
        // The one behind it is wide.
        assert_eq!(closest(&objects, 0.0, None), Judgement::Wrong, "{size:?}");
        objects.known.truncate(1);
        let shadow = |blocked| objects.along(&ray(0.0)).judge_shadow(&Answer { hit: None, blocked });
        for blocked in [None, Some(Some(FRONT))] {
            assert_eq!(shadow(blocked), Judgement::Excused, "{size:?}, {blocked:?}");
        }
        assert_eq!(closest(&objects, 0.0, None), Judgement::Excused, "{size:?}");
        assert_eq!(
            closest(&objects, 0.0, Some((2.5, FRONT))),
            Judgement::Wrong,
            "behind it"
        );
    }
    // A wide one stays wide for every ray.
    let mut objects = scene();
    objects.known.truncate(1);
    let shadow = |blocked| objects.along(&ray(0.5)).judge_shadow(&Answer { hit: None, blocked });
    for blocked in [None, Some(Some(FRONT))] {
        assert_eq!(shadow(blocked), Judgement::Border, "{blocked:?}");
    }
}

#[test]
fn distances_in_a_small_scene_are_small() {
    let place = Transform::from_scale(Vec3::splat(1e-4)).compute_affine();
    let corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]].map(DVec3::from);
    let objects = Objects {
        known: vec![Object::new(FRONT, &place, vec![corners]).unwrap()],
        ..Objects::default()
    };
    let near = TraceRay {
        origin: Vec3::Z * 1e-6,
        ..ray(0.0)
    };
    let exact = objects.along(&near);
    let judge = |hit, blocked| {
        let answer = Answer { hit, blocked };
        [exact.judge_closest(&answer), exact.judge_shadow(&answer)]
    };
    assert_eq!(
        judge(Some(hit_at(1e-6, FRONT)), Some(Some(FRONT))),
        [Judgement::Exact; 2]
    );
    assert_eq!(judge(None, None), [Judgement::Wrong; 2]);
    assert_eq!(judge(Some(hit_at(2e-6, FRONT)), None)[0], Judgement::Wrong);
}
