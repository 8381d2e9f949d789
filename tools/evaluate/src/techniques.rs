//! Translates names of techniques to components on the camera. Only this module switches them on and off.

use crate::job::{TECHNIQUES, TracerName, Variant};
use bevy::{
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    pbr::ScreenSpaceReflections,
    prelude::*,
    render::RenderApp,
};
use bevy_glint::{
    HardwareVrsSupport, RayTracedReflections, ReflectionBackend, ReflectionPreset, ReflectionStatusReport,
    ReflectionTechnique, ReflectionTracerChoice, ShadingRateHeuristic, internals::WithoutReflections, named_settings,
};
use bevy_solari::prelude::SolariLighting;
use glint_scenes::HeadlessApp;

/// Returns whether a technique can be measured by this name. The ground truth can't: all others are compared with it.
pub fn is_known(name: &str) -> bool {
    let is_ours =
        || named_settings(name).is_ok_and(|(settings, _)| settings.technique != ReflectionTechnique::Converged);
    TECHNIQUES.contains(&name) || is_ours()
}

/// Roughness cut-off of the ground truth, which traces everything.
pub const TRUTH_CUTOFF: f32 = 1.0;

/// The tracer for the plugin.
pub fn tracer_choice(tracer: TracerName) -> ReflectionTracerChoice {
    match tracer {
        TracerName::RayQuery => ReflectionTracerChoice::RayQuery,
        TracerName::Bvh => ReflectionTracerChoice::Bvh,
    }
}

/// Requests a device with shading rates, if they are supported. Must come before Bevy's plugins.
pub fn open_device(app: &mut App) {
    #[cfg(target_os = "linux")]
    app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
    #[cfg(not(target_os = "linux"))]
    let _ = app;
}

/// True if the rasterizer's shading rate can spread rays on this machine.
pub fn has_hardware_rates(report: &ReflectionStatusReport) -> bool {
    report.hardware_vrs == HardwareVrsSupport::Available
}

/// Returns whether a technique has a choice of back ends, as with a variable rate.
pub fn has_backends(technique: &str) -> bool {
    technique.starts_with("vrs-") && is_variable(technique)
}

/// True if a technique's or a preset's rate varies.
pub fn is_variable(technique: &str) -> bool {
    named_settings(technique).is_ok_and(|(settings, _)| settings.technique == ReflectionTechnique::Variable)
}

/// Gives a camera the same G-buffer for all techniques, so that they differ only by their own passes.
pub fn prepare_camera(camera: &mut EntityWorldMut) {
    camera.insert((
        DepthPrepass,
        DeferredPrepass,
        NormalPrepass,
        MotionVectorPrepass,
        Msaa::Off,
    ));
}

/// Switches a technique on and the previous one off. Its history starts empty.
///
/// `off` and `ssr` keep our component on the camera, since the library frees the whole scene when no camera has it, and extracting the
/// scene again would disturb the next measurement. A missing requirement keeps it from running: there is no normal prepass, or the camera
/// has screen-space reflections.
pub fn apply(camera: &mut EntityWorldMut, variant: &Variant) -> Result<(), String> {
    match variant.technique.as_str() {
        "off" => {
            camera.remove::<(ScreenSpaceReflections, NormalPrepass, SolariLighting)>();
        }
        "ssr" => {
            camera.insert((ScreenSpaceReflections::default(), NormalPrepass));
        }
        "solari" => {
            camera.insert(SolariLighting::default());
        }
        name => {
            let (mut settings, heuristic) = named_settings(name).map_err(|error| error.to_string())?;
            if name.parse::<ReflectionPreset>().is_err() {
                // Techniques are compared at equal tasks; presets stay as users get them.
                settings.roughness_cutoff = TRUTH_CUTOFF;
                settings.roughness_fade = 0.0;
            }
            settings.backend = if variant.hardware {
                ReflectionBackend::HardwareVrs
            } else {
                ReflectionBackend::Compute
            };
            insert(camera, settings, heuristic);
        }
    }
    Ok(())
}

/// Switches the ground truth on: everything is traced, nothing is denoised, frames are averaged.
pub fn apply_truth(camera: &mut EntityWorldMut) {
    let settings = RayTracedReflections {
        technique: ReflectionTechnique::Converged,
        roughness_cutoff: TRUTH_CUTOFF,
        roughness_fade: 0.0,
        ..default()
    };
    insert(camera, settings, ShadingRateHeuristic::default());
}

fn insert(camera: &mut EntityWorldMut, settings: RayTracedReflections, heuristic: ShadingRateHeuristic) {
    camera.remove::<ScreenSpaceReflections>();
    camera.insert((settings, heuristic, NormalPrepass));
}

/// Throws the history away, as a game does when its camera jumps.
pub fn reset(camera: &mut EntityWorldMut) {
    if let Some(mut settings) = camera.get_mut::<RayTracedReflections>() {
        settings.reset = true;
    }
    if let Some(mut lighting) = camera.get_mut::<SolariLighting>() {
        lighting.reset = true;
    }
}

/// Shows only the light of reflections, or all other light.
pub fn show_reflections(app: &mut HeadlessApp, shown: bool) {
    if let Some(render_app) = app.app().get_sub_app_mut(RenderApp) {
        if shown {
            render_app.world_mut().remove_resource::<WithoutReflections>();
        } else {
            render_app.insert_resource(WithoutReflections);
        }
    }
}

/// The diagnostics with the GPU times of a technique, to be summed.
pub fn total_spans(variant: &Variant) -> &'static [&'static str] {
    match variant.technique.as_str() {
        "off" => &[],
        "ssr" => &["render/ssr/elapsed_gpu"],
        "solari" => &[
            "render/solari_lighting/presample_light_tiles/elapsed_gpu",
            "render/solari_lighting/world_cache/elapsed_gpu",
            "render/solari_lighting/lighting/elapsed_gpu",
        ],
        // Glass and water have their own passes, if they are on the screen.
        _ => &[
            "render/glint/elapsed_gpu",
            "render/glint_find_front_layer/elapsed_gpu",
            "render/glint_front_layer/elapsed_gpu",
        ],
    }
}

/// Stages and their diagnostics.
pub const STAGES: [(&str, &str); 6] = [
    ("rate", "render/glint/rate/elapsed_gpu"),
    ("trace", "render/glint/trace/elapsed_gpu"),
    ("reconstruct", "render/glint/reconstruct/elapsed_gpu"),
    ("temporal", "render/glint/temporal/elapsed_gpu"),
    ("denoise", "render/glint/denoise/elapsed_gpu"),
    ("composite", "render/glint/composite/elapsed_gpu"),
];
/// The diagnostic of Bevy's deferred lighting.
pub const LIGHTING: &str = "render/deferred_lighting/elapsed_gpu";
/// The counters of reflection rays: of blocks, and of mirrors that have their own; of glass and water the same.
pub const RAYS: [&str; 4] = [
    "render/reflection_rays",
    "render/reflection_mirror_rays",
    "render/reflection_front_layer_rays",
    "render/reflection_front_layer_mirror_rays",
];

/// Bevy Solari.
pub mod solari {
    use bevy::{camera::CameraMainTextureUsages, prelude::*, render::render_resource::TextureUsages};
    use bevy_solari::{SolariPlugins, prelude::RaytracingMesh3d};

    /// Adds the plugins.
    pub fn add(app: &mut App) {
        app.add_plugins(SolariPlugins);
    }

    /// Allows rays to hit everything, and the camera's frame to be written in place.
    pub fn prepare_scene(world: &mut World, camera: Entity) {
        let meshes: Vec<_> = world
            .query::<(Entity, &Mesh3d)>()
            .iter(world)
            .map(|(entity, mesh)| (entity, mesh.0.clone()))
            .collect();
        for (entity, mesh) in meshes {
            world.entity_mut(entity).insert(RaytracingMesh3d(mesh));
        }
        let usages = CameraMainTextureUsages::default().with(TextureUsages::STORAGE_BINDING);
        world.entity_mut(camera).insert(usages);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::TECHNIQUES;

    #[test]
    fn every_technique_can_be_switched_on() {
        let mut world = World::new();
        for technique in TECHNIQUES.into_iter().filter(|name| *name != "solari") {
            let mut camera = world.spawn_empty();
            prepare_camera(&mut camera);
            apply(&mut camera, &Variant::new(technique)).unwrap();
            assert_eq!(
                camera.contains::<ScreenSpaceReflections>(),
                technique == "ssr",
                "{technique}"
            );
            let ours = Variant::new(technique).is_ours();
            assert_eq!(camera.contains::<RayTracedReflections>(), ours, "{technique}");
            // And off again.
            apply(&mut camera, &Variant::new("off")).unwrap();
            assert!(!camera.contains::<NormalPrepass>() && !camera.contains::<ScreenSpaceReflections>());
            apply(&mut camera, &Variant::new("reference")).unwrap();
            assert!(camera.contains::<NormalPrepass>());
        }
        assert!(apply(&mut world.spawn_empty(), &Variant::new("magic")).is_err());
    }

    #[test]
    fn only_variable_rates_have_back_ends() {
        assert!(has_backends("vrs-roughness") && has_backends("vrs-combined"));
        assert!(!has_backends("reference") && !has_backends("ssr") && !has_backends("off"));
        assert!(is_variable("medium") && !has_backends("medium") && !is_variable("ultra") && !is_variable("solari"));
    }
}
