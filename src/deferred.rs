//! Makes opaque materials deferred, and every 3D camera able to draw them.
//!
//! Rays start from Bevy's G-buffer, which deferred materials alone write. Bevy draws these on no camera without a `DeferredPrepass`,
//! and panics over one that has other prepasses. Hence all 3D cameras get it, whether they reflect or not: else the objects
//! of a mini map would vanish when the main camera begins to reflect. A camera without reflections pays for the G-buffer. The
//! alternative, to make materials deferred only while a camera reflects, would prepare all materials anew at each switch, and other
//! cameras would lose their objects meanwhile.

use crate::{device::tracing_app, settings::ReflectionFallback};
use bevy::{
    app::{App, Plugin, PostUpdate},
    camera::Camera3d,
    core_pipeline::{
        core_3d::check_msaa,
        prepass::{DeferredPrepass, DepthPrepass},
    },
    ecs::{change_detection::Tick, prelude::*},
    log::debug,
    pbr::{DefaultOpaqueRendererMethod, deferred::insert_deferred_lighting_pass_id_component},
    reflect::PartialReflect,
    render::{RenderApp, sync_world::SyncToRenderWorld, view::Msaa},
};

/// Makes opaque materials deferred unless the app says otherwise after it, or nothing reflects, since nothing can be traced.
///
/// It has to be added after `ProbePlugin`, which finds out about the latter.
pub(crate) struct DeferredPlugin {
    /// Screen-space reflections take deferred materials, too.
    pub fallback: ReflectionFallback,
}

/// The method that ours took the place of, while plugins are being added.
#[derive(Resource)]
struct Replaced {
    method: DefaultOpaqueRendererMethod,
    at: Tick,
}

impl Plugin for DeferredPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        let world = app.world_mut();
        let method = world.get_resource::<DefaultOpaqueRendererMethod>().cloned();
        // A tick of its own tells this change from those of the app.
        world.increment_change_tick();
        world.insert_resource(DefaultOpaqueRendererMethod::deferred());
        let at = world.increment_change_tick();
        world.insert_resource(Replaced {
            method: method.unwrap_or_default(),
            at,
        });
    }

    fn finish(&self, app: &mut App) {
        let needed = tracing_app(app).is_some() || self.fallback == ReflectionFallback::ScreenSpace;
        let world = app.world_mut();
        let Some(replaced) = world.remove_resource::<Replaced>() else {
            return;
        };
        if !needed {
            let method = world.get_resource_ref::<DefaultOpaqueRendererMethod>();
            if method.is_some_and(|method| method.last_changed() == replaced.at) {
                world.insert_resource(replaced.method);
            }
            return;
        }
        if world.get_resource().is_some_and(is_deferred) {
            require_prepass(world);
        }
        app.add_systems(
            PostUpdate,
            add_prepass
                .run_if(|method: Option<Res<DefaultOpaqueRendererMethod>>| method.is_some_and(|m| is_deferred(&m)))
                .before(check_msaa)
                .before(insert_deferred_lighting_pass_id_component),
        );
    }
}

/// Opaque materials are deferred unless they say otherwise.
pub(crate) fn is_deferred(method: &DefaultOpaqueRendererMethod) -> bool {
    method.reflect_partial_eq(&DefaultOpaqueRendererMethod::deferred()) == Some(true)
}

/// Has 3D cameras come with all that deferred materials take, from their first frame on. A camera's own `Msaa` stays; Bevy switches
/// it off with a warning.
fn require_prepass(world: &mut World) {
    let result = world
        .try_register_required_components::<Camera3d, DepthPrepass>()
        .and_then(|()| world.try_register_required_components::<Camera3d, DeferredPrepass>())
        .and_then(|()| world.try_register_required_components_with::<Camera3d, Msaa>(|| Msaa::Off));
    if let Err(error) = result {
        // Cameras exist already. The system does the same, a little later.
        debug!("{error}");
    }
}

/// Cameras that Bevy draws without what deferred materials take. `remove_with_requires` takes `SyncToRenderWorld`, too: then Bevy draws
/// the camera no more, and panics if something brings that component back.
type Lacking = (With<Camera3d>, With<SyncToRenderWorld>, Without<DeferredPrepass>);

/// The same for cameras that were there before, and for those that lost it.
fn add_prepass(cameras: Query<Entity, Lacking>, mut commands: Commands) {
    for camera in &cameras {
        commands
            .entity(camera)
            .insert((DepthPrepass, DeferredPrepass))
            .insert_if_new(Msaa::Off);
    }
}
