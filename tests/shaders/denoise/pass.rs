//! Runs one pass of the denoiser over all tiles of a view.

use crate::{
    compute::{self, READ, WRITTEN, depth_texture, dispatch, entry, read_texture},
    gpu::{Checks, Gpu},
    wesl::Shaders,
};
use bevy::math::{UVec2, uvec2};
use bytemuck::NoUninit;
use wgpu::{BindingResource, TextureFormat};

/// The state that all passes of a view share.
pub struct View {
    pub size: UVec2,
    pub tiles: UVec2,
    /// In each direction.
    pub tile_pixels: u32,
    /// Workgroups cover 16x16 pixels instead of 8x8.
    pub wide: bool,
    /// Definitions of the pass besides.
    pub defs: &'static [&'static str],
    /// In clip space, of all pixels.
    pub depth: f32,
}

/// Bindings of `tiles.wesl`.
const TILE_LIST: u32 = 5;
const INDIRECT_ARGS: u32 = 6;

/// One dispatch over all tiles.
pub struct Pass<'a> {
    gpu: &'a Gpu,
    entry: &'static str,
    wgsl: String,
    /// Bindings of the flattened shader, which contains only the bindings of the entry point.
    declared: Vec<u32>,
    buffers: Vec<(u32, wgpu::Buffer)>,
    textures: Vec<(u32, wgpu::Texture)>,
    /// Texture and words per texel.
    outputs: Vec<(u32, wgpu::Texture, u32)>,
    size: UVec2,
    groups: u32,
}

impl<'a> Pass<'a> {
    /// `uniforms` makes the uniforms of the view and of the settings for a flattened shader.
    pub fn new(
        gpu: &'a Gpu,
        shaders: &mut Shaders,
        module: &'static str,
        frame: &View,
        uniforms: impl Fn(&naga::Module) -> [Vec<u8>; 2],
    ) -> Self {
        let name = format!("bevy_glint/denoise/{module}.wesl");
        let entry = if module == "one_pass" { "denoise" } else { module };
        let wide: &[&str] = if frame.wide { &["WIDE"] } else { &[] };
        let defs: Vec<_> = wide.iter().chain(frame.defs).map(|name| (*name).into()).collect();
        let (wgsl, module) = shaders.expect(&name, &defs);
        let [view, settings] = uniforms(&module);
        let tiles = frame.tiles;
        let list: Vec<u32> = (0..tiles.y)
            .flat_map(|y| (0..tiles.x).map(move |x| x | (y << 16)))
            .collect();
        let mut arguments = [0u32; 20];
        arguments[14] = list.len() as u32;
        let buffers = vec![
            (0, gpu.buffer(&view)),
            (1, gpu.buffer(&settings)),
            (TILE_LIST, gpu.buffer(&list)),
            (INDIRECT_ARGS, gpu.buffer(&arguments)),
        ];
        let declared = module.global_variables.iter();
        let declared = declared.filter_map(|(_, variable)| variable.binding.as_ref().map(|binding| binding.binding));
        let side = frame.tile_pixels / if frame.wide { 16 } else { 8 };
        Self {
            gpu,
            entry,
            wgsl,
            declared: declared.collect(),
            buffers,
            textures: vec![(2, depth_texture(gpu, frame.size, frame.depth))],
            outputs: Vec::new(),
            size: frame.size,
            groups: tiles.x * tiles.y * side * side,
        }
    }

    /// Also replaces a buffer of the passes over the active tiles.
    pub fn texture<T: NoUninit>(&mut self, binding: u32, format: TextureFormat, size: UVec2, texels: &[T]) {
        self.buffers.retain(|(taken, _)| *taken != binding);
        let texture = compute::texture(self.gpu, format, size, READ, bytemuck::cast_slice(texels));
        self.textures.push((binding, texture));
    }

    pub fn output(&mut self, binding: u32, format: TextureFormat, words: u32) {
        // A pattern that distinguishes untouched texels from cleared ones.
        let texels = vec![0x42u8; (4 * self.size.x * self.size.y * words) as usize];
        let texture = compute::texture(self.gpu, format, self.size, WRITTEN, &texels);
        self.outputs.push((binding, texture, words));
    }

    /// Words of the outputs, by rows.
    pub fn run(self) -> Vec<Vec<u32>> {
        let gpu = self.gpu;
        let pipeline = gpu.pipeline(&self.wgsl, self.entry, Checks::Off);
        let textures = self.textures.iter().map(|(binding, texture)| (*binding, texture));
        let outputs = self.outputs.iter().map(|(binding, texture, _)| (*binding, texture));
        let views: Vec<_> = textures
            .chain(outputs)
            .map(|(binding, texture)| (binding, texture.create_view(&Default::default())))
            .collect();
        let mut entries: Vec<_> = self
            .buffers
            .iter()
            .map(|(binding, buffer)| entry(*binding, buffer.as_entire_binding()))
            .collect();
        let views = views.iter();
        entries.extend(views.map(|(binding, view)| entry(*binding, BindingResource::TextureView(view))));
        entries.retain(|entry| self.declared.contains(&entry.binding));
        dispatch(gpu, &pipeline, &entries, uvec2(self.groups, 1));
        self.outputs
            .iter()
            .map(|(_, texture, words)| read_texture(gpu, texture, self.size, *words))
            .collect()
    }
}
