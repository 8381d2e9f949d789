//! Bindings of `temporal.wesl`.

use super::{
    history,
    pass::{floats, integers},
    tile_entries, tile_layout, written,
};
use crate::{
    targets::{PAIR_FORMAT, RADIANCE_FORMAT, SURFACE_FORMAT},
    trace::PassContext,
};
use bevy::render::render_resource::{DynamicBindGroupEntries, DynamicBindGroupLayoutEntries};

pub(super) fn layout() -> DynamicBindGroupLayoutEntries {
    tile_layout().extend_sequential((
        // Rates of this frame and the last, motion, what is new.
        integers(),
        integers(),
        floats(),
        floats(),
        integers(),
        // History of the last frame.
        floats(),
        integers(),
        integers(),
        // And of this one.
        written(RADIANCE_FORMAT),
        written(PAIR_FORMAT),
        written(SURFACE_FORMAT),
    ))
}

pub(super) fn entries<'a>(context: &PassContext<'a>) -> Option<DynamicBindGroupEntries<'a>> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    let (history, motion) = history(context)?;
    let (now, before) = (textures.parity, 1 - textures.parity);
    Some(tile_entries(context, images).extend_sequential((
        &images.rate[now],
        &images.rate[before],
        motion,
        &images.reconstructed,
        &images.reconstructed_pair,
        &history.radiance[before],
        &history.pair[before],
        &history.surface[before],
        &history.radiance[now],
        &history.pair[now],
        &history.surface[now],
    )))
}
