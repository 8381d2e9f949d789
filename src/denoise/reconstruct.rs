//! Bindings of `reconstruct.wesl`.

use super::{floats, integers, words, written};
use crate::{
    targets::{PAIR_FORMAT, RADIANCE_FORMAT},
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
        "glint_reconstruct_layout",
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
                integers(),
                floats(),
                integers(),
                floats(),
                written(RADIANCE_FORMAT),
                written(PAIR_FORMAT),
            ),
        ),
    )
}

pub(super) fn bind_group(device: &RenderDevice, layout: &BindGroupLayout, context: &PassContext) -> Option<BindGroup> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    Some(device.create_bind_group(
        "glint_reconstruct",
        layout,
        &BindGroupEntries::sequential((
            view,
            settings,
            depth,
            gbuffer,
            normals,
            images.tiles.as_entire_binding(),
            textures.targets.arguments.as_entire_binding(),
            &images.rate[textures.parity],
            &images.ray_radiance,
            &images.ray_record,
            context.albedo_table,
            &images.reconstructed,
            &images.reconstructed_pair,
        )),
    ))
}
