//! Resources and state of a reflecting view, and its data for shaders.
//!
//! | file | contents |
//! |---|---|
//! | `textures.rs` | textures, uniform, and state from frame to frame |
//! | `kept_groups.rs` | bind groups of the view's passes |
//! | `uniform` | settings and state for the shaders |
//! | `prepare.rs` | creation and updates of all of this |
//! | `static_view.rs` | views in which nothing changes |
//! | `culling.rs` | views without reflective surfaces |

mod culling;
mod kept_groups;
mod prepare;
mod static_view;
mod textures;
mod uniform;

pub use culling::ViewCulling;
pub use textures::ReflectionTextures;
pub use uniform::GpuReflectionView;

pub(crate) use prepare::{GuideMemory, MoreMemory, PreparedView, RefusedViews, Surroundings};
pub(crate) use uniform::Frame;

use crate::{device::tracing_app, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    ecs::{
        schedule::{IntoScheduleConfigs, SystemSet},
        system::Query,
    },
    render::{Render, RenderApp, RenderSystems},
    shader::load_shader_library,
};
use prepare::{prepare_views, publish_memory};

/// Textures and uniforms of views are created.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PreparedViews;

/// Registers the shader and the systems of this folder.
pub(crate) struct ViewPlugin;

impl Plugin for ViewPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_some() {
            load_shader_library!(app, "uniform.wesl");
        }
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.init_resource::<RefusedViews>().add_systems(
            Render,
            (
                prepare_views
                    .in_set(ReflectionSystems::PrepareViews)
                    .in_set(PreparedViews),
                (publish_memory, end_frame).chain().in_set(RenderSystems::Cleanup),
            ),
        );
    }
}

fn end_frame(mut views: Query<&mut ReflectionTextures>) {
    views.iter_mut().for_each(|mut textures| textures.end_frame());
}
