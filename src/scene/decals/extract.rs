//! Copies decals from the main world, when some have changed.

use crate::{
    scene::{activity::SceneActivity, box_tree::Box6, bvh::invert, render_layers::SceneLayers},
    settings::NotReflected,
};
use bevy::{
    asset::AssetId,
    camera::visibility::{InheritedVisibility, RenderLayers},
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    light::ClusteredDecal,
    math::{Affine3A, Vec3},
    transform::components::GlobalTransform,
};

/// A decal of the main world.
#[derive(Clone, Debug)]
pub struct DecalSource {
    /// Rows of the 3x4 matrix into a space in which its box extends from -0.5 to 0.5.
    pub decal_from_world: [[f32; 4]; 3],
    /// Base colour, normal map, metallic and roughness, emission.
    pub images: [Option<AssetId<Image>>; 4],
    /// World space.
    pub bounds: Box6,
}

impl DecalSource {
    /// Returns `None` if the decal has no box.
    pub(super) fn new(decal: &ClusteredDecal, world_from_decal: &Affine3A) -> Option<Self> {
        let decal_from_world = bytemuck::cast(invert(world_from_decal)?.rows);
        let axes = world_from_decal.matrix3;
        let centre = Vec3::from(world_from_decal.translation);
        let half = 0.5 * (axes.x_axis.abs() + axes.y_axis.abs() + axes.z_axis.abs());
        // Enlarged by the rounding of the shader's test.
        let reach = 1.0001 * Vec3::from(half) + 1e-6 * centre.abs().max_element();
        let images = [
            &decal.base_color_texture,
            &decal.normal_map_texture,
            &decal.metallic_roughness_texture,
            &decal.emissive_texture,
        ];
        reach.is_finite().then(|| Self {
            decal_from_world,
            images: images.map(|image| image.as_ref().map(|image| image.id())),
            bounds: Box6::new(centre - reach, centre + reach),
        })
    }
}

/// The decals of the main world.
#[derive(Resource, Default)]
pub struct ExtractedDecals {
    pub decals: Vec<DecalSource>,
    /// Changes with each change of the decals.
    pub version: u64,
    /// Number of decals, and of those with render layers: removed components have no change.
    counts: [usize; 2],
}

type Decals<'w, 's> = Query<
    'w,
    's,
    (
        Ref<'static, ClusteredDecal>,
        Ref<'static, GlobalTransform>,
        Ref<'static, InheritedVisibility>,
        Option<Ref<'static, RenderLayers>>,
    ),
    Without<NotReflected>,
>;

/// The parts of the main world that extraction reads.
#[derive(SystemParam)]
pub struct DecalWorld<'w, 's> {
    all: Decals<'w, 's>,
}

/// Extracts all decals if any of them changed. Like Bevy, a view applies the decals on the layers of all views.
pub fn extract_decals(
    world: &DecalWorld,
    activity: &SceneActivity,
    layers: &SceneLayers,
    extracted: &mut ExtractedDecals,
) {
    if !activity.active {
        if !extracted.decals.is_empty() {
            extracted.decals.clear();
            extracted.version += 1;
        }
        return;
    }
    let mut counts = [0; 2];
    let mut is_changed = activity.started || layers.changed;
    for (decal, place, visibility, own_layers) in &world.all {
        counts[0] += 1;
        counts[1] += usize::from(own_layers.is_some());
        is_changed |= decal.is_changed() || place.is_changed() || visibility.is_changed();
        is_changed |= own_layers.is_some_and(|layers| layers.is_changed());
    }
    if counts == extracted.counts && (!is_changed || counts[0] == 0) {
        return;
    }
    extracted.counts = counts;
    extracted.version += 1;
    extracted.decals.clear();
    let shown = world
        .all
        .iter()
        .filter(|(_, _, visibility, own_layers)| visibility.get() && layers.groups_of(own_layers.as_deref()) != 0);
    let decals = shown.filter_map(|(decal, place, ..)| DecalSource::new(&decal, &place.affine()));
    extracted.decals.extend(decals);
}
