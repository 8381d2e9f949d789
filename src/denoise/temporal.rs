//! The pass of `temporal.wesl`.

use super::{reconstruct::ray_bindings, tiles};
use crate::{
    gbuffer::Binding,
    pipelines::{Failure, Pass},
    targets::{HISTORY_SURFACE_FORMAT, RADIANCE_FORMAT, STATS_FORMAT},
};

pub(crate) const TEMPORAL: &Pass = &Pass {
    label: "glint_temporal",
    shader: "denoise/temporal.wesl",
    entry_point: "temporal",
    bindings,
    ..Pass::new(Failure::DENOISER)
};

/// The bindings of this pass, and of the joint pass with the reconstruction. This pass doesn't read the rays. The joint pass doesn't read
/// the reconstruction; if there is none, other textures of the same kind are bound instead.
pub(super) fn bindings() -> Vec<Binding> {
    let mut bindings = tiles::bindings();
    bindings.extend(ray_bindings());
    bindings.extend([
        Binding::floats(|context| {
            let images = context.images()?;
            Some(images.reconstructed.as_ref().unwrap_or(&images.ray_radiance))
        }),
        Binding::integers(|context| {
            let images = context.images()?;
            Some(images.reconstructed_stats.as_ref().unwrap_or(&images.ray_sample))
        }),
        Binding::integers(|context| Some(&context.images()?.rate[context.before()])),
        Binding::floats(|context| context.motion),
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
        Binding::floats(|context| {
            let images = context.images()?;
            let changes = images.light_changes.as_ref().map(|light| &light.changes);
            Some(changes.unwrap_or(&images.ray_radiance))
        }),
    ]);
    bindings
}
