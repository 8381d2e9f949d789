//! A wall that faces the camera, its rays, and the results of the denoiser's passes.
use super::pass::{Pass, View};
use crate::{
    compute::Uniform,
    gpu::Gpu,
    sampling::reference::{ReflectionSample, guard_view, orthonormal_basis, reflection_pdf, sample_reflection, sobol},
    wesl::Shaders,
};
use bevy::math::{Mat4, UVec2, Vec2, Vec3, uvec2, vec2, vec3};
use bevy_glint::internals::directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo};
use std::sync::LazyLock;
use wgpu::TextureFormat;

pub const VIRTUAL_HISTORY: u32 = 16;
pub const SUPPRESS_FIREFLIES: u32 = 32;
pub const RATE_ACTIVE: u32 = 0x100;

/// Writes the radiance that the composite shows in each pixel, before albedo.
const SHOWN: &str = "
import package::denoise::blur::shown_radiance;
import package::gbuffer::{load_pixel, load_texels, reflection_view};

@group(0) @binding(10) var shown_out: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8)
fn shown(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let columns = (reflection_view.size.x + 7u) / 8u;
    let id = vec2(group.x % columns, group.x / columns) * 8u + local.xy;
    if all(id < reflection_view.size) {
        textureStore(shown_out, id, vec4(shown_radiance(id, load_pixel(id), load_texels(id).normal), 0.0));
    }
}
";

const NEAR: f32 = 0.1;

/// The scene of the passes: every pixel is metal.
#[derive(Clone)]
pub struct Wall {
    pub size: UVec2,
    /// Metres from the camera.
    pub distance: f32,
    pub trace_scale: u32,
    /// Code of all tiles.
    pub rate: u32,
    /// Perceptual roughness in 1/255.
    pub roughness: u8,
    /// How far shading normals lean away from the camera, as a tangent.
    pub lean: f32,
    pub samples: u32,
    pub flags: u32,
    /// Change of the light per frame in each column of cells, relative to it. Histories of light that doesn't change ignore it.
    pub light_change: Option<fn(u32) -> f32>,
    pub frame: u32,
    /// Number of frames in the history.
    pub accumulated: u32,
    /// Frames without a change.
    pub rest: u32,
    /// The passes support static images.
    pub knows_rest: bool,
    /// Blocks, given by their first pixel, with nothing to trace: their records are empty, and their radiance is left from another frame.
    pub untraced: fn(UVec2) -> bool,
}

/// The output of `reconstruct` for a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Reconstructed {
    pub radiance: [f32; 3],
    pub variance: f32,
    pub distance: f32,
    /// Mean weight of the rays: 8 if it is as expected, 0 without any ray.
    pub packed_weight: f32,
}

/// Texels of the history, as they are stored.
#[derive(Clone)]
pub struct History {
    pub radiance: Vec<[u16; 4]>,
    pub pair: Vec<u32>,
    pub surface: Vec<[u32; 2]>,
    /// Rates of the tiles.
    pub rates: Vec<u32>,
}

/// One ray of a block, before it is packed.
pub struct Ray {
    /// First pixel of the block, and the pixel that the ray started from.
    pub block: UVec2,
    pub pixel: UVec2,
    pub view: Vec3,
    pub sample: ReflectionSample,
}

/// Bits of a 16-bit float, rounded towards zero; numbers too small for its normal range become 0.
pub fn half(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16) as u16 & 0x8000;
    let exponent = ((bits >> 23) & 0xff) as i32 - 127;
    match exponent {
        128 if bits & 0x7f_ffff != 0 => sign | 0x7e00,
        16.. => sign | 0x7c00,
        -14..16 => sign | (((exponent + 15) as u16) << 10) | ((bits >> 13) as u16 & 0x3ff),
        _ => sign,
    }
}

/// A distance as the history stores it: `distance_bits` of `numeric.wesl`.
pub fn distance_bits(distance: f32) -> u32 {
    ((distance.log2() + 24.0) * 1024.0).round().clamp(1.0, 65535.0) as u32
}

pub fn unhalf(bits: u16) -> f32 {
    let (exponent, fraction) = (i32::from((bits >> 10) & 31), f32::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction > 0.0 => f32::NAN,
        31 => f32::INFINITY,
        _ => (1024.0 + fraction) * 2f32.powi(exponent - 25),
    };
    if bits & 0x8000 == 0 { size } else { -size }
}

fn octahedral(v: Vec3) -> Vec2 {
    let p = v.truncate() / (v.x.abs() + v.y.abs() + v.z.abs());
    if v.z >= 0.0 {
        return p;
    }
    let sign = |x: f32| if x >= 0.0 { 1.0 } else { -1.0 };
    vec2((1.0 - p.y.abs()) * sign(p.x), (1.0 - p.x.abs()) * sign(p.y))
}

fn from_octahedral(p: Vec2) -> Vec3 {
    let z = 1.0 - p.x.abs() - p.y.abs();
    let fold = (-z).max(0.0);
    let sign = |x: f32| if x >= 0.0 { 1.0 } else { -1.0 };
    vec3(p.x - fold * sign(p.x), p.y - fold * sign(p.y), z).normalize()
}

impl Wall {
    pub fn new(size: UVec2) -> Self {
        Self {
            size,
            distance: 5.0,
            trace_scale: 2,
            rate: 0,
            roughness: 77,
            lean: 0.5,
            samples: 8,
            flags: VIRTUAL_HISTORY | SUPPRESS_FIREFLIES,
            light_change: None,
            frame: 0,
            accumulated: 0,
            rest: 0,
            knows_rest: true,
            untraced: |_| false,
        }
    }

    pub fn trace_size(&self) -> UVec2 {
        (self.size + self.trace_scale - 1) / self.trace_scale
    }

    fn tiles(&self) -> UVec2 {
        self.trace_size().map(|size| size.div_ceil(16))
    }

    pub fn rates(&self) -> Vec<u32> {
        let tiles = self.tiles();
        vec![self.rate | RATE_ACTIVE; (tiles.x * tiles.y) as usize]
    }

    #[expect(
        deprecated,
        reason = "its successor stands in a crate that is no dependency of the tests"
    )]
    fn clip_from_view(&self) -> Mat4 {
        Mat4::perspective_infinite_reverse_rh(0.9, self.size.x as f32 / self.size.y as f32, NEAR)
    }

    fn position(&self, pixel: UVec2) -> Vec3 {
        let uv = (pixel.as_vec2() + 0.5) / self.size.as_vec2();
        let ndc = vec3(uv.x * 2.0 - 1.0, 1.0 - uv.y * 2.0, NEAR / self.distance);
        self.clip_from_view().inverse().project_point3(ndc)
    }

    /// 24 bits of the shading normal.
    fn normal_bits(&self, pixel: UVec2) -> u32 {
        let turn = (pixel.x / 16) as f32 * 1.3 + (pixel.y / 16) as f32 * 2.1;
        let p = octahedral(vec3(self.lean * turn.cos(), self.lean * turn.sin(), 1.0)) * 0.5 + 0.5;
        let bits = (p * 4095.0 + 0.5).as_uvec2();
        bits.x | (bits.y << 12)
    }

    fn normal(&self, pixel: UVec2) -> Vec3 {
        let bits = self.normal_bits(pixel);
        from_octahedral(uvec2(bits & 0xfff, bits >> 12).as_vec2() / 4095.0 * 2.0 - 1.0)
    }

    pub fn alpha(&self) -> f32 {
        (f32::from(self.roughness) / 255.0).powi(2)
    }

    /// Base colour of the metal.
    pub fn f0() -> Vec3 {
        vec3(200.0, 180.0, 90.0).map(|byte| (byte / 255.0).powf(2.2))
    }

    fn words(&self) -> Vec<[u32; 4]> {
        let word = |pixel| {
            let color = u32::from_le_bytes([200, 180, 90, self.roughness]);
            [
                color,
                0,
                u32::from_le_bytes([128, 255, 255, 0]),
                self.normal_bits(pixel),
            ]
        };
        self.pixels().map(word).collect()
    }

    pub fn pixels(&self) -> impl Iterator<Item = UVec2> + use<> {
        let size = self.size;
        (0..size.y).flat_map(move |y| (0..size.x).map(move |x| uvec2(x, y)))
    }

    /// This frame's ray of the block that a trace pixel belongs to.
    pub fn ray(&self, trace_pixel: UVec2) -> Ray {
        let log2_size = uvec2((self.rate >> 2) & 3, self.rate & 3);
        let block = ((trace_pixel >> log2_size) << log2_size) * self.trace_scale;
        let extent = (UVec2::ONE << log2_size) * self.trace_scale;
        let choice = sobol(block, self.frame, 7) * extent.as_vec2();
        let pixel = (block + choice.as_uvec2().min(extent - 1)).min(self.size - 1);
        let basis = orthonormal_basis(self.normal(pixel));
        let view = guard_view(basis.transpose() * -self.position(pixel).normalize());
        let sample = sample_reflection(view, self.alpha(), sobol(block, self.frame, 0));
        Ray {
            block,
            pixel,
            view,
            sample,
        }
    }

    /// Four words of a ray's record.
    fn record(&self, ray: &Ray) -> [u32; 4] {
        if !ray.sample.valid || (self.untraced)(ray.block) {
            return [0; 4];
        }
        let (_, direction) = self.line(ray);
        let p = octahedral(direction);
        let snorm = |x: f32| u32::from((x * 32767.0).round() as i16 as u16);
        let exponent = (self.inverse_pdf(ray).max(1e-30).log2() + 32.0) / 52.0;
        let pdf = (exponent.clamp(0.0, 1.0) * 65535.0).round() as u32;
        let offset = ray.pixel - ray.block;
        let mirror = if ray.sample.inverse_pdf == 0.0 { 0x80 } else { 0 };
        let bits = 0x40 | mirror | offset.x | (offset.y << 3);
        let surface = self.normal_bits(ray.pixel) | (u32::from(self.roughness) << 24);
        [
            snorm(p.x) | (snorm(p.y) << 16),
            pdf | (bits << 16),
            (NEAR / self.distance).to_bits(),
            surface,
        ]
    }

    fn pass<'a>(
        &self,
        gpu: &'a Gpu,
        shaders: &mut Shaders,
        module: &'static str,
        defs: &'static [&'static str],
    ) -> Pass<'a> {
        let view = View {
            defs,
            size: self.size,
            tiles: self.tiles(),
            tile_pixels: 16 * self.trace_scale,
            wide: ["reconstruct", "one_pass"].contains(&module) && self.trace_scale == 2,
            depth: NEAR / self.distance,
        };
        let uniforms = |module: &naga::Module| [self.view_uniform(module), self.settings_uniform(module)];
        let mut pass = Pass::new(gpu, shaders, module, &view, uniforms);
        let facing = vec![[128u8, 128, 255, 255]; (self.size.x * self.size.y) as usize];
        pass.texture(3, TextureFormat::Rgba32Uint, self.size, &self.words());
        pass.texture(4, TextureFormat::Rgba8Unorm, self.size, &facing);
        pass
    }

    /// Origin and direction of a ray; the wall faces positive z.
    pub fn line(&self, ray: &Ray) -> (Vec3, Vec3) {
        let drawn = orthonormal_basis(self.normal(ray.pixel)) * ray.sample.direction;
        // Directions into the wall are turned back.
        (self.position(ray.pixel), drawn.with_z(drawn.z.abs()))
    }

    /// The other sampled direction that ends in the same one, in local space; `None` if there is no such direction.
    pub fn other(&self, ray: &Ray) -> Option<Vec3> {
        let basis = orthonormal_basis(self.normal(ray.pixel));
        let drawn = basis * ray.sample.direction;
        let other = basis.transpose() * drawn.with_z(-drawn.z);
        (self.alpha() > 0.001 && other.z > 1e-6).then_some(other)
    }

    fn inverse_pdf(&self, ray: &Ray) -> f32 {
        let pdf = |direction| reflection_pdf(ray.view, direction, self.alpha());
        self.other(ray).map_or(ray.sample.inverse_pdf, |other| {
            1.0 / (pdf(ray.sample.direction) + pdf(other)).max(1e-20)
        })
    }

    /// The reconstruction from rays that see `radiance` (and a distance) of their block.
    pub fn reconstruct(
        &self,
        gpu: &Gpu,
        shaders: &mut Shaders,
        radiance: impl Fn(UVec2) -> [f32; 4],
    ) -> Vec<Reconstructed> {
        self.reconstruct_rays(gpu, shaders, |ray| radiance(ray.block))
    }

    /// The result of rays that see `radiance`.
    pub fn reconstruct_rays(
        &self,
        gpu: &Gpu,
        shaders: &mut Shaders,
        radiance: impl Fn(&Ray) -> [f32; 4],
    ) -> Vec<Reconstructed> {
        let mut pass = self.pass(gpu, shaders, "reconstruct", self.rest_defs());
        self.bind_rays(&mut pass, radiance);
        pass.output(11, TextureFormat::Rgba16Float, 2);
        pass.output(12, TextureFormat::R32Uint, 1);
        let written = pass.run();
        let texel = |(color, pair): (&[u32], &u32)| {
            let [r, g, b, variance] = halves4([color[0], color[1]]).map(unhalf);
            Reconstructed {
                radiance: [r, g, b],
                variance,
                distance: unhalf(*pair as u16),
                packed_weight: unhalf((*pair >> 16) as u16),
            }
        };
        written[0].chunks(2).zip(&written[1]).map(texel).collect()
    }

    /// Binds rates, rays, and the table for their weights.
    fn bind_rays(&self, pass: &mut Pass, radiance: impl Fn(&Ray) -> [f32; 4]) {
        let trace = self.trace_size();
        let mut seen = Vec::new();
        let mut records = Vec::new();
        for y in 0..trace.y {
            for x in 0..trace.x {
                let ray = self.ray(uvec2(x, y));
                seen.push(radiance(&ray).map(half));
                records.push(self.record(&ray));
            }
        }
        static TABLE: LazyLock<DirectionalAlbedo> = LazyLock::new(DirectionalAlbedo::new);
        let (table, side) = (TABLE.texels(), UVec2::splat(ALBEDO_TABLE_SIZE as u32));
        let (rates, tiles) = (self.rates(), self.tiles());
        pass.texture(7, TextureFormat::R32Uint, tiles, &rates);
        pass.texture(8, TextureFormat::Rgba16Float, trace, &seen);
        pass.texture(9, TextureFormat::Rgba32Uint, trace, &records);
        pass.texture(10, TextureFormat::Rg32Float, side, table);
    }

    /// Reconstruction and accumulation in one pass; nothing has moved.
    pub fn denoise(
        &self,
        gpu: &Gpu,
        shaders: &mut Shaders,
        radiance: impl Fn(&Ray) -> [f32; 4],
        before: &History,
    ) -> History {
        let mut pass = self.pass(gpu, shaders, "one_pass", self.rest_defs());
        self.bind_rays(&mut pass, radiance);
        self.history_of(pass, &[], before)
    }

    /// One frame of accumulation; nothing has moved.
    pub fn accumulate(&self, gpu: &Gpu, shaders: &mut Shaders, new: &[Reconstructed], before: &History) -> History {
        let mut pass = self.pass(gpu, shaders, "temporal", self.rest_defs());
        pass.texture(7, TextureFormat::R32Uint, self.tiles(), &self.rates());
        self.history_of(pass, new, before)
    }

    /// Binds the inputs of a frame's accumulation, and runs the pass.
    fn history_of(&self, mut pass: Pass, new: &[Reconstructed], before: &History) -> History {
        let color = |texel: &Reconstructed| {
            let [r, g, b] = texel.radiance;
            [r, g, b, texel.variance].map(half)
        };
        let pair =
            |texel: &Reconstructed| u32::from(half(texel.distance)) | (u32::from(half(texel.packed_weight)) << 16);
        let colors: Vec<_> = new.iter().map(color).collect();
        let pairs: Vec<_> = new.iter().map(pair).collect();
        let (size, tiles) = (self.size, self.tiles());
        let still = vec![[0f32; 2]; (size.x * size.y) as usize];
        pass.texture(13, TextureFormat::R32Uint, tiles, &before.rates);
        pass.texture(14, TextureFormat::Rg32Float, size, &still);
        if !new.is_empty() {
            pass.texture(11, TextureFormat::Rgba16Float, size, &colors);
            pass.texture(12, TextureFormat::R32Uint, size, &pairs);
        }
        pass.texture(15, TextureFormat::Rgba16Float, size, &before.radiance);
        pass.texture(16, TextureFormat::R32Uint, size, &before.pair);
        pass.texture(17, TextureFormat::Rg32Uint, size, &before.surface);
        let cells = self.size.map(|pixels| pixels.div_ceil(16));
        let columns = (0..cells.x * cells.y).map(|cell| self.light_change.map_or(0.0, |change| change(cell % cells.x)));
        let changes: Vec<_> = columns.map(|change| [4.0 * change, 4.0, 0.0, 0.0].map(half)).collect();
        pass.texture(21, TextureFormat::Rgba16Float, cells, &changes);
        pass.output(18, TextureFormat::Rgba16Float, 2);
        pass.output(19, TextureFormat::R32Uint, 1);
        pass.output(20, TextureFormat::Rg32Uint, 2);
        let mut written = pass.run();
        History {
            radiance: written[0]
                .chunks(2)
                .map(|words| halves4([words[0], words[1]]))
                .collect(),
            surface: written[2].chunks(2).map(|words| [words[0], words[1]]).collect(),
            pair: written.swap_remove(1),
            rates: self.rates(),
        }
    }

    /// The last filter of a history; luminance of each pixel.
    pub fn blur(&self, gpu: &Gpu, shaders: &mut Shaders, history: &History) -> Vec<f32> {
        let (size, tiles) = (self.size, self.tiles());
        shaders.add("bevy_glint/denoise/shown.wesl", SHOWN.to_string());
        let mut pass = self.pass(gpu, shaders, "shown", &["BLUR"]);
        pass.texture(5, TextureFormat::Rgba16Float, size, &history.radiance);
        pass.texture(7, TextureFormat::R32Uint, tiles, &self.rates());
        pass.texture(8, TextureFormat::R32Uint, size, &history.pair);
        pass.output(10, TextureFormat::Rgba16Float, 2);
        let written = pass.run();
        let texels = written[0].chunks(2).map(|words| halves4([words[0], words[1]]));
        texels.map(|[red, ..]| unhalf(red)).collect()
    }

    /// Definitions for static images: the passes for moving ones lack them.
    fn rest_defs(&self) -> &'static [&'static str] {
        match (self.light_change.is_some(), self.knows_rest) {
            (true, _) => &["LIGHT_CHANGES"],
            (_, true) => &["REST"],
            _ => &[],
        }
    }

    /// An empty history.
    pub fn no_history(&self) -> History {
        let count = (self.size.x * self.size.y) as usize;
        History {
            radiance: vec![[0; 4]; count],
            pair: vec![0; count],
            surface: vec![[0; 2]; count],
            rates: self.rates(),
        }
    }

    fn view_uniform(&self, module: &naga::Module) -> Vec<u8> {
        let clip_from_view = self.clip_from_view();
        let mut uniform = Uniform::new(module, "View").expect("the shader has a view");
        for (name, matrix) in [
            ("clip_from_world", clip_from_view),
            ("unjittered_clip_from_world", clip_from_view),
            ("world_from_clip", clip_from_view.inverse()),
            ("world_from_view", Mat4::IDENTITY),
            ("view_from_world", Mat4::IDENTITY),
            ("clip_from_view", clip_from_view),
            ("view_from_clip", clip_from_view.inverse()),
        ] {
            uniform.set(name, &matrix.to_cols_array());
        }
        uniform.bytes
    }

    fn settings_uniform(&self, module: &naga::Module) -> Vec<u8> {
        let mut uniform = Uniform::new(module, "ReflectionView").expect("the shader has settings");
        uniform.set("fade_start", &[1.0f32]);
        uniform.set("cutoff", &[1.0f32]);
        uniform.set("max_ray_length", &[10_000.0f32]);
        uniform.set("sample_index", &[self.frame]);
        uniform.set("accumulated", &[self.accumulated]);
        uniform.set("flags", &[self.flags]);
        uniform.set("size", &self.size.to_array());
        uniform.set("previous_size", &self.size.to_array());
        uniform.set("trace_size", &self.trace_size().to_array());
        uniform.set("tile_count", &self.tiles().to_array());
        uniform.set("trace_scale", &[self.trace_scale]);
        uniform.set("tile_size", &[16u32]);
        uniform.set("previous_tile_log2", &[(16 * self.trace_scale).ilog2()]);
        uniform.set("exposure_ratio", &[1.0f32]);
        uniform.set("previous_clip_from_world", &self.clip_from_view().to_cols_array());
        uniform.set("samples", &[self.samples]);
        uniform.set("max_history", &[32.0f32]);
        uniform.set("clip_sigma", &[1.5f32]);
        uniform.set("blur_radius", &[3.0f32]);
        uniform.set("static_frames", &[self.rest]);
        uniform.bytes
    }
}

fn halves4(words: [u32; 2]) -> [u16; 4] {
    [
        words[0] as u16,
        (words[0] >> 16) as u16,
        words[1] as u16,
        (words[1] >> 16) as u16,
    ]
}
