//! The textures of a view.

use super::passes;
use crate::{
    device::{MemoryRetry, try_allocate},
    pipelines::Pipelines,
    settings::ReflectionView,
    targets::create_texture,
    view::{ReflectionTextures, RefusedViews},
};
use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::prelude::*,
    log::warn_once,
    math::UVec2,
    render::{
        render_resource::{PipelineCache, TextureFormat, TextureUsages, TextureView, TextureViewDescriptor},
        renderer::RenderDevice,
    },
};

/// Formats of the textures.
pub(super) const FORMATS: [TextureFormat; 3] = [
    TextureFormat::Rg16Float,
    TextureFormat::R16Float,
    TextureFormat::R8Unorm,
];

/// Textures about the reflections on a view's opaque surfaces, in the render world, on the view's entity: see
/// [`ReflectionGuides`](crate::ReflectionGuides).
///
/// [`ReflectionSystems::Passes`](crate::ReflectionSystems::Passes) fills them in each frame. Read them in `Core3d` after it. Pixel (0, 0) is
/// the first pixel of the camera's viewport. The textures can be larger than the view, whose pixels are the first ones. They are 0 in frames
/// in which nothing is traced, such as those of cameras that see nothing reflective.
#[derive(Component, Clone, Debug)]
pub struct ReflectionGuideTextures {
    /// `Rg16Float`: how far the reflected image moved on the screen since the last frame, as a fraction of the view, with the convention
    /// of Bevy's [motion vectors](bevy::core_pipeline::prepass::MotionVectorPrepass). It includes the motion of the camera and the
    /// curvature of the reflector, not the motion of what is reflected. Where nothing is reflected, on rough surfaces, and on reflectors that
    /// move by themselves, it is the motion of the surface.
    pub specular_motion: TextureView,
    /// `R16Float`: distance in metres from the surface to what it reflects, at most 60,000, which also stands for the sky. 0 where nothing
    /// is traced.
    pub hit_distance: TextureView,
    /// `R8Unorm`: from 0, where the history of a pixel is valid at its motion vector, to 1, where a bright and sharp reflection doesn't
    /// follow its surface: its image moves differently, or it shows something that moves. Objects that move before a mirror with
    /// [rays of its own](crate::RayTracedReflections::full_resolution_mirrors) don't count.
    pub reactive_mask: TextureView,
    /// Pixels of the view.
    pub size: UVec2,
    /// Pixels of the textures.
    capacity: UVec2,
}

impl ReflectionGuideTextures {
    fn new(device: &RenderDevice, size: UVec2, capacity: UVec2) -> Self {
        let texture = |format, label| {
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
            let (texture, _) = create_texture(device, capacity, format, usage, label);
            texture.create_view(&TextureViewDescriptor {
                label: Some(label),
                ..Default::default()
            })
        };
        let [motion, distance, mask] = FORMATS;
        Self {
            specular_motion: texture(motion, "glint_specular_motion"),
            hit_distance: texture(distance, "glint_hit_distance"),
            reactive_mask: texture(mask, "glint_reactive_mask"),
            size,
            capacity,
        }
    }
}

/// Creates the textures of views once they can be filled, and removes them from views that don't want them any more.
pub(super) fn prepare_guides(
    mut views: Query<
        (
            Entity,
            Option<&ReflectionView>,
            Option<&ReflectionTextures>,
            Option<&ViewPrepassTextures>,
            Option<&mut ReflectionGuideTextures>,
        ),
        Or<(With<ReflectionView>, With<ReflectionGuideTextures>)>,
    >,
    pipelines: Option<Res<Pipelines>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    mut refused: ResMut<RefusedViews>,
    mut waiting: Local<Option<MemoryRetry>>,
    mut commands: Commands,
) {
    if waiting.as_mut().is_some_and(MemoryRetry::is_due) {
        *waiting = None;
    }
    for (entity, view, textures, prepass, guides) in &mut views {
        let wanted = view.filter(|view| view.guides).zip(textures).filter(|(_, textures)| {
            let compiled = |pipelines: &Pipelines| pipelines.is_compiled(&cache, &passes::variant());
            let has_motion = prepass.is_some_and(|prepass| prepass.motion_vectors_view().is_some());
            has_motion && textures.targets.pipeline.is_some() && pipelines.as_deref().is_some_and(compiled)
        });
        let Some((_, textures)) = wanted else {
            if guides.is_some() {
                commands.entity(entity).remove::<ReflectionGuideTextures>();
            }
            continue;
        };
        let (size, capacity) = (textures.size(), textures.targets.capacity().max(textures.size()));
        match guides {
            Some(mut guides) if guides.capacity == capacity => guides.size = size,
            _ if waiting.is_some() => {
                commands.entity(entity).remove::<ReflectionGuideTextures>();
            }
            _ => match try_allocate(&device, || ReflectionGuideTextures::new(&device, size, capacity)) {
                Some(guides) => {
                    commands.entity(entity).insert(guides);
                }
                None => {
                    warn_once!("`ReflectionGuides` get no textures as long as the device lacks memory for them");
                    refused.note_shortage();
                    waiting.get_or_insert_default().begin();
                    commands.entity(entity).remove::<ReflectionGuideTextures>();
                }
            },
        }
    }
}
