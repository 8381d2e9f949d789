//! Bindings of `blur.wesl`.

use super::tiles;
use crate::{
    gbuffer::{Binding, GBufferPass, OtherGroups},
    targets::RADIANCE_FORMAT,
};

pub(super) fn pass() -> GBufferPass<bool> {
    let mut bindings = tiles::bindings();
    bindings.extend([
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
        Binding::floats(|context| Some(&context.history()?.0.radiance[context.now()])),
        Binding::integers(|context| Some(&context.history()?.0.stats[context.now()])),
        Binding::integers(|context| Some(&context.history()?.0.surface[context.now()])),
        Binding::written(RADIANCE_FORMAT, |context| Some(context.images()?.blurred())),
    ]);
    GBufferPass::new("glint_blur", bindings, OtherGroups::None)
}
