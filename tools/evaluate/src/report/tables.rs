//! All tables of a folder of results, and everything else that was measured.

use super::{
    decomposition::SplitRow,
    dominance,
    objects::ObjectRow,
    rows::{self, Row, replace},
};
use crate::{machine::Machine, protocol::Protocol};
use serde::de::DeserializeOwned;
use std::path::Path;

/// The table of techniques, in the folder of results.
pub const ROWS: &str = "results.csv";
/// The table of named objects.
pub const OBJECTS: &str = "objects.csv";
/// The table of noise and bias.
pub const SPLITS: &str = "decomposition.csv";

/// The tables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tables {
    /// One row per technique.
    pub rows: Vec<Row>,
    /// Rows about named objects.
    pub objects: Vec<ObjectRow>,
    /// Rows about noise and bias.
    pub splits: Vec<SplitRow>,
}

/// Everything that was measured, for the writers of results.
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

impl Tables {
    /// Reads the tables of a folder. Only the table of techniques is required.
    pub fn load(out: &Path) -> Result<Self, String> {
        let mut rows = rows::load(&out.join(ROWS))?;
        dominance::fill(&mut rows);
        Ok(Self {
            rows,
            objects: load_if_any(&out.join(OBJECTS))?,
            splits: load_if_any(&out.join(SPLITS))?,
        })
    }

    /// These tables with newer rows in the place of older ones about the same.
    pub fn merge(self, new: Tables) -> Self {
        let objects = replace(self.objects, &new.rows, new.objects);
        let splits = replace(self.splits, &new.rows, new.splits);
        let mut rows = replace(self.rows, &new.rows, new.rows.clone());
        rows::sort(&mut rows);
        // Other rows can be faster and closer than these.
        dominance::fill(&mut rows);
        Self { rows, objects, splits }
    }
}

fn load_if_any<T: DeserializeOwned>(file: &Path) -> Result<Vec<T>, String> {
    if file.exists() {
        rows::load(file)
    } else {
        Ok(Vec::new())
    }
}
