//! Bindings of `tiles.wesl`, and variants of the passes that use it.

use crate::gbuffer::Binding;
use bevy::shader::ShaderDefVal;

/// The first bindings of passes over the active tiles.
pub(super) fn bindings() -> Vec<Binding> {
    vec![
        Binding::words(|context| Some(&context.images()?.tile_list)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
    ]
}

/// A variant of a pass over the active tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct PassVariant {
    /// Processes 16x16 pixels at a time instead of 8x8.
    pub wide: bool,
    /// The variant for static views. Views in motion use a faster variant without it.
    pub rest: bool,
    /// The variant that follows the images of moving objects. Other frames use a faster variant without it.
    pub hit_motion: bool,
}

impl PassVariant {
    pub fn shader_defs(self) -> Vec<ShaderDefVal> {
        let defs = [
            ("WIDE", self.wide),
            ("REST", self.rest),
            ("HIT_MOTION", self.hit_motion),
        ];
        defs.into_iter()
            .filter(|(_, holds)| *holds)
            .map(|(name, _)| name.into())
            .collect()
    }
}
