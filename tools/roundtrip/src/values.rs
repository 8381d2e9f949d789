//! Contents of buffers and textures: pseudo-random, the same in each run, and within bounds that passes expect.
//!
//! Loops of the passes are bounded, but some by counts from buffers, which random bits would make huge. Names of fields and variables select
//! the range. An unknown name gets small integers, and floats from 0 to 1.

use anyhow::{Result, bail};
use naga::{ArraySize, Handle, Module, ScalarKind, Type, TypeInner};

/// Width and height of textures and of the view.
pub const EDGE: u32 = 64;
/// Elements of buffers without a length.
pub const ELEMENTS: u32 = 4096;
/// Trace pixels in each direction, a quarter of all pixels: wide workgroups of the denoiser have no memory for more.
const TRACED: u32 = EDGE / 2;
/// Tiles in each direction.
const TILES: u32 = TRACED / 16;

/// A generator of numbers (splitmix64).
pub struct Values {
    state: u64,
    /// Rays find something: they follow an acceleration structure, not random links.
    pub has_objects: bool,
}

impl Values {
    pub fn new(seed: &str) -> Self {
        // FNV-1a.
        let hash = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        Self {
            state: seed.bytes().fold(0xcbf2_9ce4_8422_2325, hash),
            has_objects: false,
        }
    }

    fn bits(&mut self) -> u32 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ (mixed >> 31)) >> 32) as u32
    }

    fn below(&mut self, end: u32) -> u32 {
        self.bits() % end
    }

    /// From 0 to 1.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / (1 << 24) as f32
    }

    /// Halves and floats that are packed into the word are finite, below 2.
    fn packed(&mut self) -> u32 {
        self.bits() & 0xbfff_bfff
    }

    /// An integer of a buffer.
    fn integer(&mut self, name: &str, component: u32) -> u32 {
        match name {
            "size" | "previous_size" => EDGE,
            "trace_size" => TRACED,
            "origin" | "gbuffer_origin" | "first_tile" => 0,
            "tile_count" => TILES,
            // A rectangle that covers the view.
            "corners" if component < 2 => 0,
            "corners" => EDGE,
            "count" => 1,
            "tile_size" => 16,
            "previous_tile_log2" => (16 * EDGE / TRACED).ilog2(),
            "trace_scale" => EDGE / TRACED,
            "samples" => 8,
            "tlas_node_count" | "moving_count" => self.has_objects.into(),
            "left_count" => 0,
            "vertex_count" | "triangle_count" => EDGE,
            "node_count" => 16,
            // Exact mirrors and the denoiser's switches come from bits.
            "flags" => self.below(0x800),
            "textures" | "lightmap" => u32::MAX,
            // `x | y << 16`.
            "tile_list" => self.below(TILES) | (self.below(TILES) << 16),
            // Blocks of trace pixels: `pack_block` in `rate/codes.wesl`.
            "ray_list" | "mirror_ray_list" | "list" => {
                let place = self.below(TRACED) | (self.below(TRACED) << 13);
                place | (self.below(2) << 26) | (self.below(2) << 28)
            }
            // Lengths of lists.
            "indirect_args" => 1024 + self.below(EDGE),
            "geometry" | "values" | "places" => self.below(EDGE),
            "elements" | "bvh" | "a" | "b" | "c" => self.packed(),
            _ => self.below(4),
        }
    }

    fn float(&mut self, name: &str, component: u32) -> f32 {
        match (name, component) {
            ("viewport", 0 | 1) => 0.0,
            ("viewport", _) => EDGE as f32,
            ("max_history" | "max_ray_length", _) => 32.0,
            ("exposure_ratio", _) => 1.0,
            _ => self.unit(),
        }
    }

    /// Near the identity, so that points stay within the image.
    fn matrix(&mut self, column: u32, row: u32) -> f32 {
        let identity = if column == row { 1.0 } else { 0.0 };
        identity + 0.1 * (self.unit() - 0.5)
    }

    fn scalar(&mut self, name: &str, component: u32, scalar: naga::Scalar, to: &mut [u8]) -> Result<()> {
        match (scalar.kind, scalar.width) {
            (ScalarKind::Uint | ScalarKind::Sint, 4) => write(to, self.integer(name, component)),
            (ScalarKind::Float, 4) => write(to, self.float(name, component).to_bits()),
            (kind, width) => bail!("{name} has {kind:?} of {width} bytes"),
        }
        Ok(())
    }

    /// Fills the memory of a type. `name` is the field's, or the variable's.
    pub fn fill(&mut self, module: &Module, ty: Handle<Type>, name: &str, to: &mut [u8]) -> Result<()> {
        match &module.types[ty].inner {
            TypeInner::Scalar(scalar) => self.scalar(name, 0, *scalar, to)?,
            // The passes before have cleared counters.
            TypeInner::Atomic(_) => write(to, 0),
            TypeInner::Vector { size, scalar } => {
                for component in 0..*size as u32 {
                    let at = component as usize * usize::from(scalar.width);
                    self.scalar(name, component, *scalar, &mut to[at..])?;
                }
            }
            TypeInner::Matrix { columns, rows, scalar } => {
                let stride = if *rows as u32 == 2 { 8 } else { 16 };
                for column in 0..*columns as u32 {
                    for row in 0..*rows as u32 {
                        let at = column as usize * stride + row as usize * usize::from(scalar.width);
                        write(&mut to[at..], self.matrix(column, row).to_bits());
                    }
                }
            }
            TypeInner::Array { base, stride, .. } => {
                for element in to.chunks_exact_mut(*stride as usize) {
                    self.fill(module, *base, name, element)?;
                }
            }
            TypeInner::Struct { members, .. } => {
                for member in members {
                    let name = member.name.as_deref().unwrap_or_default();
                    let start = member.offset as usize;
                    let end = start + size(module, member.ty) as usize;
                    self.fill(module, member.ty, name, &mut to[start..end])?;
                }
            }
            other => bail!("{name} is {other:?}"),
        }
        Ok(())
    }

    /// A texel's component.
    pub fn texel(&mut self, name: &str, is_float: bool) -> u32 {
        match is_float {
            true if name.contains("motion") => (0.1 * (self.unit() - 0.5)).to_bits(),
            true => self.unit().to_bits(),
            // Active, with blocks of up to two by two pixels; `RATE_THOROUGH` of `rate/codes.wesl`.
            _ if name.contains("rate") => 0x100 | (self.bits() & 0x405),
            _ => self.packed(),
        }
    }
}

/// Bytes of a type; arrays without a length get [`ELEMENTS`].
pub fn size(module: &Module, ty: Handle<Type>) -> u32 {
    match &module.types[ty].inner {
        TypeInner::Array {
            size: ArraySize::Dynamic,
            stride,
            ..
        } => stride * ELEMENTS,
        TypeInner::Struct { members, span } => {
            let end = members.last().map(|last| last.offset + size(module, last.ty));
            end.unwrap_or_default().max(*span)
        }
        inner => inner.size(module.to_ctx()),
    }
}

fn write(to: &mut [u8], word: u32) {
    to[..4].copy_from_slice(&word.to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "
        struct Item { size: vec2<u32>, weight: f32, turn: mat3x3<f32>, count: atomic<u32> }
        @group(0) @binding(0) var<storage, read_write> items: array<Item>;
        @compute @workgroup_size(1) fn main() { atomicAdd(&items[0].count, 1u); }";

    #[test]
    fn fields_are_filled_by_name_and_type() {
        let module = naga::front::wgsl::parse_str(SOURCE).unwrap();
        let (_, variable) = module.global_variables.iter().next().unwrap();
        let bytes = size(&module, variable.ty);
        assert_eq!(bytes, ELEMENTS * 80);
        let fill = |seed: &str| {
            let mut memory = vec![0; bytes as usize];
            Values::new(seed)
                .fill(&module, variable.ty, "items", &mut memory)
                .unwrap();
            memory
        };
        let memory = fill("a");
        let word = |at: usize| u32::from_le_bytes(memory[at..at + 4].try_into().unwrap());
        let float = |at: usize| f32::from_bits(word(at));
        for item in [0, 80, 80 * (ELEMENTS as usize - 1)] {
            assert_eq!((word(item), word(item + 4), word(item + 64)), (EDGE, EDGE, 0));
            assert!((0.0..1.0).contains(&float(item + 8)));
            assert!((0.9..1.1).contains(&float(item + 16)) && float(item + 20).abs() < 0.1);
        }
        assert_eq!(memory, fill("a"));
        assert_ne!(memory, fill("b"));
    }

    #[test]
    fn packed_halves_are_finite() {
        let mut values = Values::new("");
        for _ in 0..1000 {
            let word = values.packed();
            assert!([word, word >> 16].iter().all(|half| half & 0x7c00 < 0x4000), "{word:x}");
        }
    }
}
