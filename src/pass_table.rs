//! The table of all passes, and the resource that compiles them.

use crate::{
    composite::{ADD, RESOLVE, RESOLVE_APART, RESOLVE_TILES, SCREEN},
    debug::{COUNT, FINISH, LOCATE, SHOW_INTERMEDIATE, SHOW_REFLECTION},
    denoise::{ONE_PASS, RECONSTRUCT, TEMPORAL},
    device::tracing_app,
    diagnostics::CountInvocations,
    front_layer::FIND,
    guides::GUIDES,
    pipelines::{Pass, Pipelines},
    rate::{ADAPTIVE_RATES, RATES},
    scene::SceneBindings,
    trace::{
        CONVERGED, INLINE, KEPT_RAYS, MIRRORS, RAYS, RAYS_AND_KEPT_RAYS, SHADING, SHADING_AND_KEPT_RAYS,
        SHADING_AND_MIRRORS, SHADING_MIRRORS_AND_KEPT_RAYS,
    },
};
#[cfg(feature = "internals")]
use crate::{pipelines::Options, scene::Features};
use bevy::{
    app::{App, Plugin},
    asset::AssetServer,
    core_pipeline::FullscreenShader,
    ecs::prelude::*,
    render::{RenderStartup, init_gpu_resource},
};

/// All passes over the G-buffer.
pub(crate) const PASSES: [&Pass; 27] = [
    RATES,
    ADAPTIVE_RATES,
    RAYS,
    SHADING,
    SHADING_AND_MIRRORS,
    RAYS_AND_KEPT_RAYS,
    SHADING_AND_KEPT_RAYS,
    SHADING_MIRRORS_AND_KEPT_RAYS,
    MIRRORS,
    CONVERGED,
    INLINE,
    KEPT_RAYS,
    RECONSTRUCT,
    TEMPORAL,
    ONE_PASS,
    RESOLVE_APART,
    RESOLVE,
    RESOLVE_TILES,
    ADD,
    SCREEN,
    FIND,
    SHOW_REFLECTION,
    SHOW_INTERMEDIATE,
    COUNT,
    LOCATE,
    FINISH,
    GUIDES,
];

/// Modules of all passes.
#[cfg(feature = "internals")]
pub fn modules() -> impl Iterator<Item = &'static str> {
    PASSES.iter().map(|pass| pass.shader)
}

/// Definitions that variants of passes can have, except for definitions of the tracer.
#[cfg(feature = "internals")]
pub fn definitions() -> impl Iterator<Item = &'static str> {
    let options = Options::all().iter_names().map(|(name, _)| name);
    Features::all().definitions().chain(options)
}

/// Loads the passes.
pub(crate) struct PassTablePlugin;

impl Plugin for PassTablePlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.add_systems(RenderStartup, load_passes.after(init_gpu_resource::<SceneBindings>));
    }
}

fn load_passes(
    mut commands: Commands,
    assets: Res<AssetServer>,
    fullscreen: Res<FullscreenShader>,
    scene: Res<SceneBindings>,
    count: Option<Res<CountInvocations>>,
) {
    let scene = (&scene.layout, scene.definitions());
    let common = count.map(|_| "COUNT_INVOCATIONS".into()).into_iter().collect();
    commands.insert_resource(Pipelines::new(&PASSES, &assets, &fullscreen, scene, common));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::{SAMPLED_TEXTURES_ELSEWHERE, SAMPLED_TEXTURES_IN_BROWSERS},
        gbuffer::Group0,
        pipelines::{Groups, Kind},
        scene::{Passes, environment},
    };
    use bevy::{
        platform::collections::HashSet,
        render::render_resource::{BindGroupLayoutDescriptor, BindingType},
    };
    use std::{fs, path::Path};

    #[test]
    fn passes_have_different_labels_and_entry_points_that_exist() {
        let labels: HashSet<_> = PASSES.iter().map(|pass| pass.label).collect();
        assert_eq!(labels.len(), PASSES.len());
        for pass in PASSES {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(pass.shader);
            let code = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{pass:?}: {path:?}: {error}"));
            let entry_point = format!("\nfn {}(", pass.entry_point);
            assert!(code.contains(&entry_point), "{pass:?}: no {}", pass.entry_point);
        }
    }

    /// Sampled textures of a pass in all of its bind groups. The scene's group has one, besides arrays that have a limit of their own.
    fn sampled_textures(pass: &Pass, environment: &BindGroupLayoutDescriptor) -> u32 {
        let count = |layout: &BindGroupLayoutDescriptor| {
            let textures = layout.entries.iter();
            textures
                .filter(|entry| matches!(entry.ty, BindingType::Texture { .. }))
                .count() as u32
        };
        let has_gbuffer = pass.kind != Kind::Addition;
        let group_0 = Group0::new(pass.label, pass.kind.stages(), has_gbuffer, (pass.bindings)());
        let has_screen = pass.sees.intersects(Passes::FIRST_RAYS);
        let others = match pass.groups {
            Groups::None => 0,
            Groups::Environment => count(environment),
            Groups::Scene => count(environment) + 1,
        };
        count(group_0.layout(has_screen)) + others
    }

    #[test]
    fn passes_read_no_more_textures_than_devices_must_have() {
        let counts = |environment: BindGroupLayoutDescriptor| {
            let counts = PASSES.map(|pass| (sampled_textures(pass, &environment), pass.label));
            counts.into_iter().max().unwrap()
        };
        let (browsers, label) = counts(environment::layout_in_browsers());
        assert!(browsers <= SAMPLED_TEXTURES_IN_BROWSERS, "{browsers} in {label}");
        let (elsewhere, label) = counts(environment::layout_descriptor());
        assert_eq!(elsewhere, SAMPLED_TEXTURES_ELSEWHERE, "{label}");
    }

    #[test]
    fn every_pass_is_in_the_table() {
        fn declared(path: &Path) -> usize {
            if path.is_dir() {
                return fs::read_dir(path)
                    .unwrap()
                    .map(|entry| declared(&entry.unwrap().path()))
                    .sum();
            }
            let text = fs::read_to_string(path).unwrap();
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            code.matches(": &Pass = &Pass {").count()
        }
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        assert_eq!(declared(&source), PASSES.len());
    }
}
