//! Materials and lights as they are packed for shaders.

use bevy::{
    asset::Handle,
    color::Color,
    image::Image,
    light::{DirectionalLight, PointLight, RectLight, SpotLight},
    math::{Affine2, Quat, Vec2, Vec3},
    mesh::UvChannel,
    pbr::StandardMaterial,
    prelude::{AlphaMode, GlobalTransform, LinearRgba, Transform},
    render::render_resource::{Face, TextureFormat},
};
use bevy_glint::internals::{bvh::TRAVERSAL_FLAGS, gpu_types::*, materials::*, pack_lights::*};

#[test]
fn defaults_keep_their_values() {
    let packed = pack_material(&StandardMaterial::default());
    assert_eq!(packed.base_color, [1.0; 4]);
    assert_eq!(packed.textures, [NO_TEXTURE; 5]);
    assert_eq!((packed.metallic, packed.perceptual_roughness), (0.0, 0.5));
    assert!((packed.reflectance - 0.5).abs() < 1e-6);
    assert_eq!(packed.uv_transform, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!((packed.flags, packed.alpha_cutoff), (MATERIAL_FOG, 0.0));
}

#[test]
fn bad_values_are_contained() {
    let packed = pack_material(&StandardMaterial {
        base_color: Color::linear_rgba(f32::NAN, -1.0, 2.0, 7.0),
        emissive: LinearRgba::new(f32::INFINITY, -3.0, 5000.0, 1.0),
        metallic: 2.0,
        perceptual_roughness: f32::NAN,
        reflectance: f32::NEG_INFINITY,
        alpha_mode: AlphaMode::Mask(f32::NAN),
        uv_transform: Affine2::from_scale(Vec2::new(f32::NAN, 1.0)),
        ..Default::default()
    });
    assert_eq!(packed.base_color, [0.0, 0.0, 2.0, 1.0]);
    assert_eq!(packed.emissive, [0.0, 0.0, 5000.0, 0.0]);
    assert_eq!(
        (packed.metallic, packed.perceptual_roughness, packed.reflectance),
        (1.0, 0.5, 0.5)
    );
    assert_eq!(packed.alpha_cutoff, 0.5);
    assert_eq!(
        (packed.uv_transform, packed.uv_offset),
        ([1.0, 0.0, 0.0, 1.0], [0.0; 2])
    );
}

#[test]
fn flags_follow_the_material() {
    let material = StandardMaterial {
        unlit: true,
        double_sided: true,
        cull_mode: None,
        flip_normal_map_y: true,
        normal_map_channel: UvChannel::Uv1,
        normal_map_texture: Some(Handle::<Image>::default()),
        alpha_mode: AlphaMode::Mask(0.25),
        uv_transform: Affine2::from_scale_angle_translation(Vec2::new(2.0, 3.0), 0.0, Vec2::new(4.0, 5.0)),
        ..Default::default()
    };
    let packed = pack_material(&material);
    let channel = 1 << (MATERIAL_UV1_SHIFT + TEXTURE_NORMAL as u32);
    assert_eq!(
        packed.flags,
        MATERIAL_UNLIT | MATERIAL_DOUBLE_SIDED | MATERIAL_FLIP_NORMAL_MAP_Y | MATERIAL_FOG | channel
    );
    assert_eq!(packed.alpha_cutoff, 0.25);
    assert_eq!(
        (packed.uv_transform, packed.uv_offset),
        ([2.0, 0.0, 0.0, 3.0], [4.0, 5.0])
    );
    assert_eq!(instance_flags(&material) & TRAVERSAL_FLAGS, INSTANCE_ALPHA_MASKED);
    assert_eq!(
        texture_ids(&material).map(|id| id.is_some()),
        [false, false, false, true, false]
    );

    assert_eq!(
        instance_flags(&StandardMaterial::default()) & TRAVERSAL_FLAGS,
        INSTANCE_CULL_BACK
    );
    let front = StandardMaterial {
        cull_mode: Some(Face::Front),
        ..Default::default()
    };
    assert_eq!(instance_flags(&front) & TRAVERSAL_FLAGS, INSTANCE_CULL_FRONT);
}

#[test]
fn light_passes_through_blended_and_transmissive_materials() {
    let pack = |alpha_mode, specular_transmission, diffuse_transmission| {
        let material = StandardMaterial {
            base_color: Color::linear_rgba(1.0, 1.0, 1.0, 0.25),
            alpha_mode,
            specular_transmission,
            diffuse_transmission,
            ..Default::default()
        };
        let packed = pack_material(&material);
        let is_tested = instance_flags(&material) & INSTANCE_ALPHA_MASKED != 0;
        let [.., alpha] = packed.base_color;
        (is_tested, alpha, packed.stop_probability, packed.diffuse_share)
    };
    assert_eq!(pack(AlphaMode::Opaque, 0.0, 0.0), (false, 1.0, -1.0, 1.0));
    assert_eq!(pack(AlphaMode::Opaque, 0.0, 0.75), (false, 1.0, -1.0, 0.25));
    assert_eq!(pack(AlphaMode::Opaque, 0.75, 0.5), (true, 1.0, 0.25, 0.5));
    assert_eq!(pack(AlphaMode::Opaque, f32::NAN, f32::NAN), (false, 1.0, -1.0, 1.0));
    assert_eq!(pack(AlphaMode::Blend, 0.0, 0.0), (true, 0.25, 1.0, 1.0));
    assert_eq!(pack(AlphaMode::Blend, 7.0, -1.0), (true, 0.25, 0.0, 1.0));
    // Masks are cut out, and lose their transmission.
    assert_eq!(pack(AlphaMode::Mask(0.5), 0.5, 0.5), (true, 0.25, -1.0, 0.25));
    assert_eq!(pack(AlphaMode::AlphaToCoverage, 0.0, 0.0), (true, 0.25, COVERAGE, 1.0));
}

#[test]
fn what_only_adds_light_is_not_traced() {
    for (alpha_mode, traced) in [
        (AlphaMode::Opaque, true),
        (AlphaMode::Mask(0.5), true),
        (AlphaMode::Blend, true),
        (AlphaMode::Premultiplied, true),
        (AlphaMode::AlphaToCoverage, true),
        (AlphaMode::Add, false),
        (AlphaMode::Multiply, false),
    ] {
        assert_eq!(
            is_traced(&StandardMaterial {
                alpha_mode,
                ..Default::default()
            }),
            traced,
            "{alpha_mode:?}"
        );
    }
}

#[test]
fn formats_of_two_channels_are_found() {
    assert_eq!(
        format_flags(Some(TextureFormat::Rgba8Unorm), Some(TextureFormat::Rgba8Unorm)),
        0
    );
    assert_eq!(
        format_flags(Some(TextureFormat::Rg8Unorm), None),
        MATERIAL_METALLIC_ROUGHNESS_RG
    );
    assert_eq!(
        format_flags(None, Some(TextureFormat::Bc5RgUnorm)),
        MATERIAL_TWO_COMPONENT_NORMAL_MAP
    );
}

#[test]
fn an_index_stays_with_its_material() {
    let mut table = MaterialTable::default();
    assert_eq!(table.take_dirty(), Some(0..1));
    let id = Handle::<StandardMaterial>::default().id().untyped();
    let index = table.index(id);
    assert_eq!((index, table.index(id)), (1, 1));
    assert_eq!(table.take_dirty(), Some(1..2));
    assert_eq!(table.take_dirty(), None);
    assert_eq!(table.materials()[1], table.materials()[DEFAULT_MATERIAL as usize]);
}

#[test]
fn lights_come_in_the_units_of_bevys_shaders() {
    let place = GlobalTransform::from(Transform::from_xyz(1.0, 2.0, 3.0));
    let four_pi = 4.0 * std::f32::consts::PI;
    let point = PointLight {
        intensity: four_pi * 10.0,
        range: 2.0,
        radius: 0.5,
        color: Color::WHITE,
        ..Default::default()
    };
    let packed = point_light(&point, &place).unwrap();
    assert!((packed.color[0] - 10.0).abs() < 1e-4);
    assert_eq!(
        (packed.kind, packed.position, packed.radius),
        (LIGHT_POINT, [1.0, 2.0, 3.0], 0.5)
    );
    assert_eq!((packed.inverse_range_squared, packed.flags), (0.25, 0));

    let spot = SpotLight {
        inner_angle: 0.3,
        outer_angle: 0.6,
        shadow_maps_enabled: true,
        ..Default::default()
    };
    let packed = spot_light(&spot, &place).unwrap();
    let attenuation = |angle: f32| (angle.cos() * packed.spot[0] + packed.spot[1]).clamp(0.0, 1.0);
    assert!((attenuation(0.3) - 1.0).abs() < 1e-5 && attenuation(0.6).abs() < 1e-5);
    assert_eq!((packed.direction, packed.flags), ([0.0, 0.0, -1.0], LIGHT_CASTS_SHADOW));

    let down = GlobalTransform::from(Transform::default().looking_to(Vec3::NEG_Y, Vec3::X));
    let packed = directional_light(
        &DirectionalLight {
            illuminance: 1000.0,
            ..Default::default()
        },
        &down,
    )
    .unwrap();
    assert!((Vec3::from(packed.direction) - Vec3::Y).length() < 1e-6);
    assert_eq!(packed.color, [1000.0; 3]);
}

#[test]
fn rectangles_keep_their_axes() {
    let turned = Transform::from_rotation(Quat::from_euler(bevy::math::EulerRot::XYZ, 0.4, -1.2, 2.5));
    let transform = GlobalTransform::from(turned.with_scale(Vec3::new(2.0, 1.0, 1.0)));
    let packed = rect_light(
        &RectLight {
            width: 1.0,
            height: 3.0,
            ..Default::default()
        },
        &transform,
    )
    .unwrap();
    assert!((packed.spot[0] - 1.0).abs() < 1e-5 && (packed.spot[1] - 1.5).abs() < 1e-5);
    let direction = Vec3::from(packed.direction);
    assert!((direction - *turned.forward()).length() < 1e-5);
    // The way back in `lights.wesl`.
    let s = if direction.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + direction.z);
    let reference = Vec3::new(
        1.0 + s * direction.x * direction.x * a,
        s * direction.x * direction.y * a,
        -s * direction.x,
    );
    let right = packed.radius.cos() * reference + packed.radius.sin() * direction.cross(reference);
    assert!((right - *turned.right()).length() < 1e-5);
    assert!((right.cross(direction) - *turned.up()).length() < 1e-5);
}

#[test]
fn lights_without_light_are_left_out() {
    let place = GlobalTransform::IDENTITY;
    for illuminance in [0.0, f32::NAN] {
        let sun = DirectionalLight {
            illuminance,
            ..Default::default()
        };
        assert!(directional_light(&sun, &place).is_none(), "{illuminance} lx");
    }
    let negative = PointLight {
        intensity: -5.0,
        ..Default::default()
    };
    assert!(point_light(&negative, &place).is_none());
    let lost = GlobalTransform::from(Transform::from_xyz(f32::NAN, 0.0, 0.0));
    assert!(point_light(&PointLight::default(), &lost).is_none());
    let flat = GlobalTransform::from(Transform::from_scale(Vec3::ZERO));
    assert!(spot_light(&SpotLight::default(), &flat).is_none());
    assert!(rect_light(&RectLight::default(), &flat).is_none());
    let nowhere = PointLight {
        range: f32::NAN,
        radius: f32::NAN,
        ..Default::default()
    };
    let nowhere = point_light(&nowhere, &place).unwrap();
    assert!(nowhere.inverse_range_squared.is_finite() && nowhere.radius == 0.0);
}
