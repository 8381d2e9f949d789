//! The scene that rays can hit: geometry, acceleration structures, materials, lights and environment.
//!
//! Shaders access it through one bind group (`bindings.wesl`) and two functions (`trace.wesl`): `trace_closest` and
//! `trace_any`, with one implementation by the driver's ray queries and one by the crate's own BVH.

pub mod acceleration;
mod activity;
mod alpha_images;
pub mod arena;
pub mod atmosphere;
mod bevy_shaders;
mod bind_group;
mod box_tree;
pub mod bvh;
mod change;
mod change_ticks;
mod coplanar;
mod decals;
pub mod environment;
mod extract;
mod features;
pub mod fog_volumes;
pub(crate) mod forward;
mod free_slots;
pub mod geometry;
pub mod gpu_types;
mod in_parallel;
pub mod instances;
mod light_probes;
mod light_table;
mod light_textures;
pub mod light_tree;
mod lightmaps;
pub mod lights;
mod masks;
pub mod materials;
mod merge;
pub mod meshes;
pub mod motion;
mod origin;
pub mod pack_lights;
mod particles;
mod pose;
mod prepare;
pub(crate) mod reflected_material;
mod render_layers;
mod scatter;
pub(crate) mod see_through;
#[cfg(test)]
pub(crate) mod test_gpu;
mod texture_layers;
pub mod textures;
mod top_level;
mod tree_builds;
mod unseen;
pub mod upload;
mod waiting_room;

pub use bind_group::SceneBindings;
pub(crate) use bind_group::SceneDefinitions;
pub(crate) use change::{Change, RESTLESS_FRAMES};
pub(crate) use features::{Features, Fit, Passes};
pub use materials::ReflectedMaterial;
pub use origin::OriginShift;
pub(crate) use prepare::moves_along;
pub use reflected_material::ReflectedMaterialPlugin;

use crate::{device::tracing_app, schedule::ReflectionSystems};
use activity::SceneActivity;
use alpha_images::AlphaImages;
use bevy::{
    app::{App, Last, Plugin},
    asset::embedded_asset,
    ecs::prelude::*,
    pbr::StandardMaterial,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems, init_gpu_resource,
        mesh::RenderMesh, render_asset::prepare_assets,
    },
    shader::load_shader_library,
};
use bind_group::prepare_scene_bind_group;
use decals::ExtractedDecals;
use environment::{EnvironmentBindings, prepare_environments};
use extract::{begin_extraction, extract_images, extract_lighting};
use instances::{SceneInstances, details::LevelsOfDetail, lost::LostComponents};
use light_probes::ExtractedLightProbes;
use lights::ExtractedLights;
use materials::{MaterialAssets, MaterialTable};
use meshes::{SceneMeshes, keep_render_world_meshes, kept::RenderWorldMeshes};
use origin::AnnouncedShift;
use particles::ExtractedParticles;
use pose::{ExtractedPoses, VertexShader};
use prepare::prepare_scene;
use reflected_material::add_extraction;
use render_layers::SceneLayers;
use textures::TextureTable;
use unseen::count_unseen;

/// Registers the shaders and systems of this folder.
pub(crate) struct ScenePlugin;

impl Plugin for ScenePlugin {
    fn build(&self, app: &mut App) {
        app.add_message::<OriginShift>().register_type::<OriginShift>();
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "alpha.wesl");
        load_shader_library!(app, "alpha_mask.wesl");
        load_shader_library!(app, "alpha_query.wesl");
        load_shader_library!(app, "atmosphere.wesl");
        load_shader_library!(app, "bindings.wesl");
        load_shader_library!(app, "bvh.wesl");
        load_shader_library!(app, "decals.wesl");
        load_shader_library!(app, "environment.wesl");
        load_shader_library!(app, "geometry.wesl");
        load_shader_library!(app, "light_probes.wesl");
        load_shader_library!(app, "light_sampling.wesl");
        load_shader_library!(app, "lights.wesl");
        load_shader_library!(app, "material.wesl");
        load_shader_library!(app, "medium.wesl");
        load_shader_library!(app, "motion.wesl");
        load_shader_library!(app, "change.wesl");
        load_shader_library!(app, "offset.wesl");
        load_shader_library!(app, "opacity.wesl");
        load_shader_library!(app, "particles.wesl");
        load_shader_library!(app, "pose/job.wesl");
        load_shader_library!(app, "ray_query.wesl");
        load_shader_library!(app, "light_textures.wesl");
        load_shader_library!(app, "rect_lights.wesl");
        load_shader_library!(app, "shading.wesl");
        load_shader_library!(app, "shadow.wesl");
        load_shader_library!(app, "surface.wesl");
        load_shader_library!(app, "trace.wesl");
        load_shader_library!(app, "coplanar.wesl");
        load_shader_library!(app, "transparency.wesl");
        load_shader_library!(app, "types.wesl");
        load_shader_library!(app, "pose/vertex.wesl");
        embedded_asset!(app, "pose/pose.wesl");
        embedded_asset!(app, "pose/refit.wesl");
        embedded_asset!(app, "scatter.wesl");
        embedded_asset!(app, "texture_layers.wesl");
        app.add_plugins(ReflectedMaterialPlugin::<StandardMaterial>::default());
    }

    fn finish(&self, app: &mut App) {
        if tracing_app(app).is_some() {
            app.add_systems(Last, count_unseen);
        }
        let Some(render_app) = tracing_app(app) else { return };
        add_extraction(render_app);
        render_app
            .init_resource::<RenderWorldMeshes>()
            .init_resource::<ExtractedLights>()
            .init_resource::<ExtractedPoses>()
            .init_resource::<ExtractedLightProbes>()
            .init_resource::<ExtractedDecals>()
            .init_resource::<ExtractedParticles>()
            .init_resource::<SceneLayers>()
            .init_gpu_resource::<SceneActivity>()
            .init_gpu_resource::<SceneInstances>()
            .init_resource::<LostComponents>()
            .init_resource::<AnnouncedShift>()
            .init_resource::<LevelsOfDetail>()
            .init_gpu_resource::<MaterialAssets>()
            .init_gpu_resource::<MaterialTable>()
            .init_gpu_resource::<AlphaImages>()
            .init_gpu_resource::<TextureTable>()
            .init_gpu_resource::<EnvironmentBindings>()
            .init_gpu_resource::<SceneMeshes>()
            .init_gpu_resource::<VertexShader>()
            .add_systems(
                RenderStartup,
                init_gpu_resource::<SceneBindings>
                    .after(init_gpu_resource::<TextureTable>)
                    .after(init_gpu_resource::<SceneMeshes>)
                    .ambiguous_with_all(),
            )
            .add_systems(
                ExtractSchedule,
                (extract_lighting.after(begin_extraction), extract_images).in_set(ReflectionSystems::ExtractScene),
            )
            .add_systems(
                Render,
                (
                    keep_render_world_meshes
                        .in_set(RenderSystems::PrepareAssets)
                        .before(prepare_assets::<RenderMesh>),
                    prepare_scene.in_set(ReflectionSystems::PrepareScene),
                    (prepare_environments, prepare_scene_bind_group).in_set(ReflectionSystems::PrepareBindGroups),
                ),
            );
    }
}
