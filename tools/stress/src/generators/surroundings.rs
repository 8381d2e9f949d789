//! Environment maps of all formats and rotations, backgrounds, ambient light and fog.

use super::Builder;
use bevy::{
    light::Skybox,
    pbr::{DistanceFog, FogFalloff},
    prelude::*,
    render::{render_resource::TextureFormat, settings::WgpuFeatures},
};
use glint_scenes::even_cube;

/// Texels along the side of a cube's face.
const SIDE: u32 = 4;

/// A gray texel of half floats.
const GRAY: [u16; 4] = [0x3800, 0x3800, 0x3800, 0x3c00];
const NAN: f32 = f32::NAN;

kinds! {
    SurroundingsKind, pub fn add(builder: &mut Builder) {
        // Neither an environment map nor a sky.
        Absent => (builder.scene.camera.light, builder.scene.camera.skybox) = (None, None),
        Rotated => rotate(builder, Quat::from_euler(EulerRot::XYZ, 0.5, 1.5, -2.5)),
        ZeroRotation => rotate(builder, Quat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        NanRotation => rotate(builder, Quat::from_xyzw(NAN, 0.0, 0.0, 1.0)),
        Dark => dim(builder, 0.0),
        Bright => dim(builder, 1e6),
        NanIntensity => dim(builder, NAN),
        InfiniteIntensity => dim(builder, f32::INFINITY),
        NegativeIntensity => dim(builder, -10.0),
        EightBits => cube(builder, TextureFormat::Rgba8Unorm, SIDE, &[120, 100, 80, 255]),
        EightBitsSrgb => cube(builder, TextureFormat::Rgba8UnormSrgb, SIDE, &[120, 100, 80, 255]),
        SharedExponent => cube(builder, TextureFormat::Rgb9e5Ufloat, SIDE, &[0x80, 0, 2, 0x78]),
        SmallFloats => cube(builder, TextureFormat::Rg11b10Ufloat, SIDE, &[0x80, 0x03, 0x1c, 0x70]),
        LargeFloats => large_floats(builder),
        OneTexel => halves(builder, 1, GRAY),
        // And infinite ones.
        NanTexels => halves(builder, SIDE, [0x7e00, 0x7c00, 0xfc00, 0x7e00]),
        NeverLoads => { let image = builder.absent_image(); use_image(builder, image); },
        SkyOnly => builder.scene.camera.light = None,
        LightOnly => builder.scene.camera.skybox = None,
        NanBackground => clear(builder, ClearColorConfig::Custom(Color::linear_rgb(NAN, 1.0, 1.0))),
        NoBackground => clear(builder, ClearColorConfig::None),
        Ambient => only_ambient(builder, 3.0),
        NanAmbient => only_ambient(builder, NAN),
        Fog => random_fog(builder),
        NanFog => fog(builder, Color::linear_rgba(NAN, 0.5, 0.5, NAN), FogFalloff::Exponential { density: NAN }),
    }
}

fn rotate(builder: &mut Builder, rotation: Quat) {
    let camera = &mut builder.scene.camera;
    camera.light.iter_mut().for_each(|light| light.rotation = rotation);
    camera.skybox.iter_mut().for_each(|sky| sky.rotation = rotation);
}

fn dim(builder: &mut Builder, intensity: f32) {
    let camera = &mut builder.scene.camera;
    camera.light.iter_mut().for_each(|light| light.intensity = intensity);
    camera.skybox.iter_mut().for_each(|sky| sky.brightness = intensity);
}

fn halves(builder: &mut Builder, side: u32, texel: [u16; 4]) {
    cube(
        builder,
        TextureFormat::Rgba16Float,
        side,
        &texel.map(u16::to_le_bytes).concat(),
    );
}

/// Floats of 32 bits, if they can be filtered.
fn large_floats(builder: &mut Builder) {
    let device = builder.harness.device();
    if device.is_some_and(|device| device.features().contains(WgpuFeatures::FLOAT32_FILTERABLE)) {
        let texel = [0.5f32, 0.25, 0.125, 1.0].map(f32::to_le_bytes).concat();
        cube(builder, TextureFormat::Rgba32Float, SIDE, &texel);
    } else {
        halves(builder, 1, GRAY);
    }
}

/// Makes a cube map of one colour and one level the environment map and the sky.
fn cube(builder: &mut Builder, format: TextureFormat, side: u32, texel: &[u8]) {
    let image = builder.image(even_cube(side, texel, format));
    use_image(builder, image);
}

/// Makes the image the environment map and the sky.
fn use_image(builder: &mut Builder, image: Handle<Image>) {
    builder.scene.camera.light = Some(EnvironmentMapLight {
        diffuse_map: image.clone(),
        specular_map: image.clone(),
        intensity: 1.0,
        ..default()
    });
    builder.scene.camera.skybox = Some(Skybox {
        image: Some(image),
        brightness: 1.0,
        ..default()
    });
}

fn clear(builder: &mut Builder, color: ClearColorConfig) {
    let camera = &mut builder.scene.camera;
    (camera.skybox, camera.camera.clear_color) = (None, color);
}

fn only_ambient(builder: &mut Builder, brightness: f32) {
    let camera = &mut builder.scene.camera;
    (camera.light, camera.ambient.brightness) = (None, brightness);
}

fn fog(builder: &mut Builder, color: Color, falloff: FogFalloff) {
    builder.scene.camera.fog = Some(DistanceFog {
        color,
        falloff,
        ..default()
    });
}

fn random_fog(builder: &mut Builder) {
    let random = &mut builder.scene.random;
    let density = random.range(0.01, 0.5);
    let falloff = match random.below(4) {
        0 => FogFalloff::Linear { start: 1.0, end: 1.0 },
        1 => FogFalloff::Exponential { density },
        2 => FogFalloff::ExponentialSquared { density },
        _ => FogFalloff::Atmospheric {
            extinction: Vec3::splat(density),
            inscattering: Vec3::splat(density),
        },
    };
    fog(builder, Color::linear_rgba(0.5, 0.5, 0.6, 0.8), falloff);
}
