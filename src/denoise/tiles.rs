//! Bindings of `tiles.wesl`.

use crate::gbuffer::Binding;

/// The first bindings of passes over the active tiles.
pub(super) fn bindings() -> Vec<Binding> {
    vec![
        Binding::words(|context| Some(&context.images()?.tile_list)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
        Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
    ]
}
