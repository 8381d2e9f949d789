//! Bindings of `temporal.wesl`.

use super::tiles::{self, PassVariant};
use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups},
    targets::{HISTORY_SURFACE_FORMAT, RADIANCE_FORMAT, STATS_FORMAT},
};

pub(super) fn pass() -> GBufferPass<PassVariant> {
    let mut bindings = tiles::bindings();
    bindings.extend([
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
        Binding::integers(|context| Some(&context.images()?.rate[context.before()])),
        Binding::floats(|context| context.motion),
        Binding::floats(|context| Some(&context.images()?.reconstructed)),
        Binding::integers(|context| Some(&context.images()?.reconstructed_stats)),
        Binding::floats(|context| Some(&context.history()?.0.radiance[context.before()])),
        Binding::integers(|context| Some(&context.history()?.0.stats[context.before()])),
        Binding::integers(|context| Some(&context.history()?.0.surface[context.before()])),
        Binding::written(RADIANCE_FORMAT, |context| {
            Some(&context.history()?.0.radiance[context.now()])
        }),
        Binding::written(STATS_FORMAT, |context| Some(&context.history()?.0.stats[context.now()])),
        Binding::written(HISTORY_SURFACE_FORMAT, |context| {
            Some(&context.history()?.0.surface[context.now()])
        }),
    ]);
    GBufferPass::new("glint_temporal", bindings, OtherGroups::None)
}
