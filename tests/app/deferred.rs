//! The plugin and one component are enough, and other cameras of the app lose nothing.

use crate::{
    common::if_renders,
    pictures::{red_pixels, weak_device},
    stage::{
        BEFORE_THE_MIRROR, RED, SIZE, Unprepared, WithoutPrepass, add, metal, report, set_shader, spawn_mesh, spawn_of,
        unlit, until, wall,
    },
};
use bevy::{
    asset::uuid_handle,
    camera::{RenderTarget, ShadowLodOrigin},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass, NormalPrepass},
        tonemapping::{DebandDither, Tonemapping},
    },
    pbr::{DefaultOpaqueRendererMethod, ExtendedMaterial, MaterialExtension, ScreenSpaceReflections},
    prelude::*,
    reflect::PartialReflect,
    render::{render_resource::AsBindGroup, settings::WgpuSettings},
    shader::{Shader, ShaderRef},
};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectedMaterialPlugin, ReflectionFallback};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output};

/// An app with Bevy's default plugins, and the plugins of `add`; `None` (with the reason printed) if this machine can't render.
fn start(device: WgpuSettings, add: impl FnOnce(&mut App)) -> Option<HeadlessApp> {
    let settings = HeadlessSettings {
        size: SIZE,
        device,
        ..default()
    };
    let app = HeadlessApp::new(settings, |app| {
        // The harness draws deferred; Bevy does not.
        app.insert_resource(DefaultOpaqueRendererMethod::forward());
        add(app);
    });
    if_renders(app)
}

fn start_with_plugin(add: impl FnOnce(&mut App)) -> Option<HeadlessApp> {
    start(WgpuSettings::default(), |app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
        add(app);
    })
}

fn is_deferred(app: &mut HeadlessApp) -> bool {
    let method = app.world().resource::<DefaultOpaqueRendererMethod>();
    method.reflect_partial_eq(&DefaultOpaqueRendererMethod::deferred()) == Some(true)
}

/// A camera as apps spawn it. Without a window only this component makes Bevy draw shadows.
fn camera(target: RenderTarget, order: isize) -> impl Bundle {
    let camera = Camera { order, ..default() };
    let view = (Camera3d::default(), camera, target, BEFORE_THE_MIRROR);
    (view, ShadowLodOrigin, DebandDither::Disabled, Tonemapping::None)
}

fn spawn_reflecting(app: &mut HeadlessApp) -> Entity {
    let target = app.target();
    let camera = (camera(target, 0), RayTracedReflections::default());
    app.world().spawn(camera).id()
}

fn wait(app: &mut HeadlessApp) {
    app.warm_up(20_000).unwrap();
    until(app, "not ready", |app| {
        let report = report(app);
        report.ready && report.meshes_pending == 0 && report.instances > 1
    });
    app.step(12);
}

#[test]
fn the_plugin_and_one_component_are_enough() {
    let Some(mut app) = start_with_plugin(|_| {}) else {
        return;
    };
    assert!(is_deferred(&mut app));
    spawn_mesh(&mut app, wall(), metal(0.0), Transform::IDENTITY);
    let behind = Transform::from_xyz(0.0, 0.0, 6.0);
    spawn_mesh(&mut app, Cuboid::from_length(2.0), unlit(RED), behind);
    let id = spawn_reflecting(&mut app);
    wait(&mut app);
    let on = red_pixels(&app.capture().unwrap());
    app.world().entity_mut(id).remove::<RayTracedReflections>();
    app.step(4);
    let off = red_pixels(&app.capture().unwrap());
    assert!(on > 100 && off == 0, "red pixels: {on} with reflections, {off} without");
}

/// Bevy draws deferred materials on no camera without the prepass, and panics over one with other prepasses.
#[test]
fn cameras_without_reflections_show_everything() {
    let mut early = None;
    let Some(mut app) = start_with_plugin(|app| early = Some(app.world_mut().spawn(Camera3d::default()).id())) else {
        return;
    };
    let early = early.unwrap();
    spawn_mesh(&mut app, Cuboid::from_length(1.0), unlit(RED), Transform::IDENTITY);
    let targets = [(); 4].map(|()| app.add_target(SIZE, Output::Picture));
    let main = spawn_reflecting(&mut app);
    // Typical cameras of apps: one that existed before the plugin was ready, a plain one, one with a prepass for an effect, and one that
    // has lost its prepasses with its reflections.
    app.world().entity_mut(early).insert(camera(targets[0].clone(), 1));
    app.world().spawn(camera(targets[1].clone(), 2));
    app.world()
        .spawn((camera(targets[2].clone(), 3), DepthPrepass, NormalPrepass));
    let off = app
        .world()
        .spawn((camera(targets[3].clone(), 4), RayTracedReflections::default()))
        .id();
    app.world()
        .entity_mut(off)
        .remove::<(RayTracedReflections, DepthPrepass, DeferredPrepass, NormalPrepass)>();
    app.step(1);
    for id in [main, early, off] {
        assert!(app.world().entity(id).contains::<DeferredPrepass>());
        assert_eq!(app.world().get::<Msaa>(id), Some(&Msaa::Off));
    }
    app.warm_up(20_000).unwrap();
    app.step(4);
    let expected = red_pixels(&app.capture().unwrap());
    assert!(expected > 100, "the reflecting camera shows {expected} red pixels");
    for (index, target) in targets.iter().enumerate() {
        let found = red_pixels(&app.read_target(target).unwrap());
        assert_eq!(found, expected, "red pixels of camera {index}");
    }
}

const RED_SHADER: Handle<Shader> = uuid_handle!("0d5a1c52-6f0e-4a57-9a35-3a9f4d0a7c21");

/// An extension as apps with forward rendering write it: it has a colour and doesn't mention deferred rendering.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Reddening {}

impl MaterialExtension for Reddening {
    fn fragment_shader() -> ShaderRef {
        RED_SHADER.into()
    }
}

type Reddened = ExtendedMaterial<StandardMaterial, Reddening>;

/// Makes the shader of [`Reddening`] show a colour everywhere.
fn insert_shader(app: &mut HeadlessApp, color: &str) {
    let source = format!(
        "
        import bevy_pbr::render::forward_io::VertexOutput;
        @fragment
        fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {{ return vec4({color}, 1.0); }}
        "
    );
    set_shader(app, &RED_SHADER, source, "reddening.wesl");
}

/// They would be missing in the G-buffer.
#[test]
fn materials_without_a_prepass_are_drawn() {
    let Some(mut app) = start_with_plugin(|app| {
        app.add_plugins(MaterialPlugin::<Unprepared>::default());
    }) else {
        return;
    };
    let material = Unprepared {
        base: unlit(RED),
        extension: WithoutPrepass {},
    };
    spawn_of(&mut app, wall(), material, Transform::IDENTITY);
    spawn_reflecting(&mut app);
    app.warm_up(20_000).unwrap();
    app.step(4);
    let all = (SIZE.x * SIZE.y) as usize;
    assert_eq!(red_pixels(&app.capture().unwrap()), all, "red pixels");
}

/// The G-buffer would show only their base.
#[test]
fn extended_materials_keep_a_shader_of_their_own() {
    let Some(mut app) = start_with_plugin(|app| {
        app.add_plugins(MaterialPlugin::<Reddened>::default());
    }) else {
        return;
    };
    insert_shader(&mut app, "1.0, 0.0, 0.0");
    let mesh = add(&mut app, Mesh::from(wall()));
    let (base, extension) = (Color::srgb_u8(0, 255, 0).into(), Reddening {});
    let material = add(&mut app, Reddened { base, extension });
    spawn_reflecting(&mut app);
    app.warm_up(20_000).unwrap();
    // The material is there before any object has it.
    app.world().spawn((Mesh3d(mesh), MeshMaterial3d(material.clone())));
    app.step(4);
    app.warm_up(20_000).unwrap();
    let all = (SIZE.x * SIZE.y) as usize;
    assert_eq!(red_pixels(&app.capture().unwrap()), all, "red pixels");
    // A change makes Bevy prepare it again.
    let mut materials = app.world().resource_mut::<Assets<Reddened>>();
    materials.get_mut(&material).unwrap().base.metallic = 1.0;
    app.step(4);
    assert_eq!(red_pixels(&app.capture().unwrap()), all, "red pixels after a change");
}

/// Materials that the plugin keeps forward reflect if the camera requests it.
#[test]
fn extended_materials_that_stay_forward_reflect() {
    let Some(mut app) = start_with_plugin(|app| {
        app.add_plugins((
            MaterialPlugin::<Reddened>::default(),
            ReflectedMaterialPlugin::<Reddened>::default(),
        ));
    }) else {
        return;
    };
    insert_shader(&mut app, "0.0, 0.0, 0.0");
    let target = app.target();
    let (base, extension) = (metal(0.0), Reddening {});
    spawn_of(&mut app, wall(), Reddened { base, extension }, Transform::IDENTITY);
    let behind = Transform::from_xyz(0.0, 0.0, 6.0);
    spawn_mesh(&mut app, Cuboid::from_length(2.0), unlit(RED), behind);
    let settings = RayTracedReflections {
        forward: true,
        ..default()
    };
    let camera = (camera(target, 0), settings);
    let camera = app.world().spawn(camera).id();
    wait(&mut app);
    let on = red_pixels(&app.capture().unwrap());
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().forward = false;
    wait(&mut app);
    let off = red_pixels(&app.capture().unwrap());
    assert!(on > 100 && off == 0, "red pixels: {on} with reflections, {off} without");
}

#[test]
fn an_app_can_keep_its_own_method() {
    let Some(mut app) = start(WgpuSettings::default(), |app| {
        app.add_plugins(RayTracedReflectionsPlugin {
            deferred_by_default: false,
            ..default()
        });
    }) else {
        return;
    };
    let Some(mut other) = start_with_plugin(|app| {
        app.insert_resource(DefaultOpaqueRendererMethod::forward());
    }) else {
        return;
    };
    for (what, app) in [("switched off", &mut app), ("inserted after the plugin", &mut other)] {
        let target = app.target();
        let plain = app.world().spawn(camera(target, 0)).id();
        app.step(2);
        assert!(!is_deferred(app), "{what}");
        assert!(!app.world().entity(plain).contains::<DeferredPrepass>(), "{what}");
        assert_ne!(app.world().get::<Msaa>(plain), Some(&Msaa::Off), "{what}");
    }
    // It can change its mind.
    other.world().insert_resource(DefaultOpaqueRendererMethod::deferred());
    other.step(1);
    let mut plain = other.world().query_filtered::<Has<DeferredPrepass>, With<Camera3d>>();
    assert!(plain.iter(other.world()).all(|deferred| deferred));
}

#[test]
fn where_nothing_can_be_traced_screen_space_reflections_may_take_over() {
    let Some(mut app) = start(weak_device(), |app| {
        app.add_plugins(RayTracedReflectionsPlugin {
            fallback: ReflectionFallback::ScreenSpace,
            ..default()
        });
    }) else {
        return;
    };
    assert_eq!(report(&mut app).tracer, None, "{}", report(&mut app));
    assert!(is_deferred(&mut app));
    let reflecting = spawn_reflecting(&mut app);
    app.step(2);
    let has = |app: &mut HeadlessApp| app.world().entity(reflecting).contains::<ScreenSpaceReflections>();
    assert!(has(&mut app));
    assert!(app.world().entity(reflecting).contains::<DeferredPrepass>());
    app.world().entity_mut(reflecting).remove::<RayTracedReflections>();
    app.step(2);
    assert!(!has(&mut app), "they go with the component");
    // Settings of the app itself stay.
    app.world()
        .entity_mut(reflecting)
        .insert((RayTracedReflections::default(), ScreenSpaceReflections::default()));
    app.step(2);
    app.world().entity_mut(reflecting).remove::<RayTracedReflections>();
    app.step(2);
    assert!(has(&mut app));
}

#[test]
fn where_nothing_can_be_traced_materials_stay_as_they_were() {
    let plugin = RayTracedReflectionsPlugin::default();
    let Some(mut app) = start(weak_device(), |app| {
        app.add_plugins(plugin);
    }) else {
        return;
    };
    let Some(mut own) = start(weak_device(), |app| {
        app.add_plugins(plugin)
            .insert_resource(DefaultOpaqueRendererMethod::deferred());
    }) else {
        return;
    };
    assert_eq!(report(&mut app).tracer, None, "{}", report(&mut app));
    assert!(!is_deferred(&mut app));
    let target = app.target();
    let plain = app.world().spawn(camera(target, 0)).id();
    app.step(2);
    assert!(!app.world().entity(plain).contains::<DeferredPrepass>());
    assert!(is_deferred(&mut own), "the app has said so itself");
}
