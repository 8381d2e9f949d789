//! Bindings of `temporal.wesl`.

use super::{floats, history, integers, words, written};
use crate::{
    targets::{PAIR_FORMAT, RADIANCE_FORMAT, SURFACE_FORMAT},
    trace::{GBufferBindings, PassContext, gbuffer_layout_entries},
};
use bevy::render::{
    render_resource::{
        BindGroup, BindGroupEntries, BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntries, ShaderStages,
    },
    renderer::RenderDevice,
};

pub(super) fn layout() -> BindGroupLayoutDescriptor {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    BindGroupLayoutDescriptor::new(
        "glint_temporal_layout",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                view,
                settings,
                depth,
                gbuffer,
                normals,
                words(),
                words(),
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
            ),
        ),
    )
}

pub(super) fn bind_group(device: &RenderDevice, layout: &BindGroupLayout, context: &PassContext) -> Option<BindGroup> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    let (history, motion) = history(context)?;
    let (now, before) = (textures.parity, 1 - textures.parity);
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    Some(device.create_bind_group(
        "glint_temporal",
        layout,
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            images.tiles.as_entire_binding(),
            textures.targets.arguments.as_entire_binding(),
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
        )),
    ))
}
