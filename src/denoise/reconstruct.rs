//! The pass of `reconstruct.wesl`.

use super::tiles;
use crate::{
    gbuffer::Binding,
    pipelines::{Failure, Pass},
    targets::{RADIANCE_FORMAT, STATS_FORMAT},
};

pub(crate) const RECONSTRUCT: &Pass = &Pass {
    label: "glint_reconstruct",
    shader: "denoise/reconstruct.wesl",
    entry_point: "reconstruct",
    bindings,
    ..Pass::new(Failure::DENOISER)
};

fn bindings() -> Vec<Binding> {
    let mut bindings = tiles::bindings();
    bindings.extend(ray_bindings());
    bindings.extend([
        Binding::written(RADIANCE_FORMAT, |context| context.images()?.reconstructed.as_ref()),
        Binding::written(STATS_FORMAT, |context| context.images()?.reconstructed_stats.as_ref()),
    ]);
    bindings
}

/// The rays, and the table for their weights.
pub(super) fn ray_bindings() -> [Binding; 3] {
    [
        Binding::floats(|context| Some(&context.images()?.ray_radiance)),
        Binding::integers(|context| Some(&context.images()?.ray_sample)),
        Binding::floats(|context| Some(context.albedo_table)),
    ]
}
