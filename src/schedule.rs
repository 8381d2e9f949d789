//! Positions of the crate's systems in Bevy's schedules.

use bevy::{
    app::{App, Plugin},
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        oit::resolve::node::oit_resolve,
        schedule::{Core3d, Core3dSystems},
    },
    ecs::prelude::*,
    pbr::{deferred::deferred_lighting, main_transmissive_pass_3d, wireframe::wireframe_3d},
    render::{ExtractSchedule, Render, RenderApp, RenderSystems},
};

/// Sets of the crate's systems in the render app, to order systems of an app before or after them.
///
/// They are empty if the device can't trace rays.
///
/// ```
/// # use bevy::{prelude::*, core_pipeline::schedule::Core3d, render::RenderApp};
/// # use bevy_glint::ReflectionSystems;
/// # fn reads_the_frame_with_reflections() {}
/// # fn build(app: &mut App) {
/// if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
///     render_app.add_systems(Core3d, reads_the_frame_with_reflections.after(ReflectionSystems::Passes));
/// }
/// # }
/// ```
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ReflectionSystems {
    /// In `ExtractSchedule`: extracts objects, meshes, materials, lights and environments, while any camera reflects.
    ExtractScene,
    /// In `ExtractSchedule`, after [`ExtractScene`](Self::ExtractScene): reads the settings of cameras.
    ExtractCameras,
    /// In `Render`, within [`PrepareResources`](RenderSystems::PrepareResources): updates the scene for rays.
    PrepareScene,
    /// In `Render`, within [`PrepareResourcesFlush`](RenderSystems::PrepareResourcesFlush): records which pipelines cameras need, and
    /// which cameras have all of theirs.
    RequestPipelines,
    /// In `Render`, after [`RequestPipelines`](Self::RequestPipelines): queues pipelines for compilation.
    QueuePipelines,
    /// In `Render`, after [`QueuePipelines`](Self::QueuePipelines): creates textures and uniforms of views.
    PrepareViews,
    /// In `Render`, within [`PrepareBindGroups`](RenderSystems::PrepareBindGroups).
    PrepareBindGroups,
    /// In `Core3d`, within [`MainPass`](Core3dSystems::MainPass), after deferred lighting and before the opaque forward pass: traces,
    /// denoises, and adds reflections to the frame.
    Passes,
    /// In `Core3d`, within [`MainPass`](Core3dSystems::MainPass), after the opaque forward pass and before transmissive and transparent
    /// ones: copies the frames of cameras with [`ScreenTraces`](crate::ScreenTraces).
    KeepScreens,
    /// In `Core3d`, within [`MainPass`](Core3dSystems::MainPass), after the transparent pass and before volumetric fog, wireframes and
    /// post-processing: runs the passes for transparent surfaces, like [`Passes`](Self::Passes) for opaque ones.
    FrontLayerPasses,
    /// In `Core3d`, after [`MainPass`](Core3dSystems::MainPass), before wireframes and post-processing: draws debug views.
    DebugViews,
}

/// Adds the sets to the schedules.
pub(crate) struct SchedulePlugin;

impl Plugin for SchedulePlugin {
    fn build(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app
            .configure_sets(
                ExtractSchedule,
                (ReflectionSystems::ExtractScene, ReflectionSystems::ExtractCameras).chain(),
            )
            .configure_sets(
                Render,
                (
                    ReflectionSystems::PrepareScene.in_set(RenderSystems::PrepareResources),
                    // Runs after the scene is updated, since shader definitions depend on it, and after ambient occlusion and light
                    // probes of views are prepared.
                    (
                        ReflectionSystems::RequestPipelines,
                        ReflectionSystems::QueuePipelines,
                        ReflectionSystems::PrepareViews,
                    )
                        .chain()
                        .in_set(RenderSystems::PrepareResourcesFlush),
                    ReflectionSystems::PrepareBindGroups.in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .configure_sets(
                Core3d,
                (
                    // Deferred lighting has omitted the environment's specular term. Forward and transparent surfaces are drawn later,
                    // since they would hide the added light or be hidden by it.
                    ReflectionSystems::Passes
                        .after(deferred_lighting)
                        .before(main_opaque_pass_3d)
                        .in_set(Core3dSystems::MainPass),
                    // Surfaces blended over opaque ones have different positions.
                    ReflectionSystems::KeepScreens
                        .after(main_opaque_pass_3d)
                        .before(main_transmissive_pass_3d)
                        .before(main_transparent_pass_3d)
                        .in_set(Core3dSystems::MainPass),
                    // Runs after everything that the main pass draws, and before volumetric fog: reflections get the same fog as their
                    // surfaces.
                    ReflectionSystems::FrontLayerPasses
                        .after(main_transparent_pass_3d)
                        .after(oit_resolve)
                        .in_set(Core3dSystems::MainPass),
                    // Drawn below wireframes.
                    ReflectionSystems::DebugViews
                        .after(Core3dSystems::MainPass)
                        .before(wireframe_3d)
                        .before(Core3dSystems::EarlyPostProcess),
                ),
            );
    }
}
