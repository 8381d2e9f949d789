//! Bindings of `blur.wesl`.

use super::{
    history,
    pass::{floats, integers},
    tile_entries, tile_layout, written,
};
use crate::{targets::RADIANCE_FORMAT, trace::PassContext};
use bevy::render::render_resource::{DynamicBindGroupEntries, DynamicBindGroupLayoutEntries};

pub(super) fn layout() -> DynamicBindGroupLayoutEntries {
    tile_layout().extend_sequential((integers(), floats(), integers(), integers(), written(RADIANCE_FORMAT)))
}

pub(super) fn entries<'a>(context: &PassContext<'a>) -> Option<DynamicBindGroupEntries<'a>> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    let (history, _) = history(context)?;
    let now = textures.parity;
    Some(tile_entries(context, images).extend_sequential((
        &images.rate[now],
        &history.radiance[now],
        &history.pair[now],
        &history.surface[now],
        &images.reconstructed,
    )))
}
