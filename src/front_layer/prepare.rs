//! Creates the front layers of views with suitable objects on screen, and removes them afterwards.

use super::{
    boxes::LayerBoxes,
    find::OwnShader,
    rects::{GpuRects, disjoint, screen_rects},
    textures::LayerTextures,
};
use crate::{
    device::{MemoryRetry, RealTime, WritesInPlace, try_allocate},
    settings::{ReflectionBackend, ReflectionRetention, ReflectionView, ScreenTraces},
    targets::{Needs, Sizes},
    view::{Frame, MoreMemory, PreparedView, ReflectionTextures, RefusedViews, Surroundings},
};
use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::prelude::*,
    math::{Mat4, URect, UVec2},
    platform::collections::HashMap,
    render::{
        render_resource::UniformBuffer,
        renderer::{RenderDevice, RenderQueue},
        view::ExtractedView,
    },
};
use core::{
    mem::take,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

/// The front layer of a view.
#[derive(Component)]
pub struct FrontLayer {
    pub(super) layer: LayerTextures,
    pub(super) textures: ReflectionTextures,
    /// The settings of the passes over it.
    pub(super) view: ReflectionView,
    /// Rectangles of the view in which it is written; empty if none of its objects are on screen in this frame.
    pub(super) rects: Vec<URect>,
    /// See-through objects are on screen; otherwise, all of the layer is opaque.
    pub(super) has_see_through: bool,
    /// Tiles of the view that it covers, or did in the last frames: the pair of rate images can contain these.
    pub(super) tiles: URect,
    /// Its rectangles one and two frames ago.
    before: [Vec<URect>; 2],
    /// The rectangles for shaders.
    pub(super) gpu_rects: UniformBuffer<GpuRects>,
    /// Whether it contains this frame's layer. Before that is found, it is about the last frame.
    pub(super) is_found: AtomicBool,
    /// It wasn't found in the last frame.
    is_new: bool,
    /// Time since its objects were last on screen.
    unused: Duration,
}

impl FrontLayer {
    /// `old` is the layer of the view in another size or for other settings. Its history goes on.
    fn new(
        device: &RenderDevice,
        view: &ReflectionView,
        extent: UVec2,
        (sizes, needs): ((Sizes, UVec2), Needs),
        old: Option<&Self>,
    ) -> Self {
        let textures = ReflectionTextures::new(device, sizes, needs, old.map(|old| &old.textures));
        Self {
            layer: LayerTextures::new(device, textures.targets.capacity(), extent),
            textures,
            view: view.clone(),
            rects: Vec::new(),
            has_see_through: false,
            tiles: URect::default(),
            before: Default::default(),
            gpu_rects: UniformBuffer::default(),
            // There is nothing to overwrite in new textures.
            is_found: AtomicBool::new(true),
            is_new: old.is_none_or(|old| old.is_new),
            unused: Duration::ZERO,
        }
    }

    /// Switches to another size of the view if it fits. Returns whether everything fits.
    fn fit(&mut self, sizes: Sizes, needs: Needs, extent: UVec2) -> bool {
        let before = self.textures.targets.sizes;
        let fits = self.layer.extent == extent && self.textures.fit(sizes, needs);
        if before != sizes {
            // Overwrites everything that was written elsewhere.
            self.is_found.store(false, Ordering::Relaxed);
            self.before = Default::default();
        }
        fits
    }

    /// Sets this frame's rectangles once their contents are known, and schedules clearing of stale ones.
    fn set_rects(&mut self, now: &[URect], device: &RenderDevice, queue: &RenderQueue) {
        let sizes = self.textures.targets.sizes;
        if !self.is_found.swap(false, Ordering::Relaxed) {
            self.before[0] = vec![URect::from_corners(UVec2::ZERO, sizes.full)];
        }
        let [last, earlier] = &self.before;
        self.rects = disjoint(now.iter().chain(last).copied());
        self.tiles = tiles_of(now.iter().chain(last).chain(earlier), sizes);
        self.before.swap(0, 1);
        self.before[0] = now.to_vec();
        self.gpu_rects.set(GpuRects::new(&self.rects, self.has_see_through));
        self.gpu_rects.write_buffer(device, queue);
    }

    /// Sets the settings and properties of the view in a frame, after its rectangles. `is_own` is true if an app's shader finds it.
    fn begin_frame(&mut self, view: &ReflectionView, frame: Frame, is_own: bool) {
        self.view = view.clone();
        let settings = &mut self.view.settings;
        // Its rays, which are few, come from lists. The view stores no screen for them.
        if settings.backend == ReflectionBackend::HardwareVrs {
            settings.backend = ReflectionBackend::Compute;
            settings.screen_traces = ScreenTraces::Off;
        }
        // Its history is older than the last frame.
        self.view.reset |= take(&mut self.is_new);
        self.unused = Duration::ZERO;
        let frame = frame.of_other_surfaces(self.tiles.min, is_own, !self.has_see_through);
        self.textures.begin_frame(&self.view, &frame);
    }

    /// Records that no pass writes this frame.
    pub(crate) fn miss_frame(&mut self) {
        self.textures.miss_frame();
    }

    fn memory(&self) -> MoreMemory {
        MoreMemory([&self.layer.memory[..], &self.textures.targets.memory].concat())
    }
}

/// Creates, updates and removes the layers of all views.
pub(super) fn prepare_front_layers(
    mut views: Query<(PreparedView, Option<&mut FrontLayer>, Option<&mut ViewPrepassTextures>)>,
    surroundings: Surroundings,
    (boxes, own_shader): (Res<LayerBoxes>, Res<OwnShader>),
    (in_place, device, queue): (Res<WritesInPlace>, Res<RenderDevice>, Res<RenderQueue>),
    mut refused: Local<HashMap<Entity, MemoryRetry>>,
    mut shortage: ResMut<RefusedViews>,
    (time, retention): (Res<RealTime>, Res<ReflectionRetention>),
    mut commands: Commands,
) {
    refused.retain(|_, retry| !retry.is_due());
    for (view, mut layer, prepass) in &mut views {
        let entity = view.entity;
        let settings = &view.view.settings;
        let is_wanted = settings.transparent || !boxes.opaque(settings).is_empty();
        let is_wanted = is_wanted && !refused.contains_key(&entity);
        let Some(sizes) = view.sizes().filter(|_| is_wanted) else {
            if layer.is_some() {
                commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
            }
            continue;
        };
        let clip_from_world = clip_from_world(view.extracted);
        let [see_through, opaque] = [boxes.see_through(settings), boxes.opaque(settings)]
            .map(|boxes| screen_rects(boxes, &clip_from_world, sizes.full));
        let has_see_through = !see_through.is_empty();
        let rects = disjoint([see_through, opaque].concat());
        if rects.is_empty() {
            if let Some(mut layer) = layer {
                layer.rects.clear();
                layer.is_new = true;
                layer.unused += time.delta();
                if layer.unused > retention.0 || shortage.is_short() {
                    commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
                    shortage.retry();
                }
            }
            continue;
        }
        let needs = Needs {
            // It uses the view's screen.
            screen: false,
            ..Needs::new(&view.view.settings, in_place.allows(view.extracted.target_format))
        };
        let Some(extent) = view.camera.physical_target_size else {
            continue;
        };
        let (capacity, frame) = (view.room(), view.frame(&surroundings));
        let fits = layer.as_mut().is_some_and(|layer| layer.fit(sizes, needs, extent));
        let mut created = None;
        let front = match layer {
            Some(layer) if fits => layer.into_inner(),
            old => {
                let old = old.as_deref();
                let make = || FrontLayer::new(&device, view.view, extent, ((sizes, capacity), needs), old);
                let Some(new) = try_allocate(&device, make) else {
                    commands.entity(entity).remove::<(FrontLayer, MoreMemory)>();
                    refused.entry(entity).or_default().begin();
                    shortage.note_shortage();
                    continue;
                };
                created.insert(new)
            }
        };
        front.has_see_through = has_see_through;
        front.set_rects(&rects, &device, &queue);
        front.begin_frame(view.view, frame, own_shader.is_there());
        front.textures.uniform.write_buffer(&device, &queue);
        if let Some(normal) = prepass.and_then(|prepass| prepass.into_inner().normal.as_mut()) {
            *normal = front.layer.normal_attachment();
        }
        if let Some(created) = created {
            let memory = created.memory();
            commands.entity(entity).insert((created, memory));
        }
    }
}

fn clip_from_world(view: &ExtractedView) -> Mat4 {
    view.clip_from_world
        .unwrap_or_else(|| view.clip_from_view * view.world_from_view.to_matrix().inverse())
}

/// Tiles that contain all of these rectangles.
fn tiles_of<'a>(rects: impl Iterator<Item = &'a URect>, sizes: Sizes) -> URect {
    let all = rects.copied().reduce(|a, b| a.union(b)).unwrap_or_default();
    let pixels = sizes.tile_pixels();
    URect {
        min: all.min / pixels,
        max: (all.max + (pixels - 1)) / pixels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_hold_all_rectangles() {
        let sizes = Sizes {
            full: UVec2::new(200, 100),
            trace_scale: 2,
            texel: 1,
            tile: 8,
        };
        let rects = [URect::new(24, 40, 32, 48), URect::new(48, 8, 200, 16)];
        assert_eq!(tiles_of(rects.iter(), sizes), URect::new(1, 0, 13, 3));
        assert_eq!(tiles_of([].iter(), sizes), URect::default());
    }
}
