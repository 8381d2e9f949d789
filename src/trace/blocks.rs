//! Rays of the lists: one for each block, and one for each pixel of an exact mirror.

use super::variant::Variant;
use crate::{
    common::{MIRROR_RAY_DISPATCH, RAY_DISPATCH, word_offset},
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext},
    targets::{RADIANCE_FORMAT, RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT, STATS_FORMAT},
};
use bevy::render::{render_resource::BindGroupLayoutDescriptor, renderer::RenderContext};

/// The pass over the ray list.
pub(super) fn ray_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Variant> {
    let own = [
        Binding::words(|context| Some(&context.images()?.ray_list)),
        Binding::written(RAY_RADIANCE_FORMAT, |context| Some(&context.images()?.ray_radiance)),
        Binding::written(RAY_SAMPLE_FORMAT, |context| Some(&context.images()?.ray_sample)),
    ];
    list_pass("glint_trace_rays", own, scene_layout)
}

/// The pass over the mirror ray list.
pub(super) fn mirror_ray_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Variant> {
    let own = [
        Binding::words(|context| Some(&context.images()?.mirror_ray_list)),
        Binding::written(RADIANCE_FORMAT, |context| Some(context.images()?.mirror_radiance())),
        Binding::written(STATS_FORMAT, |context| Some(context.images()?.mirror_stats())),
    ];
    list_pass("glint_trace_mirror_rays", own, scene_layout)
}

fn list_pass(label: &'static str, own: [Binding; 3], scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Variant> {
    let mut bindings = vec![
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::float_layers(|context| Some(context.noise)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
    ];
    bindings.extend(own);
    GBufferPass::new(label, bindings, OtherGroups::SceneAndEnvironment(scene_layout.clone()))
}

/// Traces the rays of one list.
pub(super) fn trace_list(
    ctx: &mut RenderContext,
    pass: &GBufferPass<Variant>,
    variant: Variant,
    context: &PassContext,
    list: List,
) {
    if let Some(mut compute) = pass.begin(ctx, context, variant.substitutes(), &[]) {
        compute.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(list.dispatch()));
    }
}

/// A list of rays.
#[derive(Clone, Copy)]
pub(super) enum List {
    Rays,
    MirrorRays,
}

impl List {
    fn dispatch(self) -> u64 {
        match self {
            Self::Rays => RAY_DISPATCH,
            Self::MirrorRays => MIRROR_RAY_DISPATCH,
        }
    }
}
