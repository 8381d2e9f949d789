//! All types that an app stores are in the type registry, with everything that inspectors, scenes and scripts need.

#[cfg(feature = "egui")]
use bevy_glint::{
    ReflectionSettingsPanel, ReflectionSettingsPanelPlugin,
    ui::{CameraSettings, Measurements, PassTime},
};

use bevy::{
    prelude::*,
    reflect::{ReflectFromReflect, TypeRegistration, TypeRegistry, std_traits::ReflectDefault},
};
use bevy_glint::{
    AdaptiveThresholds, CombinedThresholds, FrontLayerShader, GrazingThresholds, HardwareVrsSupport, NotReflected,
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectedLayers, ReflectedMaterial3d, ReflectedMesh3d,
    ReflectedPose, ReflectedPoseBudget, ReflectedSurfaceShader, ReflectionAutoQuality, ReflectionBackend,
    ReflectionBudget, ReflectionDebugCounters, ReflectionDebugSplit, ReflectionDebugView, ReflectionDenoiser,
    ReflectionEffort, ReflectionNonFiniteReport, ReflectionPreset, ReflectionQuality, ReflectionQualityChosen,
    ReflectionRetention, ReflectionSampling, ReflectionStatus, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTextureMip, ReflectionTracer, ReflectionTracerChoice, ReflectionUploadBudget, ReflectionViewMemory,
    ReflectionWarmUp, ReflectionsDeclined, ReflectionsOff, ReflectionsReady, RoughnessThresholds, ScreenTraces,
    ShadingRate, ShadingRateHeuristic, ShadingRateTileSize,
};
use core::any::{TypeId, type_name};
use std::{fs, path::Path};

/// Files with types that an app stores.
const FILES: [&str; 24] = [
    "auto_quality.rs",
    "settings/arrival.rs",
    "settings/auto_quality.rs",
    "settings/budget.rs",
    "settings/reflections.rs",
    "settings/denoiser.rs",
    "settings/front_layer.rs",
    "settings/heuristic.rs",
    "settings/shading_rate.rs",
    "settings/debug.rs",
    "settings/pose.rs",
    "settings/presets.rs",
    "settings/quality.rs",
    "settings/retention.rs",
    "settings/stand_in.rs",
    "settings/warm_up.rs",
    "device/shading_rates.rs",
    "device/texture_mode.rs",
    "device/tracer.rs",
    "events.rs",
    "status.rs",
    "ui/camera.rs",
    "ui/panel.rs",
    "ui/timings.rs",
];
/// The return type of a method, and a plugin: inspectors don't show them.
const OTHERS: [&str; 2] = ["ShadingRates", "ReflectionSettingsPanelPlugin"];

/// An app without a renderer.
fn app() -> App {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, RayTracedReflectionsPlugin::default()));
    #[cfg(feature = "egui")]
    app.add_plugins(ReflectionSettingsPanelPlugin::default());
    app
}

#[track_caller]
fn known<T: Reflect>(types: &TypeRegistry) -> &TypeRegistration {
    let registration = types.get(TypeId::of::<T>());
    let registration = registration.unwrap_or_else(|| panic!("{} is not registered", type_name::<T>()));
    let can_be_made = registration.data::<ReflectFromReflect>().is_some();
    assert!(can_be_made, "{} can't be made of its parts", type_name::<T>());
    registration
}

#[track_caller]
fn default<T: Reflect>(types: &TypeRegistry) -> Box<dyn Reflect> {
    match known::<T>(types).data::<ReflectDefault>() {
        Some(default) => default.default(),
        None => panic!("{} has no default", type_name::<T>()),
    }
}

/// A component can be inserted and read by its name alone.
#[track_caller]
fn component<T: Component + Reflect>(app: &mut App) {
    let types = app.world().resource::<AppTypeRegistry>().clone();
    let types = types.read();
    let Some(reflect) = known::<T>(&types).data::<ReflectComponent>() else {
        panic!("{} is no component for reflection", type_name::<T>());
    };
    let value = default::<T>(&types);
    let mut entity = app.world_mut().spawn_empty();
    reflect.insert(&mut entity, value.as_partial_reflect(), &types);
    assert!(entity.contains::<T>(), "{}", type_name::<T>());
    let found = reflect.reflect(entity.as_readonly());
    let is_same = found.and_then(|found| found.reflect_partial_eq(value.as_partial_reflect()));
    assert_eq!(is_same, Some(true), "{}", type_name::<T>());
}

#[test]
fn components_are_registered() {
    let mut app = app();
    component::<RayTracedReflections>(&mut app);
    component::<NotReflected>(&mut app);
    component::<ReflectedPose>(&mut app);
    component::<ReflectedMesh3d>(&mut app);
    component::<ReflectedMaterial3d>(&mut app);
    component::<ReflectedLayers>(&mut app);
    component::<ReflectionQuality>(&mut app);
    component::<ReflectionAutoQuality>(&mut app);
    component::<ReflectionBudget>(&mut app);
    component::<ReflectionEffort>(&mut app);
    component::<ShadingRateHeuristic>(&mut app);
    component::<ShadingRateTileSize>(&mut app);
    component::<ReflectionDebugView>(&mut app);
    component::<ReflectionDebugSplit>(&mut app);
    component::<ReflectionDebugCounters>(&mut app);
}

#[test]
fn resources_are_registered() {
    let app = app();
    let types = app.world().resource::<AppTypeRegistry>().read();
    let is_resource = |registration: &TypeRegistration| registration.data::<ReflectResource>().is_some();
    assert!(is_resource(known::<ReflectionStatus>(&types)));
    default::<ReflectionStatus>(&types);
    assert!(is_resource(known::<ReflectionStatusReport>(&types)));
    assert!(is_resource(known::<ReflectedPoseBudget>(&types)));
    default::<ReflectedPoseBudget>(&types);
    assert!(is_resource(known::<ReflectionRetention>(&types)));
    default::<ReflectionRetention>(&types);
    assert!(is_resource(known::<ReflectionUploadBudget>(&types)));
    default::<ReflectionUploadBudget>(&types);
    assert!(is_resource(known::<FrontLayerShader>(&types)));
    default::<FrontLayerShader>(&types);
    assert!(is_resource(known::<ReflectedSurfaceShader>(&types)));
    default::<ReflectedSurfaceShader>(&types);
    assert!(is_resource(known::<ReflectionWarmUp>(&types)));
    default::<ReflectionWarmUp>(&types);
    #[cfg(feature = "egui")]
    assert!(is_resource(known::<ReflectionSettingsPanel>(&types)));
}

#[test]
fn settings_are_registered() {
    let app = app();
    let types = app.world().resource::<AppTypeRegistry>().read();
    default::<ReflectionTechnique>(&types);
    default::<ReflectionBackend>(&types);
    default::<ReflectionSampling>(&types);
    default::<ReflectionDenoiser>(&types);
    default::<ReflectionTextureMip>(&types);
    default::<ScreenTraces>(&types);
    default::<ReflectionTracerChoice>(&types);
    default::<ReflectionPreset>(&types);
    default::<ShadingRate>(&types);
    default::<RoughnessThresholds>(&types);
    default::<GrazingThresholds>(&types);
    default::<CombinedThresholds>(&types);
    default::<AdaptiveThresholds>(&types);
}

#[test]
fn reports_are_registered() {
    let app = app();
    let types = app.world().resource::<AppTypeRegistry>().read();
    default::<ReflectionStatusReport>(&types);
    default::<HardwareVrsSupport>(&types);
    known::<ReflectionTracer>(&types);
    known::<ReflectionViewMemory>(&types);
    known::<ReflectionNonFiniteReport>(&types);
    known::<ReflectionsReady>(&types);
    known::<ReflectionsDeclined>(&types);
    known::<ReflectionQualityChosen>(&types);
    let off = known::<ReflectionsOff>(&types);
    assert!(off.data::<ReflectComponent>().is_some());
}

#[cfg(feature = "egui")]
#[test]
fn what_the_panel_brings_is_registered() {
    let app = app();
    let types = app.world().resource::<AppTypeRegistry>().read();
    default::<CameraSettings>(&types);
    default::<Measurements>(&types);
    known::<PassTime>(&types);
}

#[test]
fn nothing_that_an_app_holds_is_left_out() {
    let mut count = 0;
    for file in FILES {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(file);
        let source = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut is_reflected = false;
        for line in source.lines() {
            is_reflected = !line.is_empty() && (is_reflected || is_derive(line));
            let named = line
                .strip_prefix("pub struct ")
                .or_else(|| line.strip_prefix("pub enum "));
            if let Some(rest) = named {
                let end = rest.find(|letter: char| !letter.is_alphanumeric());
                let name = &rest[..end.unwrap_or(rest.len())];
                assert!(is_reflected || OTHERS.contains(&name), "{file}: {name} isn't reflected");
                count += 1;
            }
        }
    }
    assert!(count > 25, "only {count} types were found");
}

fn is_derive(line: &str) -> bool {
    line.starts_with("#[derive(") && line.contains("Reflect")
}
