//! The fallback of cameras on devices that can't trace.

use crate::{
    device::tracing_app,
    settings::{RayTracedReflections, ReflectionFallback},
};
use bevy::{
    app::{App, Plugin, PostUpdate},
    core_pipeline::core_3d::check_msaa,
    ecs::prelude::*,
    log::info,
    pbr::{ScreenSpaceReflections, deferred::insert_deferred_lighting_pass_id_component},
    render::RenderApp,
};

/// Gives cameras with [`RayTracedReflections`] a fallback, if the device can't trace.
///
/// Must be added after `ProbePlugin`, which detects that.
pub(crate) struct FallbackPlugin {
    pub fallback: ReflectionFallback,
}

impl Plugin for FallbackPlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() || tracing_app(app).is_some() {
            return;
        }
        if self.fallback == ReflectionFallback::ScreenSpace {
            info!("cameras with `RayTracedReflections` show screen-space reflections instead");
            app.add_systems(
                PostUpdate,
                (fall_back, come_back)
                    .before(check_msaa)
                    .before(insert_deferred_lighting_pass_id_component),
            );
        }
    }
}

/// A camera that got its `ScreenSpaceReflections` from here.
#[derive(Component)]
struct FellBack;

type Reflecting = (
    With<RayTracedReflections>,
    Without<FellBack>,
    Without<ScreenSpaceReflections>,
);

fn fall_back(cameras: Query<Entity, Reflecting>, mut commands: Commands) {
    for camera in &cameras {
        commands
            .entity(camera)
            .insert((FellBack, ScreenSpaceReflections::default()));
    }
}

fn come_back(cameras: Query<Entity, (With<FellBack>, Without<RayTracedReflections>)>, mut commands: Commands) {
    for camera in &cameras {
        commands.entity(camera).remove::<(FellBack, ScreenSpaceReflections)>();
    }
}
