//! Every texture and buffer of a reflecting view on the GPU, with format and meaning.
//!
//! *Full* is one texel per pixel of the view, *denoised* one per texel of the denoiser
//! ([`half_resolution`](crate::ReflectionDenoiser::half_resolution)), *trace* one per trace pixel (see [`ReflectionTechnique`]), *tile* one
//! per tile of the rate image. Only resources that the view's settings use are created.

use crate::{
    common::{COUNTER_WORDS, INDIRECT_ARG_WORDS, word_offset},
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
};
use bevy::{
    math::UVec2,
    render::{
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, Extent3d, LoadOp, Operations, RenderPassColorAttachment, StoreOp,
            Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
            TextureViewDescriptor,
        },
        renderer::RenderDevice,
    },
};
use core::mem::take;
use wgpu::Color;

/// One texel per tile: `rate/codes.wesl` documents its bits.
pub const RATE_FORMAT: TextureFormat = TextureFormat::R32Uint;
/// Result of a ray: exposed radiance, and the distance of the hit in metres (at most 60,000, which also marks a miss).
pub const RAY_RADIANCE_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// How the ray was sampled: direction, inverse pdf, chosen pixel; see `trace/record.wesl`.
pub const RAY_SAMPLE_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Exposed radiance of the lobe divided by the lobe's albedo. Alpha is documented at the declaration of each texture.
pub const RADIANCE_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// Two halves, documented at the declaration of each texture.
pub const STATS_FORMAT: TextureFormat = TextureFormat::R32Uint;
/// Two words that identify a surface, documented at the declaration of the texture.
pub const HISTORY_SURFACE_FORMAT: TextureFormat = TextureFormat::Rg32Uint;
/// A quarter of a ray's hit: `trace/hit.wesl`.
pub const HIT_FORMAT: TextureFormat = HISTORY_SURFACE_FORMAT;
/// Mean radiance over frames; alpha is the number of frames.
pub const ACCUMULATION_FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// Radiance that the composite adds to the lit frame.
pub const REFLECTION_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// The frame for rays that reuse it: exposed light, and the distance from the viewer in metres (at most 60,000; 0 is the sky).
pub const SCREEN_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// Pixels of a cell of [`LightChangeTargets`] in each direction, as in `gbuffer.wesl`.
const CELL: u32 = 16;
/// Bytes of a ray in [`LightChangeTargets::rays`].
const KEPT_RAY_BYTES: u64 = 80;

/// Maximum number of trace pixels of a view in each direction: limited by the bits for a block's position in the ray list.
pub const LARGEST_TRACE_SIZE: u32 = 1 << 13;

/// Sizes of a view's resources.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Pixels of the view.
    pub full: UVec2,
    /// Pixels per trace pixel in each direction: 1 or 2.
    pub trace_scale: u32,
    /// Pixels per texel of the denoiser in each direction: 1 or 2.
    pub texel: u32,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub tile: u32,
}

impl Sizes {
    /// Texels of the denoiser.
    pub fn denoised(self) -> UVec2 {
        (self.full + self.texel - 1) / self.texel
    }

    /// Trace pixels of the view.
    pub fn trace(self) -> UVec2 {
        (self.full + self.trace_scale - 1) / self.trace_scale
    }

    /// Pixels of a tile in each direction.
    pub fn tile_pixels(self) -> u32 {
        self.tile * self.trace_scale
    }

    /// Texels of the denoiser per tile in each direction, a power of two.
    pub fn tile_texels(self) -> u32 {
        self.tile_pixels() / self.texel
    }

    /// Tiles of the view.
    pub fn tiles(self) -> UVec2 {
        (self.trace() + self.tile - 1) / self.tile
    }

    /// Cells that keep a ray each.
    pub fn cells(self) -> UVec2 {
        (self.full + CELL - 1) / CELL
    }
}

/// The textures that exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    pub accumulation: bool,
    pub pipeline: bool,
    pub temporal: bool,
    pub mirrors: bool,
    /// The reconstruction is a separate pass.
    pub reconstructed: bool,
    pub reflection: bool,
    pub screen: bool,
    /// Rays of earlier frames are traced again.
    pub light_changes: bool,
    /// A view can occupy a part of them: no textures are drawn into, and only a reprojected history outlives a frame.
    pub in_parts: bool,
}

impl Needs {
    /// `in_place` is true if the composite writes directly to the frame.
    pub fn new(settings: &ClampedSettings, in_place: bool) -> Self {
        let accumulation = settings.technique == ReflectionTechnique::Converged;
        let is_drawn = settings.technique == ReflectionTechnique::QuarterInline
            || settings.backend == ReflectionBackend::HardwareVrs;
        Self {
            in_parts: in_place && !accumulation && !is_drawn,
            reflection: !in_place,
            accumulation,
            pipeline: !accumulation,
            temporal: !accumulation && settings.denoiser.temporal,
            mirrors: !accumulation && settings.full_resolution_mirrors,
            reconstructed: !accumulation && !settings.denoises_in_one_pass(),
            screen: settings.reuses_screen(),
            light_changes: settings.follows_light(),
        }
    }
}

/// GPU resources of a view. They are kept as long as the view reflects, its needs stay the same and its size fits.
pub struct Targets {
    pub sizes: Sizes,
    /// Maximum size in pixels.
    capacity: UVec2,
    pub needs: Needs,
    /// All created resources: the label of each texture or buffer, and its bytes.
    pub memory: Vec<(&'static str, u64)>,
    /// Sizes of indirect dispatches and lengths of their lists, cleared each frame: `common/lists.rs`.
    pub indirect_args: Buffer,
    /// Counters of passes, cleared each frame: `common/lists.rs`. Separate from the indirect arguments, since a dispatch can't write to
    /// the buffer that contains its size.
    pub counters: Buffer,
    /// Radiance that the composite adds (full); exists only if the composite can't write directly to the frame.
    pub reflection: Option<TextureView>,
    /// Ping-pong pair (full), only for the technique `Converged`.
    pub accumulation: Option<[TextureView; 2]>,
    /// [`SCREEN_FORMAT`] (full), only with [`ScreenTraces`](crate::ScreenTraces): the camera's last frame, and after the opaque pass, the
    /// current one.
    pub screen: Option<TextureView>,
    /// Everything between the rate image and the composite.
    pub pipeline: Option<PipelineTargets>,
}

/// Textures of the variable-rate pipeline.
pub struct PipelineTargets {
    /// [`RATE_FORMAT`] (tile): this frame's in `[write_index]`, the last frame's in `[1 - write_index]`.
    pub rate: [TextureView; 2],
    /// Blocks of trace pixels that get a ray, one word each: see `rate/codes.wesl`.
    pub ray_list: Buffer,
    /// Full-resolution mirror pixels that get their own ray, `x | y << 16`. A single word without such rays.
    pub mirror_ray_list: Buffer,
    /// Active tiles, `x | y << 16`.
    pub tile_list: Buffer,
    /// [`RAY_RADIANCE_FORMAT`] (trace).
    pub ray_radiance: TextureView,
    /// [`RAY_SAMPLE_FORMAT`] (trace).
    pub ray_sample: TextureView,
    /// [`HIT_FORMAT`] (twice as large as trace): exists only if no other texture can store it, see [`Self::hits`].
    own_hits: Option<TextureView>,
    /// [`RADIANCE_FORMAT`] (denoised): the reconstructed radiance; alpha is the relative variance of its mean. Mirror rays write their
    /// radiance here, too: see [`Self::mirror_radiance`]. Absent if one pass reconstructs and accumulates.
    pub reconstructed: Option<TextureView>,
    /// [`STATS_FORMAT`] (denoised): `pack2x16float(hit distance, 16 w / (1 + w))`, with the mean weight w of the rays, which is 1 if it is as
    /// expected; 0 if nothing reflects.
    pub reconstructed_stats: Option<TextureView>,
    /// [`RADIANCE_FORMAT`] and [`STATS_FORMAT`] (full): the results of mirror rays if the denoiser's textures have fewer texels than pixels.
    pub mirrors: Option<(TextureView, TextureView)>,
    /// Textures that outlive the frame; absent without temporal accumulation.
    pub history: Option<HistoryTargets>,
    /// Absent without [`ReflectionDenoiser::follow_light_changes`](crate::ReflectionDenoiser::follow_light_changes).
    pub light_changes: Option<LightChangeTargets>,
}

/// Rays that are traced again, and the changes that they found.
pub struct LightChangeTargets {
    /// One `KeptRay` of `trace/kept_ray.wesl` for each cell of pixels.
    pub rays: Buffer,
    /// [`RADIANCE_FORMAT`] (cell): change of the light, and light.
    pub changes: TextureView,
}

/// The textures of one index of all ping-pong pairs that are part of the history.
pub struct HistoryHalf {
    rate: TextureView,
    history: Option<[TextureView; 3]>,
}

impl PipelineTargets {
    /// The textures of this index.
    pub fn half(&self, index: usize) -> HistoryHalf {
        let history = self.history.as_ref();
        HistoryHalf {
            rate: self.rate[index].clone(),
            history: history
                .map(|pairs| [&pairs.radiance, &pairs.stats, &pairs.surface].map(|pair| pair[index].clone())),
        }
    }

    /// Replaces the textures of this index, and returns the replaced ones.
    pub fn replace_half(&mut self, index: usize, half: HistoryHalf) -> HistoryHalf {
        let replaced = self.half(index);
        self.rate[index] = half.rate;
        if let (Some(pairs), Some([radiance, stats, surface])) = (&mut self.history, half.history) {
            (pairs.radiance[index], pairs.stats[index], pairs.surface[index]) = (radiance, stats, surface);
        }
        replaced
    }

    /// Texture for passing hits from tracing to shading: the surfaces of the history that this frame writes later, if it has four pixels
    /// for each trace pixel.
    pub fn hits(&self, write_index: usize) -> Option<&TextureView> {
        let unused = || self.history.as_ref().map(|history| &history.surface[write_index]);
        self.own_hits.as_ref().or_else(unused)
    }

    /// Texture into which mirror rays write their radiance: their own, or the reconstruction, or this frame's history if there is neither.
    /// They bypass the denoiser, whose passes leave their pixels unchanged.
    pub fn mirror_radiance(&self, write_index: usize) -> Option<&TextureView> {
        let history = || self.history.as_ref().map(|history| &history.radiance[write_index]);
        let own = self.mirrors.as_ref().map(|(radiance, _)| radiance);
        own.or(self.reconstructed.as_ref()).or_else(history)
    }

    /// Texture into which mirror rays write their hit distance, and the number of their rays or their variance.
    pub fn mirror_stats(&self, write_index: usize) -> Option<&TextureView> {
        let history = || self.history.as_ref().map(|history| &history.stats[write_index]);
        let own = self.mirrors.as_ref().map(|(_, stats)| stats);
        own.or(self.reconstructed_stats.as_ref()).or_else(history)
    }
}

impl LightChangeTargets {
    fn new(create: &mut Creator, cells: UVec2) -> Self {
        let bytes = KEPT_RAY_BYTES * u64::from(cells.x) * u64::from(cells.y);
        Self {
            rays: create.buffer(bytes, BufferUsages::empty(), "glint_kept_rays"),
            changes: create.texture(cells, RADIANCE_FORMAT, "glint_light_changes"),
        }
    }
}

/// Ping-pong pairs: this frame writes `[write_index]` and reads `[1 - write_index]`.
pub struct HistoryTargets {
    /// [`RADIANCE_FORMAT`] (denoised): accumulated radiance; alpha is the history length in frames, 0 = nothing.
    pub radiance: [TextureView; 2],
    /// [`STATS_FORMAT`] (denoised): `pack2x16float(hit distance, relative variance of one frame's samples)`.
    pub stats: [TextureView; 2],
    /// [`HISTORY_SURFACE_FORMAT`] (denoised): `pack2x16float(distance from the viewer in metres, mean Y of the last frames)`, 0 if nothing
    /// reflects; geometric normal as `pack2x16snorm` of its octahedral map with the lowest 8 bits of the word replaced by the roughness.
    pub surface: [TextureView; 2],
}

impl HistoryTargets {
    fn new(create: &mut Creator, size: UVec2) -> Self {
        Self {
            radiance: create.pair(
                size,
                RADIANCE_FORMAT,
                ["glint_history_radiance_a", "glint_history_radiance_b"],
            ),
            stats: create.pair(size, STATS_FORMAT, ["glint_history_stats_a", "glint_history_stats_b"]),
            surface: create.pair(
                size,
                HISTORY_SURFACE_FORMAT,
                ["glint_history_surface_a", "glint_history_surface_b"],
            ),
        }
    }
}

/// A target of fragments that are kept.
pub(crate) fn attachment(view: &TextureView, load: LoadOp<Color>) -> Option<RenderPassColorAttachment<'_>> {
    Some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: Operations {
            load,
            store: StoreOp::Store,
        },
    })
}

/// A texture with one mip level for shaders, and its bytes.
pub(crate) fn create_texture(
    device: &RenderDevice,
    size: UVec2,
    format: TextureFormat,
    usage: TextureUsages,
    label: &'static str,
) -> (Texture, u64) {
    let texture = device.create_texture(&TextureDescriptor {
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
        usage: TextureUsages::TEXTURE_BINDING | usage,
        view_formats: &[],
    });
    let texel = format.block_copy_size(None).unwrap_or(16);
    (texture, u64::from(size.x) * u64::from(size.y) * u64::from(texel))
}

struct Creator<'a> {
    device: &'a RenderDevice,
    memory: Vec<(&'static str, u64)>,
}

impl Creator<'_> {
    fn texture(&mut self, size: UVec2, format: TextureFormat, label: &'static str) -> TextureView {
        let size = size.max(UVec2::ONE);
        let mut usage = TextureUsages::STORAGE_BINDING | TextureUsages::COPY_SRC;
        if matches!(format, RAY_RADIANCE_FORMAT | RAY_SAMPLE_FORMAT) {
            usage |= TextureUsages::RENDER_ATTACHMENT;
        }
        let (texture, bytes) = create_texture(self.device, size, format, usage, label);
        self.memory.push((label, bytes));
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

/// Sizes of the textures of a view that can grow to `capacity` pixels later.
fn room_for(sizes: Sizes, capacity: UVec2, needs: Needs) -> Sizes {
    let full = if needs.in_parts {
        // In this case, all trace pixels are whole.
        sizes.trace_scale
            * capacity
                .max(sizes.full)
                .map(|pixels| pixels.div_ceil(sizes.trace_scale))
    } else {
        sizes.full
    };
    Sizes { full, ..sizes }
}

impl Targets {
    /// Maximum size in pixels.
    pub fn capacity(&self) -> UVec2 {
        self.capacity
    }

    /// Returns whether a view of another size can use them: it must fit and leave less than three quarters of them unused.
    pub fn can_hold(&self, sizes: Sizes) -> bool {
        let fits = sizes.full.cmple(self.capacity).all() && (2 * sizes.full).cmpge(self.capacity).all();
        sizes == self.sizes || (fits && self.is_like(sizes, self.needs))
    }

    /// Returns whether a view of this size and with these needs can read the history in them.
    pub fn is_like(&self, sizes: Sizes, needs: Needs) -> bool {
        let kind = |sizes: Sizes| (sizes.trace_scale, sizes.texel, sizes.tile);
        let is_same_kind = self.needs == needs && kind(sizes) == kind(self.sizes);
        is_same_kind && (needs.in_parts || sizes == self.sizes)
    }

    /// Lets a frame read the history of other targets of the view, which were made for other settings, in place of the own textures of this
    /// index, with the rates of its tiles. Returns the own ones; `None` if the frame can't read it.
    pub fn read_history(&mut self, index: usize, other: &Self, other_index: usize) -> Option<HistoryHalf> {
        let (sizes, theirs) = (self.sizes, other.sizes);
        let is_alike = sizes.full == theirs.full || (self.needs.in_parts && other.needs.in_parts);
        let has_history = self.needs.temporal && other.needs.temporal;
        if sizes.texel != theirs.texel || !is_alike || !has_history {
            return None;
        }
        let own = self.pipeline.as_mut()?;
        Some(own.replace_half(index, other.pipeline.as_ref()?.half(other_index)))
    }

    /// For a view that can grow to `capacity` pixels later, if it can occupy a part of them.
    pub fn new(device: &RenderDevice, sizes: Sizes, capacity: UVec2, needs: Needs) -> Self {
        let room = room_for(sizes, capacity, needs);
        let create = &mut Creator {
            device,
            memory: Vec::new(),
        };
        let (full, denoised, trace, tiles) = (room.full, room.denoised(), room.trace(), room.tiles());
        let words = |size: UVec2| 4 * u64::from(size.x) * u64::from(size.y);
        let indirect_args = create.buffer(
            word_offset(INDIRECT_ARG_WORDS),
            BufferUsages::INDIRECT,
            "glint_indirect_args",
        );
        let accumulation = needs.accumulation.then(|| {
            create.pair(
                full,
                ACCUMULATION_FORMAT,
                ["glint_accumulation_a", "glint_accumulation_b"],
            )
        });
        let pipeline = needs.pipeline.then(|| PipelineTargets {
            rate: create.pair(tiles, RATE_FORMAT, ["glint_rate_a", "glint_rate_b"]),
            ray_list: create.buffer(words(trace), BufferUsages::empty(), "glint_ray_list"),
            mirror_ray_list: create.buffer(
                words(if needs.mirrors { full } else { UVec2::ONE }),
                BufferUsages::empty(),
                "glint_mirror_ray_list",
            ),
            tile_list: create.buffer(words(tiles), BufferUsages::empty(), "glint_tile_list"),
            ray_radiance: create.texture(trace, RAY_RADIANCE_FORMAT, "glint_ray_radiance"),
            ray_sample: create.texture(trace, RAY_SAMPLE_FORMAT, "glint_ray_sample"),
            own_hits: (!needs.temporal || denoised != 2 * trace)
                .then(|| create.texture(2 * trace, HIT_FORMAT, "glint_hits")),
            reconstructed: needs
                .reconstructed
                .then(|| create.texture(denoised, RADIANCE_FORMAT, "glint_reconstructed")),
            reconstructed_stats: needs
                .reconstructed
                .then(|| create.texture(denoised, STATS_FORMAT, "glint_reconstructed_stats")),
            mirrors: (needs.mirrors && denoised != full).then(|| {
                let radiance = create.texture(full, RADIANCE_FORMAT, "glint_mirror_radiance");
                (radiance, create.texture(full, STATS_FORMAT, "glint_mirror_stats"))
            }),
            history: needs.temporal.then(|| HistoryTargets::new(create, denoised)),
            light_changes: needs
                .light_changes
                .then(|| LightChangeTargets::new(create, room.cells())),
        });
        let counters = create.buffer(word_offset(COUNTER_WORDS), BufferUsages::empty(), "glint_counters");
        let reflection = needs
            .reflection
            .then(|| create.texture(full, REFLECTION_FORMAT, "glint_reflection"));
        let screen = needs
            .screen
            .then(|| create.texture(full, SCREEN_FORMAT, "glint_screen"));
        Self {
            sizes,
            capacity: room.full,
            needs,
            memory: take(&mut create.memory),
            indirect_args,
            counters,
            reflection,
            accumulation,
            screen,
            pipeline,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shaders_have_the_same_cells() {
        let shader = include_str!("gbuffer.wesl");
        assert!(shader.contains(&format!("const KEPT_CELL_LOG2: u32 = {}u;", CELL.ilog2())));
    }
}
