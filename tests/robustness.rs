//! Meshes of all formats, materials that do not reflect, cameras that cannot, values that are no numbers, any size.

#[path = "robustness/cameras.rs"]
mod cameras;
#[path = "robustness/meshes.rs"]
mod meshes;
#[path = "common/pictures.rs"]
mod pictures;

use bevy::{math::UVec2, prelude::*};
use bevy_glint::{ReflectionStatus, ReflectionStatusReport, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, SceneName, environment};

const BOTH: [ReflectionTracerChoice; 2] = [ReflectionTracerChoice::RayQuery, ReflectionTracerChoice::Bvh];
const SIZE: UVec2 = UVec2::new(96, 64);
const RED: [u8; 3] = [255, 0, 0];
/// Behind the camera, where only the mirror shows it.
const BEHIND: Vec3 = Vec3::new(0.0, 0.0, 6.0);

fn unlit(color: [u8; 3]) -> StandardMaterial {
    let [r, g, b] = color;
    StandardMaterial {
        base_color: Color::srgb_u8(r, g, b),
        unlit: true,
        ..default()
    }
}

fn mirror_material() -> StandardMaterial {
    StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    }
}

fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    let world = app.world();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// A camera at a distance of three metres from the origin, in the surroundings of a scene.
fn camera(app: &mut HeadlessApp, surroundings: SceneName) -> Entity {
    let environment = environment(surroundings, app.world());
    let camera = app.spawn_camera(Transform::from_xyz(0.0, 0.0, 3.0));
    environment.insert(&mut app.world().entity_mut(camera));
    camera
}

/// Turned towards the mirror.
fn facing_the_mirror(position: Vec3) -> Transform {
    Transform::from_translation(position).with_rotation(Quat::from_rotation_y(core::f32::consts::PI))
}

fn report(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

fn differing_pixels(a: &[u8], b: &[u8], tolerance: u8) -> usize {
    let apart = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > tolerance);
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(apart).count()
}
