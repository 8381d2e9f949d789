//! What the writers of results share.

use super::tables::Tables;
use crate::{machine::Machine, protocol::Protocol};
use std::path::Path;

/// Everything that was measured.
pub struct Results<'a> {
    /// The folder of results.
    pub out: &'a Path,
    /// The machine.
    pub machine: &'a Machine,
    /// How much was measured.
    pub protocol: &'a Protocol,
    /// All rows.
    pub tables: &'a Tables,
}
