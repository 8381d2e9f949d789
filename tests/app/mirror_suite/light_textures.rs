//! Rows of the mirror suite about lights with textures.

use super::{Row, SUN, Stage, blue};
use crate::stage::{add, image};
use bevy::{
    camera::primitives::CubemapLayout,
    image::Image,
    light::{DirectionalLightTexture, PointLightTexture, SpotLightTexture},
    prelude::*,
    render::render_resource::TextureFormat,
};

pub(super) const ROWS: [Row; 6] = [
    ("texture of a spot light", |stage| {
        let image = stage.pattern(8, 8);
        stage.light_by_spot(image);
        stage.spawn(blue());
    }),
    ("texture of a point light", |stage| {
        stage.spawn_under_a_cube_map(CubemapLayout::CrossVertical, 12, 16);
    }),
    ("texture of a point light in a row", |stage| {
        stage.spawn_under_a_cube_map(CubemapLayout::SequenceHorizontal, 24, 4);
    }),
    ("texture of a directional light", |stage| {
        stage.spawn_under_a_textured_sun(false);
    }),
    ("repeated texture of a directional light", |stage| {
        stage.spawn_under_a_textured_sun(true);
    }),
    ("textures of lights of different sizes and formats", |stage| {
        let image = stage.pattern_of(TextureFormat::R8Unorm, UVec2::new(5, 3), |value| vec![value]);
        stage.light_by_spot(image);
        let image = stage.pattern_of(TextureFormat::Rgba16Float, UVec2::new(24, 4), |value| {
            half_float_of_128ths(value).to_le_bytes().repeat(4)
        });
        stage.light_by_point(image, CubemapLayout::SequenceHorizontal);
        stage.spawn(blue());
    }),
];

/// The bits of a half float with the value `parts` / 128; at least one part.
fn half_float_of_128ths(parts: u8) -> u16 {
    let exponent = u16::from(parts).ilog2() as u16;
    let rest = u16::from(parts) - (1 << exponent);
    ((exponent + 15 - 7) << 10) | (rest << (10 - exponent))
}

impl Stage<'_> {
    fn pattern(&mut self, width: u32, height: u32) -> Handle<Image> {
        self.pattern_of(TextureFormat::Rgba8Unorm, UVec2::new(width, height), |value| {
            vec![value, 0, 0, 255]
        })
    }

    /// An image with this number of texels and no repeated part. Its borders match, because edges would differ in single pixels when
    /// the image repeats. `texel` makes bytes of a value.
    fn pattern_of(&mut self, format: TextureFormat, size: UVec2, texel: impl Fn(u8) -> Vec<u8>) -> Handle<Image> {
        let texels = (0..size.element_product()).flat_map(|i| {
            let place = UVec2::new(i % size.x, i / size.x);
            let is_border = place.x == 0 || place.y == 0 || (place + 1).cmpeq(size).any();
            texel(if is_border { 120 } else { 40 + (i * 53 % 216) as u8 })
        });
        add(self.app, image(size, format, texels.collect()))
    }

    fn light_by_spot(&mut self, image: Handle<Image>) {
        self.add((
            SpotLight {
                intensity: 150_000.0,
                range: 20.0,
                outer_angle: 0.5,
                inner_angle: 0.4,
                ..default()
            },
            SpotLightTexture { image },
            Transform::from_xyz(0.2, 0.1, 4.0).looking_to(Vec3::new(0.05, -0.02, 1.0), Vec3::new(0.4, 1.0, 0.0)),
        ));
    }

    fn light_by_point(&mut self, image: Handle<Image>, cubemap_layout: CubemapLayout) {
        self.add((
            PointLight {
                intensity: 120_000.0,
                // Too short for a highlight on the mirror.
                range: 5.5,
                ..default()
            },
            PointLightTexture { image, cubemap_layout },
            Transform::from_xyz(0.5, 0.5, 5.6).with_rotation(Quat::from_euler(EulerRot::XYZ, 0.4, 0.7, 0.2)),
        ));
    }

    fn light_by_sun(&mut self, image: Handle<Image>, tiled: bool) {
        self.add((
            DirectionalLight {
                illuminance: 2000.0,
                ..default()
            },
            DirectionalLightTexture { image, tiled },
            Transform::from_xyz(0.3, 0.2, 6.0)
                .looking_to(SUN, Vec3::new(0.2, 1.0, 0.0))
                .with_scale(Vec3::new(3.0, 2.0, 1.0)),
        ));
    }

    fn spawn_under_a_cube_map(&mut self, cubemap_layout: CubemapLayout, width: u32, height: u32) {
        let image = self.pattern(width, height);
        self.light_by_point(image, cubemap_layout);
        self.spawn(blue());
    }

    fn spawn_under_a_textured_sun(&mut self, tiled: bool) {
        let image = self.pattern(8, 8);
        self.light_by_sun(image, tiled);
        self.spawn(blue());
    }
}
