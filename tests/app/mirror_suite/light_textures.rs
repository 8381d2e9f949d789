//! Rows of the mirror suite about lights with textures.

use super::{Row, SUN, Stage, blue};
use bevy::{
    asset::RenderAssetUsages,
    camera::primitives::CubemapLayout,
    image::Image,
    light::{DirectionalLightTexture, PointLightTexture, SpotLightTexture},
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};

pub(super) const ROWS: [Row; 5] = [
    ("texture of a spot light", |stage| {
        let image = stage.pattern(8, 8);
        stage.add((
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
];

impl Stage<'_> {
    /// An image of so many texels, no part of which is like another. Its borders meet: where images repeat, edges would differ in single pixels.
    fn pattern(&mut self, width: u32, height: u32) -> Handle<Image> {
        let size = Extent3d {
            width,
            height,
            ..default()
        };
        let texel = |i: u32| {
            let (x, y) = (i % width, i / width);
            let is_border = x == 0 || y == 0 || x == width - 1 || y == height - 1;
            let value = if is_border { 120 } else { 40 + (i * 53 % 216) as u8 };
            [value, 0, 0, 255]
        };
        let texels = (0..width * height).flat_map(texel).collect();
        let format = TextureFormat::Rgba8Unorm;
        let image = Image::new(size, TextureDimension::D2, texels, format, RenderAssetUsages::default());
        self.app.world().resource_mut::<Assets<Image>>().add(image)
    }

    fn spawn_under_a_cube_map(&mut self, cubemap_layout: CubemapLayout, width: u32, height: u32) {
        let image = self.pattern(width, height);
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
        self.spawn(blue());
    }

    fn spawn_under_a_textured_sun(&mut self, tiled: bool) {
        let image = self.pattern(8, 8);
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
        self.spawn(blue());
    }
}
