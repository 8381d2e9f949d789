//! Skies as functions of direction, and the cube maps that Bevy's environment light needs, baked on the CPU.

use crate::random::{noise, smooth};
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageSampler, ToExtents},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat, TextureViewDescriptor, TextureViewDimension},
};
use half::f16;
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// The light that rays find when they leave a scene. Values are relative; the scene scales them to cd/m².
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sky {
    /// A radiance of 1 in every direction.
    White,
    /// Late afternoon: a blue vault with thin clouds, warm towards the sun; the sun's disc itself is left to a directional light.
    Evening {
        /// Unit vector towards the sun.
        sun: Vec3,
    },
    /// A bright hazy day.
    Day {
        /// Unit vector towards the sun.
        sun: Vec3,
    },
}

impl Sky {
    /// Radiance from a unit direction.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        match *self {
            Sky::White => Vec3::ONE,
            Sky::Evening { sun } => {
                let colors = [vec3(0.10, 0.20, 0.44), vec3(0.98, 0.62, 0.40), vec3(0.13, 0.11, 0.11)];
                vault(direction, sun, colors, vec3(1.9, 1.05, 0.5), 0.75)
            }
            Sky::Day { sun } => {
                let colors = [vec3(0.22, 0.42, 0.85), vec3(0.82, 0.90, 0.98), vec3(0.30, 0.27, 0.23)];
                vault(direction, sun, colors, vec3(1.6, 1.4, 1.1), 0.9)
            }
        }
    }

    /// Bakes the diffuse and specular cube maps.
    pub fn environment(&self, images: &mut Assets<Image>, intensity: f32) -> EnvironmentMapLight {
        let (diffuse_size, specular_size) = if *self == Sky::White { (4, 16) } else { (16, 128) };
        let source = Cube::bake(64, |direction| self.radiance(direction));
        let diffuse = Cube::bake(diffuse_size, |normal| {
            irradiance(normal, |direction| source.sample(direction))
        });
        let mut levels = vec![Cube::bake(specular_size, |direction| self.radiance(direction))];
        let count = specular_size.ilog2();
        for level in 1..=count {
            let perceptual_roughness = level as f32 / count as f32;
            let alpha = perceptual_roughness * perceptual_roughness;
            levels.push(Cube::bake(specular_size >> level, |reflected| {
                prefilter(reflected, alpha, |direction| source.sample(direction))
            }));
        }
        EnvironmentMapLight {
            diffuse_map: images.add(cube_image(&[diffuse])),
            specular_map: images.add(cube_image(&levels)),
            intensity,
            ..Default::default()
        }
    }

    /// Bakes the sky's image for the camera.
    pub fn background(&self, images: &mut Assets<Image>) -> Handle<Image> {
        let size = if *self == Sky::White { 4 } else { 256 };
        images.add(cube_image(&[Cube::bake(size, |direction| self.radiance(direction))]))
    }
}

fn vault(direction: Vec3, sun: Vec3, [zenith, horizon, ground]: [Vec3; 3], glow: Vec3, cloud_cover: f32) -> Vec3 {
    let up = direction.y;
    let towards_sun = direction.dot(sun).max(0.0);
    // The horizon is warm on the side of the sun and cooler opposite.
    let side = 0.5
        + 0.5
            * vec2(direction.x, direction.z)
                .normalize_or_zero()
                .dot(vec2(sun.x, sun.z).normalize_or_zero());
    let low = horizon.lerp(zenith * 1.6 + Vec3::splat(0.08), 0.62 * (1.0 - side));
    let mut color = low.lerp(zenith, ops::powf(up.clamp(0.0, 1.0), 0.45));
    color += glow * (0.55 * ops::powf(towards_sun, 48.0) + 0.16 * ops::powf(towards_sun, 6.0));
    if up > 0.0 {
        // Clouds on a plane overhead, thinning out towards the horizon.
        let p = vec2(direction.x, direction.z) / (up + 0.12) * 1.5;
        let octave = |scale: f32, seed| noise((p + Vec2::splat(100.0)) * scale, 4096, seed);
        let density = 0.5 * octave(1.0, 1) + 0.25 * octave(2.1, 2) + 0.14 * octave(4.3, 3) + 0.11 * octave(8.7, 4);
        let cover = smooth(0.50, 0.74, density) * smooth(0.02, 0.22, up) * cloud_cover;
        let lit = horizon * 0.9 + glow * (0.12 + 0.35 * ops::powf(towards_sun, 4.0));
        color = color.lerp(lit, 0.7 * cover);
    }
    color.lerp(ground * (0.7 + 0.6 * side), smooth(0.03, -0.06, up))
}

/// A cube map of f32 colours, indexed as the GPU does.
struct Cube {
    size: u32,
    texels: Vec<Vec3>,
}

impl Cube {
    /// Evaluates a function of the world direction at every texel's centre.
    fn bake(size: u32, value: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let size = size.max(1);
        let texel = |i: u32| {
            let (face, texel) = (i / (size * size), i % (size * size));
            let st = (vec2((texel % size) as f32, (texel / size) as f32) + 0.5) / size as f32 * 2.0 - 1.0;
            value(direction_of(face, st))
        };
        let texels = (0..6 * size * size).into_par_iter().map(texel).collect();
        Self { size, texels }
    }

    /// The nearest texel: good enough below an integral.
    fn sample(&self, direction: Vec3) -> Vec3 {
        let (face, st) = face_of(direction);
        let at = |v: f32| (((v * 0.5 + 0.5) * self.size as f32) as u32).min(self.size - 1);
        self.texels[((face * self.size + at(st.y)) * self.size + at(st.x)) as usize]
    }
}

/// World direction of a point of a cube map's face, `st` in -1..1 with t down. Bevy looks cube maps up with z negated, as they
/// are left-handed.
fn direction_of(face: u32, st: Vec2) -> Vec3 {
    let (s, t) = (st.x, st.y);
    let cube = match face {
        0 => vec3(1.0, -t, -s),
        1 => vec3(-1.0, -t, s),
        2 => vec3(s, 1.0, t),
        3 => vec3(s, -1.0, -t),
        4 => vec3(s, -t, 1.0),
        _ => vec3(-s, -t, -1.0),
    };
    (cube * vec3(1.0, 1.0, -1.0)).normalize()
}

/// The inverse of [`direction_of`].
fn face_of(direction: Vec3) -> (u32, Vec2) {
    let d = direction * vec3(1.0, 1.0, -1.0);
    let a = d.abs();
    let (face, major, s, t) = if a.x >= a.y && a.x >= a.z {
        if d.x > 0.0 {
            (0, a.x, -d.z, -d.y)
        } else {
            (1, a.x, d.z, -d.y)
        }
    } else if a.y >= a.z {
        if d.y > 0.0 {
            (2, a.y, d.x, d.z)
        } else {
            (3, a.y, d.x, -d.z)
        }
    } else if d.z > 0.0 {
        (4, a.z, d.x, -d.y)
    } else {
        (5, a.z, -d.x, -d.y)
    };
    (face, vec2(s, t) / major.max(1e-20))
}

/// Point `i` of `n` of the Hammersley set.
fn hammersley(i: u32, n: u32) -> Vec2 {
    vec2((i as f32 + 0.5) / n as f32, i.reverse_bits() as f32 / 4_294_967_296.0)
}

/// Mean radiance over the cosine lobe: Bevy's diffuse map contains irradiance divided by pi.
fn irradiance(normal: Vec3, radiance: impl Fn(Vec3) -> Vec3) -> Vec3 {
    const SAMPLES: u32 = 256;
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    let sum: Vec3 = (0..SAMPLES)
        .map(|i| {
            let xi = hammersley(i, SAMPLES);
            let (r, phi) = (xi.x.sqrt(), xi.y * TAU);
            let local = vec3(r * ops::cos(phi), r * ops::sin(phi), (1.0 - xi.x).max(0.0).sqrt());
            radiance(tangent * local.x + bitangent * local.y + normal * local.z)
        })
        .sum();
    sum / SAMPLES as f32
}

/// Radiance over the GGX lobe around a reflected direction, seen head-on (the split-sum approximation).
fn prefilter(reflected: Vec3, alpha: f32, radiance: impl Fn(Vec3) -> Vec3) -> Vec3 {
    const SAMPLES: u32 = 128;
    let (tangent, bitangent) = reflected.any_orthonormal_pair();
    let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
    for i in 0..SAMPLES {
        let xi = hammersley(i, SAMPLES);
        let cos2 = (1.0 - xi.x) / (1.0 + (alpha * alpha - 1.0) * xi.x).max(1e-7);
        let (cos, sin, phi) = (cos2.sqrt(), (1.0 - cos2).max(0.0).sqrt(), xi.y * TAU);
        let half = tangent * sin * ops::cos(phi) + bitangent * sin * ops::sin(phi) + reflected * cos;
        let light = 2.0 * reflected.dot(half) * half - reflected;
        let n_dot_l = reflected.dot(light);
        if n_dot_l > 0.0 {
            sum += n_dot_l * radiance(light);
            weight += n_dot_l;
        }
    }
    if weight > 0.0 {
        sum / weight
    } else {
        radiance(reflected)
    }
}

/// Nearest half float of a value that is not negative. Ties round up instead of to even: the stored images were made with such skies.
fn half(value: f32) -> f16 {
    f16::from_f32(f32::from_bits(value.to_bits() | 1))
}

/// A cube map image of half floats, with the given cubes as mip levels.
fn cube_image(levels: &[Cube]) -> Image {
    let size = levels.first().map_or(1, |cube| cube.size);
    let mut data = Vec::new();
    for face in 0..6usize {
        for cube in levels {
            let per_face = (cube.size * cube.size) as usize;
            for texel in &cube.texels[face * per_face..(face + 1) * per_face] {
                for value in [texel.x, texel.y, texel.z, 1.0] {
                    data.extend(half(value).to_le_bytes());
                }
            }
        }
    }
    let mut image = Image::new_uninit(
        UVec3::new(size, size, 6).to_extents(),
        TextureDimension::D2,
        TextureFormat::Rgba16Float,
        RenderAssetUsages::default(),
    );
    image.texture_descriptor.mip_level_count = levels.len().max(1) as u32;
    image.data = Some(data);
    as_cube(image)
}

/// A cube map of equal texels.
pub fn even_cube(side: u32, texel: &[u8], format: TextureFormat) -> Image {
    let (size, usage) = (UVec3::new(side, side, 6).to_extents(), RenderAssetUsages::default());
    as_cube(Image::new_fill(size, TextureDimension::D2, texel, format, usage))
}

fn as_cube(mut image: Image) -> Image {
    image.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..Default::default()
    });
    image.sampler = ImageSampler::linear();
    image
}

/// Unit vector towards a sun at the given azimuth (degrees from -z towards +x) and elevation (degrees).
pub fn sun_direction(azimuth: f32, elevation: f32) -> Vec3 {
    let (azimuth, elevation) = (azimuth * PI / 180.0, elevation * PI / 180.0);
    let ring = ops::cos(elevation);
    vec3(ring * ops::sin(azimuth), ops::sin(elevation), -ring * ops::cos(azimuth))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_and_faces_agree() {
        for face in 0..6 {
            for st in [vec2(0.3, -0.7), vec2(-0.9, 0.1), Vec2::ZERO] {
                let (back, at) = face_of(direction_of(face, st));
                assert_eq!(back, face);
                assert!(at.distance(st) < 1e-5);
            }
        }
    }

    #[test]
    fn a_white_sky_stays_white() {
        for alpha in [0.0, 0.2, 1.0] {
            assert!(prefilter(Vec3::Y, alpha, |_| Vec3::ONE).distance(Vec3::ONE) < 1e-5);
        }
        assert!(irradiance(Vec3::X, |_| Vec3::ONE).distance(Vec3::ONE) < 1e-5);
    }
}
