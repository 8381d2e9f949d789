//! Positions of the crate's systems in Bevy's schedules.

use bevy::{
    app::{App, Plugin},
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        oit::resolve::node::oit_resolve,
        schedule::{Core3d, Core3dSystems},
    },
    ecs::{
        prelude::*,
        schedule::{
            FlattenedDependencies, InternedSystemSet, NodeId, ScheduleBuildError, ScheduleBuildPass, ScheduleGraph,
            SystemKey, SystemSetKey, graph::DiGraph,
        },
    },
    pbr::{deferred::deferred_lighting, main_transmissive_pass_3d, wireframe::wireframe_3d},
    platform::{collections::HashMap, hash::FixedHasher},
    render::{ExtractSchedule, Render, RenderApp, RenderSystems},
};
use core::iter;
use indexmap::IndexSet;

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
    /// ones: copies the frames of cameras with [`ScreenTraces`](crate::ScreenTraces). An app's own opaque pass belongs before this set:
    /// without an order, systems that follow Bevy's opaque pass run after reflections on forward surfaces are added.
    KeepScreens,
    /// In `Core3d`, within [`MainPass`](Core3dSystems::MainPass), after the transparent pass and before volumetric fog, wireframes and
    /// post-processing: runs the passes for transparent surfaces, like [`Passes`](Self::Passes) for opaque ones.
    FrontLayerPasses,
    /// In `Core3d`, after [`MainPass`](Core3dSystems::MainPass), before wireframes and post-processing: draws debug views.
    DebugViews,
}

/// In `Core3d`, after [`ReflectionSystems::KeepScreens`] and before the other passes that follow the opaque forward pass: finds the surfaces
/// of front layers, and runs the passes for opaque ones.
#[derive(SystemSet, Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct OpaqueLayerPasses;

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
                    (ReflectionSystems::KeepScreens, OpaqueLayerPasses)
                        .chain()
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
            )
            .edit_schedule(Core3d, |schedule| {
                schedule.add_build_pass(UnnamedPasses::default());
            });
    }
}

/// Orders our passes and those that Bevy doesn't export, which no set contains.
///
/// Forward surfaces get the same haze as deferred ones if their reflections are added before the pass of the atmosphere, and debug views
/// are drawn over volumetric fog. Direct successors of a known pass that have no order with ours are such passes, or the app's.
#[derive(Debug, Default)]
struct UnnamedPasses {
    /// The systems of each set.
    systems: HashMap<SystemSetKey, Vec<SystemKey>>,
}

impl UnnamedPasses {
    fn of(&self, graph: &ScheduleGraph, set: InternedSystemSet) -> &[SystemKey] {
        let key = graph.system_sets.get_key(set);
        key.and_then(|key| self.systems.get(&key)).map_or(&[], Vec::as_slice)
    }
}

impl ScheduleBuildPass for UnnamedPasses {
    type EdgeOptions = ();

    fn add_dependency(&mut self, _from: NodeId, _to: NodeId, _options: Option<&()>) {}

    fn collapse_set(
        &mut self,
        set: SystemSetKey,
        systems: &IndexSet<SystemKey, FixedHasher>,
        _graph: &DiGraph<NodeId>,
    ) -> impl Iterator<Item = (NodeId, NodeId)> {
        self.systems.insert(set, systems.iter().copied().collect());
        iter::empty()
    }

    fn build(
        &mut self,
        _world: &mut World,
        graph: &mut ScheduleGraph,
        mut dependencies: FlattenedDependencies<'_>,
    ) -> Result<(), ScheduleBuildError> {
        let debug_views = ReflectionSystems::DebugViews.intern();
        let orders = [
            (
                OpaqueLayerPasses.intern(),
                main_opaque_pass_3d.into_system_set().intern(),
                true,
            ),
            (debug_views, main_transparent_pass_3d.into_system_set().intern(), false),
        ];
        for (ours, known, is_first) in orders {
            let analysis = dependencies.analyze().map_err(ScheduleBuildError::FlatDependencySort)?;
            let ours = self.of(graph, ours);
            let next = self
                .of(graph, known)
                .iter()
                .flat_map(|known| dependencies.graph().neighbors(*known));
            let mut edges = Vec::new();
            for other in next.filter(|other| !ours.contains(other)) {
                let connected = analysis.connected();
                if ours
                    .iter()
                    .any(|own| connected.contains(&(*own, other)) || connected.contains(&(other, *own)))
                {
                    continue;
                }
                edges.extend(
                    ours.iter()
                        .map(|own| if is_first { (*own, other) } else { (other, *own) }),
                );
            }
            for (before, after) in edges {
                dependencies.add_edge(before, after);
            }
        }
        Ok(())
    }
}
