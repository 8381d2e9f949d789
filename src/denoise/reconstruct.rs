//! Bindings of `reconstruct.wesl`.

use super::tiles::{self, PassVariant};
use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups},
    targets::{RADIANCE_FORMAT, STATS_FORMAT},
};

pub(super) fn pass() -> GBufferPass<PassVariant> {
    let mut bindings = tiles::bindings();
    bindings.extend(ray_bindings());
    bindings.extend([
        Binding::written(RADIANCE_FORMAT, |context| context.images()?.reconstructed.as_ref()),
        Binding::written(STATS_FORMAT, |context| context.images()?.reconstructed_stats.as_ref()),
    ]);
    GBufferPass::new("glint_reconstruct", bindings, OtherGroups::None)
}

/// The rays, and the table for their weights.
pub(super) fn ray_bindings() -> [Binding; 3] {
    [
        Binding::floats(|context| Some(&context.images()?.ray_radiance)),
        Binding::integers(|context| Some(&context.images()?.ray_sample)),
        Binding::floats(|context| Some(context.albedo_table)),
    ]
}
