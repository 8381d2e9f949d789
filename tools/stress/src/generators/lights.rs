//! Lights of any strength and shape, and more of them than shaders support.

use super::Builder;
use bevy::prelude::*;
use core::f32::consts::{FRAC_PI_2, PI};

/// Lumens that suit the exposure of the camera.
const LUMENS: f32 = 30.0;
const NAN: f32 = f32::NAN;
const INFINITY: f32 = f32::INFINITY;

kinds! {
    LightKind, fn add_at(builder: &mut Builder, at: Transform) {
        Lamp => point(builder, at, |_| {}),
        NanPoint => point(builder, at, |lamp| lamp.intensity = NAN),
        InfinitePoint => point(builder, at, |lamp| lamp.intensity = INFINITY),
        HugePoint => point(builder, at, |lamp| lamp.intensity = 1e12),
        NegativePoint => point(builder, at, |lamp| lamp.intensity = -LUMENS),
        NanColor => point(builder, at, |lamp| lamp.color = Color::linear_rgb(NAN, 1.0, 1.0)),
        ZeroRange => point(builder, at, |lamp| lamp.range = 0.0),
        NanRange => point(builder, at, |lamp| lamp.range = NAN),
        InfiniteRange => point(builder, at, |lamp| lamp.range = INFINITY),
        OddRadius => point(builder, at, |lamp| lamp.radius = if at.translation.x > 0.0 { NAN } else { -5.0 }),
        FarPoint => point(builder, Transform::from_xyz(0.0, 1e6, 0.0), |lamp| (lamp.intensity, lamp.range) = (1e13, 1e7)),
        NanPosition => point(builder, Transform::from_translation(Vec3::NAN), |_| {}),
        InfinitePosition => point(builder, Transform::from_translation(Vec3::INFINITY), |_| {}),
        OnTheSurface => point(builder, Transform::from_xyz(0.3, 0.0, 1.0), |_| {}),
        NanCone => spot(builder, at, NAN, NAN, |_, _| {}),
        InvertedCone => spot(builder, at, 1.0, 0.3, |_, _| {}),
        ZeroCone => spot(builder, at, 0.0, 0.0, |_, _| {}),
        WideCone => spot(builder, at, FRAC_PI_2, PI, |_, _| {}),
        CollapsedSpot => spot(builder, at, 0.2, 0.6, |_, place| place.scale = Vec3::ZERO),
        NanDirectional => sun(builder, NAN, |_, _| {}),
        InfiniteDirectional => sun(builder, INFINITY, |_, _| {}),
        CollapsedDirectional => sun(builder, 2.0, |_, place| place.scale = Vec3::ZERO),
        // Without area, or with a width of NaN.
        OddRectangles => [(0.0, 1.0), (NAN, 1.0), (0.5, 0.5)].into_iter().for_each(|(width, height)| {
            let light = RectLight { intensity: LUMENS, width, height, ..default() };
            builder.add((light, at));
        }),
        // More than shaders support.
        ManyPoints => (0..300).for_each(|index| {
            let light = PointLight { intensity: 0.1, range: 4.0, ..default() };
            let position = Vec3::new((index % 20) as f32, 4.0, (index / 20) as f32) * 0.3;
            builder.add((light, Transform::from_translation(position - Vec3::new(3.0, 0.0, 2.0))));
        }),
        // More than Bevy supports.
        ManyDirectional => (0..14).for_each(|index| sun(builder, 0.1, |_, place| {
            *place = Transform::default().looking_to(Vec3::new(index as f32 - 7.0, -5.0, -2.0), Vec3::Y);
        })),
        ShadowedPoint => point(builder, at, |lamp| lamp.shadow_maps_enabled = true),
        ShadowedSpot => spot(builder, at, 0.2, 0.6, |light, _| light.shadow_maps_enabled = true),
        ShadowedDirectional => sun(builder, 2.0, |light, _| light.shadow_maps_enabled = true),
    }
}

pub fn add(kind: LightKind, builder: &mut Builder) {
    let random = &mut builder.scene.random;
    let at = Transform::from_xyz(random.range(-1.0, 1.0), random.range(0.5, 2.0), random.range(-1.0, 5.0));
    add_at(kind, builder, at);
}

fn point(builder: &mut Builder, at: Transform, change: impl FnOnce(&mut PointLight)) {
    let mut lamp = PointLight {
        intensity: LUMENS,
        range: 20.0,
        ..default()
    };
    change(&mut lamp);
    builder.add((lamp, at));
}

fn spot(
    builder: &mut Builder,
    at: Transform,
    inner_angle: f32,
    outer_angle: f32,
    change: impl FnOnce(&mut SpotLight, &mut Transform),
) {
    let mut down = Transform::from_translation(at.translation + Vec3::Y * 1.5).looking_to(Vec3::NEG_Y, Vec3::X);
    let mut light = SpotLight {
        intensity: LUMENS,
        inner_angle,
        outer_angle,
        ..default()
    };
    change(&mut light, &mut down);
    builder.add((light, down));
}

fn sun(builder: &mut Builder, illuminance: f32, change: impl FnOnce(&mut DirectionalLight, &mut Transform)) {
    let mut down = Transform::default().looking_to(Vec3::new(-0.3, -1.0, -0.4), Vec3::Y);
    let mut light = DirectionalLight {
        illuminance,
        ..default()
    };
    change(&mut light, &mut down);
    builder.add((light, down));
}
