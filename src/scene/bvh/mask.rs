//! What the alpha test needs to know of a triangle, side by side: in the packed mesh, each part has to be looked up by another one.

use super::Item;

/// Alpha of vertices that have none of their own; `alpha.wesl` has the same numbers.
const NO_VERTEX_ALPHA: u32 = u32::MAX;
/// Above the index of the triangle.
const HAS_UVS: u32 = 1 << 30;
const SECOND_UVS: u32 = 1 << 31;

/// What a mesh says about the opacity of its triangles.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaskSource<'a> {
    /// Three per triangle.
    pub indices: &'a [u32],
    /// UV coordinates of the vertices; empty where the mesh has none.
    pub uvs: &'a [[f32; 2]],
    /// They are the second set, which the material's transform leaves as it is.
    pub is_second: bool,
    /// Colours of the vertices, alpha in the upper byte; empty where the mesh has none.
    pub colors: &'a [u32],
}

/// The masks of all triangles, in their order. What is out of range counts as zero, and as opaque.
pub fn masks(source: &MaskSource) -> Vec<Item> {
    let triangles = source.indices.as_chunks::<3>().0;
    (0..)
        .zip(triangles)
        .map(|(primitive, corners)| mask(source, primitive, *corners))
        .collect()
}

fn mask(source: &MaskSource, primitive: u32, corners: [u32; 3]) -> Item {
    let uv = |vertex: u32| {
        source
            .uvs
            .get(vertex as usize)
            .copied()
            .unwrap_or_default()
            .map(f32::to_bits)
    };
    let [a, b, c] = corners.map(uv);
    let alpha = if source.colors.is_empty() {
        NO_VERTEX_ALPHA
    } else {
        let [a, b, c] = corners.map(|vertex| source.colors.get(vertex as usize).map_or(255, |color| color >> 24));
        a | b << 8 | c << 16
    };
    let mut name = primitive;
    if !source.uvs.is_empty() {
        name |= HAS_UVS;
    }
    if source.is_second {
        name |= SECOND_UVS;
    }
    // One load less than with all three rows.
    [[a[0], a[1], b[0], b[1]], [c[0], c[1], name, alpha], [0; 4]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_hold_what_their_vertices_have() {
        let uvs: Vec<[f32; 2]> = (0..4).map(|i| [i as f32, -0.5 * i as f32]).collect();
        let colors = [0x1100_0000, 0x22ff_ffff, 0x3300_0000, 0xff00_0000];
        let source = MaskSource {
            indices: &[0, 1, 2, 2, 1, 9],
            uvs: &uvs,
            is_second: true,
            colors: &colors,
        };
        let made = masks(&source);
        assert_eq!(made.len(), 2);
        let floats = |words: &[u32]| words.iter().map(|word| f32::from_bits(*word)).collect::<Vec<_>>();
        assert_eq!(floats(&made[0][0]), [0.0, 0.0, 1.0, -0.5]);
        assert_eq!(floats(&made[0][1][..2]), [2.0, -1.0]);
        assert_eq!(made[0][1][2..], [HAS_UVS | SECOND_UVS, 0x0033_2211]);
        let last = [0, 0, HAS_UVS | SECOND_UVS | 1, 0x00ff_2233];
        assert_eq!(made[1][1], last, "the last vertex is missing");

        let bare = masks(&MaskSource {
            indices: &[0, 1, 2],
            ..MaskSource::default()
        });
        assert_eq!(bare[0][1][2..], [0, NO_VERTEX_ALPHA]);
    }
}
