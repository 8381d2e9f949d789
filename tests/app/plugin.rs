//! The plugin in apps of all kinds.

use crate::common;
use bevy::{
    app::PluginGroupBuilder,
    core_pipeline::schedule::{Core3d, Core3dSystems},
    ecs::schedule::{InternedScheduleLabel, LogLevel, ScheduleBuildSettings, ScheduleLabel, SystemSet},
    platform::collections::HashMap,
    prelude::*,
    render::{
        MainWorld, Render, RenderApp, RenderPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        settings::{RenderCreation, WgpuSettings},
    },
};
use bevy_glint::{
    NotReflected, RayTracedReflections, RayTracedReflectionsPlugin, ReflectionStatus, ReflectionSystems,
    ReflectionTracerChoice,
};
use glint_scenes::Output;
use std::sync::{Arc, Mutex};

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

/// Bevy's plugins without an event loop, a log and a handler of Ctrl+C.
fn plugins_with(render: RenderPlugin) -> PluginGroupBuilder {
    DefaultPlugins
        .set(render)
        .disable::<bevy::winit::WinitPlugin>()
        .disable::<bevy::log::LogPlugin>()
        .disable::<bevy::app::TerminalCtrlCHandlerPlugin>()
}

/// Such plugins with a renderer that has no device.
pub fn plugins_without_gpu() -> PluginGroupBuilder {
    plugins_with(RenderPlugin {
        render_creation: RenderCreation::Automatic(Box::new(WgpuSettings {
            backends: None,
            ..default()
        })),
        ..default()
    })
}

#[test]
fn a_renderer_without_a_device_is_no_error() {
    let mut app = App::new();
    app.add_plugins((plugins_without_gpu(), RayTracedReflectionsPlugin::default()));
    app.finish();
    app.cleanup();
    app.update();
}

/// Our systems must not touch the same data in an undefined order, because frames would differ.
#[test]
fn no_system_order_is_left_to_chance() {
    let without = ambiguities(|_| {});
    let with = ambiguities(|app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
    });
    let (Some(without), Some(with)) = (without, with) else {
        return;
    };
    for (schedule, pairs) in &with {
        let before = without.get(schedule).map_or(&[][..], Vec::as_slice);
        let new: Vec<_> = pairs.iter().filter(|pair| !before.contains(pair)).collect();
        assert!(new.is_empty(), "{schedule:?}: {new:#?}");
    }
}

/// The target of passes. Bevy's ambiguity check doesn't see it, since passes only record commands.
#[derive(Resource)]
struct Frame;

/// Systems in the place of passes, which declare that they draw.
#[test]
fn passes_run_in_an_order_that_is_declared() {
    let found = ambiguities(|app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        let [ours, fog] = [(); 2].map(|()| |_: ResMut<Frame>| {});
        render_app.insert_resource(Frame).add_systems(
            Core3d,
            (
                ours.in_set(ReflectionSystems::FrontLayerPasses),
                // As Bevy's volumetric fog does.
                fog.after(Core3dSystems::MainPass)
                    .before(Core3dSystems::EarlyPostProcess),
            ),
        );
    });
    let pairs = found.into_iter().flatten().flat_map(|(_, pairs)| pairs);
    let drawn: Vec<_> = pairs.filter(|pair| pair.contains("Frame\"")).collect();
    assert!(
        drawn.is_empty(),
        "fog over reflections on water is left to chance: {drawn:#?}"
    );
}

/// Sets of the plugin in the order in which they run, by schedule.
fn sets() -> [(InternedScheduleLabel, &'static [ReflectionSystems]); 3] {
    use ReflectionSystems::{
        DebugViews, ExtractCameras, ExtractScene, Passes, PrepareBindGroups, PrepareScene, PrepareViews,
        QueuePipelines, RequestPipelines,
    };
    [
        (ExtractSchedule.intern(), &[ExtractScene, ExtractCameras]),
        (
            Render.intern(),
            &[
                PrepareScene,
                RequestPipelines,
                QueuePipelines,
                PrepareViews,
                PrepareBindGroups,
            ],
        ),
        (Core3d.intern(), &[Passes, DebugViews]),
    ]
}

/// Names of systems before the first of these sets, between any two, and after the last.
fn names(sets: &[ReflectionSystems]) -> Vec<String> {
    let after = sets.iter().map(|set| format!("after {set:?}"));
    [format!("before {:?}", sets[0])].into_iter().chain(after).collect()
}

/// Names of an app's systems in the order in which they ran.
#[derive(Clone, Default)]
struct Order(Arc<Mutex<Vec<String>>>);

impl Order {
    fn note(&self, name: String) -> impl FnMut() + Send + Sync + 'static {
        let names = self.0.clone();
        move || names.lock().unwrap().push(name.clone())
    }
}

/// Adds systems around all sets of the plugin. Each of them records its name.
fn add_systems_around_sets(app: &mut App, notes: &Order) {
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        return;
    };
    for (schedule, sets) in sets() {
        for (place, name) in names(sets).into_iter().enumerate() {
            let mut system = notes.note(name).into_configs();
            if let Some(next) = sets.get(place) {
                system = system.before(*next);
            }
            if let Some(last) = place.checked_sub(1) {
                system = system.after(sets[last]);
            }
            render_app.add_systems(schedule, system);
        }
    }
}

/// The sets are public so that apps can do this.
#[test]
fn systems_of_an_app_run_before_and_after_those_of_the_plugin() {
    let order = Order::default();
    let notes = order.clone();
    let add = move |app: &mut App| add_systems_around_sets(app, &notes);
    let Some(mut app) = common::app_with(UVec2::new(32, 18), Output::Picture, ReflectionTracerChoice::Bvh, add) else {
        return;
    };
    app.spawn_camera(RayTracedReflections::default());
    app.step(1);
    order.0.lock().unwrap().clear();
    app.step(1);
    let ran = order.0.lock().unwrap().clone();
    for (schedule, sets) in sets() {
        let expected = names(sets);
        let ran: Vec<_> = ran.iter().filter(|name| expected.contains(name)).collect();
        assert_eq!(ran, expected.iter().collect::<Vec<_>>(), "{schedule:?}");
        let render_world = app.app().sub_app_mut(RenderApp).world_mut();
        render_world.schedule_scope(schedule, |_, schedule| {
            for set in sets {
                let systems = schedule.graph().systems_in_set(set.intern());
                assert!(systems.is_ok_and(|systems| !systems.is_empty()), "nothing in {set:?}");
            }
        });
    }
}

/// Our passes and those of Bevy that touch the same textures, in the order in which they are recorded. Bevy exports neither the pass of the
/// sky nor that of the fog.
#[test]
fn passes_are_recorded_in_order() {
    let chains: [&[&str]; 6] = [
        &[
            "deferred_lighting",
            "ray_traced_reflections",
            "write_guides",
            "main_opaque_pass_3d",
            "find_front_layers",
            "reflect_on_opaque_layers",
            "main_transmissive_pass_3d",
            "main_transparent_pass_3d",
            "reflect_on_front_layers",
            "volumetric_fog",
            "tonemapping",
        ],
        &["main_opaque_pass_3d", "keep_screens", "reflect_on_opaque_layers"],
        &["keep_screens", "main_transmissive_pass_3d"],
        // Haze lies over reflections.
        &["reflect_on_opaque_layers", "render_sky", "reflect_on_front_layers"],
        &["oit_resolve", "reflect_on_front_layers"],
        // Debug views lie over everything.
        &["volumetric_fog", "show_debug_views", "show_front_layers", "tonemapping"],
    ];
    let Some(mut app) = built(|app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
    }) else {
        return;
    };
    let passes: Vec<String> = app
        .sub_app_mut(RenderApp)
        .world_mut()
        .schedule_scope(Core3d, |world, schedule| {
            schedule.initialize(world).unwrap();
            let systems = schedule.systems().unwrap();
            systems.map(|(_, system)| system.name().to_string()).collect()
        });
    let place = |name: &str| {
        let is_it = |pass: &String| pass.rsplit("::").next() == Some(name);
        passes.iter().position(is_it)
    };
    let mut wrong = Vec::new();
    for pair in chains.iter().flat_map(|chain| chain.windows(2)) {
        if place(pair[0])
            .zip(place(pair[1]))
            .is_none_or(|(first, then)| first > then)
        {
            wrong.push(pair);
        }
    }
    assert!(wrong.is_empty(), "not in this order: {wrong:?} of {passes:#?}");
}

/// Pairs of systems with an undefined order, and the data that both touch, by schedule.
fn ambiguities(add: impl FnOnce(&mut App)) -> Option<HashMap<(bool, InternedScheduleLabel), Vec<String>>> {
    let mut app = built(add)?;
    let mut pairs = HashMap::default();
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
            let found = sub_app.world_mut().schedule_scope(label, |world, schedule| {
                schedule.initialize(world).unwrap().unwrap();
                let names: HashMap<_, _> = schedule
                    .systems()
                    .unwrap()
                    .map(|(key, system)| (key, system.name()))
                    .collect();
                let conflicts = schedule.graph().conflicting_systems().iter();
                conflicts
                    .map(|(a, b, data)| {
                        let data = data.iter().map(|id| world.components().get_name(*id));
                        format!("{} and {}: {:?}", names[a], names[b], data.collect::<Vec<_>>())
                    })
                    .collect()
            });
            pairs.insert((in_render_world, label), found);
        }
    }
    Some(pairs)
}

/// An app with a renderer, before its first frame.
fn built(add: impl FnOnce(&mut App)) -> Option<App> {
    let mut app = App::new();
    let render = RenderPlugin {
        synchronous_pipeline_compilation: true,
        ..default()
    };
    app.add_plugins(plugins_with(render).disable::<PipelinedRenderingPlugin>());
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
    app.sub_app_mut(RenderApp).init_resource::<MainWorld>();
    Some(app)
}
