//! Bindings of `tiles.wesl`, and the variants of the passes that it serves.

use crate::gbuffer::Binding;
use bevy::shader::ShaderDefVal;

/// The bindings that passes over the active tiles begin with.
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
    /// It works on 16x16 pixels at a time, not on 8x8.
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
