//! Circles among arrows.

use std::collections::{BTreeMap, BTreeSet};

/// Arrows from a file to one that it imports.
pub type Arrows = BTreeSet<(String, String)>;

/// Groups of files that reach each other, one line for each with its inner arrows.
pub fn circles(arrows: &Arrows) -> Vec<String> {
    let mut next: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (from, to) in arrows {
        next.entry(from).or_default().push(to);
    }
    let reach = |start: &str| {
        let mut seen = BTreeSet::new();
        let mut stack = vec![start];
        while let Some(node) = stack.pop() {
            for &to in next.get(node).into_iter().flatten() {
                if seen.insert(to) {
                    stack.push(to);
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&str, BTreeSet<&str>> = next.keys().map(|&node| (node, reach(node))).collect();
    let mut groups: BTreeSet<BTreeSet<&str>> = BTreeSet::new();
    for (&node, seen) in &reached {
        if seen.contains(node) {
            let back = |other: &&str| reached.get(other).is_some_and(|seen| seen.contains(node));
            groups.insert(seen.iter().copied().filter(back).collect());
        }
    }
    let describe = |group: BTreeSet<&str>| {
        let inside = arrows
            .iter()
            .filter(|(from, to)| group.contains(from.as_str()) && group.contains(to.as_str()));
        let lines: Vec<String> = inside.map(|(from, to)| format!("{from} -> {to}")).collect();
        lines.join(", ")
    };
    groups.into_iter().map(describe).collect()
}

/// For each folder the arrows between its children (files and folders). A file and the folder of the same name are one.
pub fn between_children(arrows: &Arrows) -> BTreeMap<String, Arrows> {
    let mut found: BTreeMap<String, Arrows> = BTreeMap::new();
    for (from, to) in arrows {
        let (a, b): (Vec<&str>, Vec<&str>) = (from.split('/').collect(), to.split('/').collect());
        let common = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
        let child = |parts: &[&str]| parts[common].split('.').next().unwrap_or_default().to_owned();
        let (from, to) = (child(&a), child(&b));
        if from != to && from != "mod" {
            found.entry(a[..common].join("/")).or_default().insert((from, to));
        }
    }
    found
}
