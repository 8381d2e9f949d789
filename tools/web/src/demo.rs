//! The demo's scene with a camera that flies, the settings panel, and the comparison.

use crate::{
    compare::ComparePlugin,
    page::{Address, PagePlugin},
};
use bevy::{
    camera::Hdr,
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass},
    light::{DirectionalLightShadowMap, PointLightShadowMap},
    prelude::*,
};
use bevy_egui::{EguiContexts, EguiGlobalSettings, EguiPrimaryContextPass};
use bevy_glint::{RayTracedReflectionsPlugin, named_settings, ui::ReflectionSettingsPanelPlugin};
use glint_scenes::{SceneAnimationPlugin, SceneName, camera, drop_anisotropy, environment, spawn};

/// Default settings of a visitor.
const TECHNIQUE: &str = "medium";

/// Choices in the address of the page.
#[derive(Resource, Clone)]
struct Wishes {
    scene: SceneName,
    technique: String,
    trilinear: bool,
}

/// Runs the demo on the page's canvas.
///
/// The page's address has the options: `scene`, `technique`, `shadows` (texels of a shadow map in each direction), and `panel`, `bar`,
/// `still` and `trilinear` (textures are filtered without anisotropy), each true or false.
pub fn run() {
    let address = Address::read();
    let still = address.get("still").unwrap_or(false);
    let shadows = address.get("shadows").unwrap_or(2048).clamp(64, 8192);
    let wishes = Wishes {
        scene: address.get("scene").unwrap_or(SceneName::Demo),
        technique: address.get("technique").unwrap_or_else(|| TECHNIQUE.to_owned()),
        trilinear: address.get("trilinear").unwrap_or(false),
    };
    App::new()
        .add_plugins((
            DefaultPlugins.set(WindowPlugin {
                primary_window: Some(Window {
                    canvas: Some("#demo".to_owned()),
                    fit_canvas_to_parent: true,
                    ..default()
                }),
                ..default()
            }),
            FreeCameraPlugin,
            SceneAnimationPlugin,
            RayTracedReflectionsPlugin::default(),
            ReflectionSettingsPanelPlugin {
                open: address.get("panel").unwrap_or(true),
                ..default()
            },
            PagePlugin { still },
            ComparePlugin {
                bar: address.get("bar").unwrap_or(true),
            },
        ))
        // Input over the panel isn't meant for the camera.
        .insert_resource(EguiGlobalSettings {
            enable_absorb_bevy_input_system: true,
            ..default()
        })
        .insert_resource(wishes)
        .insert_resource(DirectionalLightShadowMap { size: shadows })
        .insert_resource(PointLightShadowMap { size: shadows / 2 })
        .add_systems(EguiPrimaryContextPass, accept_long_clicks)
        .add_systems(
            Startup,
            (spawn_scene, move |mut time: ResMut<Time<Virtual>>| {
                if still {
                    time.pause();
                }
            }),
        )
        .run();
}

/// On slow devices a frame can be longer than egui allows for a click.
fn accept_long_clicks(mut contexts: EguiContexts) -> Result {
    let context = contexts.ctx_mut()?;
    context.options_mut(|options| options.input_options.max_click_duration = f64::INFINITY);
    Ok(())
}

fn spawn_scene(world: &mut World) {
    let wishes = world.resource::<Wishes>().clone();
    spawn(wishes.scene, world);
    if wishes.trilinear {
        drop_anisotropy(&mut world.resource_mut());
    }
    let settings = named_settings(&wishes.technique).unwrap_or_else(|error| {
        warn!("{error}");
        default()
    });
    let (transform, projection) = camera(wishes.scene);
    let light = environment(wishes.scene, world);
    let mut camera = world.spawn((
        Camera3d::default(),
        Hdr,
        Msaa::Off,
        DepthPrepass,
        DeferredPrepass,
        Projection::from(projection),
        transform,
        FreeCamera {
            walk_speed: 3.0,
            run_speed: 12.0,
            ..default()
        },
        settings,
    ));
    light.insert(&mut camera);
}
