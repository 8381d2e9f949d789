//! The pass of `one_pass.wesl`.

use super::temporal;
use crate::pipelines::{Failure, Pass};

pub(crate) const ONE_PASS: &Pass = &Pass {
    label: "glint_denoise",
    shader: "denoise/one_pass.wesl",
    entry_point: "denoise",
    bindings: temporal::bindings,
    ..Pass::new(Failure::DENOISER)
};
