//! Creates the textures of new and resized views, and writes the uniforms of all views.

use super::{
    culling::ViewCulling,
    textures::ReflectionTextures,
    uniform::{Frame, Screen, VIEW_DRAWS_GLASS, VIEW_HAS_IRRADIANCE, VIEW_HAS_SSAO},
};
use crate::{
    device::{MemoryRetry, WritesInPlace, try_allocate},
    scene::{
        SceneBindings,
        environment::{EnvironmentBindings, ViewEnvironment},
    },
    settings::ReflectionView,
    status::{ReflectionStatus, ReflectionViewMemory},
    targets::{Needs, Sizes},
};
use bevy::{
    camera::{MainPassResolutionOverride, NormalizedRenderTarget},
    core_pipeline::prepass::PreviousViewData,
    diagnostic::FrameCount,
    ecs::{entity::EntityHashMap, prelude::*, query::QueryData, system::SystemParam},
    light::{EnvironmentMapLight, IrradianceVolume},
    math::{Mat4, UVec2, Vec4Swizzles},
    pbr::{DistanceFog, RenderViewLightProbes, ScreenSpaceAmbientOcclusionResources, ScreenSpaceTransmission},
    render::{
        camera::ExtractedCamera,
        renderer::{RenderDevice, RenderQueue},
        sync_world::MainEntity,
        view::ExtractedView,
    },
    time::Time,
};

/// A reflecting view, with all inputs of its frame.
#[derive(QueryData)]
#[query_data(mutable)]
pub(crate) struct PreparedView {
    pub entity: Entity,
    pub view: &'static ReflectionView,
    pub extracted: &'static ExtractedView,
    pub camera: &'static ExtractedCamera,
    textures: Option<&'static mut ReflectionTextures>,
    culling: Option<&'static mut ViewCulling>,
    resolution: Option<&'static MainPassResolutionOverride>,
    environment: Option<&'static ViewEnvironment>,
    previous: Option<&'static PreviousViewData>,
    fog: Option<&'static DistanceFog>,
    ssao: Has<ScreenSpaceAmbientOcclusionResources>,
    transmission: Has<ScreenSpaceTransmission>,
    probes: Has<RenderViewLightProbes<EnvironmentMapLight>>,
    volume: Has<RenderViewLightProbes<IrradianceVolume>>,
}

/// The scene and its environment, as far as frames depend on them.
#[derive(SystemParam)]
pub(crate) struct Surroundings<'w, 's> {
    cameras: Query<'w, 's, &'static ExtractedCamera>,
    scene: Res<'w, SceneBindings>,
    environments: Res<'w, EnvironmentBindings>,
    time: Res<'w, Time>,
    frames: Res<'w, FrameCount>,
}

impl PreparedViewItem<'_, '_> {
    /// Returns `None` for views without pixels.
    pub fn sizes(&self) -> Option<Sizes> {
        let viewport = self.camera.physical_viewport_size?;
        let resolution = self.resolution.map(|resolution| resolution.0.min(viewport));
        Some(Sizes {
            full: resolution.unwrap_or(viewport).max(UVec2::ONE),
            trace_scale: self.view.settings.technique.trace_scale(),
            texel: self.view.settings.texel(),
            tile: self.view.rate.tile_size,
        })
    }

    /// Capacity of new textures in pixels. A view that grows gets an extra quarter, up to its maximum size, since it might grow again in
    /// the next frame. `most` is the maximum size of textures.
    fn capacity(&self, full: UVec2, most: u32) -> UVec2 {
        let grows = |textures: &ReflectionTextures| full.cmpgt(textures.targets.capacity()).any();
        if !self.textures.as_deref().is_some_and(grows) {
            return full;
        }
        let largest = match self.resolution {
            Some(_) => self.camera.physical_viewport_size,
            None => self.camera.physical_target_size,
        };
        // Hits take two texels for each trace pixel.
        let most = UVec2::splat(most / 2 * self.view.settings.technique.trace_scale());
        (full + full / 4).min(largest.unwrap_or(full)).min(most).max(full)
    }

    /// Capacity of its textures in pixels.
    pub fn room(&self) -> UVec2 {
        let room = self.textures.as_ref().map(|textures| textures.targets.capacity());
        room.or(self.camera.physical_viewport_size).unwrap_or_default()
    }

    pub fn frame(&self, surroundings: &Surroundings) -> Frame {
        let extracted = self.extracted;
        let mut flags = if self.ssao { VIEW_HAS_SSAO } else { 0 };
        if self.probes || self.volume {
            flags |= VIEW_HAS_IRRADIANCE;
        }
        if self.transmission {
            flags |= VIEW_DRAWS_GLASS;
        }
        let mut cameras = surroundings.cameras.iter();
        // With the same rounding as Bevy's matrix of the last frame.
        let by_bevy = extracted.clip_from_view * Mat4::from(extracted.world_from_view.affine().inverse());
        Frame {
            origin: extracted.viewport.xy(),
            gbuffer_origin: extracted.viewport.xy(),
            first_tile: UVec2::ZERO,
            flags,
            fog: self.fog.into(),
            seconds: surroundings.time.elapsed_secs_wrapped(),
            number: surroundings.frames.0,
            shift: surroundings.scene.shift,
            world_origin: surroundings.scene.origin,
            scene: surroundings.scene.version.all,
            unmarked: surroundings.scene.version.unmarked,
            changes_met: self.culling.as_ref().and_then(|culling| culling.changes_met()),
            clip_from_world: extracted
                .clip_from_world
                .unwrap_or_else(|| extracted.clip_from_view * extracted.world_from_view.to_matrix().inverse()),
            was_here: self
                .previous
                .is_none_or(|previous| previous.unjittered_clip_from_world == by_bevy),
            world_position: extracted.world_from_view.translation(),
            exposure: self.camera.exposure,
            environment: self.environment.cloned(),
            environment_id: surroundings.environments.id(self.entity),
            may_move: self.view.settings.marches_screen() || cameras.any(|other| is_screen(other, self.camera)),
            culled: self.culling.as_ref().is_some_and(|culling| culling.is_culled()),
            screen: Screen::Last,
            follows_own_motion: false,
        }
    }
}

/// Views for whose textures the device lacked memory, and when to retry them.
#[derive(Resource, Default)]
pub(crate) struct RefusedViews {
    views: EntityHashMap<MemoryRetry>,
    /// Memory was refused since the last query.
    is_short: bool,
}

impl RefusedViews {
    /// Call at the beginning of a frame.
    pub fn begin_frame(&mut self) {
        self.views.retain(|_, retry| !retry.is_due());
    }

    /// Returns whether a view can't reflect in this frame.
    pub fn contains(&self, view: Entity) -> bool {
        self.views.contains_key(&view)
    }

    fn note(&mut self, view: Entity) {
        self.views.entry(view).or_default().begin();
        self.is_short = true;
    }

    /// Call if the device lacked memory for something other than a view's textures.
    pub fn note_shortage(&mut self) {
        self.is_short = true;
    }

    /// Returns whether the device has refused memory in this frame.
    pub fn is_short(&self) -> bool {
        self.is_short
    }

    /// Returns whether the device has refused memory since the last call.
    pub fn take_shortage(&mut self) -> bool {
        core::mem::take(&mut self.is_short)
    }

    /// Call after memory was freed.
    pub fn retry(&mut self) {
        self.views.clear();
    }
}

/// Part of a frame beyond which the history of another view is worth reading. With a larger value, more cuts begin with noise; a smaller one
/// reads histories that most pixels find nothing in.
const COVERAGE: f32 = 0.5;

/// Textures of views that aren't drawn in this frame.
type LeftViews<'w, 's> = Query<'w, 's, &'static ReflectionTextures, Without<ReflectionView>>;

/// After a cut between two cameras, lets a view read the history of the camera that was drawn in the last frame, if that history shows more of
/// the view than its own one. Returns whether it does.
fn borrow_history(textures: &mut ReflectionTextures, view: &ReflectionView, frame: &Frame, left: &LeftViews) -> bool {
    let (sizes, needs) = (textures.targets.sizes, textures.targets.needs);
    if view.reset || needs.accumulation || frame.culled || textures.is_of_last_frame(frame) {
        return false;
    }
    let others = left
        .iter()
        .filter(|other| other.is_of_last_frame(frame) && other.targets.is_like(sizes, needs));
    let best = others
        .map(|other| (other.coverage(frame), other))
        .max_by(|(a, _), (b, _)| a.total_cmp(b));
    let least = COVERAGE.max(textures.coverage(frame));
    let Some((_, other)) = best.filter(|(coverage, _)| *coverage > least) else {
        return false;
    };
    textures.borrow(other, frame);
    true
}

/// Creates the textures of new and resized views and writes the uniforms of all views.
pub(super) fn prepare_views(
    mut views: Query<PreparedView>,
    left: LeftViews,
    surroundings: Surroundings,
    in_place: Res<WritesInPlace>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    mut refused: ResMut<RefusedViews>,
    mut commands: Commands,
) {
    for view in &mut views {
        let Some(sizes) = view.sizes() else { continue };
        let needs = Needs::new(&view.view.settings, in_place.allows(view.extracted.target_format));
        let capacity = view.capacity(sizes.full, device.limits().max_texture_dimension_2d);
        let frame = view.frame(&surroundings);
        let PreparedViewItem {
            entity,
            view,
            mut textures,
            culling,
            ..
        } = view;
        let is_resized = textures.as_ref().is_some_and(|textures| textures.size() != sizes.full);
        let fits = textures.as_mut().is_some_and(|textures| textures.fit(sizes, needs));
        match textures {
            Some(mut textures) if fits => {
                // Earlier reports were about another size.
                let has_borrowed = borrow_history(&mut textures, view, &frame, &left);
                if let Some(mut culling) = culling.filter(|_| is_resized || has_borrowed) {
                    culling.invalidate();
                }
                textures.begin_frame(view, &frame);
                textures.uniform.write_buffer(&device, &queue);
            }
            old => {
                let create = || {
                    let sizes = (sizes, capacity);
                    let mut textures = ReflectionTextures::new(&device, sizes, needs, old.as_deref());
                    textures.targets.memory.push(ViewCulling::MEMORY);
                    textures
                };
                let Some(mut textures) = try_allocate(&device, create) else {
                    // Textures of other sizes or settings are useless.
                    commands.entity(entity).remove::<ReflectionTextures>();
                    refused.note(entity);
                    continue;
                };
                borrow_history(&mut textures, view, &frame, &left);
                textures.begin_frame(view, &frame);
                textures.uniform.write_buffer(&device, &queue);
                commands.entity(entity).insert(textures);
                match culling {
                    // Earlier reports were about other targets.
                    Some(mut culling) => culling.invalidate(),
                    None => {
                        commands.entity(entity).insert(ViewCulling::new(&device));
                    }
                }
            }
        }
    }
}

/// Returns whether a camera renders into an image, other than the target of `own`.
fn is_screen(camera: &ExtractedCamera, own: &ExtractedCamera) -> bool {
    matches!(camera.target, Some(NormalizedRenderTarget::Image(_))) && camera.target != own.target
}

/// Label and bytes of a view's resources besides its [`ReflectionTextures`]: its front layer.
#[derive(Component, Clone, Debug, Default)]
pub(crate) struct MoreMemory(pub Vec<(&'static str, u64)>);

impl MoreMemory {
    fn bytes(&self) -> u64 {
        self.0.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// Label and bytes of the textures of a view that describe its reflections.
#[derive(Component, Clone, Debug, Default)]
pub(crate) struct GuideMemory(pub Vec<(&'static str, u64)>);

impl GuideMemory {
    fn bytes(&self) -> u64 {
        self.0.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// Reports the memory of views to the main world.
pub(super) fn publish_memory(
    views: Query<(
        &MainEntity,
        &ReflectionTextures,
        Option<&MoreMemory>,
        Option<&GuideMemory>,
    )>,
    status: Res<ReflectionStatus>,
    mut published: Local<Vec<(Entity, u64)>>,
) {
    let present = views.iter().map(|(camera, textures, more, guides)| {
        let bytes = textures.bytes() + more.map_or(0, MoreMemory::bytes) + guides.map_or(0, GuideMemory::bytes);
        (camera.id(), bytes)
    });
    if present.clone().eq(published.iter().copied()) {
        return;
    }
    *published = present.collect();
    let view_memory = views
        .iter()
        .map(|(entity, textures, more, guides)| ReflectionViewMemory {
            camera: entity.id(),
            pixels: u64::from(textures.size().x) * u64::from(textures.size().y),
            parts: [
                &textures.targets.memory[..],
                more.map_or(&[], |more| &more.0),
                guides.map_or(&[], |guides| &guides.0),
            ]
            .concat(),
            front_layer_bytes: more.map_or(0, MoreMemory::bytes),
        });
    status.update(|report| report.view_memory = view_memory.collect());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::REFUSED_FRAMES;

    #[test]
    fn refused_views_are_forgotten() {
        let mut refused = RefusedViews::default();
        let view = Entity::from_raw_u32(7).unwrap();
        refused.note(view);
        (1..REFUSED_FRAMES).for_each(|_| refused.begin_frame());
        assert!(refused.contains(view));
        refused.begin_frame();
        assert!(refused.views.is_empty(), "the camera might be gone");
    }
}
