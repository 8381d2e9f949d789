//! Reflections on surfaces that Bevy draws in its forward passes: on transparent surfaces such as glass and water, which are drawn over
//! the opaque frame, and on opaque surfaces without a pixel in its G-buffer.
//!
//! The front-most of these surfaces in each pixel form the *front layer*. A ray from the viewer finds each of them and writes it in the
//! formats of Bevy's G-buffer, so that the passes for deferred surfaces also trace and denoise the reflections of the layer.
//!
//! | file | contents |
//! |---|---|
//! | `forward.rs` | opaque materials drawn in the forward pass |
//! | `boxes.rs` | bounds of see-through and forward objects |
//! | `rects.rs` | parts of a view that they can cover |
//! | `textures.rs` | the textures of the layer |
//! | `find`, `layer.wesl` | the rays that find it, and the library for an app's shader |
//! | `prepare.rs` | creation and removal of all of this |
//! | `passes.rs` | the passes over it |

mod boxes;
mod find;
mod forward;
mod passes;
mod prepare;
mod rects;
mod textures;

pub use prepare::FrontLayer;

pub(crate) use find::FIND;

use crate::{
    debug::{request_debug_passes, show_debug_views},
    device::tracing_app,
    schedule::{OpaqueLayerPasses, ReflectionSystems},
    view::PreparedViews,
};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    core_pipeline::schedule::Core3d,
    ecs::{schedule::IntoScheduleConfigs, system::Query},
    render::{ExtractSchedule, Render, RenderApp, RenderSystems},
    shader::load_shader_library,
};
use boxes::{LayerBoxes, extract_boxes};
use find::{OwnShader, extract_shader, keep_depth_readable, request_find_pass};
use forward::note_forward_materials;
use passes::{find_front_layers, reflect_on_front_layers, reflect_on_opaque_layers, show_front_layers};
use prepare::prepare_front_layers;

/// Registers the shaders, the pipelines and the systems of this folder.
pub(crate) struct FrontLayerPlugin;

impl Plugin for FrontLayerPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_some() {
            load_shader_library!(app, "layer.wesl");
            embedded_asset!(app, "find.wesl");
        }
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_resource::<LayerBoxes>()
            .init_resource::<OwnShader>()
            .add_systems(
                ExtractSchedule,
                (extract_boxes, extract_shader).in_set(ReflectionSystems::ExtractScene),
            )
            .add_systems(
                Render,
                (
                    // `deferred.rs` runs before.
                    note_forward_materials
                        .after(RenderSystems::Specialize)
                        .before(ReflectionSystems::PrepareScene),
                    request_find_pass
                        .after(request_debug_passes)
                        .in_set(ReflectionSystems::QueuePipelines),
                    keep_depth_readable
                        .in_set(RenderSystems::PrepareViews)
                        .ambiguous_with(RenderSystems::PrepareViews),
                    prepare_front_layers
                        .after(PreparedViews)
                        .in_set(ReflectionSystems::PrepareViews),
                    end_frame.in_set(RenderSystems::Cleanup),
                ),
            )
            .add_systems(
                Core3d,
                (
                    (find_front_layers, reflect_on_opaque_layers)
                        .chain()
                        .in_set(OpaqueLayerPasses),
                    reflect_on_front_layers.in_set(ReflectionSystems::FrontLayerPasses),
                    // Drawn over the darkened frame of the other debug views.
                    show_front_layers
                        .after(show_debug_views)
                        .in_set(ReflectionSystems::DebugViews),
                ),
            );
    }
}

/// All views of a render world begin their sample sequences anew, so that their noise doesn't depend on how many frames they have drawn.
#[cfg(feature = "internals")]
pub fn restart_noise(world: &mut bevy::ecs::world::World) {
    let mut views = world.query::<(&mut crate::view::ReflectionTextures, Option<&mut FrontLayer>)>();
    for (mut textures, layer) in views.iter_mut(world) {
        textures.restart_noise();
        if let Some(mut layer) = layer {
            layer.textures.restart_noise();
        }
    }
}

fn end_frame(mut layers: Query<&mut FrontLayer>) {
    layers.iter_mut().for_each(|mut layer| layer.textures.end_frame());
}
