//! Meshes, places and components of the objects in random scenes.

use super::{
    Object, Recipe,
    fields::{Images, color},
};
use bevy::{
    camera::visibility::RenderLayers,
    light::{ClusteredDecal, NotShadowCaster, NotShadowReceiver},
    mesh::{
        MeshCompressionArgs, VertexAttributeValues,
        morph::{MeshMorphWeights, MorphAttributes},
        skinning::{SkinnedMesh, SkinnedMeshInverseBindposes},
    },
    pbr::Lightmap,
    prelude::*,
};
use core::f32::consts::PI;
use glint_scenes::Random;

impl Recipe {
    /// Coincident objects share their shape and place, or Bevy's image would depend on rounding.
    pub fn mesh(&self) -> Mesh {
        let mesh: Mesh = match self.shape {
            0 => Sphere::new(0.75).mesh().uv(32, 18),
            1 => Cuboid::from_length(1.0).into(),
            _ => Rectangle::new(1.4, 1.4).into(),
        };
        let mut mesh = if self.varies("mesh: no tangents").is_some() {
            mesh
        } else {
            mesh.with_generated_tangents().unwrap()
        };
        if self.varies("mesh: second UVs").is_some() || self.varies("object: lightmap").is_some() {
            let Some(VertexAttributeValues::Float32x2(uvs)) = mesh.attribute(Mesh::ATTRIBUTE_UV_0) else {
                unreachable!("all shapes have UVs")
            };
            let uvs: Vec<[f32; 2]> = uvs.iter().map(|[u, v]| [1.7 * v + 0.2, 0.8 * u]).collect();
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_1, uvs);
        }
        if let Some(seed) = self.varies("mesh: colours") {
            self.paint(&mut mesh, seed);
        }
        if self.varies("mesh: no indices").is_some() {
            mesh.duplicate_vertices();
        }
        if let Some(seed) = self.varies("mesh: morphed") {
            mesh = morphable(mesh, seed);
        }
        if self.varies("mesh: skinned").is_some() {
            mesh = skinnable(mesh);
        }
        if self.varies("mesh: compressed").is_some() {
            // What can't be compressed stays as it is.
            _ = mesh.compress_mesh(&MeshCompressionArgs::regular());
        }
        mesh
    }

    fn paint(&self, mesh: &mut Mesh, seed: u64) {
        let mut random = Random::new(seed);
        let most = random.pick(&[1.0, 4.0]);
        let colors: Vec<[f32; 4]> = if self.shape == 0 {
            // The same for all: differences between small triangles are differences between pixels.
            let one = color(&mut random, most, 0.8).to_linear().to_f32_array();
            vec![one; mesh.count_vertices()]
        } else {
            let colors = (0..mesh.count_vertices()).map(|_| color(&mut random, most, 0.8).to_linear().to_f32_array());
            colors.collect()
        };
        mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, colors);
    }

    /// The place within its cell, and the place of its parent.
    pub fn place(&self) -> (Transform, Transform) {
        let mut place = Transform::from_rotation(Quat::from_rotation_y(PI));
        if let Some(seed) = self.varies("place: turned") {
            let mut random = Random::new(seed);
            let most = if self.shape == 2 { 0.8 } else { PI };
            let [x, y, z] = [(); 3].map(|()| random.range(-most, most));
            place.rotate_local(Quat::from_euler(EulerRot::XYZ, x, y, z));
        }
        if let Some(seed) = self.varies("place: mirrored") {
            let mut random = Random::new(seed);
            place.scale = Vec3::from_array([(); 3].map(|()| random.pick(&[-1.0, -0.6, 0.8])));
        }
        let mut parent = Transform::default();
        if let Some(seed) = self.varies("place: sheared") {
            let mut random = Random::new(seed);
            parent.scale = Vec3::new(random.range(0.6, 1.0), random.range(0.5, 1.0), 0.8);
            parent.rotation = Quat::from_rotation_z(random.range(-0.8, 0.8));
            place.rotate_z(random.range(-0.8, 0.8));
        }
        (parent, place)
    }

    /// Gives an object its components beside mesh, material and place.
    pub fn dress(&self, object: &Object, entity: &mut EntityWorldMut, light: &Handle<Image>) {
        if let Some(seed) = self.varies("mesh: morphed") {
            let weights = vec![Random::new(seed).range(-0.5, 1.0)];
            entity.insert(MeshMorphWeights::Value { weights });
        }
        // Bevy has no pipelines for lightmaps on such meshes, and ends the app.
        let is_posed = ["mesh: morphed", "mesh: skinned"]
            .iter()
            .any(|name| self.varies(name).is_some());
        for (index, seed) in &object.varied {
            let mut random = Random::new(*seed);
            match super::FIELDS[*index].0 {
                "object: lightmap" if !is_posed => {
                    let corner = Vec2::new(random.range(0.0, 0.4), random.range(0.0, 0.4));
                    entity.insert(Lightmap {
                        image: light.clone(),
                        uv_rect: Rect::from_corners(corner, corner + random.range(0.2, 0.6)),
                        ..default()
                    });
                }
                "object: visibility" => {
                    entity.insert(random.pick(&[Visibility::Hidden, Visibility::Visible, Visibility::Inherited]));
                }
                "object: layers" => {
                    let layers: [&[usize]; 3] = [&[1], &[0, 1], &[]];
                    entity.insert(RenderLayers::from_layers(random.pick(&layers)));
                }
                "object: casts no shadow" => {
                    entity.insert(NotShadowCaster);
                }
                "object: receives no shadow" => {
                    entity.insert(NotShadowReceiver);
                }
                _ => (),
            }
        }
    }

    /// A decal on the objects, with any of its images. Bevy composites several in any order.
    pub fn decal(&self, images: &Images) -> Option<(ClusteredDecal, Transform)> {
        let mut random = Random::new(self.varies("decal")?);
        // Decals don't stop rays.
        let is_see_through = |object| {
            let material = self.material(object, images);
            let is_blended = matches!(material.alpha_mode, AlphaMode::Blend | AlphaMode::Premultiplied);
            is_blended || material.specular_transmission > 0.0
        };
        if self.objects.iter().any(is_see_through) {
            return None;
        }
        let mut chosen = |image: &Handle<Image>| random.chance(0.6).then(|| image.clone());
        let decal = ClusteredDecal {
            base_color_texture: chosen(&images.colors),
            normal_map_texture: chosen(&images.normals),
            metallic_roughness_texture: chosen(&images.numbers),
            emissive_texture: chosen(&images.light),
            tag: 0,
        };
        let [x, y, z] = [(); 3].map(|()| random.range(-PI, PI));
        let turned = Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, x, y, z));
        let size = Vec3::from_array([(); 3].map(|()| random.range(0.4, 1.6)));
        Some((decal, turned.with_scale(size)))
    }

    /// Two joints at the place of the object. The upper half follows the second one.
    pub fn add_joints(&self, world: &mut World, parent: Entity, child: Entity, place: Transform) {
        let Some(seed) = self.varies("mesh: skinned") else {
            return;
        };
        let mut random = Random::new(seed);
        let [x, y, z] = [(); 3].map(|()| random.range(-0.6, 0.6));
        let bend = Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, x, y, z));
        let lower = world.spawn((place, ChildOf(parent))).id();
        let upper = world.spawn((bend, ChildOf(lower))).id();
        let inverse_bindposes = world
            .resource_mut::<Assets<SkinnedMeshInverseBindposes>>()
            .add(SkinnedMeshInverseBindposes::from(vec![Mat4::IDENTITY; 2]));
        world.entity_mut(child).insert(SkinnedMesh {
            inverse_bindposes,
            joints: vec![lower, upper],
        });
    }
}

/// Bevy finds the weights of a mesh that comes into sight only if the mesh changes then.
pub fn touch_morphed_meshes(mut meshes: Query<&mut Mesh3d, With<MeshMorphWeights>>) {
    meshes.iter_mut().for_each(|mut mesh| mesh.set_changed());
}

fn positions(mesh: &Mesh) -> Vec<Vec3> {
    let Some(VertexAttributeValues::Float32x3(positions)) = mesh.attribute(Mesh::ATTRIBUTE_POSITION) else {
        unreachable!("all shapes have positions")
    };
    positions.iter().map(|&position| position.into()).collect()
}

/// One target, which stretches the mesh.
fn morphable(mesh: Mesh, seed: u64) -> Mesh {
    let mut random = Random::new(seed + 1);
    let stretch = Vec3::from_array([(); 3].map(|()| random.range(-0.3, 0.4)));
    let by = |position: &Vec3| MorphAttributes::new(*position * stretch, Vec3::ZERO, Vec3::ZERO);
    let targets = positions(&mesh).iter().map(by).collect();
    mesh.with_morph_targets(targets)
}

fn skinnable(mesh: Mesh) -> Mesh {
    let upper = |position: &Vec3| (position.y + 0.5).clamp(0.0, 1.0);
    let weights: Vec<[f32; 4]> = positions(&mesh)
        .iter()
        .map(|position| [1.0 - upper(position), upper(position), 0.0, 0.0])
        .collect();
    let joints = VertexAttributeValues::Uint16x4(vec![[0, 1, 0, 0]; weights.len()]);
    mesh.with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, joints)
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights)
}
