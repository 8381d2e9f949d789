//! Rows of the mirror suite about skies, and about levels of detail.

use super::{Row, Stage, blue};
use crate::stage::{add, cube_map, image_of_layers};
use bevy::{
    camera::visibility::VisibilityRange,
    image::{Image, ImageAddressMode, ImageSampler, ImageSamplerDescriptor},
    light::{
        Atmosphere, AtmosphereEnvironmentMapLight, FogVolume, GeneratedEnvironmentMapLight, NotShadowCaster,
        NotShadowReceiver, Skybox, SunDisk, VolumetricFog, VolumetricLight, atmosphere::ScatteringMedium,
    },
    pbr::AtmosphereSettings,
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use bevy_glint::ReflectionTechnique;
use std::{f32::consts::TAU, ops::Range};

/// Components that rows add to the camera.
pub(super) type Components = (
    AtmosphereSettings,
    AtmosphereEnvironmentMapLight,
    GeneratedEnvironmentMapLight,
    Skybox,
    VolumetricFog,
);

/// Direction of light from a low sun behind the mirror.
const LOW_SUN: Vec3 = Vec3::new(0.4, -0.12, 1.0);

pub(super) const ROWS: [Row; 12] = [
    ("sunlight through an atmosphere", |stage| {
        stage.breathe(5_000.0);
        stage.spawn(blue());
    }),
    ("the sky of an atmosphere", |stage| {
        stage.breathe(6_000.0);
        stage.spawn(blue());
        stage.open();
    }),
    ("a volume of fog", |stage| {
        stage.add_fog_volume();
        stage.spawn(blue());
        // Edges of shadow maps aren't compared.
        stage.dress_spawned(NotShadowReceiver);
    }),
    ("a shadow in a volume of fog", |stage| {
        stage.add_fog_volume();
        stage.spawn(blue());
        stage.dress_spawned(NotShadowReceiver);
        // In front of the light, beside the objects that both cameras see.
        let at = Transform::from_xyz(-7.6, 2.4, 2.0);
        stage.put(Cuboid::new(4.0, 6.0, 4.0), blue(), at);
    }),
    ("a spot light with shadows in a volume of fog", |stage| {
        stage.add_dark_fog();
        stage.add((
            SpotLight {
                intensity: 150_000.0,
                range: 12.0,
                outer_angle: 0.5,
                inner_angle: 0.2,
                shadow_maps_enabled: true,
                ..default()
            },
            VolumetricLight,
            Transform::from_xyz(-4.0, 2.5, 6.5).looking_to(Vec3::new(1.0, -0.45, 0.2), Vec3::Y),
        ));
        stage.spawn(blue());
        stage.dress_spawned(NotShadowReceiver);
    }),
    ("a point light in a volume of fog", |stage| {
        stage.add_dark_fog();
        // The light near the lamp is too uneven for Bevy's default number of steps.
        stage.dress(VolumetricFog {
            ambient_intensity: 0.0,
            step_count: 1024,
            ..default()
        });
        stage.add((
            PointLight {
                intensity: 60_000.0,
                range: 6.0,
                shadow_maps_enabled: true,
                ..default()
            },
            VolumetricLight,
            Transform::from_xyz(-2.4, 1.6, 7.0),
        ));
        stage.spawn(blue());
        stage.dress_spawned((NotShadowCaster, NotShadowReceiver));
    }),
    ("a texture of the density of fog", |stage| {
        stage.add_fog_volume();
        stage.texture_fog();
        stage.spawn(blue());
        stage.dress_spawned(NotShadowReceiver);
    }),
    ("volumetric fog under the sky of an atmosphere", |stage| {
        // Bevy's fog is dark where another directional light shines.
        stage.add_air();
        stage.add_fog_volume();
        stage.spawn(blue());
        stage.open();
    }),
    ("an atmosphere's environment map", |stage| {
        stage.breathe(5_000.0);
        stage.dress(AtmosphereEnvironmentMapLight {
            size: UVec2::splat(64),
            ..default()
        });
        stage.spawn(StandardMaterial {
            metallic: 0.6,
            ..blue()
        });
    }),
    ("a generated environment map", |stage| {
        let environment_map = stage.colored_cube(64);
        stage.dress(GeneratedEnvironmentMapLight {
            environment_map,
            intensity: 700.0,
            ..default()
        });
        stage.spawn(StandardMaterial {
            metallic: 0.6,
            ..blue()
        });
    }),
    ("a skybox", |stage| {
        let image = Some(stage.colored_cube(64));
        stage.dress(Skybox {
            image,
            brightness: 700.0,
            rotation: Quat::from_rotation_y(0.5),
        });
        stage.light_and_spawn(blue());
        stage.open();
    }),
    ("levels of detail", |stage| {
        stage.light_and_spawn(blue());
        // The first level ends before both cameras: one is 2.5 m from the sheets, and the other one 8.5 m.
        stage.add_level(Color::linear_rgb(0.8, 0.3, 0.1), -0.7, 0.0..2.0);
        stage.add_level(Color::linear_rgb(0.1, 0.7, 0.2), 0.7, 2.0..50.0);
    }),
];

impl Stage<'_> {
    /// Surrounds everything with air.
    fn add_air(&mut self) {
        let medium = ScatteringMedium::earth(64, 64);
        let medium = add(self.app, medium);
        self.add(Atmosphere::earth(medium));
        self.dress(AtmosphereSettings::default());
    }

    /// Like `add_air`, with a low sun.
    fn breathe(&mut self, illuminance: f32) {
        self.add_air();
        self.add_sun(illuminance, false, LOW_SUN, SunDisk::OFF);
    }

    /// Fog between the camera and the wall behind it.
    fn add_dark_fog(&mut self) {
        // Points in fog with shadow tests are sampled, and so are the points of a mirror that the denoiser smooths.
        self.technique = ReflectionTechnique::Converged;
        self.frames = 64;
        self.dress(VolumetricFog {
            ambient_color: Color::linear_rgb(0.2, 0.5, 1.0),
            ambient_intensity: 0.05,
            ..default()
        });
        self.add((
            FogVolume {
                density_factor: 0.4,
                light_tint: Color::linear_rgb(1.0, 0.7, 0.4),
                light_intensity: 3.0,
                ..default()
            },
            // Beyond the camera that looks into the mirror, and beyond the mirrored one.
            Transform::from_xyz(0.0, 0.0, 8.0)
                .with_rotation(Quat::from_rotation_y(0.1))
                .with_scale(Vec3::new(9.0, 7.0, 6.0)),
        ));
    }

    /// Adds the light that makes it visible, too.
    fn add_fog_volume(&mut self) {
        self.add_dark_fog();
        self.add_sun(2000.0, true, Vec3::new(1.0, -0.35, 0.9), VolumetricLight);
    }

    /// Gives the fog a density texture, which is alternately dense and thin along each axis.
    fn texture_fog(&mut self) {
        const SIZE: u32 = 8;
        let texel = |i: u32| {
            let [x, y, z] =
                [i % SIZE, i / SIZE % SIZE, i / (SIZE * SIZE)].map(|place| place as f32 * TAU / SIZE as f32);
            (255.0 * (0.4 + 0.2 * (x.sin() + (y + 0.5).sin() + (2.0 * z).cos()))).clamp(0.0, 255.0) as u8
        };
        let texels = (0..SIZE * SIZE * SIZE).map(texel).collect();
        let mut image = image_of_layers(UVec3::splat(SIZE), TextureDimension::D3, TextureFormat::R8Unorm, texels);
        image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
            address_mode_u: ImageAddressMode::Repeat,
            address_mode_v: ImageAddressMode::Repeat,
            address_mode_w: ImageAddressMode::Repeat,
            ..ImageSamplerDescriptor::linear()
        });
        let image = add(self.app, image);
        let world = self.app.world();
        for entity in &self.spawned {
            if let Some(mut volume) = world.get_mut::<FogVolume>(*entity) {
                volume.density_texture = Some(image.clone());
                volume.density_texture_offset = Vec3::new(0.3, 0.1, 0.7);
            }
        }
    }

    /// Removes the wall behind the spawned objects.
    pub(super) fn open(&mut self) {
        let wall = self.spawned.pop().expect("something was spawned");
        self.app.world().despawn(wall);
    }

    /// A sheet before everything else that is visible from distances within a range.
    fn add_level(&mut self, color: Color, x: f32, range: Range<f32>) {
        let material = StandardMaterial {
            base_color: color,
            ..blue()
        };
        let at = Transform::from_xyz(x, 0.0, 5.5).looking_to(Vec3::Z, Vec3::Y);
        let level = self.put(Rectangle::new(1.2, 1.6), material, at);
        let range = VisibilityRange::abrupt(range.start, range.end);
        self.app.world().entity_mut(level).insert(range);
    }

    /// A cube map with smooth gradients of different colours on its faces.
    fn colored_cube(&mut self, size: u32) -> Handle<Image> {
        let shade = |place: u32| (255 * place / (size - 1)) as u8;
        let texel = |i: u32| {
            let (x, y, face) = (
                shade(i % size),
                shade(i / size % size),
                (40 * (i / (size * size))) as u8,
            );
            [face, x / 2 + 60, 255 - y / 2, 255]
        };
        let texels = (0..6 * size * size).flat_map(texel).collect();
        add(self.app, cube_map(size, texels))
    }
}
