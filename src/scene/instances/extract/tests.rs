//! Tests entities that lose a component, in any frame.

use super::*;
use bevy::render::MainWorld;
use core::time::Duration;

fn note_lost(mut removed: Extract<RemovedFromScene>, mut lost: ResMut<LostComponents>) {
    lost.follow(&mut removed);
}

fn drop_lost(mut lost: ResMut<LostComponents>, mut instances: ResMut<SceneInstances>) {
    lost.drop_objects(&mut instances);
}

/// Extracts a frame in which reflections begin or continue.
fn extract(render_world: &mut World, schedule: &mut Schedule, started: bool) {
    if started {
        render_world.resource_mut::<SceneInstances>().clear();
    }
    let mut activity = SceneActivity::default();
    for _ in 0..2 - u32::from(started) {
        activity.follow(true, Duration::ZERO, Duration::ZERO);
    }
    render_world.insert_resource(activity);
    schedule.run(render_world);
}

/// A render world with a camera that draws the default layers, and its extraction.
fn worlds() -> (World, Schedule) {
    let mut layers = SceneLayers::default();
    layers.follow(core::iter::once((None, None)), core::iter::empty());
    layers.changed = false;
    let mut render_world = World::new();
    render_world.init_resource::<MainWorld>();
    render_world.insert_resource(layers);
    render_world.init_resource::<LevelsOfDetail>();
    render_world.init_resource::<LostComponents>();
    render_world.init_resource::<SceneInstances>();
    let mut schedule = Schedule::default();
    schedule.add_systems(
        (
            note_lost,
            note_lost_materials::<MeshMaterial3d<StandardMaterial>>,
            extract_instances::<MeshMaterial3d<StandardMaterial>>,
            drop_lost,
        )
            .chain(),
    );
    (render_world, schedule)
}

#[test]
fn layers_of_lights_concern_objects_with_layers() {
    let (mut render_world, mut schedule) = worlds();
    let mut main_world = render_world.resource_mut::<MainWorld>();
    let [plain, layered] = [None, Some(RenderLayers::from_layers(&[0, 1]))].map(|layers| {
        let object = (
            Mesh3d::default(),
            MeshMaterial3d::<StandardMaterial>::default(),
            InheritedVisibility::VISIBLE,
        );
        let mut entity = main_world.spawn(object);
        layers.map(|layers| entity.insert(layers));
        entity.id()
    });
    extract(&mut render_world, &mut schedule, true);
    // Entities that are extracted again reappear.
    let mut instances = render_world.resource_mut::<SceneInstances>();
    for entity in [plain, layered] {
        instances.remove(entity);
    }
    let mut layers = render_world.resource_mut::<SceneLayers>();
    let flash = RenderLayers::from_layers(&[0, 1]);
    layers.follow(core::iter::once((None, None)), core::iter::once(&flash));
    extract(&mut render_world, &mut schedule, false);
    let instances = render_world.resource::<SceneInstances>();
    let found = [plain, layered].map(|entity| instances.find(entity).is_some());
    assert_eq!(found, [false, true]);
}

#[test]
fn who_loses_a_component_is_looked_at_anew() {
    for started in [false, true] {
        let (mut render_world, mut schedule) = worlds();
        let mut main_world = render_world.resource_mut::<MainWorld>();
        let [left_out, shadowless, shapeless, colorless] = [(); 4].map(|()| {
            let object = (
                Mesh3d::default(),
                MeshMaterial3d::<StandardMaterial>::default(),
                InheritedVisibility::VISIBLE,
            );
            main_world.spawn(object).id()
        });
        main_world.entity_mut(left_out).insert(NotReflected);
        main_world.entity_mut(shadowless).insert(NotShadowCaster);
        extract(&mut render_world, &mut schedule, true);
        let find = |render_world: &World, entity: Entity| {
            let instances = render_world.resource::<SceneInstances>();
            instances.find(entity).map(|(_, source)| source.casts_shadow)
        };
        let before = [left_out, shadowless, shapeless, colorless].map(|entity| find(&render_world, entity));
        assert_eq!(before, [None, Some(false), Some(true), Some(true)]);

        let mut main_world = render_world.resource_mut::<MainWorld>();
        main_world.entity_mut(left_out).remove::<NotReflected>();
        main_world.entity_mut(shadowless).remove::<NotShadowCaster>();
        main_world.entity_mut(shapeless).remove::<Mesh3d>();
        main_world
            .entity_mut(colorless)
            .remove::<MeshMaterial3d<StandardMaterial>>();
        extract(&mut render_world, &mut schedule, started);
        let after = [left_out, shadowless, shapeless, colorless].map(|entity| find(&render_world, entity));
        assert_eq!(
            after,
            [Some(true), Some(true), None, None],
            "reflections begin: {started}"
        );
    }
}
