//! Bindings of `tiles.wesl`.

use crate::gbuffer::Binding;

/// The bindings that passes over the active tiles begin with.
pub(super) fn bindings() -> Vec<Binding> {
    vec![
        Binding::words(|context| Some(&context.images()?.tile_list)),
        Binding::words(|context| Some(&context.targets().indirect_args)),
    ]
}
