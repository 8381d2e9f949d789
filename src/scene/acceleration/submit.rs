//! Submits builds to the driver.

use crate::device::try_allocate;
use bevy::{
    log::warn_once,
    render::{
        render_resource::{BlasBuildEntry, CommandEncoderDescriptor, Tlas},
        renderer::{RenderDevice, RenderQueue},
    },
};
use wgpu::CommandBuffer;

/// Builds these structures. Returns false and changes nothing if the device lacks the memory.
pub(super) fn submit_builds<'a>(
    label: &'static str,
    blas: &'a [BlasBuildEntry<'a>],
    tlas: Option<&'a Tlas>,
    device: &RenderDevice,
    queue: &RenderQueue,
) -> bool {
    let commands = record_builds(label, blas, tlas, device);
    commands.map(|commands| queue.submit([commands])).is_some()
}

/// Records commands that build these structures; `None` if the device lacks the memory.
pub(super) fn record_builds<'a>(
    label: &'static str,
    blas: &'a [BlasBuildEntry<'a>],
    tlas: Option<&'a Tlas>,
    device: &RenderDevice,
) -> Option<CommandBuffer> {
    let commands = try_allocate(device, || {
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor { label: Some(label) });
        encoder.build_acceleration_structures(blas, tlas);
        encoder.finish()
    });
    if commands.is_none() {
        warn_once!(
            "objects are missing from reflections, since the device has no memory to build acceleration structures; use \
             fewer or smaller meshes, or keep some out with `NotReflected`"
        );
    }
    commands
}
