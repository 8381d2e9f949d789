//! Bindings of `reconstruct.wesl`.

use super::tiles::{self, PassVariant};
use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups},
    targets::{RADIANCE_FORMAT, STATS_FORMAT},
};

pub(super) fn pass() -> GBufferPass<PassVariant> {
    let mut bindings = tiles::bindings();
    bindings.extend([
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
        Binding::floats(|context| Some(&context.images()?.ray_radiance)),
        Binding::integers(|context| Some(&context.images()?.ray_sample)),
        Binding::floats(|context| Some(context.albedo_table)),
        Binding::written(RADIANCE_FORMAT, |context| Some(&context.images()?.reconstructed)),
        Binding::written(STATS_FORMAT, |context| Some(&context.images()?.reconstructed_stats)),
    ]);
    GBufferPass::new("glint_reconstruct", bindings, OtherGroups::None)
}
