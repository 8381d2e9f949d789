//! The plugin in apps of all kinds.

#[path = "common/pictures.rs"]
mod pictures;

use bevy::{
    ecs::schedule::{InternedScheduleLabel, LogLevel, ScheduleBuildSettings},
    platform::collections::HashMap,
    prelude::*,
    render::{
        MainWorld, RenderApp, RenderPlugin, pipelined_rendering::PipelinedRenderingPlugin, settings::RenderCreation,
    },
};
use bevy_glint::{NotReflected, RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus};

#[test]
fn an_app_without_a_renderer_goes_on() {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, RayTracedReflectionsPlugin::default()));
    app.world_mut().spawn((RayTracedReflections::default(), NotReflected));
    app.finish();
    app.cleanup();
    app.update();
    app.update();
    let report = app.world().resource::<ReflectionStatus>().report();
    assert_eq!(report.tracer, None);
    assert!(!report.ready);
}

#[test]
fn a_renderer_without_a_device_is_no_error() {
    let mut app = App::new();
    let no_gpu = RenderPlugin {
        render_creation: RenderCreation::Automatic(Box::new(bevy::render::settings::WgpuSettings {
            backends: None,
            ..default()
        })),
        ..default()
    };
    app.add_plugins((
        DefaultPlugins
            .set(no_gpu)
            .disable::<bevy::winit::WinitPlugin>()
            .disable::<bevy::log::LogPlugin>()
            .disable::<bevy::app::TerminalCtrlCHandlerPlugin>(),
        RayTracedReflectionsPlugin::default(),
    ));
    app.finish();
    app.cleanup();
    app.update();
}

/// Systems of ours that may run in either order and touch the same data would make frames differ.
#[test]
fn no_system_order_is_left_to_chance() {
    let without = ambiguities(|_| {});
    let with = ambiguities(|app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
    });
    let (Some(without), Some(with)) = (without, with) else {
        return;
    };
    for (schedule, count) in &with {
        let before = without.get(schedule).copied().unwrap_or(0);
        assert_eq!(*count, before, "new ambiguities in {schedule:?}");
    }
}

fn ambiguities(add: impl FnOnce(&mut App)) -> Option<HashMap<(bool, InternedScheduleLabel), usize>> {
    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
                ..default()
            })
            .disable::<PipelinedRenderingPlugin>()
            .disable::<bevy::winit::WinitPlugin>()
            .disable::<bevy::log::LogPlugin>()
            .disable::<bevy::app::TerminalCtrlCHandlerPlugin>(),
    );
    add(&mut app);
    while app.plugins_state() == bevy::app::PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    if app.get_sub_app(RenderApp).is_none_or(|render| {
        !render
            .world()
            .contains_resource::<bevy::render::renderer::RenderDevice>()
    }) {
        assert!(
            std::env::var_os("GLINT_REQUIRE_GPU").is_none(),
            "a GPU is required, but there is none"
        );
        println!("skipped: no GPU");
        return None;
    }
    let mut counts = HashMap::default();
    app.sub_app_mut(RenderApp).init_resource::<MainWorld>();
    for in_render_world in [false, true] {
        let sub_app = if in_render_world {
            app.sub_app_mut(RenderApp)
        } else {
            app.main_mut()
        };
        let labels: Vec<_> = {
            let mut schedules = sub_app.world_mut().resource_mut::<Schedules>();
            schedules
                .iter_mut()
                .map(|(_, schedule)| {
                    schedule.set_build_settings(ScheduleBuildSettings {
                        ambiguity_detection: LogLevel::Warn,
                        auto_insert_apply_deferred: false,
                        use_shortnames: false,
                        ..default()
                    });
                    schedule.label()
                })
                .collect()
        };
        for label in labels {
            let count = sub_app.world_mut().schedule_scope(label, |world, schedule| {
                schedule.initialize(world).unwrap().unwrap();
                schedule.graph().conflicting_systems().len()
            });
            counts.insert((in_render_world, label), count);
        }
    }
    Some(counts)
}
