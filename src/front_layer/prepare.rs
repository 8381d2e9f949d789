//! Makes the front layers of views in which something see-through is on the screen, and gives them back afterwards.

use super::{
    boxes::SeeThroughBoxes,
    rects::{GpuRects, screen_rects},
    textures::LayerTextures,
};
use crate::{
    device::{WritesInPlace, try_allocate},
    settings::{ReflectionBackend, ReflectionView},
    targets::{Needs, Sizes},
    view::{MoreMemory, PreparedView, ReflectionTextures, Surroundings},
};
use bevy::{
    camera::visibility::RenderLayers,
    ecs::prelude::*,
    math::{Mat4, URect, UVec2},
    platform::collections::HashMap,
    render::{
        render_resource::UniformBuffer,
        renderer::{RenderDevice, RenderQueue},
        view::ExtractedView,
    },
};
use core::sync::atomic::AtomicBool;

/// Frames without anything see-through on the screen after which the layer of a view is given back. Less allocates
/// it again whenever a window passes by, more holds memory that nothing uses.
const IDLE_FRAMES: u32 = 60;
/// Frames after which memory for the layer of a view is asked for once more. Less asks a device that is full again and again, with
/// more the layer comes back later.
const REFUSED_FRAMES: u32 = 300;

/// The front layer of a view.
#[derive(Component)]
pub struct FrontLayer {
    pub(super) layer: LayerTextures,
    pub(super) textures: ReflectionTextures,
    /// The settings of the passes over it.
    pub(super) view: ReflectionView,
    /// Rectangles of the view that it lies in; none: nothing of it is on the screen in this frame.
    pub(super) rects: Vec<URect>,
    /// The same for shaders.
    pub(super) gpu_rects: UniformBuffer<GpuRects>,
    /// It holds the layer of this frame.
    pub(super) is_found: AtomicBool,
    idle: u32,
}

impl FrontLayer {
    fn fits(&self, sizes: Sizes, needs: Needs, extent: UVec2) -> bool {
        let targets = &self.textures.targets;
        targets.sizes == sizes && targets.needs == needs && self.layer.size == extent
    }

    fn set_rects(&mut self, rects: Vec<URect>, device: &RenderDevice, queue: &RenderQueue) {
        self.gpu_rects.set(GpuRects::from(&rects[..]));
        self.gpu_rects.write_buffer(device, queue);
        self.rects = rects;
    }

    fn memory(&self) -> MoreMemory {
        MoreMemory([&self.layer.memory[..], &self.textures.targets.memory].concat())
    }
}

/// Makes, updates and removes the layers of all views.
pub(super) fn prepare_front_layers(
    mut views: Query<(PreparedView, Option<&mut FrontLayer>, Option<&RenderLayers>)>,
    surroundings: Surroundings,
    boxes: Res<SeeThroughBoxes>,
    in_place: Res<WritesInPlace>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    mut refused: Local<HashMap<Entity, u32>>,
    mut commands: Commands,
) {
    refused.retain(|_, frames| {
        *frames -= 1;
        *frames > 0
    });
    for (view, layer, layers) in &mut views {
        let entity = view.entity;
        let is_wanted = view.view.settings.transparent && !refused.contains_key(&entity);
        let Some(sizes) = view.sizes().filter(|_| is_wanted) else {
            if layer.is_some() {
                commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
            }
            continue;
        };
        // Rays see objects of the default layer, and what a camera doesn't draw shows no reflection.
        let draws = layers.is_none_or(|layers| layers.intersects(&RenderLayers::default()));
        let rects = if draws {
            screen_rects(&boxes.boxes, &clip_from_world(view.extracted), sizes.full)
        } else {
            Vec::new()
        };
        if rects.is_empty() {
            if let Some(mut layer) = layer {
                layer.rects.clear();
                layer.idle += 1;
                if layer.idle > IDLE_FRAMES {
                    commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
                }
            }
            continue;
        }
        let needs = Needs::new(&view.view.settings, in_place.allows(view.extracted.target_format));
        let Some(extent) = view.camera.physical_target_size else {
            continue;
        };
        let mut settings = view.view.clone();
        // Lists hold its rays, which are few.
        if settings.settings.backend == ReflectionBackend::HardwareVrs {
            settings.settings.backend = ReflectionBackend::Compute;
        }
        let frame = view.frame(&surroundings).of_other_surfaces();
        match layer {
            Some(mut layer) if layer.fits(sizes, needs, extent) => {
                // Its history is older than the last frame.
                settings.reset |= layer.idle > 0;
                layer.idle = 0;
                layer.set_rects(rects, &device, &queue);
                layer.textures.begin_frame(&settings, &frame);
                layer.textures.uniform.write_buffer(&device, &queue);
                layer.view = settings;
            }
            _ => {
                let create = || {
                    (
                        LayerTextures::new(&device, extent),
                        ReflectionTextures::new(&device, sizes, needs, None),
                    )
                };
                let Some((layer, mut textures)) = try_allocate(&device, create) else {
                    commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
                    refused.insert(entity, REFUSED_FRAMES);
                    continue;
                };
                settings.reset = true;
                textures.begin_frame(&settings, &frame);
                textures.uniform.write_buffer(&device, &queue);
                let mut layer = FrontLayer {
                    layer,
                    textures,
                    view: settings,
                    rects: Vec::new(),
                    gpu_rects: UniformBuffer::default(),
                    is_found: AtomicBool::new(false),
                    idle: 0,
                };
                layer.set_rects(rects, &device, &queue);
                let memory = layer.memory();
                commands.entity(entity).insert((layer, memory));
            }
        }
    }
}

fn clip_from_world(view: &ExtractedView) -> Mat4 {
    view.clip_from_world
        .unwrap_or_else(|| view.clip_from_view * view.world_from_view.to_matrix().inverse())
}
