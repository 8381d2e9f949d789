//! Rows of the mirror suite about fields of materials and vertices that Bevy's forward and deferred shading treat in ways of their own.

use super::{Row, Stage, blue};
use crate::stage::{add, image};
use bevy::{
    image::Image,
    material::OpaqueRendererMethod,
    math::Affine2,
    mesh::{UvChannel, VertexAttributeValues},
    prelude::*,
    render::render_resource::TextureFormat,
};
use bevy_glint::ReflectionTechnique;

pub(super) const ROWS: [Row; 12] = [
    ("a transform of both UV sets", |stage| {
        stage.spawn_with_second_uvs(AlphaMode::Opaque);
    }),
    (
        "a transform of both UV sets, in an alpha test and its shadow",
        |stage| {
            stage.spawn_with_second_uvs(AlphaMode::Mask(0.5));
        },
    ),
    ("specular tint of forward materials", |stage| {
        stage.light_and_spawn(tinted());
    }),
    ("specular tint of forward materials, on paths of two bounces", |stage| {
        stage.bounces = 2;
        stage.light_and_spawn(tinted());
    }),
    ("exposed emission of forward materials", |stage| {
        stage.spawn(StandardMaterial {
            emissive: LinearRgba::rgb(600.0, 300.0, 60.0),
            emissive_exposure_weight: 1.0,
            opaque_render_method: OpaqueRendererMethod::Forward,
            ..blue()
        });
    }),
    ("emission of deferred materials, which nothing exposes", |stage| {
        stage.spawn(StandardMaterial {
            emissive: LinearRgba::rgb(0.6, 0.3, 0.06),
            emissive_exposure_weight: 1.0,
            ..blue()
        });
    }),
    ("emission of blended materials", |stage| {
        stage.show_layers();
        stage.spawn(StandardMaterial {
            base_color: Color::linear_rgba(0.0, 0.0, 0.0, 0.6),
            emissive: LinearRgba::rgb(0.9, 0.45, 0.1),
            reflectance: 0.0,
            alpha_mode: AlphaMode::Blend,
            ..blue()
        });
    }),
    ("exposed emission of blended materials", |stage| {
        stage.show_layers();
        stage.spawn(StandardMaterial {
            base_color: Color::linear_rgba(0.0, 0.0, 0.0, 0.4),
            emissive: LinearRgba::rgb(900.0, 450.0, 100.0),
            emissive_exposure_weight: 0.97,
            reflectance: 0.0,
            alpha_mode: AlphaMode::Blend,
            ..blue()
        });
    }),
    ("diffuse transmission that deferred materials ignore", |stage| {
        stage.light_and_spawn(StandardMaterial {
            diffuse_transmission: 0.8,
            opaque_render_method: OpaqueRendererMethod::Deferred,
            ..blue()
        });
    }),
    ("vertex colours above 1, unlit", |stage| {
        stage.spawn(StandardMaterial {
            unlit: true,
            ..dim(OpaqueRendererMethod::Auto)
        });
        stage.paint();
    }),
    ("vertex colours above 1, deferred", |stage| {
        stage.light_and_spawn(dim(OpaqueRendererMethod::Auto));
        stage.paint();
    }),
    ("alpha to coverage, and its shadow", |stage| {
        let base_color_texture = Some(stage.spots());
        stage.light_and_spawn(StandardMaterial {
            base_color_texture,
            alpha_mode: AlphaMode::AlphaToCoverage,
            ..blue()
        });
    }),
];

fn dim(opaque_render_method: OpaqueRendererMethod) -> StandardMaterial {
    StandardMaterial {
        base_color: Color::linear_rgb(0.25, 0.25, 0.25),
        opaque_render_method,
        ..blue()
    }
}

fn tinted() -> StandardMaterial {
    StandardMaterial {
        base_color: Color::BLACK,
        reflectance: 1.0,
        specular_tint: Color::linear_rgb(0.2, 1.0, 0.4),
        perceptual_roughness: 0.6,
        opaque_render_method: OpaqueRendererMethod::Forward,
        ..blue()
    }
}

impl Stage<'_> {
    /// Exact mirrors show the first see-through surfaces without chance.
    pub(super) fn show_layers(&mut self) {
        self.technique = ReflectionTechnique::Quarter;
        self.own_rays = true;
    }

    /// Base colours by the second set of UVs, roughness by the first; both are transformed.
    fn spawn_with_second_uvs(&mut self, alpha_mode: AlphaMode) {
        let base_color_texture = Some(self.checkers([255, 160, 60, 255], [60, 90, 255, 0], true));
        let metallic_roughness_texture = Some(self.checkers([0, 80, 255, 255], [0, 255, 0, 255], false));
        self.light_and_spawn(StandardMaterial {
            base_color: Color::WHITE,
            base_color_texture,
            base_color_channel: UvChannel::Uv1,
            metallic_roughness_texture,
            uv_transform: Affine2::from_scale_angle_translation(Vec2::new(2.0, 0.7), 0.4, Vec2::new(0.25, 0.5)),
            alpha_mode,
            ..blue()
        });
        self.change_meshes(|mesh| {
            let uvs = mesh.attribute(Mesh::ATTRIBUTE_UV_0).unwrap().clone();
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_1, uvs);
        });
    }

    /// Colours of vertices from 0.02 to 4.
    fn paint(&mut self) {
        self.change_meshes(|mesh| {
            let count = mesh.count_vertices();
            // Few borders: if colours change from pixel to pixel, half a pixel makes a difference.
            let colors = (0..count).map(|i| {
                if 2 * i < count {
                    [4.0, 1.0, 0.02, 1.0]
                } else {
                    [0.2, 3.0, 1.0, 1.0]
                }
            });
            let colors: Vec<[f32; 4]> = colors.collect();
            mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, VertexAttributeValues::Float32x4(colors));
        });
    }

    fn change_meshes(&mut self, change: impl Fn(&mut Mesh)) {
        let world = self.app.world();
        for &entity in &self.spawned {
            let Some(mesh) = world.get::<Mesh3d>(entity).map(|mesh| mesh.id()) else {
                continue;
            };
            let mut meshes = world.resource_mut::<Assets<Mesh>>();
            change(&mut meshes.get_mut(mesh).unwrap());
        }
    }

    /// A round spot that fades at its border.
    fn spots(&mut self) -> Handle<Image> {
        const WIDTH: u32 = 32;
        let texels = (0..WIDTH * WIDTH).flat_map(|i| {
            let from_center = Vec2::new((i % WIDTH) as f32 - 15.5, (i / WIDTH) as f32 - 15.5).length() / 16.0;
            [60, 200, 40, (255.0 * (1.2 - from_center).clamp(0.0, 1.0)) as u8]
        });
        let format = TextureFormat::Rgba8UnormSrgb;
        add(self.app, image(UVec2::splat(WIDTH), format, texels.collect()))
    }
}
