//! Files with missing or broken images: their materials are shown without these.

use bevy::{
    asset::AssetLoadFailedEvent,
    platform::collections::{HashMap, HashSet},
    prelude::*,
};

/// Removes images that can't be loaded from materials, with a warning for each. Bevy doesn't draw objects with a material that
/// waits for an image.
pub struct MissingImagesPlugin;

impl Plugin for MissingImagesPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<MissingImages>()
            .add_systems(Update, (note_missing_images, leave_out_missing_images).chain());
    }
}

/// Images that can't be loaded.
#[derive(Resource, Default)]
pub struct MissingImages {
    ids: HashSet<AssetId<Image>>,
    paths: Vec<String>,
}

impl MissingImages {
    /// A sentence on each image.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        self.paths.iter().map(|path| warning(path))
    }
}

fn warning(path: &str) -> String {
    format!("{path} can't be loaded; its materials are shown without it")
}

fn note_missing_images(mut failures: MessageReader<AssetLoadFailedEvent<Image>>, mut missing: ResMut<MissingImages>) {
    for failure in failures.read() {
        if missing.ids.insert(failure.id) {
            let path = failure.path.to_string();
            warn!("{}", warning(&path));
            missing.paths.push(path);
        }
    }
}

/// Runs each frame, since a material might load after its image has failed.
fn leave_out_missing_images(missing: Res<MissingImages>, mut materials: ResMut<Assets<StandardMaterial>>) {
    if missing.ids.is_empty() {
        return;
    }
    let is_missing =
        |image: &Option<Handle<Image>>| image.as_ref().is_some_and(|image| missing.ids.contains(&image.id()));
    let affected: Vec<_> = materials
        .iter()
        .filter(|(_, material)| images(material).into_iter().any(is_missing))
        .map(|(id, _)| id)
        .collect();
    for id in affected {
        let Some(mut material) = materials.get_mut(id) else {
            continue;
        };
        for image in images_mut(&mut material) {
            if is_missing(image) {
                *image = None;
            }
        }
    }
}

fn images(material: &StandardMaterial) -> [&Option<Handle<Image>>; 6] {
    [
        &material.base_color_texture,
        &material.emissive_texture,
        &material.metallic_roughness_texture,
        &material.normal_map_texture,
        &material.occlusion_texture,
        &material.depth_map,
    ]
}

fn images_mut(material: &mut StandardMaterial) -> [&mut Option<Handle<Image>>; 6] {
    [
        &mut material.base_color_texture,
        &mut material.emissive_texture,
        &mut material.metallic_roughness_texture,
        &mut material.normal_map_texture,
        &mut material.occlusion_texture,
        &mut material.depth_map,
    ]
}

/// Returns whether an image of some material is still being loaded.
pub(crate) fn are_images_loading(server: &AssetServer, materials: &Assets<StandardMaterial>) -> bool {
    let mut states: HashMap<AssetId<Image>, bool> = HashMap::default();
    materials
        .iter()
        .flat_map(|(_, material)| images(material))
        .flatten()
        .any(|image| {
            let is_loading = || {
                server
                    .get_load_state(image.id())
                    .is_some_and(|state| state.is_loading())
            };
            *states.entry(image.id()).or_insert_with(is_loading)
        })
}
