//! Lights of any strength and shape, and more of them than shaders support.

use super::Builder;
use bevy::prelude::*;
use clap::ValueEnum;
use core::f32::consts::{FRAC_PI_2, PI};
use serde::{Deserialize, Serialize};

/// Lumens that suit the exposure of the camera.
const LUMENS: f32 = 30.0;

/// Lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum LightKind {
    /// An ordinary lamp.
    Lamp,
    /// A NaN number of lumens.
    NanPoint,
    /// An infinite number of lumens.
    InfinitePoint,
    /// 1e12 lumens.
    HugePoint,
    /// A negative number of lumens.
    NegativePoint,
    /// A colour that is NaN.
    NanColor,
    /// A range of 0.
    ZeroRange,
    /// A range that is NaN.
    NanRange,
    /// An infinite range.
    InfiniteRange,
    /// A radius that is NaN or negative.
    OddRadius,
    /// A bright lamp 1e6 metres away.
    FarPoint,
    /// A position that is NaN.
    NanPosition,
    /// An infinite position.
    InfinitePosition,
    /// A lamp exactly on a surface.
    OnTheSurface,
    /// A cone with angles that are NaN.
    NanCone,
    /// An inner cone wider than the outer one.
    InvertedCone,
    /// A cone of zero width.
    ZeroCone,
    /// A cone of a full turn.
    WideCone,
    /// A spot light without a direction.
    CollapsedSpot,
    /// An illuminance that is NaN.
    NanDirectional,
    /// An infinite illuminance.
    InfiniteDirectional,
    /// A sun without a direction.
    CollapsedDirectional,
    /// A rectangle without area, and one with a width of NaN.
    OddRectangles,
    /// More lamps than shaders support.
    ManyPoints,
    /// More suns than Bevy supports.
    ManyDirectional,
    /// A lamp with shadows.
    ShadowedPoint,
    /// A spot light with shadows.
    ShadowedSpot,
    /// A sun with shadows.
    ShadowedDirectional,
}

/// Adds such lights.
pub fn add(kind: LightKind, builder: &mut Builder) {
    let at = Transform::from_xyz(
        builder.random.range(-1.0, 1.0),
        builder.random.range(0.5, 2.0),
        builder.random.range(-1.0, 5.0),
    );
    if let Some(light) = point(kind, at) {
        builder.add(light);
    } else if let Some(light) = spot(kind, at) {
        builder.add(light);
    } else if let Some(light) = directional(kind) {
        builder.add(light);
    } else {
        several(kind, at, builder);
    }
}

/// Adds several lights at once.
fn several(kind: LightKind, at: Transform, builder: &mut Builder) {
    match kind {
        LightKind::OddRectangles => {
            for (width, height) in [(0.0, 1.0), (f32::NAN, 1.0), (0.5, 0.5)] {
                let light = RectLight {
                    intensity: LUMENS,
                    width,
                    height,
                    ..default()
                };
                builder.add((light, at));
            }
        }
        LightKind::ManyPoints => {
            for index in 0..300 {
                let light = PointLight {
                    intensity: 0.1,
                    range: 4.0,
                    ..default()
                };
                let position = Vec3::new((index % 20) as f32, 4.0, (index / 20) as f32) * 0.3;
                builder.add((light, Transform::from_translation(position - Vec3::new(3.0, 0.0, 2.0))));
            }
        }
        LightKind::ManyDirectional => {
            for index in 0..14 {
                let light = DirectionalLight {
                    illuminance: 0.1,
                    ..default()
                };
                let towards = Vec3::new(index as f32 - 7.0, -5.0, -2.0);
                builder.add((light, Transform::default().looking_to(towards, Vec3::Y)));
            }
        }
        _ => {}
    }
}

fn point(kind: LightKind, mut at: Transform) -> Option<(PointLight, Transform)> {
    let mut lamp = PointLight {
        intensity: LUMENS,
        range: 20.0,
        ..default()
    };
    match kind {
        LightKind::Lamp => {}
        LightKind::NanPoint => lamp.intensity = f32::NAN,
        LightKind::InfinitePoint => lamp.intensity = f32::INFINITY,
        LightKind::HugePoint => lamp.intensity = 1e12,
        LightKind::NegativePoint => lamp.intensity = -LUMENS,
        LightKind::NanColor => lamp.color = Color::linear_rgb(f32::NAN, 1.0, 1.0),
        LightKind::ZeroRange => lamp.range = 0.0,
        LightKind::NanRange => lamp.range = f32::NAN,
        LightKind::InfiniteRange => lamp.range = f32::INFINITY,
        LightKind::OddRadius => lamp.radius = if at.translation.x > 0.0 { f32::NAN } else { -5.0 },
        LightKind::FarPoint => {
            (lamp.intensity, lamp.range) = (1e13, 1e7);
            at = Transform::from_xyz(0.0, 1e6, 0.0);
        }
        LightKind::NanPosition => at.translation = Vec3::NAN,
        LightKind::InfinitePosition => at.translation = Vec3::INFINITY,
        LightKind::OnTheSurface => at = Transform::from_xyz(0.3, 0.0, 1.0),
        LightKind::ShadowedPoint => lamp.shadow_maps_enabled = true,
        _ => return None,
    }
    Some((lamp, at))
}

fn spot(kind: LightKind, at: Transform) -> Option<(SpotLight, Transform)> {
    let down = Transform::from_translation(at.translation + Vec3::Y * 1.5).looking_to(Vec3::NEG_Y, Vec3::X);
    let cone = |inner_angle: f32, outer_angle: f32| SpotLight {
        intensity: LUMENS,
        inner_angle,
        outer_angle,
        ..default()
    };
    Some(match kind {
        LightKind::NanCone => (cone(f32::NAN, f32::NAN), down),
        LightKind::InvertedCone => (cone(1.0, 0.3), down),
        LightKind::ZeroCone => (cone(0.0, 0.0), down),
        LightKind::WideCone => (cone(FRAC_PI_2, PI), down),
        LightKind::CollapsedSpot => (cone(0.2, 0.6), down.with_scale(Vec3::ZERO)),
        LightKind::ShadowedSpot => {
            let mut shadowed = cone(0.2, 0.6);
            shadowed.shadow_maps_enabled = true;
            (shadowed, down)
        }
        _ => return None,
    })
}

fn directional(kind: LightKind) -> Option<(DirectionalLight, Transform)> {
    let down = Transform::default().looking_to(Vec3::new(-0.3, -1.0, -0.4), Vec3::Y);
    let sun = |illuminance: f32, shadow_maps_enabled: bool| DirectionalLight {
        illuminance,
        shadow_maps_enabled,
        ..default()
    };
    Some(match kind {
        LightKind::NanDirectional => (sun(f32::NAN, false), down),
        LightKind::InfiniteDirectional => (sun(f32::INFINITY, false), down),
        LightKind::CollapsedDirectional => (sun(2.0, false), down.with_scale(Vec3::ZERO)),
        LightKind::ShadowedDirectional => (sun(2.0, true), down),
        _ => return None,
    })
}
