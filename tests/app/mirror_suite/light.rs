//! Rows of the mirror suite about environment light: light probes, clearcoats and their reflections, and render layers.

use super::{Row, Stage, blue};
use crate::stage::{add, cube_map, image_of_layers};
use bevy::{
    camera::visibility::RenderLayers,
    image::Image,
    light::{IrradianceVolume, LightProbe, ParallaxCorrection, RectLight},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use bevy_glint::ReflectionTechnique;

/// In each direction of a block of lights: 1,000.
const GRID: u32 = 10;

pub(super) const ROWS: [Row; 11] = [
    ("clearcoat", |stage| {
        stage.surround();
        stage.light_and_spawn(lacquer());
    }),
    ("clearcoat under a lamp", |stage| {
        stage.add((
            PointLight {
                intensity: 1_500_000.0,
                range: 5.5,
                radius: 0.4,
                ..default()
            },
            Transform::from_xyz(0.5, 0.5, 5.6),
        ));
        stage.spawn(StandardMaterial {
            base_color: Color::BLACK,
            clearcoat_perceptual_roughness: 0.5,
            ..lacquer()
        });
    }),
    ("rectangular light", |stage| {
        stage.light_by_a_rectangle(40_000.0);
        stage.spawn(polished());
    }),
    ("rectangular light on clearcoat", |stage| {
        stage.light_by_a_rectangle(250_000.0);
        stage.spawn(StandardMaterial {
            base_color: Color::BLACK,
            ..lacquer()
        });
    }),
    ("many lights", |stage| {
        // Each hit draws some of them.
        stage.technique = ReflectionTechnique::Converged;
        stage.frames = 64;
        for index in 0..GRID * GRID * GRID {
            let [x, y, z] = [index % GRID, index / GRID % GRID, index / (GRID * GRID)].map(|cell| cell as f32);
            stage.add((
                PointLight {
                    color: Color::hsl(360.0 * (index as f32 * 0.618_034).fract(), 0.9, 0.6),
                    intensity: 300.0,
                    range: 2.5,
                    radius: 0.05,
                    ..default()
                },
                Transform::from_xyz(x - 4.5, y - 4.5, 5.2 + 0.7 * z),
            ));
        }
        stage.spawn(blue());
    }),
    ("reflection probes", |stage| {
        stage.surround();
        stage.spawn(polished());
        stage.add_probe(cube_around(-1.0, 0.5, 8.0), 0, Quat::IDENTITY);
        let turned = Transform::from_xyz(2.5, 0.0, 9.0).with_rotation(Quat::from_rotation_y(0.4));
        stage.add_probe(
            turned.with_scale(Vec3::new(7.0, 9.0, 8.0)),
            2,
            Quat::from_rotation_x(0.7),
        );
    }),
    ("a reflection probe without parallax", |stage| {
        stage.spawn(polished());
        stage.add_probe(cube_around(0.0, 0.0, 40.0), 3, Quat::IDENTITY);
        stage.dress_last(ParallaxCorrection::None);
    }),
    ("clearcoat in a reflection probe", |stage| {
        stage.spawn(lacquer());
        stage.add_probe(cube_around(0.0, 0.0, 12.0), 0, Quat::IDENTITY);
    }),
    ("irradiance volumes", |stage| {
        stage.surround();
        stage.spawn(blue());
        stage.add_volume(cube_around(0.0, 0.0, 44.0), 0);
        let turned = Transform::from_xyz(0.5, 0.0, 9.0).with_rotation(Quat::from_rotation_z(0.4));
        stage.add_volume(turned.with_scale(Vec3::new(6.0, 9.0, 8.0)), 3);
    }),
    ("render layers of the camera", |stage| {
        stage.light_and_spawn(blue());
        stage.dress(RenderLayers::from_layers(&[0, 2]));
        stage.move_to_layers(&[2, 1]);
    }),
    ("a shadow of what only the light's layers show", |stage| {
        stage.add_sun_with_shadows(RenderLayers::from_layers(&[0, 1]));
        stage.spawn(blue());
        stage.move_to_layers(&[0, 1]);
    }),
];

/// The place of a cube of light around the objects, `size` metres wide.
fn cube_around(x: f32, y: f32, size: f32) -> Transform {
    Transform::from_xyz(x, y, 9.0).with_scale(Vec3::splat(size))
}

fn lacquer() -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness: 0.9,
        clearcoat: 1.0,
        clearcoat_perceptual_roughness: 0.3,
        ..blue()
    }
}

fn polished() -> StandardMaterial {
    StandardMaterial {
        metallic: 0.6,
        perceptual_roughness: 0.1,
        ..blue()
    }
}

/// Another colour for each number.
fn color(number: usize) -> [u8; 4] {
    const COLORS: [[u8; 4]; 6] = [
        [230, 60, 40, 255],
        [40, 200, 60, 255],
        [60, 80, 240, 255],
        [220, 200, 40, 255],
        [200, 50, 210, 255],
        [50, 200, 210, 255],
    ];
    COLORS[number % COLORS.len()]
}

impl Stage<'_> {
    /// A wide lamp between the mirror and the spawned objects, which it lights.
    fn light_by_a_rectangle(&mut self, intensity: f32) {
        self.add((
            RectLight {
                color: Color::linear_rgb(1.0, 0.8, 0.5),
                intensity,
                range: 14.0,
                width: 2.4,
                height: 0.8,
            },
            Transform::from_xyz(0.6, 1.4, 4.8).looking_to(Vec3::new(-0.2, -0.4, 1.0), Vec3::new(0.3, 1.0, 0.0)),
        ));
    }

    /// Light from the sky and from the ground.
    pub(super) fn surround(&mut self) {
        let mut images = self.app.world().resource_mut::<Assets<Image>>();
        let [top, middle, bottom] = [0.9, 0.4, 0.1].map(|value| Color::linear_rgb(value, value, 0.7 * value));
        let light = EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom);
        self.dress(light.with_intensity(600.0));
    }

    /// A cube map with two colours on each face.
    fn cube(&mut self, first: usize) -> Handle<Image> {
        let texel = |i: usize| color(first + i / 4 + usize::from(i % 4 == 3));
        add(self.app, cube_map(2, (0..24).flat_map(texel).collect()))
    }

    /// A reflection probe in a box, with the colours from a number on.
    pub(super) fn add_probe(&mut self, at: Transform, first: usize, rotation: Quat) {
        let [diffuse_map, specular_map] = [first + 1, first].map(|first| self.cube(first));
        self.add((
            LightProbe {
                falloff: Vec3::splat(0.3),
            },
            EnvironmentMapLight {
                diffuse_map,
                specular_map,
                intensity: 700.0,
                rotation,
                ..default()
            },
            at,
        ));
    }

    /// An irradiance volume of 2x2x2 voxels.
    fn add_volume(&mut self, at: Transform, first: usize) {
        let size = UVec3::new(2, 4, 6);
        let texels = (0..48).flat_map(|i| color(first + i + i / 5)).collect();
        let format = TextureFormat::Rgba8UnormSrgb;
        let voxels = add(self.app, image_of_layers(size, TextureDimension::D3, format, texels));
        self.add((
            LightProbe {
                falloff: Vec3::splat(0.2),
            },
            IrradianceVolume {
                voxels,
                intensity: 700.0,
                ..default()
            },
            at,
        ));
    }

    /// Gives the last spawned entity a component.
    fn dress_last(&mut self, bundle: impl Bundle) {
        if let Some(&last) = self.spawned.last() {
            self.app.world().entity_mut(last).insert(bundle);
        }
    }

    /// Moves the first meshes that were spawned to a layer each.
    fn move_to_layers(&mut self, layers: &[usize]) {
        let world = self.app.world();
        let meshes = self
            .spawned
            .iter()
            .filter(|entity| world.get::<Mesh3d>(**entity).is_some());
        let meshes: Vec<_> = meshes.copied().collect();
        for (entity, layer) in meshes.into_iter().zip(layers) {
            world.entity_mut(entity).insert(RenderLayers::layer(*layer));
        }
    }
}
