//! Packs data for posing: joints of vertices, and morph targets.

use super::{
    decode,
    packed::{Bounds, Deformation, GeometryError, MAX_COORDINATE, PackedMesh},
};
use bevy::{
    math::Vec3,
    mesh::{
        Mesh, VertexAttributeValues,
        morph::{MAX_MORPH_WEIGHTS, MorphAttributes},
    },
};

/// Words of a vertex's joints: four indices of 16 bits, and four weights.
const JOINT_WORDS: u32 = 6;
/// Larger weights count as not finite.
const MAX_WEIGHT: f32 = 1e6;

/// The skin and the morph targets of a mesh.
pub(super) struct Pose<'a> {
    joints: Option<(&'a VertexAttributeValues, &'a VertexAttributeValues)>,
    morphs: &'a [MorphAttributes],
    /// Number of vertices of a target.
    stride: usize,
    target_count: usize,
}

impl<'a> Pose<'a> {
    /// Fails if the mesh's data is in the render world. `stride` is the number of positions.
    pub fn new(mesh: &'a Mesh, stride: usize) -> Result<Self, GeometryError> {
        let indices = mesh.try_attribute_option(Mesh::ATTRIBUTE_JOINT_INDEX)?;
        let joints = indices.zip(mesh.try_attribute_option(Mesh::ATTRIBUTE_JOINT_WEIGHT)?);
        let morphs = mesh.try_morph_targets().map_or(&[][..], Vec::as_slice);
        let target_count = morphs.len().checked_div(stride).unwrap_or(0).min(MAX_MORPH_WEIGHTS);
        Ok(Self {
            joints,
            morphs,
            stride,
            target_count,
        })
    }

    /// Maximum number of words that [`Self::pack`] adds for each vertex.
    pub fn words_per_vertex(&self) -> u64 {
        let joints = if self.joints.is_some() {
            u64::from(JOINT_WORDS)
        } else {
            0
        };
        joints + 9 * self.target_count as u64
    }

    /// Appends joints and morph targets to a mesh after its other attributes.
    pub fn pack(&self, packed: &mut PackedMesh) {
        let mut deformation = Deformation::default();
        if let Some((indices, weights)) = self.joints {
            deformation.joints = pack_joints(packed, indices, weights);
        }
        if self.target_count > 0 {
            deformation.targets = self.pack_morphs(packed);
        }
        if self.joints.is_some() || self.target_count > 0 {
            deformation.bounds = packed.bounds;
            packed.deformation = Some(deformation);
        }
    }

    fn pack_morphs(&self, packed: &mut PackedMesh) -> Vec<Bounds> {
        packed.offsets.morphs = packed.words.len() as u32;
        let (normals, tangents) = (packed.offsets.normals != 0, packed.offsets.tangents != 0);
        let mut replaced = 0;
        let mut sound = |difference: Vec3| {
            let is_sound = difference.is_finite() && difference.abs().max_element() <= MAX_COORDINATE;
            replaced += u32::from(!is_sound);
            if is_sound { difference } else { Vec3::ZERO }
        };
        let targets = self.morphs.chunks_exact(self.stride).take(self.target_count);
        let bounds = targets
            .map(|target| {
                let mut bounds: Option<Bounds> = None;
                for vertex in &target[..packed.vertex_count as usize] {
                    let position = sound(vertex.position);
                    add(&mut bounds, position);
                    packed.words.extend(position.to_array().map(f32::to_bits));
                    if normals {
                        packed.words.extend(sound(vertex.normal).to_array().map(f32::to_bits));
                    }
                    if tangents {
                        packed.words.extend(sound(vertex.tangent).to_array().map(f32::to_bits));
                    }
                }
                bounds.unwrap_or_default()
            })
            .collect();
        packed.defects.replaced_values += replaced;
        bounds
    }
}

fn pack_joints(
    packed: &mut PackedMesh,
    indices: &VertexAttributeValues,
    weights: &VertexAttributeValues,
) -> Vec<(u32, Bounds)> {
    let count = packed.vertex_count as usize;
    let mut joints = Vec::with_capacity(count);
    decode::for_each_value(indices, count, |joint| joints.push(joint.map(|index| index as u16)));
    let mut bounds: Vec<Option<Bounds>> = Vec::new();
    let mut words = Vec::with_capacity(count * JOINT_WORDS as usize);
    let mut vertex = 0;
    decode::for_each_value(weights, count, |weights| {
        let is_sound = weights.iter().all(|weight| weight.abs() <= MAX_WEIGHT);
        packed.defects.replaced_values += u32::from(!is_sound);
        // A vertex without valid joints follows the first joint.
        let (joint, weights) = if is_sound && weights != [0.0; 4] {
            (joints.get(vertex).copied().unwrap_or_default(), weights)
        } else {
            ([0; 4], [1.0, 0.0, 0.0, 0.0])
        };
        let [a, b, c, d] = joint.map(u32::from);
        words.extend([a | b << 16, c | d << 16]);
        words.extend(weights.map(f32::to_bits));
        let position = packed.positions().get(vertex).copied().unwrap_or_default();
        for (joint, _) in joint.into_iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
            let joint = usize::from(joint);
            if joint >= bounds.len() {
                bounds.resize(joint + 1, None);
            }
            add(&mut bounds[joint], position.into());
        }
        vertex += 1;
    });
    packed.offsets.joints = packed.words.len() as u32;
    packed.words.append(&mut words);
    let moving = (0..).zip(bounds);
    moving.filter_map(|(joint, bounds)| Some((joint, bounds?))).collect()
}

fn add(bounds: &mut Option<Bounds>, point: Vec3) {
    let all = bounds.get_or_insert(Bounds { min: point, max: point });
    *all = Bounds {
        min: all.min.min(point),
        max: all.max.max(point),
    };
}
