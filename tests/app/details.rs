//! Levels of detail: reflections show the levels that the nearest reflecting camera sees.

use crate::{
    pictures::{apps_of_both, reflect, warm_up},
    stage::{BEFORE_THE_MIRROR, GREEN, RED, SIZE, behind, metal, spawn_camera, spawn_mesh, unlit, wall},
};
use bevy::{camera::visibility::VisibilityRange, prelude::*};
use bevy_glint::ReflectionTechnique;
use glint_scenes::{HeadlessApp, Output, SceneName};

/// The colour in the middle of the image.
fn color(app: &mut HeadlessApp) -> [u8; 3] {
    warm_up(app);
    app.step(2);
    let picture = app.capture().unwrap();
    let middle = 4 * (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
    [picture[middle], picture[middle + 1], picture[middle + 2]]
}

#[track_caller]
fn assert_shows(app: &mut HeadlessApp, expected: [u8; 3], when: &str) {
    let color = color(app);
    let is_near = (0..3).all(|channel| color[channel].abs_diff(expected[channel]) < 25);
    assert!(is_near, "{when}: {color:?}, not {expected:?}");
}

#[test]
fn reflections_show_the_level_that_the_nearest_camera_sees() {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        let app = &mut app;
        println!("{tracer}");
        spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
        let levels = [(RED, 0.0, 14.0), (GREEN, 14.0, 100.0)].map(|(color, start, end)| {
            let level = spawn_mesh(app, Rectangle::new(60.0, 60.0), unlit(color), behind(20.0));
            let range = VisibilityRange::abrupt(start, end);
            app.world().entity_mut(level).insert(range);
            level
        });
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        reflect(app, camera, ReflectionTechnique::Reference);
        assert_shows(app, GREEN, "from afar");
        let near = Transform::from_xyz(0.0, 0.0, 8.5);
        app.world().entity_mut(camera).insert(near);
        assert_shows(app, RED, "the camera has come near");
        app.world().entity_mut(camera).insert(BEFORE_THE_MIRROR);
        assert_shows(app, GREEN, "it has gone away again");
        for level in levels {
            app.world().entity_mut(level).insert(behind(16.0));
        }
        assert_shows(app, RED, "the objects have come near");
        for level in levels {
            app.world().entity_mut(level).insert(behind(20.0));
        }
        let target = app.add_target(SIZE, Output::Picture);
        let other = app.spawn_camera((Transform::from_xyz(0.0, 0.0, 15.0), target));
        reflect(app, other, ReflectionTechnique::Reference);
        assert_shows(app, RED, "another camera is near");
        app.world().entity_mut(other).get_mut::<Camera>().unwrap().is_active = false;
        assert_shows(app, GREEN, "it is switched off");
        app.world().entity_mut(levels[0]).remove::<VisibilityRange>();
        app.world().despawn(levels[1]);
        assert_shows(app, RED, "the level is one no longer");
    }
}
