//! The floors of the library, from its architecture document.

use crate::graph::Arrows;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// The table that follows this line.
const MARKER: &str = "<!-- floors -->";

/// The floor of each module below `src/`.
pub struct Floors(BTreeMap<String, u32>);

impl Floors {
    /// Reads the table of a document: the number of a floor in the first column, its modules as code in the second.
    pub fn read(document: &Path) -> Self {
        let text = fs::read_to_string(document).unwrap();
        let (_, table) = text.split_once(MARKER).expect("the document has a table of floors");
        let rows = table.lines().skip_while(|line| !line.starts_with('|'));
        let mut floors = BTreeMap::new();
        for row in rows.take_while(|line| line.starts_with('|')) {
            let mut cells = row.trim_matches('|').split('|').map(str::trim);
            let (Some(Ok(floor)), Some(modules)) = (cells.next().map(str::parse), cells.next()) else {
                continue;
            };
            for name in modules.split('`').skip(1).step_by(2) {
                let module = name.trim_end_matches('/').split('.').next().unwrap_or_default();
                let before = floors.insert(module.to_owned(), floor);
                assert!(
                    before.is_none_or(|before| before == floor),
                    "{module} stands on two floors"
                );
            }
        }
        Self(floors)
    }

    pub fn modules(&self) -> BTreeSet<String> {
        self.0.keys().cloned().collect()
    }

    /// Arrows between modules that don't lead to a lower floor.
    pub fn wrong_arrows(&self, arrows: &Arrows) -> Vec<String> {
        let module = |file: &str| {
            let inside = file.strip_prefix("src/").unwrap_or(file);
            inside.split(['/', '.']).next().unwrap_or_default().to_owned()
        };
        let floor = |module: &str| self.0.get(module).copied();
        let mut wrong = Vec::new();
        for (from, to) in arrows {
            let (a, b) = (module(from), module(to));
            // Another file replaces raw Vulkan if that isn't compiled.
            let is_stand_in = [&a, &b].iter().all(|name| ["vrs", "no_vrs"].contains(&name.as_str()));
            if a != b && !is_stand_in && floor(&a) <= floor(&b) {
                let (a, b) = (floor(&a), floor(&b));
                wrong.push(format!("{from} (floor {a:?}) -> {to} (floor {b:?})"));
            }
        }
        wrong
    }
}
