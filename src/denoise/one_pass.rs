//! The pass of `one_pass.wesl`.

use super::{temporal, tiles::PassVariant};
use crate::gbuffer::{GBufferPass, OtherGroups};

pub(super) fn pass() -> GBufferPass<PassVariant> {
    GBufferPass::new("glint_denoise", temporal::bindings(), OtherGroups::None)
}
