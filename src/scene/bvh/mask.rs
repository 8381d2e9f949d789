//! Stores the data for a triangle's alpha test side by side. In the packed mesh, it would take a chain of dependent loads.

use super::{
    format::Item,
    opacity::{Micromap, OpacityBaker, UNKNOWN},
};
use bevy::math::{Affine2, Vec2};

/// Alpha of vertices without colours: opaque.
pub(super) const FULL_VERTEX_ALPHA: u32 = 0x00ff_ffff;

/// Mesh data that determines the opacity of its triangles.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaskSource<'a> {
    /// Three per triangle.
    pub indices: &'a [u32],
    /// UV coordinates of the vertices; empty if the mesh has none.
    pub uvs: &'a [[f32; 2]],
    /// The material's transform of the UV coordinates.
    pub uv_transform: Affine2,
    /// Colours of the vertices, alpha in the highest byte; empty if the mesh has none.
    pub colors: &'a [[u32; 2]],
}

/// Returns the header in front of masks, with the alpha parameters of their material: see
/// [`crate::scene::gpu_types::GpuMaterial`]. The texture is a word of [`crate::scene::gpu_types::GpuMaterial::textures`],
/// or `NO_TEXTURE` if the mesh has no UV coordinates.
pub fn mask_header(texture: u32, alpha: f32, cutoff: f32, stop_probability: f32) -> Item {
    let numbers = [alpha, cutoff, stop_probability].map(f32::to_bits);
    [[texture, numbers[0], numbers[1], numbers[2]], [0; 4], [0; 4]]
}

/// Returns the masks of all triangles, in order, with opacity micromaps if there is a baker. Vertices out of range are
/// opaque, with UV coordinates of zero.
pub fn masks(source: &MaskSource, baker: Option<&OpacityBaker>) -> Vec<Item> {
    let triangles = source.indices.as_chunks::<3>().0;
    (0..)
        .zip(triangles)
        .map(|(primitive, corners)| mask(source, primitive, *corners, baker))
        .collect()
}

/// The micromap of a mask.
pub fn micromap_of(mask: &Item) -> Micromap {
    mask[2]
}

fn mask(source: &MaskSource, primitive: u32, corners: [u32; 3], baker: Option<&OpacityBaker>) -> Item {
    let uvs = corners.map(|vertex| {
        let uv = source.uvs.get(vertex as usize).copied().unwrap_or_default();
        source.uv_transform.transform_point2(Vec2::from(uv)).to_array()
    });
    let alpha = if source.colors.is_empty() {
        FULL_VERTEX_ALPHA
    } else {
        let [a, b, c] = corners.map(|vertex| source.colors.get(vertex as usize).map_or(255, |color| color[1] >> 24));
        a | b << 8 | c << 16
    };
    let has_uvs = !source.uvs.is_empty();
    let micromap = baker.map_or([UNKNOWN; 4], |baker| baker.micromap(has_uvs.then_some(uvs), alpha));
    let [a, b, c] = uvs.map(|uv| uv.map(f32::to_bits));
    [[a[0], a[1], b[0], b[1]], [c[0], c[1], primitive, alpha], micromap]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_hold_what_their_vertices_have() {
        let uvs: Vec<[f32; 2]> = (0..4).map(|i| [i as f32, -0.5 * i as f32]).collect();
        let colors = [0x1100_0000, 0x22ff_ffff, 0x3300_0000, 0xff00_0000].map(|word| [7, word]);
        let source = MaskSource {
            indices: &[0, 1, 2, 2, 1, 9],
            uvs: &uvs,
            uv_transform: Affine2::from_translation(Vec2::new(0.0, 1.0)),
            colors: &colors,
        };
        let made = masks(&source, None);
        assert_eq!(made.len(), 2);
        let floats = |words: &[u32]| words.iter().map(|word| f32::from_bits(*word)).collect::<Vec<_>>();
        assert_eq!(floats(&made[0][0]), [0.0, 1.0, 1.0, 0.5]);
        assert_eq!(floats(&made[0][1][..2]), [2.0, 0.0]);
        assert_eq!(made[0][1][2..], [0, 0x0033_2211]);
        let last = [0, 1.0f32.to_bits(), 1, 0x00ff_2233];
        assert_eq!(made[1][1], last, "the last vertex is missing");

        let bare = MaskSource {
            indices: &[0, 1, 2],
            ..MaskSource::default()
        };
        let bare = masks(&bare, None);
        assert_eq!(bare[0][1][2..], [0, FULL_VERTEX_ALPHA]);
    }
}
