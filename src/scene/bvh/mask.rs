//! What the alpha test of a merged triangle needs, side by side: in the packed mesh, each part has to be looked up by another one.

use super::Item;

/// Flags above the index of the material; `alpha.wesl` has the same numbers.
const HAS_UVS: u32 = 0x8000_0000;
const SECOND_UVS: u32 = 0x4000_0000;
const VERTEX_ALPHA: u32 = 0x2000_0000;
const MATERIAL: u32 = 0x0fff_ffff;

/// The material of an alpha-masked object, and how it wants its base colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskMaterial {
    /// Index in the material buffer.
    pub material: u32,
    /// Its base colour has the second set of UV coordinates, where the mesh has one.
    pub wants_second_uvs: bool,
}

/// What a mesh says about the opacity of its surface, by vertices.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaskAttributes<'a> {
    /// Both sets of UV coordinates; empty where the mesh has none.
    pub uvs: [&'a [[f32; 2]]; 2],
    /// Packed colours, alpha in the upper byte; empty where the mesh has none.
    pub colors: &'a [u32],
}

/// The mask of a triangle: UV coordinates of the three vertices, the triangle's index in the mesh, material and flags, then the
/// vertices' alpha.
pub(super) fn mask(primitive: u32, corners: [u32; 3], attributes: &MaskAttributes, material: MaskMaterial) -> Item {
    let is_second = material.wants_second_uvs && !attributes.uvs[1].is_empty();
    let set = attributes.uvs[usize::from(is_second)];
    let [a, b, c] = corners.map(|vertex| set.get(vertex as usize).copied().unwrap_or_default().map(f32::to_bits));
    let mut word = material.material & MATERIAL;
    if !set.is_empty() {
        word |= HAS_UVS;
    }
    if is_second {
        word |= SECOND_UVS;
    }
    let mut alpha = 0;
    if !attributes.colors.is_empty() {
        word |= VERTEX_ALPHA;
        let bytes = corners.map(|vertex| attributes.colors.get(vertex as usize).map_or(255, |color| color >> 24));
        alpha = bytes[0] | bytes[1] << 8 | bytes[2] << 16;
    }
    [
        [a[0], a[1], b[0], b[1]],
        [c[0], c[1], primitive, word],
        [alpha, 0, 0, 0],
    ]
}
