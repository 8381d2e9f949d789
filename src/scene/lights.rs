//! Lights as hits need them: all visible ones of the scene, in the units of Bevy's shaders. Bevy's own list leaves out what the camera
//! does not see.

use std::f32::consts::{FRAC_PI_2, PI};

use bevy::{
    camera::visibility::{InheritedVisibility, RenderLayers},
    color::{Color, LinearRgba},
    ecs::prelude::*,
    light::{DirectionalLight, PointLight, RectLight, SpotLight, SunDisk},
    log::warn_once,
    math::{Vec3, Vec3A},
    pbr::AreaLightLuts,
    render::{Extract, render_asset::RenderAssets, texture::GpuImage},
    transform::components::GlobalTransform,
};

use super::{
    activity::SceneActivity,
    change::{Change, RESTLESS_FRAMES},
    gpu_types::*,
    render_layers::SceneLayers,
};

/// Lights that hits go through one by one. Where there are more, they do so with directional ones alone, of which there are at most so
/// many, and draw from the others. `shading.wesl` has the same number.
pub const MAX_LIGHTS: usize = 256;

/// The lights of the scene in the render world.
#[derive(Resource, Default)]
pub struct ExtractedLights {
    /// Directional lights first, then points, spots and rectangles.
    pub lights: Vec<GpuLight>,
    /// `true` if `lights` differs from the last frame, if only in marks.
    pub changed: bool,
    /// How it differs.
    pub(super) change: Change,
    /// By light, the frames for which it stays marked.
    restless: Vec<u32>,
}

/// `true` if Bevy's shaders apply rectangle lights, which they do only with Bevy's cargo feature `area_light_luts`.
#[derive(Resource, Default, Clone, Copy, Debug, PartialEq, Eq)]
pub struct RectLightsEnabled(pub bool);

fn radiance(color: Color, intensity: f32) -> Option<[f32; 3]> {
    let color = LinearRgba::from(color);
    let scaled = [color.red, color.green, color.blue].map(|channel| channel * intensity);
    let lit = scaled.iter().all(|channel| channel.is_finite()) && scaled.iter().any(|channel| *channel > 0.0);
    lit.then(|| scaled.map(|channel| channel.max(0.0)))
}

/// The direction of local -z, or `None` when the transform has collapsed it.
fn forward(transform: &GlobalTransform) -> Option<Vec3> {
    let axis = (transform.affine().matrix3 * Vec3A::NEG_Z).try_normalize()?;
    Some(axis.into())
}

fn inverse_square(range: f32) -> f32 {
    let squared = 1.0 / (range * range);
    if squared.is_finite() { squared } else { f32::MAX }
}

fn shadow_flag(enabled: bool) -> u32 {
    if enabled { LIGHT_CASTS_SHADOW } else { 0 }
}

/// A directional light; `None` when it gives no light.
pub fn directional_light(light: &DirectionalLight, transform: &GlobalTransform) -> Option<GpuLight> {
    Some(GpuLight {
        color: radiance(light.color, light.illuminance)?,
        kind: LIGHT_DIRECTIONAL,
        direction: (-forward(transform)?).to_array(),
        flags: shadow_flag(light.shadow_maps_enabled),
        ..Default::default()
    })
}

/// A point light; `None` when it gives no light.
pub fn point_light(light: &PointLight, transform: &GlobalTransform) -> Option<GpuLight> {
    let position = transform.translation();
    position.is_finite().then_some(())?;
    Some(GpuLight {
        // Lumens to candela, as Bevy has it.
        color: radiance(light.color, light.intensity / (4.0 * PI))?,
        kind: LIGHT_POINT,
        position: position.to_array(),
        inverse_range_squared: inverse_square(light.range),
        radius: non_negative(light.radius),
        flags: shadow_flag(light.shadow_maps_enabled),
        shadow_near: non_negative(light.shadow_map_near_z),
        ..Default::default()
    })
}

/// A spot light; `None` when it gives no light.
pub fn spot_light(light: &SpotLight, transform: &GlobalTransform) -> Option<GpuLight> {
    let position = transform.translation();
    position.is_finite().then_some(())?;
    // The clamps of Bevy's extraction.
    let outer = if light.outer_angle >= FRAC_PI_2 {
        FRAC_PI_2 - 1e-4
    } else {
        light.outer_angle
    };
    let inner = light.inner_angle.min(outer);
    let cos_outer = outer.cos();
    let scale = 1.0 / (inner.cos() - cos_outer).max(1e-4);
    let offset = -cos_outer * scale;
    (scale.is_finite() && offset.is_finite()).then_some(())?;
    Some(GpuLight {
        // Bevy divides by 4 pi for spots as well, so that a cone does not change the brightness inside it.
        color: radiance(light.color, light.intensity / (4.0 * PI))?,
        kind: LIGHT_SPOT,
        position: position.to_array(),
        inverse_range_squared: inverse_square(light.range),
        direction: forward(transform)?.to_array(),
        radius: non_negative(light.radius),
        spot: [scale, offset],
        flags: shadow_flag(light.shadow_maps_enabled),
        shadow_near: non_negative(light.shadow_map_near_z),
    })
}

/// A rectangular light, which casts no shadows in Bevy; `None` when it gives no light.
pub fn rect_light(light: &RectLight, transform: &GlobalTransform) -> Option<GpuLight> {
    let matrix = transform.affine().matrix3;
    let width = light.width * matrix.x_axis.length();
    let height = light.height * matrix.y_axis.length();
    let area = width * height;
    let position = transform.translation();
    (position.is_finite() && area.is_finite() && area > 0.0).then_some(())?;
    let right: Vec3 = matrix.x_axis.try_normalize()?.into();
    let up: Vec3 = matrix.y_axis.try_normalize()?.into();
    let direction = up.cross(right).try_normalize()?;
    let reference = any_orthogonal(direction);
    Some(GpuLight {
        color: radiance(light.color, light.intensity / (area * PI))?,
        kind: LIGHT_RECT,
        position: position.to_array(),
        inverse_range_squared: 1.0 / (light.range * light.range).max(1e-4),
        direction: direction.to_array(),
        radius: f32::atan2(right.dot(direction.cross(reference)), right.dot(reference)),
        spot: [width * 0.5, height * 0.5],
        flags: 0,
        shadow_near: 0.0,
    })
    .filter(|light| light.inverse_range_squared.is_finite() && light.radius.is_finite())
}

fn non_negative(value: f32) -> f32 {
    if value.is_finite() { value.max(0.0) } else { 0.0 }
}

/// The same as in `numeric.wesl`: a unit vector at a right angle to `n`.
fn any_orthogonal(n: Vec3) -> Vec3 {
    let s = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + n.z);
    Vec3::new(1.0 + s * n.x * n.x * a, s * n.x * n.y * a, -s * n.x)
}

type Lights<'w, 's, L> = Extract<
    'w,
    's,
    Query<
        'static,
        'static,
        (
            &'static L,
            &'static GlobalTransform,
            &'static InheritedVisibility,
            Option<&'static RenderLayers>,
        ),
    >,
>;

/// Directional lights with their disks.
type Suns<'w, 's> = Extract<
    'w,
    's,
    Query<
        'static,
        'static,
        (
            &'static DirectionalLight,
            &'static GlobalTransform,
            &'static InheritedVisibility,
            Option<&'static RenderLayers>,
            Option<&'static SunDisk>,
        ),
    >,
>;

/// Gathers the lights. Belongs in `ExtractSchedule`.
pub fn extract_lights(
    directional: Suns,
    points: Lights<PointLight>,
    spots: Lights<SpotLight>,
    rects: Lights<RectLight>,
    rects_enabled: Option<Res<RectLightsEnabled>>,
    (activity, layers): (Option<Res<SceneActivity>>, Option<Res<SceneLayers>>),
    mut extracted: ResMut<ExtractedLights>,
    mut previous: Local<Vec<GpuLight>>,
) {
    let ExtractedLights {
        lights,
        changed,
        change,
        restless,
    } = &mut *extracted;
    std::mem::swap(lights, &mut *previous);
    lights.clear();
    if activity.is_some_and(|activity| !activity.active) {
        *changed = !previous.is_empty();
        previous.clear();
        return;
    }
    fn visible<L: Component>(
        (light, transform, visibility, own_layers): (&L, &GlobalTransform, &InheritedVisibility, Option<&RenderLayers>),
        layers: Option<&SceneLayers>,
        convert: fn(&L, &GlobalTransform) -> Option<GpuLight>,
    ) -> Option<GpuLight> {
        // Bevy lights a view by the lights on its layers alone.
        let shines = visibility.get() && layers.is_none_or(|layers| layers.groups_of(own_layers) != 0);
        shines.then(|| convert(light, transform))?
    }
    let layers = layers.as_deref();
    lights.extend(directional.iter().filter_map(|(light, place, visibility, own, disk)| {
        let packed = visible((light, place, visibility, own), layers, directional_light)?;
        let radius = non_negative(disk.unwrap_or_default().angular_size);
        Some(GpuLight { radius, ..packed })
    }));
    if lights.len() > MAX_LIGHTS {
        warn_once!(
            "{} directional lights in the scene: reflections show the {MAX_LIGHTS} strongest of them.",
            lights.len()
        );
        keep_strongest(lights);
    }
    lights.extend(points.iter().filter_map(|item| visible(item, layers, point_light)));
    lights.extend(spots.iter().filter_map(|item| visible(item, layers, spot_light)));
    if rects_enabled.is_some_and(|enabled| enabled.0) {
        lights.extend(rects.iter().filter_map(|item| visible(item, layers, rect_light)));
    }
    *change = mark_changes(lights, &previous, restless);
    *changed = lights != &*previous;
}

/// Marks the lights that are others than in the last frame, when they may have had marks, or were so lately.
fn mark_changes(lights: &mut [GpuLight], previous: &[GpuLight], restless: &mut Vec<u32>) -> Change {
    if lights.len() != previous.len() {
        restless.clear();
        return Change::Unmarked;
    }
    restless.resize(lights.len(), 0);
    let mut change = Change::Nothing;
    for ((light, previous), restless) in lights.iter_mut().zip(previous).zip(restless) {
        let previous = GpuLight {
            flags: previous.flags & !LIGHT_RESTLESS,
            ..*previous
        };
        if *light != previous {
            let in_its_color = GpuLight {
                color: light.color,
                ..previous
            };
            // One that begins to move may no longer shine where it did.
            let is_marked = *restless > 0 || *light == in_its_color;
            change = change.max(if is_marked { Change::Marked } else { Change::Unmarked });
            *restless = RESTLESS_FRAMES;
        }
        if *restless > 0 {
            *restless -= 1;
            light.flags |= LIGHT_RESTLESS;
        }
    }
    change
}

/// Keeps the strongest lights, in their order: a light that comes or goes changes one other at most.
fn keep_strongest(lights: &mut Vec<GpuLight>) {
    let mut order: Vec<usize> = (0..lights.len()).collect();
    // Equal ones are told apart by their place.
    order.sort_by(|a, b| strength(&lights[*b]).total_cmp(&strength(&lights[*a])));
    order.truncate(MAX_LIGHTS);
    order.sort_unstable();
    *lights = order.into_iter().map(|index| lights[index]).collect();
}

/// How bright a light is from afar.
pub fn strength(light: &GpuLight) -> f32 {
    let luminance = Vec3::from(light.color).dot(Vec3::new(0.2126, 0.7152, 0.0722));
    match light.kind {
        // Its radiance times its area.
        LIGHT_RECT => luminance * 4.0 * light.spot[0] * light.spot[1],
        _ => luminance,
    }
}

/// Finds out whether Bevy was built with the tables for rectangular lights. Belongs in `RenderSystems::PrepareResources`; lights
/// follow in the next frame.
pub fn detect_rect_lights(
    luts: Option<Res<AreaLightLuts>>,
    images: Res<RenderAssets<GpuImage>>,
    mut enabled: ResMut<RectLightsEnabled>,
) {
    // Without the feature there is a placeholder of one texel.
    let image = luts.as_ref().and_then(|luts| images.get(&luts.image));
    let found = RectLightsEnabled(image.is_some_and(|image| image.texture_descriptor.size.width > 1));
    enabled.set_if_neq(found);
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
}
