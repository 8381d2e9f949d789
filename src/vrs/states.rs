//! wgpu's part of the pass: packs the rates and moves all resources of the pass into the states that it expects.

use super::{
    draw::VrsDraw,
    rate_image::{RateImage, RateRows},
};
use crate::targets::attachment;
use bevy::render::{
    render_resource::{
        BindGroupEntries, BindGroupLayout, ComputePassDescriptor, ComputePipeline, LoadOp, RenderPassDescriptor,
    },
    renderer::RenderContext,
};
use wgpu::{BufferTransition, BufferUses, TextureTransition, TextureUses};

/// The entry points of the attachment shader.
pub(super) struct StateSetter<'a> {
    pub pack: &'a ComputePipeline,
    pub pack_layout: BindGroupLayout,
    pub touch: &'a ComputePipeline,
}

impl StateSetter<'_> {
    /// `new_targets` is true if wgpu hasn't used them in this back end before.
    pub fn set(&self, ctx: &mut RenderContext, pass: &VrsDraw, rates: Option<&RateImage>, new_targets: bool) {
        let targets = [pass.ray_radiance, pass.ray_sample];
        if new_targets {
            // wgpu doesn't see the pass write them. It would clear them on their first use after the pass.
            let attachments = targets.map(|view| attachment(view, LoadOp::Clear(Default::default())));
            drop(ctx.command_encoder().begin_render_pass(&RenderPassDescriptor {
                label: Some("glint_vrs_clear"),
                color_attachments: &attachments,
                ..Default::default()
            }));
        }
        let pack_group = rates.map(|rates| {
            ctx.render_device().create_bind_group(
                "glint_vrs_rates",
                &self.pack_layout,
                &BindGroupEntries::sequential((pass.rate, rates.words.as_entire_binding())),
            )
        });
        {
            let mut compute = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
                label: Some("glint_vrs_rates"),
                timestamp_writes: None,
            });
            if let (Some(rates), Some(pack_group)) = (rates, &pack_group) {
                let words = RateRows::new(rates.tiles).total_words();
                compute.set_pipeline(self.pack);
                compute.set_bind_group(0, pack_group, &[]);
                compute.dispatch_workgroups(words.div_ceil(64), 1, 1);
            }
            // wgpu inserts its barriers even for an empty dispatch, and for shaders of all stages.
            compute.set_pipeline(self.touch);
            for (index, group) in (0..).zip(&pass.groups) {
                let Ok(contents) = group.contents.contents() else {
                    continue;
                };
                compute.set_bind_group(index, &contents.bind_group, group.offsets);
            }
            compute.dispatch_workgroups(0, 0, 0);
        }
        ctx.command_encoder().transition_resources(
            rates.iter().map(|rates| BufferTransition {
                buffer: &*rates.words,
                state: BufferUses::COPY_SRC,
            }),
            targets.iter().map(|target| TextureTransition {
                texture: target.texture(),
                selector: None,
                state: TextureUses::COLOR_TARGET,
            }),
        );
    }
}
