//! Loads a glTF file, frames it with the camera, and lights it: a sky is always there, a sun if the file has no lights.

use bevy::{
    asset::{AssetPath, LoadState},
    camera::{primitives::Aabb, visibility::NoFrustumCulling},
    camera_controller::free_camera::FreeCamera,
    prelude::*,
    world_serialization::WorldInstanceReady,
};
use glint_scenes::file_sun;
use std::path::Path;

/// Field of view of the camera.
const VERTICAL_DEGREES: f32 = 45.0;

/// Progress of a file.
#[derive(Resource, Default, Clone, Copy, Debug, PartialEq)]
pub enum Framing {
    /// The file is being read.
    #[default]
    Loading,
    /// Its entities exist, their bounds are not all known.
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

/// Ends an app whose file turns out to be broken.
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

/// Once all bounds are known, places the camera such that everything is seen, and adds a sun if there is no light.
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
    let Some((low, high)) = bounds(&objects) else { return };
    let center = 0.5 * (low + high);
    let radius = (0.5 * (high - low).length()).max(1e-3);
    let fov = VERTICAL_DEGREES.to_radians();
    let distance = radius / (0.5 * fov).sin();
    let (mut transform, mut projection, fly) = camera.into_inner();
    *transform = Transform::from_translation(center + Vec3::new(0.55, 0.38, 1.0).normalize() * distance)
        .looking_at(center, Vec3::Y);
    *projection = Projection::from(PerspectiveProjection {
        fov,
        near: 0.002 * radius,
        far: 50.0 * radius,
        ..default()
    });
    if let Some(mut fly) = fly {
        fly.walk_speed = radius;
        fly.run_speed = 4.0 * radius;
    }
    if lights.is_empty() {
        commands.spawn(file_sun(radius, distance));
    }
    *framing = Framing::Done;
}

/// Corners of the box around all objects; `None` if there are none, or none at a finite place.
fn bounds(objects: &Query<(&Aabb, &GlobalTransform), With<Mesh3d>>) -> Option<(Vec3, Vec3)> {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (aabb, transform) in objects {
        for corner in 0..8u32 {
            let sign = Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32) * 2.0 - 1.0;
            let point = transform.transform_point(Vec3::from(aabb.center) + sign * Vec3::from(aabb.half_extents));
            if point.is_finite() {
                low = low.min(point);
                high = high.max(point);
            }
        }
    }
    (low.is_finite() && high.is_finite()).then_some((low, high))
}
