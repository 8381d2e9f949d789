//! Triangle soups as the entities of an app, and rays that try them.

use crate::tracer::soup::{self, Packed, Random, SOUPS, Soup};
use bevy::{math::Mat4, prelude::*, render::render_resource::Face};
use bevy_glint::internals::{
    bvh::TraceRay,
    gpu_types::{INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT},
};

const CULLING: [Option<Face>; 3] = [None, Some(Face::Back), Some(Face::Front)];
/// Width of the narrowest triangles that rays are aimed at, relative to their distance: through narrower ones, no ray in single
/// precision can be sure to pass.
const AIMED_WIDTH: f64 = 3e-5;

/// An entity with a mesh and a material.
pub struct Object {
    /// Index in [`Scene::meshes`].
    pub mesh: usize,
    pub transform: Transform,
    /// With its own scale, which shears the object.
    pub parent: Option<Transform>,
    pub cull_mode: Option<Face>,
    /// Every other triangle is cut out.
    pub masked: bool,
    pub casts_shadow: bool,
    /// Not opted out.
    pub reflected: bool,
}

impl Object {
    fn new(mesh: usize, transform: Transform, cull_mode: Option<Face>) -> Self {
        Self {
            mesh,
            transform,
            parent: None,
            cull_mode,
            masked: false,
            casts_shadow: true,
            reflected: true,
        }
    }

    pub fn material(&self) -> StandardMaterial {
        StandardMaterial {
            cull_mode: self.cull_mode,
            double_sided: self.cull_mode.is_none(),
            alpha_mode: if self.masked {
                AlphaMode::Mask(0.5)
            } else {
                AlphaMode::Opaque
            },
            ..default()
        }
    }

    /// Flags that the tracer must derive from the material and the components.
    pub fn flags(&self) -> u32 {
        let culling = match self.cull_mode {
            None => 0,
            Some(Face::Back) => INSTANCE_CULL_BACK,
            Some(Face::Front) => INSTANCE_CULL_FRONT,
        };
        let masked = if self.masked { INSTANCE_ALPHA_MASKED } else { 0 };
        let shadow = if self.casts_shadow { INSTANCE_CASTS_SHADOW } else { 0 };
        culling | masked | shadow
    }
}

/// The contents of an app.
pub struct Scene {
    pub name: &'static str,
    /// Size of its meshes.
    pub scale: f32,
    /// Rays start within this from the origin, along each axis.
    pub spread: f32,
    pub meshes: Vec<soup::Mesh>,
    pub objects: Vec<Object>,
}

impl Scene {
    /// All kinds of soups in the same place.
    pub fn soups(name: &'static str, scale: f32, random: &mut Random) -> Self {
        let meshes = all_soups(100, scale, random);
        let objects = (0..meshes.len())
            .map(|i| Object::new(i, Transform::IDENTITY, CULLING[i % CULLING.len()]))
            .collect();
        Self {
            name,
            scale,
            spread: 2.0 * scale,
            meshes,
            objects,
        }
    }

    /// All kinds of soups, turned, stretched, mirrored and sheared, with materials of all kinds; some are opted out.
    pub fn instances(random: &mut Random) -> Self {
        let meshes = all_soups(80, 1.0, random);
        let kinds = meshes.len();
        let objects = (0..6 * kinds)
            .map(|i| {
                let (mesh, round) = (i % kinds, i / kinds);
                let placement = Transform::from_matrix(Mat4::from(soup::placement(random, 4.0)));
                let parent = (i % 5 == 4).then(|| Transform {
                    rotation: Quat::from_rotation_z(0.6),
                    scale: Vec3::new(1.0, 1.6, 0.7),
                    ..default()
                });
                Object {
                    parent,
                    // Not if triangles overlap in a plane: the tracer can return either of two at the same distance.
                    masked: round % 2 == 1 && [Soup::Random, Soup::Needles, Soup::Grid].contains(&kind_of(mesh)),
                    casts_shadow: i % 7 != 3,
                    reflected: i % 9 != 5,
                    ..Object::new(mesh, placement, CULLING[round % CULLING.len()])
                }
            })
            .collect();
        Self {
            name: "instances",
            scale: 1.0,
            spread: 6.0,
            meshes,
            objects,
        }
    }

    /// Small soups on a grid.
    pub fn crowd(count: usize, random: &mut Random) -> Self {
        let meshes = all_soups(8, 0.4, random);
        let edge = (count as f32).cbrt().ceil();
        let objects = (0..count)
            .map(|i| {
                let cell = Vec3::new(
                    i as f32 % edge,
                    (i as f32 / edge).floor() % edge,
                    (i as f32 / (edge * edge)).floor(),
                );
                let transform = Transform::from_translation(1.5 * (cell - 0.5 * edge));
                Object::new(i % meshes.len(), transform, CULLING[i % CULLING.len()])
            })
            .collect();
        Self {
            name: "crowd",
            scale: 0.4,
            spread: 0.75 * edge,
            meshes,
            objects,
        }
    }

    /// Closed surfaces with insides that can be hit.
    pub fn closed(random: &mut Random) -> Self {
        let mesh = soup::closed_surface(20, 30, random);
        let volume: f32 = (0..mesh.triangle_count())
            .map(|primitive| {
                let [a, b, c] = mesh.corners(primitive).map(Vec3::from);
                a.dot(b.cross(c))
            })
            .sum();
        let single_sided = |transform: Transform| {
            let mirrored = transform.scale.element_product() < 0.0;
            // If the winding is counter-clockwise seen from outside, back faces look inward.
            let culled = if (volume > 0.0) != mirrored {
                Face::Front
            } else {
                Face::Back
            };
            Object::new(0, transform, Some(culled))
        };
        let far = Transform::from_xyz(7.0, -9.0, 40.0).with_scale(Vec3::splat(0.1));
        let long = Transform::from_rotation(Quat::from_rotation_x(0.7)).with_scale(Vec3::new(20.0, 1.0, 4.0));
        let mirrored = Transform::from_xyz(-40.0, 5.0, 0.0)
            .with_rotation(Quat::from_rotation_y(2.0))
            .with_scale(Vec3::new(-1.5, 2.0, 1.0));
        Self {
            name: "closed",
            scale: 1.0,
            spread: 1.0,
            meshes: vec![mesh],
            objects: vec![
                Object::new(0, far, None),
                single_sided(long),
                single_sided(mirrored),
                Object::new(0, mirrored.with_translation(Vec3::new(0.0, 30.0, 3.0)), None),
            ],
        }
    }
}

/// The kind of a mesh of [`all_soups`]. Meshes without area count as duplicates, because their triangles overlap, too.
fn kind_of(mesh: usize) -> Soup {
    SOUPS.get(mesh).copied().unwrap_or(Soup::Duplicates)
}

/// A mesh of each kind, and one of triangles without area.
fn all_soups(triangles: usize, scale: f32, random: &mut Random) -> Vec<soup::Mesh> {
    let mut meshes: Vec<_> = SOUPS
        .iter()
        .map(|kind| soup::mesh(*kind, triangles, scale, Vec3::ZERO, random))
        .collect();
    meshes.push(without_area(triangles, scale, random));
    meshes
}

/// Points, lines and lines after rounding, between triangles that can be hit.
fn without_area(triangles: usize, scale: f32, random: &mut Random) -> soup::Mesh {
    let mut mesh = soup::Mesh::default();
    while mesh.triangle_count() < triangles {
        let [a, b, c] = [(); 3].map(|()| random.vector() * scale);
        mesh.push(match mesh.triangle_count() % 6 {
            0 => [a, a, a],
            1 => [a, b, b],
            2 => [a, b, a],
            3 => [a, a.lerp(b, 0.3), b],
            _ => [a, b, c],
        });
    }
    mesh
}

/// Rays from around the origin into triangles, well within their edges, and some in any direction.
pub fn rays_into(packed: &Packed, count: usize, spread: f32, random: &mut Random) -> Vec<TraceRay> {
    let mut rays = Vec::with_capacity(count);
    while rays.len() < count {
        let origin = random.vector() * spread;
        if rays.len() % 4 == 3 {
            rays.push(soup::ray(origin, random.vector()));
            continue;
        }
        let [a, b, c] = packed.any_triangle(random).world;
        let [x, y, z] = [(); 3].map(|()| f64::from(0.6 + 0.4 * random.signed()));
        let to_target = (a * x + b * y + c * z) / (x + y + z) - origin.as_dvec3();
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let width = (b - a).cross(c - a).length() / longest;
        if width > AIMED_WIDTH * to_target.length() {
            rays.push(soup::ray(origin, to_target.normalize().as_vec3()));
        }
    }
    rays
}

/// Rays from within closed surfaces at their triangles and edges and, if requested, exactly at their corners.
pub fn rays_from_within(packed: &Packed, count: usize, at_corners: bool, random: &mut Random) -> Vec<TraceRay> {
    (0..count)
        .map(|i| {
            let target = packed.any_triangle(random);
            let (_, matrix) = &packed.instances[target.instance as usize];
            let origin = matrix.transform_point3(random.vector() * 0.3);
            let [a, b, c] = target.world;
            let target = match i % 4 {
                0 => (a + b + c) / 3.0,
                1 if at_corners => a,
                _ => a.lerp(b, f64::from(0.5 + 0.48 * random.signed())),
            };
            soup::ray(origin, (target - origin.as_dvec3()).as_vec3())
        })
        .collect()
}
