//! Finds the named object that each pixel shows, from the distance of pixels and the boxes around objects.

use super::runner::Runner;
use crate::compare::reflected_light::Objects;
use bevy::{camera::primitives::Aabb, math::Affine3A, prelude::*};

/// Scenes with more named objects than this have no table of them.
const MOST_OBJECTS: usize = 256;
/// Room around a box, as a share of the distance from the camera: distances are known to 11 bits.
const ROOM: f32 = 2e-3;

/// The box around an object.
struct NamedBox {
    name: String,
    /// From the world into the space of the box.
    local: Affine3A,
    aabb: Aabb,
    /// Length of a metre of the world in the space of the box, on its longest axis.
    scale: f32,
    volume: f32,
}

impl NamedBox {
    fn holds(&self, point: Vec3, room: f32) -> bool {
        let offset = self.local.transform_point3a(point.into()) - self.aabb.center;
        offset.abs().cmple(self.aabb.half_extents + room * self.scale).all()
    }
}

impl Runner<'_> {
    /// The named objects that the camera sees, at these distances from it. An orthographic camera sees none of them.
    pub fn objects(&mut self, distance: &[f32]) -> Objects {
        let boxes = named_boxes(self.app.world());
        let world = self.app.world();
        let (Some(camera), Some(Projection::Perspective(projection))) = (
            world.get::<GlobalTransform>(self.camera),
            world.get::<Projection>(self.camera),
        ) else {
            return Objects::default();
        };
        if boxes.is_empty() {
            return Objects::default();
        }
        let (width, height) = (self.job.protocol.width, self.job.protocol.height);
        let top = (0.5 * projection.fov).tan();
        let right = top * width as f32 / height as f32;
        let ray = |index: usize| {
            let (x, y) = (index as u32 % width, index as u32 / width);
            let across = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / Vec2::new(width as f32, height as f32) * 2.0 - 1.0;
            camera.rotation() * Vec3::new(across.x * right, -across.y * top, -1.0).normalize()
        };
        let seen = distance.iter().enumerate().map(|(index, &distance)| {
            let point = camera.translation() + distance * ray(index);
            let found = boxes.iter().position(|object| object.holds(point, ROOM * distance));
            found.map_or(0, |object| object as u16 + 1)
        });
        let seen = seen.collect();
        Objects {
            seen,
            names: boxes.into_iter().map(|object| object.name).collect(),
        }
    }
}

/// The boxes of a scene, smallest first: a small object before a large one is nearer to its own box.
fn named_boxes(world: &mut World) -> Vec<NamedBox> {
    let mut query = world.query_filtered::<(&Name, &Aabb, &GlobalTransform), With<Mesh3d>>();
    let mut boxes: Vec<NamedBox> = query
        .iter(world)
        .filter_map(|(name, aabb, transform)| {
            let (scale, _, _) = transform.to_scale_rotation_translation();
            let least = scale.abs().min_element();
            let size = aabb.half_extents * scale.abs().to_vec3a();
            (least > 0.0).then(|| NamedBox {
                name: name.to_string(),
                local: transform.affine().inverse(),
                aabb: *aabb,
                scale: least.recip(),
                volume: size.x * size.y * size.z,
            })
        })
        .collect();
    if boxes.len() > MOST_OBJECTS {
        return Vec::new();
    }
    boxes.sort_by(|a, b| a.volume.total_cmp(&b.volume));
    boxes
}
