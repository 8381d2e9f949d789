//! Packs Bevy's light components into the GPU's layout, in the units of its shaders.

use super::gpu_types::*;
use bevy::{
    color::{Color, LinearRgba},
    light::{DirectionalLight, PointLight, RectLight, SpotLight},
    math::{Vec3, Vec3A},
    transform::components::GlobalTransform,
};
use std::f32::consts::{FRAC_PI_2, PI};

fn radiance(color: Color, intensity: f32) -> Option<[f32; 3]> {
    let color = LinearRgba::from(color);
    let scaled = [color.red, color.green, color.blue].map(|channel| channel * intensity);
    let lit = scaled.iter().all(|channel| channel.is_finite()) && scaled.iter().any(|channel| *channel > 0.0);
    lit.then(|| scaled.map(|channel| channel.max(0.0)))
}

/// The direction of local -z, or `None` if the transform collapses it.
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

/// A directional light; `None` if it gives no light.
pub fn directional_light(light: &DirectionalLight, transform: &GlobalTransform) -> Option<GpuLight> {
    Some(GpuLight {
        color: radiance(light.color, light.illuminance)?,
        kind: LIGHT_DIRECTIONAL,
        direction: (-forward(transform)?).to_array(),
        flags: shadow_flag(light.shadow_maps_enabled),
        ..Default::default()
    })
}

/// A point light; `None` if it gives no light.
pub fn point_light(light: &PointLight, transform: &GlobalTransform) -> Option<GpuLight> {
    let position = transform.translation();
    position.is_finite().then_some(())?;
    Some(GpuLight {
        // Lumens to candela, like in Bevy.
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

/// A spot light; `None` if it gives no light.
pub fn spot_light(light: &SpotLight, transform: &GlobalTransform) -> Option<GpuLight> {
    let position = transform.translation();
    position.is_finite().then_some(())?;
    // Same clamps as in Bevy's extraction.
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
        // Bevy divides by 4 pi for spots as well, so that a cone doesn't change the brightness inside it.
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

/// A rectangular light, which casts no shadows in Bevy; `None` if it gives no light.
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

/// Returns 0 for negative numbers and NaN.
pub fn non_negative(value: f32) -> f32 {
    if value.is_finite() { value.max(0.0) } else { 0.0 }
}

/// Twin of the function in `numeric.wesl`: a unit vector at a right angle to `n`.
fn any_orthogonal(n: Vec3) -> Vec3 {
    let s = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + n.z);
    Vec3::new(1.0 + s * n.x * n.x * a, s * n.x * n.y * a, -s * n.x)
}
