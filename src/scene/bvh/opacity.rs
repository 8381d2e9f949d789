//! Opacity micromaps: precomputed results of the alpha test for parts of a triangle, so that most candidates of a traversal cost one word
//! instead of a material and a texture.
//!
//! After Gruen, Benthin and Woop, "Sub-triangle opacity masks for faster ray tracing of transparent objects" (2020). A triangle has 64
//! micro-triangles with one of three states each. Uncertain parts are [`UNKNOWN`] and get the full alpha test, so images don't change.

#[cfg(test)]
mod tests;

use super::format::Bounds;
use bevy::math::{DVec2, Vec2, Vec3A};
use core::cell::Cell;
use std::sync::Arc;

/// Needs the alpha test.
pub const UNKNOWN: u32 = 0;
/// Rays pass.
pub const TRANSPARENT: u32 = 1;
/// Rays hit.
pub const OPAQUE: u32 = 2;

/// Two bits for each of 64 micro-triangles, indexed by [`micro_triangle`].
pub type Micromap = [u32; 4];

/// Micro-triangles along each edge; `opacity.wesl` has the same number.
const ROWS: u32 = 8;
/// Error bound of a sample's alpha: texture filters have 8-bit weights.
const ALPHA_ROOM: f32 = 0.003;
/// Error bound of a sample's position in texels, besides the rounding of its coordinates: samplers round coordinates to 1/256 texel.
const TEXEL_ROOM: f64 = 0.02;
/// Rounding of coordinates on their way to the sampler, relative to the largest one.
const ROUNDING: f64 = 2e-6;
/// Maximum number of texel rows read for the triangles of a mesh: a fraction of a second on a slow machine. The remaining triangles stay
/// unknown.
const ROW_BUDGET: u64 = 1 << 25;

/// Address mode for coordinates outside of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// The texture repeats.
    Repeat,
    /// The texture repeats, and every other copy is mirrored.
    Mirror,
    /// The texels at the edge repeat.
    Clamp,
}

/// The alpha channel of a texture's finest level.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AlphaTexels {
    /// Texels.
    pub width: u32,
    /// Texels.
    pub height: u32,
    /// Texels in rows, from the top.
    pub texels: Vec<u8>,
}

/// Parameters of the alpha test of a material.
#[derive(Clone, Debug)]
pub struct AlphaTest {
    /// Alpha of the base colour.
    pub alpha: f32,
    /// Alpha below which surfaces are cut out.
    pub cutoff: f32,
    /// The texture and its address modes in u and v; `None` for a material without one.
    pub texture: Option<(Arc<AlphaTexels>, [Wrap; 2])>,
}

/// The micro-triangle at the weights of a triangle's second and third vertex.
#[cfg(any(test, feature = "internals"))]
pub fn micro_triangle(second: f32, third: f32) -> u32 {
    let (x, y) = (second * ROWS as f32, third * ROWS as f32);
    let row = (y as u32).min(ROWS - 1);
    let column = (x as u32).min(ROWS - 1 - row);
    let is_upper = column + row < ROWS - 1 && (x - column as f32) + (y - row as f32) > 1.0;
    row * (2 * ROWS - row) + 2 * column + u32::from(is_upper)
}

/// The state of a micro-triangle.
pub fn state_of(map: &Micromap, micro: u32) -> u32 {
    (map[(micro >> 4) as usize] >> (2 * (micro & 15))) & 3
}

/// Returns the state that all micro-triangles share, if they do.
pub fn common_state(map: &Micromap) -> Option<u32> {
    let state = map[0] & 3;
    (*map == uniform(state)).then_some(state)
}

/// Returns the box around the parts of a triangle that rays can hit; `None` if they pass through all of it.
pub fn solid_bounds(map: &Micromap, corners: &[[f32; 3]; 3]) -> Option<Bounds> {
    let [a, b, c] = corners.map(Vec3A::from);
    let mut bounds: Option<(Vec3A, Vec3A)> = None;
    for (micro, points) in micro_triangles().enumerate() {
        if state_of(map, micro as u32) == TRANSPARENT {
            continue;
        }
        for (column, row) in points {
            let point = a + (b - a) * (column as f32 / ROWS as f32) + (c - a) * (row as f32 / ROWS as f32);
            let (min, max) = bounds.unwrap_or((point, point));
            bounds = Some((min.min(point), max.max(point)));
        }
    }
    // Margin for rounding in the weights of a hit and in the computations above.
    let room = ((b - a).abs() + (c - a).abs() + a.abs() * 1e-3) * 1e-3;
    bounds.map(|(min, max)| Bounds {
        min: (min - room).to_array(),
        max: (max + room).to_array(),
    })
}

/// Columns and rows of the corners of all micro-triangles, in index order.
fn micro_triangles() -> impl Iterator<Item = [(u32, u32); 3]> {
    (0..ROWS).flat_map(|row| {
        (0..ROWS - row).flat_map(move |column| {
            let (right, above) = ((column + 1, row), (column, row + 1));
            let upper = (column + row < ROWS - 1).then_some([(column + 1, row + 1), right, above]);
            core::iter::once([(column, row), right, above]).chain(upper)
        })
    })
}

const fn uniform(state: u32) -> Micromap {
    [state * 0x5555_5555; 4]
}

/// Makes the micromaps of a mesh for one material.
pub struct OpacityBaker<'a> {
    test: &'a AlphaTest,
    /// State for each alpha value of a texel.
    states: [u32; 256],
    /// For each texel, the column of the next texel in its row with another state, or the width.
    run_ends: Vec<u16>,
    /// The state of all texels, if it is the same.
    all: Option<u32>,
    rows_left: Cell<u64>,
}

impl<'a> OpacityBaker<'a> {
    /// Scans the texture once.
    pub fn new(test: &'a AlphaTest) -> Self {
        let states = core::array::from_fn(|alpha| decide(test.alpha * (alpha as f32 / 255.0), test.cutoff));
        let mut baker = Self {
            test,
            states,
            run_ends: Vec::new(),
            all: None,
            rows_left: Cell::new(ROW_BUDGET),
        };
        if let Some((image, _)) = &test.texture
            && test.cutoff > 0.0
            && is_sound(image)
        {
            baker.run_ends = run_ends(image, &states);
            let first = states[usize::from(image.texels[0])];
            let same = |texel: &u8| states[usize::from(*texel)] == first;
            baker.all = image.texels.iter().all(same).then_some(first);
        }
        baker
    }

    /// Returns the micromap of a triangle. `uvs` are its UV coordinates, if it has any, as the sampler gets them; `vertex_alpha` is
    /// packed as in masks.
    pub fn micromap(&self, uvs: Option<[[f32; 2]; 3]>, vertex_alpha: u32) -> Micromap {
        let test = self.test;
        if !(test.alpha.is_finite() && test.cutoff.is_finite()) {
            return uniform(UNKNOWN);
        }
        let (low, high) = alpha_range(vertex_alpha);
        if test.cutoff <= 0.0 {
            return uniform(OPAQUE);
        }
        if decide(test.alpha * high, test.cutoff) == TRANSPARENT {
            return uniform(TRANSPARENT);
        }
        let (Some((image, wrap)), Some(uvs)) = (&test.texture, uvs) else {
            let is_opaque = decide(test.alpha * low, test.cutoff) == OPAQUE;
            return uniform(if is_opaque { OPAQUE } else { UNKNOWN });
        };
        if low < 1.0 || self.run_ends.is_empty() {
            return uniform(UNKNOWN);
        }
        if let Some(state) = self.all {
            return uniform(state);
        }
        let view = TextureView {
            baker: self,
            image,
            wrap: *wrap,
        };
        view.micromap(uvs)
    }
}

/// Returns the state for an alpha, with the tolerance [`ALPHA_ROOM`].
fn decide(alpha: f32, cutoff: f32) -> u32 {
    if alpha >= cutoff + ALPHA_ROOM {
        OPAQUE
    } else if alpha < cutoff - ALPHA_ROOM {
        TRANSPARENT
    } else {
        UNKNOWN
    }
}

fn alpha_range(vertex_alpha: u32) -> (f32, f32) {
    let [a, b, c, _] = vertex_alpha.to_le_bytes();
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (f32::from(low) / 255.0, f32::from(high) / 255.0)
}

fn is_sound(image: &AlphaTexels) -> bool {
    let (width, height) = (image.width as usize, image.height as usize);
    (1..=usize::from(u16::MAX)).contains(&width) && height > 0 && image.texels.len() == width * height
}

fn run_ends(image: &AlphaTexels, states: &[u32; 256]) -> Vec<u16> {
    let mut ends = vec![0u16; image.texels.len()];
    let width = image.width as usize;
    for (row, ends) in image.texels.chunks_exact(width).zip(ends.chunks_exact_mut(width)) {
        let mut end = width as u16;
        let mut last = states[usize::from(row[width - 1])];
        for (x, (texel, place)) in row.iter().zip(ends).enumerate().rev() {
            let state = states[usize::from(*texel)];
            if state != last {
                end = x as u16 + 1;
                last = state;
            }
            *place = end;
        }
    }
    ends
}

struct TextureView<'a> {
    baker: &'a OpacityBaker<'a>,
    image: &'a AlphaTexels,
    wrap: [Wrap; 2],
}

impl TextureView<'_> {
    fn micromap(&self, uvs: [[f32; 2]; 3]) -> Micromap {
        let size = DVec2::new(self.image.width.into(), self.image.height.into());
        let corners = uvs.map(|uv| Vec2::from(uv).as_dvec2() * size);
        let magnitude = corners.iter().fold(size, |most, corner| most.max(corner.abs()));
        let room = TEXEL_ROOM + ROUNDING * magnitude.max_element();
        // Coordinates can't resolve texels any more with a larger tolerance.
        if !(room < 1e3 && corners.iter().all(|corner| corner.is_finite())) {
            return uniform(UNKNOWN);
        }
        let whole = self.state(corners, room);
        if whole != UNKNOWN {
            return uniform(whole);
        }
        let point = |(column, row): (u32, u32)| {
            let (second, third) = (f64::from(column) / f64::from(ROWS), f64::from(row) / f64::from(ROWS));
            corners[0] + (corners[1] - corners[0]) * second + (corners[2] - corners[0]) * third
        };
        let mut map = uniform(UNKNOWN);
        for (micro, points) in micro_triangles().enumerate() {
            map[micro / 16] |= self.state(points.map(point), room) << (2 * (micro % 16));
        }
        map
    }

    /// Common state of all texels that samples within a triangle can read. The corners are in texels, with a tolerance of `room`.
    fn state(&self, corners: [DVec2; 3], room: f64) -> u32 {
        let low = corners[0].y.min(corners[1].y).min(corners[2].y);
        let high = corners[0].y.max(corners[1].y).max(corners[2].y);
        let (first, last) = touched(low, high, room);
        // The triangle covers all rows, and their states differ.
        let height = i64::from(self.image.height);
        if last - first > height + 1 {
            return UNKNOWN;
        }
        let Some(left) = self.baker.rows_left.get().checked_sub((last - first) as u64 + 1) else {
            return UNKNOWN;
        };
        self.baker.rows_left.set(left);
        let mut common = None;
        for row in first..=last {
            // Samples in this band touch the row.
            let band = (row as f64 - 0.5 - room, row as f64 + 1.5 + room);
            let Some((low, high)) = extent_within(corners, band) else {
                continue;
            };
            let row = wrapped(row, height, self.wrap[1]);
            let state = self.span(row, touched(low, high, room));
            if state == UNKNOWN || *common.get_or_insert(state) != state {
                return UNKNOWN;
            }
        }
        common.unwrap_or(UNKNOWN)
    }

    /// State of the texels of a row from `first` to `last`, inclusive.
    fn span(&self, row: usize, (first, last): (i64, i64)) -> u32 {
        let width = i64::from(self.image.width);
        let (period, last_period) = (first.div_euclid(width), last.div_euclid(width));
        let (from, to) = (first.rem_euclid(width), last.rem_euclid(width));
        let turned = |(from, to): (i64, i64), period: i64| match self.wrap[0] {
            Wrap::Mirror if period.rem_euclid(2) == 1 => (width - 1 - to, width - 1 - from),
            _ => (from, to),
        };
        let parts = match self.wrap[0] {
            Wrap::Clamp => [Some((first.clamp(0, width - 1), last.clamp(0, width - 1))), None],
            _ if period == last_period => [Some(turned((from, to), period)), None],
            _ if period + 1 == last_period => [
                Some(turned((from, width - 1), period)),
                Some(turned((0, to), last_period)),
            ],
            _ => [Some((0, width - 1)), None],
        };
        let mut common = None;
        for (from, to) in parts.into_iter().flatten() {
            let at = row * self.image.width as usize + from as usize;
            let state = self.baker.states[usize::from(self.image.texels[at])];
            let is_one_run = i64::from(self.baker.run_ends[at]) > to;
            if !is_one_run || *common.get_or_insert(state) != state {
                return UNKNOWN;
            }
        }
        common.unwrap_or(UNKNOWN)
    }
}

/// The first and last texel that a linear filter reads for samples from `low` to `high`.
fn touched(low: f64, high: f64, room: f64) -> (i64, i64) {
    (
        (low - 0.5 - room).floor() as i64,
        (high - 0.5 + room).floor() as i64 + 1,
    )
}

fn wrapped(index: i64, count: i64, wrap: Wrap) -> usize {
    let inside = match wrap {
        Wrap::Clamp => index.clamp(0, count - 1),
        Wrap::Mirror if index.div_euclid(count).rem_euclid(2) == 1 => count - 1 - index.rem_euclid(count),
        Wrap::Repeat | Wrap::Mirror => index.rem_euclid(count),
    };
    inside as usize
}

/// Range of a triangle in x between two values of y.
fn extent_within(corners: [DVec2; 3], (low, high): (f64, f64)) -> Option<(f64, f64)> {
    let mut extent: Option<(f64, f64)> = None;
    let mut add = |x: f64| {
        extent = Some(extent.map_or((x, x), |(least, most)| (least.min(x), most.max(x))));
    };
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        if (low..=high).contains(&a.y) {
            add(a.x);
        }
        for border in [low, high] {
            if (a.y < border) != (b.y < border) {
                add(a.x + (b.x - a.x) * ((border - a.y) / (b.y - a.y)));
            }
        }
    }
    extent
}
