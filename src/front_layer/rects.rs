//! Rectangles of a view that objects can cover.

use super::boxes::ObjectBox;
use bevy::{
    math::{Mat4, URect, UVec2, UVec4, Vec2, Vec3A, Vec4, Vec4Swizzles},
    render::render_resource::ShaderType,
};

/// Maximum number of rectangles of a view; `layer.wesl` has the same number. More objects share the rectangle around all of them.
/// More rectangles skip more of the screen, and each adds a test for every pixel in one.
const MOST_RECTS: usize = 16;
/// Maximum number of separate rectangles while objects are added. Each object is compared with all of them.
const MOST_JOINED: usize = 4 * MOST_RECTS;
/// Pixels of a workgroup in each direction. Rectangles begin and end at multiples of it, or at the edge of the view.
const GROUP_SIZE: u32 = 8;
/// Boxes with corners nearer than this in clip space can cover anything. A lower value divides by almost zero; a higher one lets
/// objects close to the camera cover the whole view.
const NEAREST: f32 = 1e-5;

/// Rectangles in the layout of `layer.wesl`, which has the same constants.
#[derive(ShaderType, Clone, Default)]
pub(super) struct GpuRects {
    count: u32,
    /// 1 if some of them contain see-through surfaces that should reflect.
    have_glass: u32,
    /// First pixel, and the one after the last.
    corners: [UVec4; MOST_RECTS],
}

impl GpuRects {
    /// `have_glass` is true if some of them contain see-through surfaces that should reflect.
    pub fn new(rects: &[URect], have_glass: bool) -> Self {
        let mut gpu = Self {
            have_glass: have_glass.into(),
            ..Self::default()
        };
        for (corners, rect) in gpu.corners.iter_mut().zip(rects) {
            *corners = UVec4::new(rect.min.x, rect.min.y, rect.max.x, rect.max.y);
            gpu.count += 1;
        }
        gpu
    }

    /// Number of workgroups for all of their pixels.
    pub fn groups(&self) -> u32 {
        let rects = self.corners.iter().take(self.count as usize);
        rects
            .map(|corners| {
                let groups = (corners.zw() - corners.xy() + (GROUP_SIZE - 1)) / GROUP_SIZE;
                groups.x * groups.y
            })
            .sum()
    }
}

/// Rectangles that don't overlap and contain every pixel of the boxes. `None` among the boxes is one that can be anywhere.
pub(super) fn screen_rects(boxes: &[Option<ObjectBox>], clip_from_world: &Mat4, size: UVec2) -> Vec<URect> {
    let whole = URect::from_corners(UVec2::ZERO, size);
    disjoint(boxes.iter().filter_map(|found| match found {
        Some(found) => box_rect(found, clip_from_world, size),
        None => Some(whole),
    }))
}

/// Rectangles that don't overlap and contain all of the given ones.
pub(super) fn disjoint(parts: impl IntoIterator<Item = URect>) -> Vec<URect> {
    let around_all = |rects: &[URect]| rects.iter().copied().reduce(|a, b| a.union(b));
    let mut rects: Vec<URect> = Vec::new();
    for mut rect in parts.into_iter().filter(|rect| !rect.is_empty()) {
        // A rectangle that grew can overlap others.
        while let Some(index) = rects.iter().position(|other| !other.intersect(rect).is_empty()) {
            rect = rect.union(rects.swap_remove(index));
        }
        rects.push(rect);
        if rects.len() > MOST_JOINED {
            rects = around_all(&rects).into_iter().collect();
        }
    }
    if rects.len() > MOST_RECTS {
        rects = around_all(&rects).into_iter().collect();
    }
    rects
}

/// Pixels that a box can cover; `None` if it is outside the view.
fn box_rect(found: &ObjectBox, clip_from_world: &Mat4, size: UVec2) -> Option<URect> {
    let whole = URect::from_corners(UVec2::ZERO, size);
    let corners: [Vec4; 8] = core::array::from_fn(|index| {
        let sign = |bit: usize| if index & bit == 0 { -1.0 } else { 1.0 };
        let offset = Vec3A::new(sign(1), sign(2), sign(4)) * found.half_extents;
        let world = found.world_from_object.transform_point3a(found.center + offset);
        *clip_from_world * world.extend(1.0)
    });
    if corners.iter().any(|corner| !corner.is_finite()) {
        return Some(whole);
    }
    let is_outside = |beyond: fn(&Vec4) -> bool| corners.iter().all(beyond);
    // The near plane has a depth of 1.
    if is_outside(|c| c.x < -c.w)
        || is_outside(|c| c.x > c.w)
        || is_outside(|c| c.y < -c.w)
        || is_outside(|c| c.y > c.w)
        || is_outside(|c| c.z > c.w)
    {
        return None;
    }
    if corners.iter().any(|corner| corner.w < NEAREST) {
        return Some(whole);
    }
    let places = corners.map(|corner| {
        let ndc = Vec2::new(corner.x, -corner.y) / corner.w;
        (ndc * 0.5 + 0.5) * size.as_vec2()
    });
    let min = places.into_iter().reduce(Vec2::min)? - 1.0;
    let max = places.into_iter().reduce(Vec2::max)? + 1.0;
    let last = size.as_vec2();
    let step = GROUP_SIZE as f32;
    let corner = |place: Vec2| (step * place).clamp(Vec2::ZERO, last).as_uvec2();
    Some(URect::from_corners(
        corner((min / step).floor()),
        corner((max / step).ceil()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::{Affine3A, Vec3, Vec3A};

    const SIZE: UVec2 = UVec2::new(200, 100);

    fn at(x: f32, y: f32, z: f32) -> Option<ObjectBox> {
        Some(ObjectBox {
            world_from_object: Affine3A::from_translation(Vec3::new(x, y, z)),
            center: Vec3A::ZERO,
            half_extents: Vec3A::splat(0.1),
        })
    }

    fn rects(boxes: &[Option<ObjectBox>]) -> Vec<URect> {
        // Infinite and reversed, like Bevy's: 53 degrees high, twice as wide, from 0.1 m on.
        let projection = Mat4::from_cols_array_2d(&[
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 2.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, -1.0],
            [0.0, 0.0, 0.1, 0.0],
        ]);
        screen_rects(boxes, &projection, SIZE)
    }

    #[test]
    fn boxes_out_of_sight_have_none() {
        assert_eq!(rects(&[at(0.0, 0.0, 5.0)]), [], "behind");
        assert_eq!(rects(&[at(30.0, 0.0, -5.0), at(0.0, -30.0, -5.0)]), [], "beside");
    }

    #[test]
    fn a_box_before_the_viewer_has_its_surroundings() {
        let [rect] = rects(&[at(0.0, 0.0, -5.0)])[..] else {
            panic!("one rectangle")
        };
        assert!(rect.contains(SIZE / 2), "{rect:?}");
        assert!(rect.width() < 33 && rect.height() < 33, "{rect:?}");
        assert_eq!(
            (rect.min % GROUP_SIZE, rect.max % GROUP_SIZE),
            (UVec2::ZERO, UVec2::ZERO)
        );
    }

    #[test]
    fn rectangles_do_not_overlap() {
        let apart = rects(&[at(-2.0, 0.0, -5.0), at(2.0, 0.0, -5.0)]);
        assert_eq!(apart.len(), 2);
        let near = rects(&[at(-2.0, 0.0, -5.0), at(-1.9, 0.1, -5.0), at(2.0, 0.0, -5.0)]);
        assert_eq!(near.len(), 2);
        let overlap = |rects: &[URect]| {
            let pairs = rects
                .iter()
                .enumerate()
                .flat_map(|(i, a)| rects[..i].iter().map(move |b| a.intersect(*b)));
            pairs.filter(|common| !common.is_empty()).count()
        };
        assert_eq!((overlap(&apart), overlap(&near)), (0, 0));
        // Small and far apart: more than the maximum, and more than are stored while they are joined.
        for (columns, rows) in [(8, 4), (11, 9)] {
            let cells = (0..columns * rows).map(|i| {
                URect::from_center_size(
                    UVec2::new(8 + 16 * (i % columns), 4 + 10 * (i / columns)),
                    UVec2::splat(4),
                )
            });
            let around = URect::new(6, 2, 10 + 16 * (columns - 1), 6 + 10 * (rows - 1));
            assert_eq!(disjoint(cells), [around]);
        }
    }

    #[test]
    fn workgroups_hold_all_pixels() {
        let rects = [
            URect::new(0, 0, 8, 16),
            URect::new(16, 0, 24, 8),
            URect::new(192, 96, 200, 100),
        ];
        assert_eq!(GpuRects::new(&rects, false).groups(), 4);
    }

    #[test]
    fn constants_are_those_of_the_shader() {
        let shader = include_str!("layer.wesl");
        for (name, value) in [("MOST_RECTS", MOST_RECTS as u32), ("GROUP_SIZE", GROUP_SIZE)] {
            let line = format!("const {name}: u32 = {value}u;");
            assert!(shader.contains(&line), "{line}");
        }
    }

    #[test]
    fn boxes_around_the_viewer_and_unknown_ones_cover_all() {
        let whole = URect::from_corners(UVec2::ZERO, SIZE);
        assert_eq!(rects(&[at(0.0, 0.0, -0.05)]), [whole]);
        assert_eq!(rects(&[None, at(0.0, 0.0, -5.0)]), [whole]);
    }
}
