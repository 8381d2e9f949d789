//! Every texture and buffer that a reflecting view owns on the GPU, with format and meaning.
//!
//! *Full* is one texel per pixel of the view, *trace* one per trace pixel (see [`Technique`]), *tile* one per tile of
//! the rate image. Only what the view's settings use is created.

use crate::settings::{SafeSettings, Technique};
use bevy::{
    math::UVec2,
    render::{
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, Extent3d, TextureDescriptor, TextureDimension, TextureFormat,
            TextureUsages, TextureView, TextureViewDescriptor,
        },
        renderer::RenderDevice,
    },
};
use core::mem::take;

/// One texel per tile: `rate/codes.wesl` says what its bits mean.
pub const RATE_FORMAT: TextureFormat = TextureFormat::R32Uint;
/// What a ray saw: exposed radiance, and the distance of the hit in metres (at most 60,000, which stands for a miss, too).
pub const RAY_RADIANCE_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// How the ray was drawn: direction, inverse pdf, chosen pixel; see `trace/record.wesl`.
pub const RAY_RECORD_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Exposed radiance of the lobe divided by the lobe's albedo. What alpha holds is said where the texture is declared.
pub const RADIANCE_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// Two halves: see where the texture is declared.
pub const PAIR_FORMAT: TextureFormat = TextureFormat::R32Uint;
/// Depth and packed normal of the last frame.
pub const SURFACE_FORMAT: TextureFormat = TextureFormat::Rg32Uint;
/// Mean radiance over frames; alpha is the number of frames.
pub const ACCUMULATION_FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// What the composite adds to the lit frame.
pub const REFLECTION_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// Words in [`Targets::arguments`].
pub const ARGUMENT_WORDS: u64 = 12;
/// Words in [`Targets::counters`].
pub const COUNTER_WORDS: u64 = 8;
/// Byte offset in [`Targets::arguments`] of the dispatch over the list of blocks.
pub const BLOCK_DISPATCH: u64 = 0;
/// Byte offset of the dispatch over the list of mirror pixels.
pub const MIRROR_DISPATCH: u64 = 12;
/// Byte offset of the dispatch over active tiles, one workgroup of 8x8 pixels each.
pub const TILE_DISPATCH: u64 = 24;
/// Byte offset of the number of blocks; the number of mirror pixels and of active tiles follow.
pub const BLOCK_COUNT: u64 = 36;

/// How large everything is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Pixels of the view.
    pub full: UVec2,
    /// Pixels per trace pixel in each direction: 1 or 2.
    pub trace_scale: u32,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub tile: u32,
}

impl Sizes {
    /// Trace pixels of the view.
    pub fn trace(self) -> UVec2 {
        (self.full + self.trace_scale - 1) / self.trace_scale
    }

    /// Tiles of the view.
    pub fn tiles(self) -> UVec2 {
        (self.trace() + self.tile - 1) / self.tile
    }
}

/// Which of the textures exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    pub accumulation: bool,
    pub pipeline: bool,
    pub temporal: bool,
    pub reflection: bool,
}

impl Needs {
    /// `in_place`: the composite writes into the frame itself.
    pub fn new(settings: &SafeSettings, in_place: bool) -> Self {
        let accumulation = settings.technique == Technique::Converged;
        Self {
            reflection: !in_place,
            accumulation,
            pipeline: !accumulation,
            temporal: !accumulation && settings.denoiser.temporal,
        }
    }
}

/// What a view owns on the GPU. It stays as long as the view reflects and needs and sizes are the same.
pub struct Targets {
    pub sizes: Sizes,
    pub needs: Needs,
    /// All that was created: the label of each texture or buffer, and its bytes.
    pub memory: Vec<(&'static str, u64)>,
    /// Counts and indirect arguments, cleared each frame: [`BLOCK_DISPATCH`] and following.
    pub arguments: Buffer,
    /// What passes count, cleared each frame: rays that hit, non-finite values that were stopped, then fragment invocations by the
    /// logarithm of the block's number of trace pixels (if counted). Apart from the arguments, since a dispatch can't write
    /// to the buffer that it takes its size from.
    pub counters: Buffer,
    /// What the composite adds (full); only where it can't write into the frame itself.
    pub reflection: Option<TextureView>,
    /// Ping-pong pair (full), only for the technique `Converged`.
    pub accumulation: Option<[TextureView; 2]>,
    /// Everything between the rate image and the composite.
    pub pipeline: Option<PipelineTargets>,
}

/// Textures of the variable-rate pipeline.
pub struct PipelineTargets {
    /// [`RATE_FORMAT`] (tile): of this frame in `[parity]`, of the last in `[1 - parity]`.
    pub rate: [TextureView; 2],
    /// Blocks of trace pixels that get a ray, one word each: see `rate/codes.wesl`.
    pub blocks: Buffer,
    /// Mirror pixels of the full resolution that get a ray of their own, `x | y << 16`.
    pub mirrors: Buffer,
    /// Active tiles, `x | y << 16`.
    pub tiles: Buffer,
    /// [`RAY_RADIANCE_FORMAT`] (trace).
    pub ray_radiance: TextureView,
    /// [`RAY_RECORD_FORMAT`] (trace).
    pub ray_record: TextureView,
    /// [`RADIANCE_FORMAT`] (full): the reconstructed radiance; alpha is the relative variance of its mean. The blur writes its
    /// result here, too.
    pub reconstructed: TextureView,
    /// [`PAIR_FORMAT`] (full): `pack2x16float(hit distance, effective number of rays)`; 0 where nothing reflects. In a picture at
    /// rest the second number is the mean weight w of the rays, as 16 w / (1 + w).
    pub reconstructed_pair: TextureView,
    /// What outlives the frame; absent without temporal accumulation.
    pub history: Option<HistoryTargets>,
}

/// Ping-pong pairs: this frame writes `[parity]` and reads `[1 - parity]`.
pub struct HistoryTargets {
    /// [`RADIANCE_FORMAT`] (full): accumulated radiance; alpha is the history length in frames, 0 = nothing.
    pub radiance: [TextureView; 2],
    /// [`PAIR_FORMAT`] (full): `pack2x16float(hit distance, relative variance of one frame's samples)`.
    pub pair: [TextureView; 2],
    /// [`SURFACE_FORMAT`] (full): `pack2x16float(distance from the viewer in metres, mean Y of the last frames)`, 0 where nothing
    /// reflects; geometric normal as `pack2x16snorm` of its octahedral map with the lowest 8 bits of the word replaced by the
    /// roughness.
    pub surface: [TextureView; 2],
}

struct Creator<'a> {
    device: &'a RenderDevice,
    memory: Vec<(&'static str, u64)>,
}

impl Creator<'_> {
    fn texture(&mut self, size: UVec2, format: TextureFormat, label: &'static str) -> TextureView {
        let size = size.max(UVec2::ONE);
        let texel = u64::from(format.block_copy_size(None).unwrap_or(16));
        self.memory.push((label, u64::from(size.x) * u64::from(size.y) * texel));
        let mut usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING | TextureUsages::COPY_SRC;
        if matches!(format, RAY_RADIANCE_FORMAT | RAY_RECORD_FORMAT) {
            usage |= TextureUsages::RENDER_ATTACHMENT;
        }
        let texture = self.device.create_texture(&TextureDescriptor {
            label: Some(label),
            size: Extent3d {
                width: size.x,
                height: size.y,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        });
        texture.create_view(&TextureViewDescriptor {
            label: Some(label),
            ..Default::default()
        })
    }

    fn pair(&mut self, size: UVec2, format: TextureFormat, labels: [&'static str; 2]) -> [TextureView; 2] {
        labels.map(|label| self.texture(size, format, label))
    }

    fn buffer(&mut self, size: u64, extra: BufferUsages, label: &'static str) -> Buffer {
        self.memory.push((label, size));
        self.device.create_buffer(&BufferDescriptor {
            label: Some(label),
            size,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST | extra,
            mapped_at_creation: false,
        })
    }
}

impl Targets {
    pub fn new(device: &RenderDevice, sizes: Sizes, needs: Needs) -> Self {
        let create = &mut Creator {
            device,
            memory: Vec::new(),
        };
        let (full, trace, tiles) = (sizes.full, sizes.trace(), sizes.tiles());
        let words = |size: UVec2| 4 * u64::from(size.x) * u64::from(size.y);
        let arguments = create.buffer(4 * ARGUMENT_WORDS, BufferUsages::INDIRECT, "glint_arguments");
        let accumulation = needs.accumulation.then(|| {
            create.pair(
                full,
                ACCUMULATION_FORMAT,
                ["glint_accumulation_a", "glint_accumulation_b"],
            )
        });
        let pipeline = needs.pipeline.then(|| PipelineTargets {
            rate: create.pair(tiles, RATE_FORMAT, ["glint_rate_a", "glint_rate_b"]),
            blocks: create.buffer(words(trace), BufferUsages::empty(), "glint_blocks"),
            mirrors: create.buffer(words(full), BufferUsages::empty(), "glint_mirrors"),
            tiles: create.buffer(words(tiles), BufferUsages::empty(), "glint_tiles"),
            ray_radiance: create.texture(trace, RAY_RADIANCE_FORMAT, "glint_ray_radiance"),
            ray_record: create.texture(trace, RAY_RECORD_FORMAT, "glint_ray_record"),
            reconstructed: create.texture(full, RADIANCE_FORMAT, "glint_reconstructed"),
            reconstructed_pair: create.texture(full, PAIR_FORMAT, "glint_reconstructed_pair"),
            history: needs.temporal.then(|| HistoryTargets {
                radiance: create.pair(
                    full,
                    RADIANCE_FORMAT,
                    ["glint_history_radiance_a", "glint_history_radiance_b"],
                ),
                pair: create.pair(full, PAIR_FORMAT, ["glint_history_pair_a", "glint_history_pair_b"]),
                surface: create.pair(
                    full,
                    SURFACE_FORMAT,
                    ["glint_history_surface_a", "glint_history_surface_b"],
                ),
            }),
        });
        let counters = create.buffer(4 * COUNTER_WORDS, BufferUsages::empty(), "glint_counters");
        let reflection = needs
            .reflection
            .then(|| create.texture(full, REFLECTION_FORMAT, "glint_reflection"));
        Self {
            sizes,
            needs,
            memory: take(&mut create.memory),
            arguments,
            counters,
            reflection,
            accumulation,
            pipeline,
        }
    }
}
