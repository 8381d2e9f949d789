//! Lights for hits: all visible lights of the scene. Bevy's own list omits lights outside the camera's view. `lights/extract.rs` tracks
//! their changes.

pub(super) mod extract;

use bevy::{
    ecs::prelude::*,
    math::Vec3,
    pbr::AreaLightLuts,
    render::{render_asset::RenderAssets, texture::GpuImage},
};

use super::{
    change::{Change, RESTLESS_FRAMES},
    gpu_types::*,
    light_textures::LightTexture,
    origin::is_step,
};

/// Maximum number of lights that hits evaluate one by one. If there are more, they evaluate only the directional ones, up to the same
/// number, and sample the others. `shading.wesl` has the same number.
pub const MAX_LIGHTS: usize = 256;

/// Lights that changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Touched {
    /// Any light might have changed, or the number of lights.
    All,
    /// Only these lights. There can be duplicates.
    Lights(Vec<u32>),
}

impl Default for Touched {
    fn default() -> Self {
        Self::Lights(Vec::new())
    }
}

impl Touched {
    /// Returns whether no light changed.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    fn add(&mut self, light: u32) {
        if let Self::Lights(lights) = self {
            lights.push(light);
        }
    }
}

/// A light that moved, and didn't change otherwise.
struct MovedLight {
    /// Its index.
    place: u32,
    /// Its position and the frames for which it stayed marked, before it moved.
    position: Vec3,
    restless: u32,
    /// The kind of change, unless the whole world moved.
    change: Change,
}

/// The lights of the scene in the render world.
#[derive(Resource, Default)]
pub struct ExtractedLights {
    /// Directional lights first, then points, spots and rectangles.
    lights: Vec<GpuLight>,
    /// Textures of lights, each with the index of its light.
    textures: Vec<(u32, LightTexture)>,
    /// Lights that differ from the last frame, even if only in marks, and the kind of change.
    touched: Touched,
    change: Change,
    /// By light, the frames for which it stays marked.
    restless: Vec<u32>,
    /// Lights with a mark.
    marked: Vec<u32>,
    /// Number of lights that give no light at the moment, but keep their places.
    dark: usize,
    /// Lights that only moved in this frame.
    moved: Vec<MovedLight>,
    /// Bevy's shaders support rectangle lights, which depends on Bevy's cargo feature `area_light_luts`.
    rects_shine: bool,
}

impl ExtractedLights {
    /// The lights: directional ones first.
    pub fn lights(&self) -> &[GpuLight] {
        &self.lights
    }

    /// Returns whether there are rectangular lights, which come last.
    pub(super) fn has_rects(&self) -> bool {
        self.lights.last().is_some_and(|light| light.kind == LIGHT_RECT)
    }

    /// Textures of lights, each with the index of its light.
    pub(super) fn textures(&self) -> &[(u32, LightTexture)] {
        &self.textures
    }

    /// Lights that changed since the last call, and the kind of change. Lights that moved with the whole world by `shift` are uploaded, but
    /// count as unchanged.
    pub(super) fn take_changes(&mut self, shift: Vec3) -> (Touched, Change) {
        let mut unmarked = false;
        for light in self.moved.drain(..) {
            let now = &mut self.lights[light.place as usize];
            if shift == Vec3::ZERO || !is_step(light.position, now.position.into(), shift) {
                self.change = self.change.max(light.change);
                continue;
            }
            self.restless[light.place as usize] = light.restless;
            if light.restless == 0 {
                now.flags &= !LIGHT_RESTLESS;
                unmarked = true;
            }
        }
        if unmarked {
            let lights = &self.lights;
            self.marked
                .retain(|place| lights[*place as usize].flags & LIGHT_RESTLESS != 0);
        }
        (core::mem::take(&mut self.touched), core::mem::take(&mut self.change))
    }

    /// Returns whether a directional light is among the changed ones.
    pub(super) fn touches_sun(&self, touched: &Touched) -> bool {
        let is_sun = |light: &GpuLight| light.kind == LIGHT_DIRECTIONAL;
        match touched {
            Touched::All => self.lights.iter().any(is_sun),
            Touched::Lights(places) => places.iter().any(|&place| is_sun(&self.lights[place as usize])),
        }
    }

    /// Replaces all lights, and marks the ones that changed since the last frame if any of them can have marks or had them recently.
    fn replace(&mut self, lights: Vec<GpuLight>) {
        let previous = core::mem::replace(&mut self.lights, lights);
        if self.lights.len() == previous.len() {
            for (place, previous) in previous.iter().enumerate() {
                let light = core::mem::replace(&mut self.lights[place], *previous);
                self.set(place as u32, light);
            }
            self.mark();
        } else {
            self.touched = Touched::All;
            self.change = Change::Unmarked;
            self.dark = 0;
            self.marked.clear();
            self.moved.clear();
            self.restless.clear();
            self.restless.resize(self.lights.len(), 0);
        }
    }

    /// A light as it is while it gives no light: lamps that flicker keep their places, since a new list concerns all views.
    fn darkened(&self, place: u32) -> GpuLight {
        let light = self.lights[place as usize];
        GpuLight {
            color: [0.0; 3],
            // No shadow rays for nothing.
            flags: light.flags & !(LIGHT_RESTLESS | LIGHT_CASTS_SHADOW | LIGHT_VOLUMETRIC),
            ..light
        }
    }

    /// Returns whether so many lights are dark that a list without them is worth its cost.
    fn has_many_dark(&self) -> bool {
        self.dark > 16 + self.lights.len() / 4
    }

    /// Replaces one light. Call before [`Self::mark`].
    fn set(&mut self, place: u32, light: GpuLight) {
        let known = &mut self.lights[place as usize];
        let previous = GpuLight {
            flags: known.flags & !LIGHT_RESTLESS,
            ..*known
        };
        if light == previous {
            return;
        }
        self.dark = self.dark + usize::from(is_dark(&light)) - usize::from(is_dark(&previous));
        let flags = if is_dark(&light) || is_dark(&previous) {
            light.flags
        } else {
            previous.flags
        };
        let in_its_color = GpuLight {
            color: light.color,
            flags,
            ..previous
        };
        let restless = &mut self.restless[place as usize];
        // Hits at a light's old place can't detect that it begins to move.
        let is_marked = *restless > 0 || light == in_its_color;
        let change = if is_marked { Change::Marked } else { Change::Unmarked };
        let in_its_place = GpuLight {
            position: light.position,
            ..previous
        };
        if light == in_its_place {
            self.moved.push(MovedLight {
                place,
                position: previous.position.into(),
                restless: *restless,
                change,
            });
        } else {
            self.change = self.change.max(change);
        }
        let mark = known.flags & LIGHT_RESTLESS;
        if mark == 0 {
            self.marked.push(place);
        }
        *restless = RESTLESS_FRAMES;
        *known = GpuLight {
            flags: light.flags | mark,
            ..light
        };
        self.touched.add(place);
    }

    /// Marks exactly the lights that have changed lately; call once per frame.
    fn mark(&mut self) {
        let Self {
            lights,
            touched,
            restless,
            marked,
            ..
        } = self;
        marked.retain(|&place| {
            let (flags, restless) = (&mut lights[place as usize].flags, &mut restless[place as usize]);
            let before = *flags;
            let is_restless = *restless > 0;
            if is_restless {
                *restless -= 1;
                *flags |= LIGHT_RESTLESS;
            } else {
                *flags &= !LIGHT_RESTLESS;
            }
            if *flags != before {
                touched.add(place);
            }
            is_restless
        });
    }

    fn clear(&mut self) {
        *self = Self {
            rects_shine: self.rects_shine,
            ..Self::default()
        };
    }

    /// Detects whether Bevy was built with the tables for rectangular lights. Such lights appear in the next frame.
    pub(super) fn detect_rects(&mut self, luts: Option<&AreaLightLuts>, images: &RenderAssets<GpuImage>) {
        // Without the feature there is a placeholder of one texel.
        let image = luts.and_then(|luts| images.get(&luts.image));
        self.rects_shine = image.is_some_and(|image| image.texture_descriptor.size.width > 1);
    }
}

/// Keeps the strongest lights, in order, so that an added or removed light replaces at most one other.
fn keep_strongest(lights: &mut Vec<GpuLight>) {
    let mut order: Vec<usize> = (0..lights.len()).collect();
    // Ties are broken by the index, since the sort is stable.
    order.sort_by(|a, b| strength(&lights[*b]).total_cmp(&strength(&lights[*a])));
    order.truncate(MAX_LIGHTS);
    order.sort_unstable();
    *lights = order.into_iter().map(|index| lights[index]).collect();
}

/// Returns whether a light gives no light.
fn is_dark(light: &GpuLight) -> bool {
    light.color == [0.0; 3]
}

/// Brightness of a light from afar.
pub fn strength(light: &GpuLight) -> f32 {
    let luminance = Vec3::from(light.color).dot(Vec3::new(0.2126, 0.7152, 0.0722));
    match light.kind {
        // Radiance times area.
        LIGHT_RECT => luminance * 4.0 * light.spot[0] * light.spot[1],
        _ => luminance,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_lights_are_kept_in_their_order() {
        let sun = |illuminance: f32| GpuLight {
            color: [illuminance; 3],
            ..Default::default()
        };
        let mut lights: Vec<_> = (0..MAX_LIGHTS).map(|index| sun(10.0 + index as f32)).collect();
        lights.insert(100, sun(1_000.0));
        lights.push(sun(9.0));
        let kept = [&lights[1..=MAX_LIGHTS]].concat();
        keep_strongest(&mut lights);
        assert!(lights == kept);
    }

    #[test]
    fn suns_are_told_from_lamps() {
        let lights = [LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT].map(|kind| GpuLight {
            kind,
            ..Default::default()
        });
        let all = ExtractedLights {
            lights: lights.to_vec(),
            ..Default::default()
        };
        assert!(all.touches_sun(&Touched::All));
        assert!(all.touches_sun(&Touched::Lights(vec![2, 0])));
        assert!(!all.touches_sun(&Touched::Lights(vec![2, 1])));
        assert!(!all.touches_sun(&Touched::default()));
    }
}
