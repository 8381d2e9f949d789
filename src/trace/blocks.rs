//! Rays of the lists: one for each block, traced in one pass and shaded in the next; and one for each pixel of an exact mirror, traced
//! in that shading pass or in a separate pass.

use crate::{
    common::{ALL_RAYS_DISPATCH, MIRROR_RAY_DISPATCH, RAY_DISPATCH, word_offset},
    gbuffer::{Binding, GBufferPass, OtherGroups, PassContext},
    scene::Features,
    targets::{HIT_FORMAT, RADIANCE_FORMAT, RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT, STATS_FORMAT},
};
use bevy::render::{render_resource::BindGroupLayoutDescriptor, renderer::RenderContext};

/// The pass over the ray list.
pub(super) fn ray_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Features> {
    let own = vec![
        Binding::words(|context| Some(&context.images()?.ray_list)),
        Binding::written(RAY_RADIANCE_FORMAT, |context| Some(&context.images()?.ray_radiance)),
        Binding::written(RAY_SAMPLE_FORMAT, |context| Some(&context.images()?.ray_sample)),
        Binding::written(HIT_FORMAT, |context| context.images()?.hits(context.now())),
    ];
    list_pass("glint_trace_rays", own, scene_layout)
}

/// The pass that shades the hits of the ray list.
pub(super) fn shading_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Features> {
    let groups = OtherGroups::SceneAndEnvironment(scene_layout.clone());
    GBufferPass::new("glint_shade_hits", shading_bindings(), groups)
}

/// The pass that shades the hits of the ray list and traces the mirror ray list.
pub(super) fn shading_and_mirrors_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Features> {
    let mut bindings = shading_bindings();
    bindings.extend([
        Binding::words(|context| Some(&context.images()?.mirror_ray_list)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
        Binding::written(RADIANCE_FORMAT, |context| {
            context.images()?.mirror_radiance(context.now())
        }),
        Binding::written(STATS_FORMAT, |context| context.images()?.mirror_stats(context.now())),
    ]);
    let groups = OtherGroups::SceneAndEnvironment(scene_layout.clone());
    GBufferPass::new("glint_shade_hits_and_mirrors", bindings, groups).with_screen(reads_screen)
}

fn shading_bindings() -> Vec<Binding> {
    vec![
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::words(|context| Some(&context.images()?.ray_list)),
        Binding::integers(|context| Some(&context.images()?.ray_sample)),
        Binding::integers(|context| context.images()?.hits(context.now())),
        Binding::written(RAY_RADIANCE_FORMAT, |context| Some(&context.images()?.ray_radiance)),
        Binding::floats(|context| Some(context.albedo_table)),
    ]
}

/// The pass over the mirror ray list.
pub(super) fn mirror_ray_pass(scene_layout: &BindGroupLayoutDescriptor) -> GBufferPass<Features> {
    let own = vec![
        Binding::words(|context| Some(&context.images()?.mirror_ray_list)),
        Binding::written(RADIANCE_FORMAT, |context| {
            context.images()?.mirror_radiance(context.now())
        }),
        Binding::written(STATS_FORMAT, |context| context.images()?.mirror_stats(context.now())),
    ];
    list_pass("glint_trace_mirror_rays", own, scene_layout)
}

fn list_pass(
    label: &'static str,
    own: Vec<Binding>,
    scene_layout: &BindGroupLayoutDescriptor,
) -> GBufferPass<Features> {
    let mut bindings = vec![
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::float_layers(|context| Some(context.noise)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::written_words(1, |context| Some(&context.targets().counters)),
    ];
    bindings.extend(own);
    let groups = OtherGroups::SceneAndEnvironment(scene_layout.clone());
    GBufferPass::new(label, bindings, groups).with_screen(reads_screen)
}

fn reads_screen(features: &Features) -> bool {
    features.contains(Features::SCREEN_TRACES)
}

/// Traces or shades the rays of one list.
pub(super) fn run_list(
    ctx: &mut RenderContext,
    pass: &GBufferPass<Features>,
    features: Features,
    context: &PassContext,
    list: List,
) {
    if let Some(mut compute) = pass.begin(ctx, context, [features], &[]) {
        compute.dispatch_workgroups_indirect(&context.targets().indirect_args, word_offset(list.dispatch()));
    }
}

/// A list of rays.
#[derive(Clone, Copy)]
pub(super) enum List {
    Rays,
    MirrorRays,
    /// Mirror rays, followed by the others.
    AllRays,
}

impl List {
    fn dispatch(self) -> u64 {
        match self {
            Self::Rays => RAY_DISPATCH,
            Self::MirrorRays => MIRROR_RAY_DISPATCH,
            Self::AllRays => ALL_RAYS_DISPATCH,
        }
    }
}
