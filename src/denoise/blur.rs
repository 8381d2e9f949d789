//! Bindings of `blur.wesl`.

use super::{floats, history, integers, words, written};
use crate::{
    targets::RADIANCE_FORMAT,
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
        "glint_blur_layout",
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
                integers(),
                written(RADIANCE_FORMAT),
            ),
        ),
    )
}

pub(super) fn bind_group(device: &RenderDevice, layout: &BindGroupLayout, context: &PassContext) -> Option<BindGroup> {
    let textures = context.textures;
    let images = textures.targets.pipeline.as_ref()?;
    let (history, _) = history(context)?;
    let now = textures.parity;
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    Some(device.create_bind_group(
        "glint_blur",
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
            &history.radiance[now],
            &history.pair[now],
            &history.surface[now],
            &images.reconstructed,
        )),
    ))
}
