//! Copies of a view's targets for this crate's own tests and tools. Not covered by semantic versioning.

use crate::{
    scene::environment::{EnvironmentBindings, ViewEnvironment},
    settings::{ReflectionView, WantsReflections},
    view::{ReflectionTextures, ViewCulling},
};
use bevy::{
    app::App,
    ecs::prelude::*,
    math::UVec2,
    pbr::{ScreenSpaceReflectionsPipelineId, ViewKeyCache},
    render::{
        RenderApp,
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, CommandEncoder, CommandEncoderDescriptor, Extent3d, MapMode,
            PollType, TexelCopyBufferInfo, TexelCopyBufferLayout, TextureView,
        },
        renderer::{RenderDevice, RenderQueue},
        sync_world::RenderEntity,
        view::ExtractedView,
    },
};

/// Target to read back; `targets.rs` describes its contents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The rate image.
    Rate,
    /// Radiance of rays.
    RayRadiance,
    /// How rays were sampled.
    RaySample,
    /// Reconstructed and filtered radiance.
    Reconstructed,
    /// Hit distance and number of rays of the reconstruction.
    ReconstructedStats,
    /// Accumulated radiance.
    HistoryRadiance,
    /// Hit distance and variance of the history.
    HistoryStats,
    /// Sizes of dispatches and lists.
    IndirectArgs,
    /// Counters of the passes.
    Counters,
    /// The list of blocks.
    RayList,
}

/// A copy of a target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Copied {
    /// Texels; a buffer is one row of words.
    pub size: UVec2,
    /// Rows without padding.
    pub words: Vec<u32>,
    /// Words of a texel.
    pub texel: usize,
}

impl Copied {
    /// The words of a texel inside [`size`](Self::size).
    #[must_use]
    pub fn at(&self, place: UVec2) -> &[u32] {
        let first = (place.y * self.size.x + place.x) as usize * self.texel;
        &self.words[first..first + self.texel]
    }
}

/// Names of the render-world resources of a reflecting camera; empty for other cameras.
#[must_use]
pub fn render_world_components(app: &App, camera: Entity) -> Vec<&'static str> {
    let view = app.world().get::<RenderEntity>(camera).map(|view| view.id());
    let world = app.get_sub_app(RenderApp).map(|render| render.world());
    let (Some(view), Some(world)) = (view, world) else {
        return Vec::new();
    };
    let bindings = world.get_resource::<EnvironmentBindings>();
    let bind_group = bindings.and_then(|bindings| bindings.bind_group(view));
    let all = [
        ("settings", world.get::<ReflectionView>(view).is_some()),
        ("request", world.get::<WantsReflections>(view).is_some()),
        ("targets", world.get::<ReflectionTextures>(view).is_some()),
        ("reports", world.get::<ViewCulling>(view).is_some()),
        ("environment", world.get::<ViewEnvironment>(view).is_some()),
        ("bind group", bind_group.is_some()),
        // Views that could reflect always have the other components of the hook in Bevy's lighting.
        (
            "pipeline",
            world.get::<ScreenSpaceReflectionsPipelineId>(view).is_some(),
        ),
    ];
    all.into_iter()
        .filter_map(|(name, exists)| exists.then_some(name))
        .collect()
}

/// The bits by which Bevy selects pipelines for the objects of a camera; `None` if it draws nothing.
#[must_use]
pub fn view_key(app: &App, camera: Entity) -> Option<u64> {
    let view = app.world().get::<RenderEntity>(camera)?.id();
    let world = app.get_sub_app(RenderApp)?.world();
    let view = world.get::<ExtractedView>(view)?;
    let keys = world.get_resource::<ViewKeyCache>()?;
    keys.get(&view.retained_view_entity).map(|key| key.bits())
}

/// Returns the contents of a camera's target after the last frame; `None` if there is no such target or it can't be read.
#[must_use]
pub fn copy(app: &App, camera: Entity, target: Target) -> Option<Copied> {
    let view = app.world().get::<RenderEntity>(camera)?.id();
    let world = app.get_sub_app(RenderApp)?.world();
    let textures = world.get::<ReflectionTextures>(view)?;
    let (targets, now) = (&textures.targets, textures.write_index);
    let images = targets.pipeline.as_ref()?;
    match target {
        Target::Rate => copy_texture(world, &images.rate[now]),
        Target::RayRadiance => copy_texture(world, &images.ray_radiance),
        Target::RaySample => copy_texture(world, &images.ray_sample),
        Target::Reconstructed => copy_texture(world, images.reconstructed.as_ref()?),
        Target::ReconstructedStats => copy_texture(world, images.reconstructed_stats.as_ref()?),
        Target::HistoryRadiance => copy_texture(world, &images.history.as_ref()?.radiance[now]),
        Target::HistoryStats => copy_texture(world, &images.history.as_ref()?.stats[now]),
        Target::IndirectArgs => copy_buffer(world, &targets.indirect_args),
        Target::Counters => copy_buffer(world, &targets.counters),
        Target::RayList => copy_buffer(world, &images.ray_list),
    }
}

fn copy_texture(world: &World, view: &TextureView) -> Option<Copied> {
    let texture = view.texture();
    let Extent3d { width, height, .. } = texture.size();
    let texel = texture.format().block_copy_size(None)?;
    let row = (width * texel) as usize;
    let padded = RenderDevice::align_copy_bytes_per_row(row);
    let bytes = read(world, padded as u64 * u64::from(height), |encoder, buffer| {
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            TexelCopyBufferInfo {
                buffer,
                layout: TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded as u32),
                    rows_per_image: None,
                },
            },
            Extent3d {
                width,
                height,
                depth_or_array_layers: 1,
            },
        );
    })?;
    Some(Copied {
        size: UVec2::new(width, height),
        words: bytes
            .chunks_exact(padded)
            .flat_map(|line| words(&line[..row]))
            .collect(),
        texel: texel as usize / 4,
    })
}

fn copy_buffer(world: &World, source: &Buffer) -> Option<Copied> {
    let bytes = read(world, source.size(), |encoder, buffer| {
        encoder.copy_buffer_to_buffer(source, 0, buffer, 0, source.size());
    })?;
    let words: Vec<u32> = words(&bytes).collect();
    Some(Copied {
        size: UVec2::new(words.len() as u32, 1),
        words,
        texel: 1,
    })
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u32> {
    let word = |word: &[u8]| u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
    bytes.chunks_exact(4).map(word)
}

fn read(world: &World, size: u64, copy: impl FnOnce(&mut CommandEncoder, &Buffer)) -> Option<Vec<u8>> {
    let device = world.get_resource::<RenderDevice>()?;
    let queue = world.get_resource::<RenderQueue>()?;
    let buffer = device.create_buffer(&BufferDescriptor {
        label: Some("glint_readback"),
        size,
        usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
        label: Some("glint_readback"),
    });
    copy(&mut encoder, &buffer);
    queue.submit([encoder.finish()]);
    let slice = buffer.slice(..);
    slice.map_async(MapMode::Read, |_| {});
    let wait = PollType::Wait {
        submission_index: None,
        timeout: None,
    };
    device.poll(wait).ok()?;
    let bytes = slice.get_mapped_range().ok()?.to_vec();
    Some(bytes)
}
