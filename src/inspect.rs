//! What a view's targets hold, for this crate's own tests and tools. No part of the interface that versions keep.

use crate::{
    extract::{ReflectionView, WantsReflections},
    idle::ViewActivity,
    scene::environment::{EnvironmentBindings, ViewEnvironment},
    view::ReflectionTextures,
};
use bevy::{
    app::App,
    ecs::prelude::*,
    math::UVec2,
    pbr::{ScreenSpaceReflectionsPipelineId, ScreenSpaceReflectionsUniform, ViewScreenSpaceReflectionsUniformOffset},
    render::{
        RenderApp,
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, CommandEncoder, CommandEncoderDescriptor, Extent3d, MapMode,
            PollType, TexelCopyBufferInfo, TexelCopyBufferLayout, TextureView,
        },
        renderer::{RenderDevice, RenderQueue},
        sync_world::RenderEntity,
    },
};

/// In the render world before the renderer starts: the passes count the invocations that trace rays, in [`Target::Counters`] from
/// word 2 on, by the logarithm to base 2 of the trace pixels of their blocks.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct CountInvocations;

/// In the render world: only the whole of a view's passes is timed, since timers between passes keep them from overlapping.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct TotalTimeOnly;

/// What to look at; `targets.rs` says what it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The rate image.
    Rate,
    /// What rays saw.
    RayRadiance,
    /// How rays were drawn.
    RayRecord,
    /// Reconstructed and filtered radiance.
    Reconstructed,
    /// Hit distance and number of rays of the same.
    ReconstructedPair,
    /// Accumulated radiance.
    HistoryRadiance,
    /// Sizes of dispatches and lists.
    Arguments,
    /// What passes count.
    Counters,
    /// The list of blocks.
    Blocks,
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
    /// The words of a texel inside of [`size`](Self::size).
    #[must_use]
    pub fn at(&self, place: UVec2) -> &[u32] {
        let first = (place.y * self.size.x + place.x) as usize * self.texel;
        &self.words[first..first + self.texel]
    }
}

/// What the render world has for a camera that reflects, by name; nothing for others.
#[must_use]
pub fn held(app: &App, camera: Entity) -> Vec<&'static str> {
    let view = app.world().get::<RenderEntity>(camera).map(|view| view.id());
    let world = app.get_sub_app(RenderApp).map(|render| render.world());
    let (Some(view), Some(world)) = (view, world) else {
        return Vec::new();
    };
    let bindings = world.get_resource::<EnvironmentBindings>();
    let bind_group = bindings.and_then(|bindings| bindings.bind_group(view));
    // The last three are Bevy's, borrowed from its screen-space reflections.
    let offset = world.get::<ViewScreenSpaceReflectionsUniformOffset>(view);
    let all = [
        ("settings", world.get::<ReflectionView>(view).is_some()),
        ("wish", world.get::<WantsReflections>(view).is_some()),
        ("targets", world.get::<ReflectionTextures>(view).is_some()),
        ("reports", world.get::<ViewActivity>(view).is_some()),
        ("environment", world.get::<ViewEnvironment>(view).is_some()),
        ("bind group", bind_group.is_some()),
        ("uniform", world.get::<ScreenSpaceReflectionsUniform>(view).is_some()),
        ("offset", offset.is_some()),
        (
            "pipeline",
            world.get::<ScreenSpaceReflectionsPipelineId>(view).is_some(),
        ),
    ];
    let held = all.into_iter().filter(|(_, is_held)| *is_held);
    held.map(|(name, _)| name).collect()
}

/// What a target of a camera holds after the last frame; `None` where there is no such target or it can't be read.
#[must_use]
pub fn copy(app: &App, camera: Entity, target: Target) -> Option<Copied> {
    let view = app.world().get::<RenderEntity>(camera)?.id();
    let world = app.get_sub_app(RenderApp)?.world();
    let textures = world.get::<ReflectionTextures>(view)?;
    let (targets, parity) = (&textures.targets, textures.parity);
    let images = targets.pipeline.as_ref()?;
    match target {
        Target::Rate => copy_texture(world, &images.rate[parity]),
        Target::RayRadiance => copy_texture(world, &images.ray_radiance),
        Target::RayRecord => copy_texture(world, &images.ray_record),
        Target::Reconstructed => copy_texture(world, &images.reconstructed),
        Target::ReconstructedPair => copy_texture(world, &images.reconstructed_pair),
        Target::HistoryRadiance => copy_texture(world, &images.history.as_ref()?.radiance[parity]),
        Target::Arguments => copy_buffer(world, &targets.arguments),
        Target::Counters => copy_buffer(world, &targets.counters),
        Target::Blocks => copy_buffer(world, &images.blocks),
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
        label: Some("glint_inspect"),
        size,
        usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
        label: Some("glint_inspect"),
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
