//! Bindings of `reconstruct.wesl`.

use super::{
    pass::{floats, integers},
    tile_entries, tile_layout, written,
};
use crate::{
    targets::{PAIR_FORMAT, RADIANCE_FORMAT},
    trace::PassContext,
};
use bevy::render::render_resource::{DynamicBindGroupEntries, DynamicBindGroupLayoutEntries};

pub(super) fn layout() -> DynamicBindGroupLayoutEntries {
    tile_layout().extend_sequential((
        integers(),
        floats(),
        integers(),
        floats(),
        written(RADIANCE_FORMAT),
        written(PAIR_FORMAT),
    ))
}

pub(super) fn entries<'a>(context: &PassContext<'a>) -> Option<DynamicBindGroupEntries<'a>> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    Some(tile_entries(context, images).extend_sequential((
        &images.rate[textures.parity],
        &images.ray_radiance,
        &images.ray_record,
        context.albedo_table,
        &images.reconstructed,
        &images.reconstructed_pair,
    )))
}
