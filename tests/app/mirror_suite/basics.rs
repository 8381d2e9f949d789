//! Rows of the mirror suite about single lights and their shadows, plain materials, lightmaps, glass and fog.

use super::{Row, blue};
use crate::stage::{behind, unlit};
use bevy::{
    camera::visibility::RenderLayers, material::OpaqueRendererMethod, pbr::ScreenSpaceTransmission, prelude::*,
    render::render_resource::Face,
};
use bevy_glint::ReflectionTechnique;

pub(super) const ROWS: [Row; 32] = [
    ("unlit", |stage| stage.spawn(StandardMaterial { unlit: true, ..blue() })),
    ("directional light", |stage| stage.light_and_spawn(blue())),
    ("shadow of a directional light", |stage| {
        stage.add_sun_with_shadows(RenderLayers::default());
        stage.spawn(blue());
    }),
    ("shadows of faces that are not drawn", |stage| {
        stage.add_sun_with_shadows(RenderLayers::default());
        let back = behind(12.0);
        let white = StandardMaterial {
            base_color: Color::WHITE,
            ..blue()
        };
        stage.put(Rectangle::new(60.0, 60.0), white, back);
        for (x, to, cull_mode) in [
            (-4.0, Vec3::NEG_Z, Some(Face::Back)),
            (-1.5, Vec3::Z, Some(Face::Front)),
            (1.0, Vec3::Z, None),
            (3.5, Vec3::Z, Some(Face::Back)),
        ] {
            let material = StandardMaterial { cull_mode, ..blue() };
            let at = Transform::from_xyz(x, 2.5, 9.0).looking_to(to, Vec3::Y);
            stage.put(Rectangle::new(1.4, 1.4), material, at);
        }
    }),
    ("a lamp in a bulb", |stage| {
        stage.add((
            PointLight {
                intensity: 200_000.0,
                range: 5.5,
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::from_xyz(0.3, 1.8, 8.5),
        ));
        stage.spawn(blue());
        stage.put(
            Sphere::new(0.4),
            unlit([200, 180, 90]),
            Transform::from_xyz(0.3, 1.8, 8.5),
        );
    }),
    ("point light", |stage| {
        stage.add((
            PointLight {
                intensity: 60_000.0,
                range: 5.5,
                radius: 0.1,
                ..default()
            },
            Transform::from_xyz(0.5, 0.5, 5.6),
        ));
        stage.spawn(blue());
    }),
    ("spot light", |stage| {
        stage.add((
            SpotLight {
                intensity: 150_000.0,
                range: 20.0,
                outer_angle: 0.5,
                inner_angle: 0.2,
                ..default()
            },
            behind(5.0),
        ));
        stage.spawn(blue());
    }),
    ("ambient light", |stage| {
        stage.dress(AmbientLight {
            brightness: 600.0,
            ..default()
        });
        stage.spawn(blue());
    }),
    ("metal", |stage| {
        stage.light_and_spawn(StandardMaterial {
            metallic: 0.8,
            ..blue()
        });
    }),
    ("rough dielectric", |stage| {
        stage.light_and_spawn(StandardMaterial {
            perceptual_roughness: 0.9,
            reflectance: 0.2,
            ..blue()
        });
    }),
    ("emission", |stage| {
        stage.spawn(StandardMaterial {
            emissive: LinearRgba::rgb(0.2, 0.8, 0.1),
            ..blue()
        });
    }),
    ("base-colour texture with alpha test", |stage| {
        let base_color_texture = Some(stage.checkers([255, 255, 255, 255], [255, 0, 0, 0], true));
        stage.light_and_spawn(StandardMaterial {
            base_color_texture,
            alpha_mode: AlphaMode::Mask(0.5),
            ..blue()
        });
    }),
    ("normal map", |stage| {
        let normal_map_texture = Some(stage.checkers([150, 128, 250, 255], [100, 150, 240, 255], false));
        stage.light_and_spawn(StandardMaterial {
            normal_map_texture,
            ..blue()
        });
    }),
    ("metallic and roughness texture", |stage| {
        let metallic_roughness_texture = Some(stage.checkers([0, 80, 255, 255], [0, 255, 0, 255], false));
        stage.light_and_spawn(StandardMaterial {
            metallic_roughness_texture,
            metallic: 1.0,
            ..blue()
        });
    }),
    ("two-sided surfaces", |stage| {
        let material = StandardMaterial {
            double_sided: true,
            cull_mode: None,
            ..blue()
        };
        stage.light_and_spawn(material.clone());
        stage.turn_a_back(material);
    }),
    ("backs of one-sided surfaces", |stage| {
        stage.light_and_spawn(blue());
        stage.turn_a_back(blue());
    }),
    ("lightmap", |stage| {
        stage.spawn_baked(StandardMaterial {
            metallic: 0.3,
            lightmap_exposure: 2000.0,
            ..blue()
        });
    }),
    ("lightmap on a colour above 1", |stage| {
        stage.spawn_baked(StandardMaterial {
            base_color: Color::linear_rgb(0.3, 2.5, 1.6),
            lightmap_exposure: 500.0,
            ..blue()
        });
    }),
    ("lightmap on a deferred surface that transmits light", |stage| {
        stage.spawn_baked(StandardMaterial {
            diffuse_transmission: 0.7,
            opaque_render_method: OpaqueRendererMethod::Deferred,
            lightmap_exposure: 2000.0,
            ..blue()
        });
    }),
    ("lightmap on a premultiplied surface", |stage| {
        stage.show_layers();
        stage.spawn_baked(StandardMaterial {
            base_color: Color::linear_rgba(0.1, 0.3, 0.8, 0.5),
            alpha_mode: AlphaMode::Premultiplied,
            lightmap_exposure: 2000.0,
            ..blue()
        });
    }),
    ("coloured glass", |stage| {
        // Rough glass blurs the surfaces behind it, and reflects: in Bevy's image only.
        stage.dress(ScreenSpaceTransmission::default());
        let base_color_texture = Some(stage.checkers([255, 160, 60, 255], [90, 255, 200, 255], true));
        stage.light_and_spawn(StandardMaterial {
            base_color_texture,
            specular_transmission: 1.0,
            perceptual_roughness: 0.0,
            reflectance: 0.0,
            ..blue()
        });
    }),
    ("glass that emits light", |stage| {
        // Rays that pass it by chance see its light as noise.
        stage.technique = ReflectionTechnique::Quarter;
        stage.own_rays = true;
        stage.dress(ScreenSpaceTransmission::default());
        stage.light_and_spawn(StandardMaterial {
            base_color: Color::linear_rgb(0.9, 0.8, 0.6),
            specular_transmission: 0.8,
            perceptual_roughness: 0.0,
            reflectance: 0.0,
            emissive: LinearRgba::rgb(0.05, 0.2, 0.3),
            ..blue()
        });
    }),
    ("glass with thickness, index and absorption", |stage| {
        // Only at lower resolutions do mirrors have their own rays.
        stage.technique = ReflectionTechnique::Quarter;
        stage.own_rays = true;
        stage.spawn_thick_glass();
    }),
    ("the same glass, by chance", |stage| stage.spawn_thick_glass()),
    ("the same glass, at rest", |stage| {
        stage.technique = ReflectionTechnique::Converged;
        stage.frames = 16;
        stage.spawn_thick_glass();
    }),
    ("linear fog", |stage| {
        stage.spawn_in_fog(FogFalloff::Linear { start: 2.0, end: 16.0 }, Color::NONE);
    }),
    ("exponential fog", |stage| {
        stage.spawn_in_fog(FogFalloff::Exponential { density: 0.1 }, Color::NONE);
    }),
    ("squared exponential fog", |stage| {
        stage.spawn_in_fog(FogFalloff::ExponentialSquared { density: 0.1 }, Color::NONE);
    }),
    ("atmospheric fog", |stage| {
        let extinction = Vec3::new(0.05, 0.08, 0.12);
        let inscattering = Vec3::new(0.03, 0.06, 0.15);
        stage.spawn_in_fog(
            FogFalloff::Atmospheric {
                extinction,
                inscattering,
            },
            Color::NONE,
        );
    }),
    ("glow of fog around the sun", |stage| {
        // The fog before the mirror glows as much as the fog behind it, if light comes from the side.
        stage.sun = Vec3::new(1.0, -0.2, 0.0);
        stage.spawn_in_fog(
            FogFalloff::Exponential { density: 0.1 },
            Color::linear_rgba(1.0, 0.6, 0.2, 0.5),
        );
    }),
    ("translucent fog", |stage| {
        stage.fog_color = Color::linear_rgba(0.1, 0.3, 0.2, 0.5);
        stage.spawn_in_fog(FogFalloff::Linear { start: 2.0, end: 16.0 }, Color::NONE);
    }),
    ("a material without fog", |stage| {
        stage.material.fog_enabled = false;
        stage.set_fog_before_the_mirror(false);
        stage.spawn_in_fog(FogFalloff::Exponential { density: 0.1 }, Color::NONE);
    }),
];
