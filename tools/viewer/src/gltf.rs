//! Loads a glTF file, frames it with the camera, and lights it: a sky is always there, a sun if the file has no lights.

use bevy::{
    asset::{AssetPath, LoadState},
    camera::{primitives::Aabb, visibility::NoFrustumCulling},
    camera_controller::free_camera::FreeCamera,
    prelude::*,
    world_serialization::WorldInstanceReady,
};
use glint_scenes::{FileView, file_sun};
use std::path::Path;

/// Progress of a file.
#[derive(Resource, Default, Clone, Copy, Debug, PartialEq)]
pub enum Framing {
    /// The file is being read.
    #[default]
    Loading,
    /// Its entities exist, but not all of their bounds are available.
    Measuring,
    /// The camera is placed.
    Done,
}

/// The camera that the viewer places.
#[derive(Component)]
pub struct ViewerCamera;

/// Places the camera once the file is loaded.
pub fn plugin(app: &mut App) {
    app.init_resource::<Framing>()
        .add_systems(Update, frame_scene.run_if(resource_equals(Framing::Measuring)));
}

/// Starts loading the file.
pub fn load(world: &mut World, file: &Path) {
    let path = GltfAssetLabel::Scene(0).from_asset(AssetPath::from_path_buf(file.to_owned()));
    let scene = world.resource::<AssetServer>().load(path);
    world.spawn(WorldAssetRoot(scene)).observe(loaded);
}

/// Ends the app if its file turns out to be broken.
pub fn exit_on_failure(roots: Query<&WorldAssetRoot>, server: Res<AssetServer>, mut exit: MessageWriter<AppExit>) {
    for root in &roots {
        if let Some(LoadState::Failed(_)) = server.get_load_state(root.0.id()) {
            exit.write(AppExit::error());
        }
    }
}

/// Switches the file's own cameras off.
fn loaded(
    ready: On<WorldInstanceReady>,
    children: Query<&Children>,
    mut cameras: Query<&mut Camera, Without<ViewerCamera>>,
    mut framing: ResMut<Framing>,
) {
    for descendant in children.iter_descendants(ready.entity) {
        if let Ok(mut camera) = cameras.get_mut(descendant) {
            camera.is_active = false;
        }
    }
    *framing = Framing::Measuring;
}

/// Once all bounds are available, places the camera so that everything is visible, and adds a sun if there is no light.
fn frame_scene(
    mut framing: ResMut<Framing>,
    objects: Query<(&Aabb, &GlobalTransform), With<Mesh3d>>,
    unbounded: Query<(), (With<Mesh3d>, Without<Aabb>, Without<NoFrustumCulling>)>,
    lights: Query<(), Or<(With<DirectionalLight>, With<PointLight>, With<SpotLight>)>>,
    camera: Single<(&mut Transform, &mut Projection, Option<&mut FreeCamera>), With<ViewerCamera>>,
    mut commands: Commands,
) {
    if !unbounded.is_empty() {
        return;
    }
    let Some(view) = FileView::of(objects) else { return };
    let (mut transform, mut projection, fly) = camera.into_inner();
    *transform = view.transform;
    *projection = Projection::from(view.projection);
    if let Some(mut fly) = fly {
        fly.walk_speed = view.radius;
        fly.run_speed = 4.0 * view.radius;
    }
    if lights.is_empty() {
        commands.spawn(file_sun(view.radius, view.distance));
    }
    *framing = Framing::Done;
}
