//! A glTF file as a scene to measure: with its own camera and lights if it has them, and ours otherwise.

use crate::{FileView, HeadlessApp, file_environment, file_sun};
use bevy::{asset::AssetPath, camera::primitives::Aabb, prelude::*, world_serialization::WorldAssetRoot};
use std::path::Path;

/// Starts loading a file, and returns a camera under a sky. [`arrange_file`] gives it a place once the file is loaded.
pub fn load_file(app: &mut HeadlessApp, file: &Path) -> Entity {
    let camera = app.spawn_camera(());
    let world = app.world();
    let path = GltfAssetLabel::Scene(0).from_asset(AssetPath::from_path_buf(file.to_owned()));
    let scene = world.resource::<AssetServer>().load(path);
    world.spawn(WorldAssetRoot(scene));
    file_environment(world).insert(&mut world.entity_mut(camera));
    camera
}

/// Places and projections of a file's own cameras, once it is loaded. The first one is the camera of [`arrange_file`].
pub fn file_cameras(world: &mut World, ours: Entity) -> Vec<(Transform, Projection)> {
    let mut cameras = world.query_filtered::<(Entity, &GlobalTransform, &Projection), With<Camera>>();
    cameras
        .iter(world)
        .filter(|(entity, ..)| *entity != ours)
        .map(|(_, transform, projection)| (transform.compute_transform(), projection.clone()))
        .collect()
}

/// Places the camera of a loaded file: at this place, otherwise at the file's first camera, otherwise at a place from which everything is
/// visible. Adds a sun if there is no light. Returns the place, and half of the diagonal of the box around all objects, in metres; `None`
/// for an empty file.
pub fn arrange_file(world: &mut World, ours: Entity, place: Option<Transform>) -> Option<(Transform, f32)> {
    let mut objects = world.query_filtered::<(&Aabb, &GlobalTransform), With<Mesh3d>>();
    let view = FileView::of(objects.iter(world))?;

    // The file's own cameras don't draw.
    let mut found = None;
    let mut cameras = world.query::<(Entity, &GlobalTransform, &Projection, &mut Camera)>();
    for (entity, transform, projection, mut camera) in cameras.iter_mut(world) {
        if entity != ours {
            camera.is_active = false;
            found.get_or_insert((transform.compute_transform(), projection.clone()));
        }
    }
    let whole = (view.transform, Projection::from(view.projection));
    let (transform, projection) = match place {
        Some(place) => (place, whole.1),
        None => found.unwrap_or(whole),
    };
    world.entity_mut(ours).insert((transform, projection));

    let mut lights = world.query_filtered::<(), Or<(With<DirectionalLight>, With<PointLight>, With<SpotLight>)>>();
    if lights.iter(world).next().is_none() {
        world.spawn(file_sun(view.radius, view.distance));
    }
    Some((transform, view.radius))
}
