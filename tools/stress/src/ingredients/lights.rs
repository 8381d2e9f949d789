//! Lights of any strength and shape, and more of them than shaders take.

use super::{Builder, kinds};
use bevy::prelude::*;
use core::f32::consts::{FRAC_PI_2, PI};

/// Lumens that light the scene well at the exposure of its camera.
const LUMENS: f32 = 30.0;

kinds! {
    /// What is odd about a light.
    LightKind {
        /// An ordinary lamp.
        Lamp,
        /// Lumens that are NaN.
        NanPoint,
        /// Infinitely many lumens.
        InfinitePoint,
        /// 1e12 lumens.
        HugePoint,
        /// Less than no lumens.
        NegativePoint,
        /// A colour that is NaN.
        NanColor,
        /// Range 0.
        ZeroRange,
        /// Range NaN.
        NanRange,
        /// Range infinite.
        InfiniteRange,
        /// Radius NaN and negative.
        OddRadius,
        /// 1e6 metres away, and as bright.
        FarPoint,
        /// Position NaN.
        NanPosition,
        /// Position infinite.
        InfinitePosition,
        /// Exactly on a surface.
        OnTheSurface,
        /// A cone that is NaN.
        NanCone,
        /// The inner cone wider than the outer one.
        InvertedCone,
        /// A cone without a width.
        ZeroCone,
        /// A cone of more than a half turn.
        WideCone,
        /// A spot whose axis has no direction.
        CollapsedSpot,
        /// Illuminance NaN.
        NanDirectional,
        /// Illuminance infinite.
        InfiniteDirectional,
        /// A sun whose axis has no direction.
        CollapsedDirectional,
        /// A rectangle without an area, and one that is NaN.
        OddRectangles,
        /// More lamps than shaders take.
        ManyPoints,
        /// More suns than Bevy takes.
        ManyDirectional,
        /// A lamp with shadows.
        ShadowedPoint,
        /// A spot with shadows.
        ShadowedSpot,
        /// A sun with shadows.
        ShadowedDirectional,
    }
}

/// Adds such lights.
pub fn add(kind: LightKind, builder: &mut Builder) {
    let at = Transform::from_xyz(
        builder.random.range(-1.0, 1.0),
        builder.random.range(0.5, 2.0),
        builder.random.range(-1.0, 5.0),
    );
    if let Some((light, transform)) = point(kind, at) {
        builder.add((light, transform));
        return;
    }
    if let Some((light, transform)) = spot(kind, at) {
        builder.add((light, transform));
        return;
    }
    if let Some((light, transform)) = directional(kind) {
        builder.add((light, transform));
        return;
    }
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
                let place = Vec3::new((index % 20) as f32, 4.0, (index / 20) as f32) * 0.3;
                builder.add((light, Transform::from_translation(place - Vec3::new(3.0, 0.0, 2.0))));
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

fn point(kind: LightKind, at: Transform) -> Option<(PointLight, Transform)> {
    let lamp = PointLight {
        intensity: LUMENS,
        range: 20.0,
        ..default()
    };
    let with = |intensity: f32| PointLight { intensity, ..lamp };
    let ranged = |range: f32| PointLight { range, ..lamp };
    Some(match kind {
        LightKind::Lamp => (lamp, at),
        LightKind::NanPoint => (with(f32::NAN), at),
        LightKind::InfinitePoint => (with(f32::INFINITY), at),
        LightKind::HugePoint => (with(1e12), at),
        LightKind::NegativePoint => (with(-LUMENS), at),
        LightKind::NanColor => {
            let color = Color::linear_rgb(f32::NAN, 1.0, 1.0);
            (PointLight { color, ..lamp }, at)
        }
        LightKind::ZeroRange => (ranged(0.0), at),
        LightKind::NanRange => (ranged(f32::NAN), at),
        LightKind::InfiniteRange => (ranged(f32::INFINITY), at),
        LightKind::OddRadius => {
            let radius = if at.translation.x > 0.0 { f32::NAN } else { -5.0 };
            (PointLight { radius, ..lamp }, at)
        }
        LightKind::FarPoint => {
            let far = PointLight {
                intensity: 1e13,
                range: 1e7,
                ..lamp
            };
            (far, Transform::from_xyz(0.0, 1e6, 0.0))
        }
        LightKind::NanPosition => (lamp, at.with_translation(Vec3::splat(f32::NAN))),
        LightKind::InfinitePosition => (lamp, at.with_translation(Vec3::splat(f32::INFINITY))),
        LightKind::OnTheSurface => (lamp, Transform::from_xyz(0.3, 0.0, 1.0)),
        LightKind::ShadowedPoint => {
            let shadowed = PointLight {
                shadow_maps_enabled: true,
                ..lamp
            };
            (shadowed, at)
        }
        _ => return None,
    })
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
            let shadowed = SpotLight {
                shadow_maps_enabled: true,
                ..cone(0.2, 0.6)
            };
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
