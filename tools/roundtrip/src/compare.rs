//! Compares what two runs of a pass left in its outputs.

use crate::resources::{Component, Kind, Pass};
use anyhow::{Result, ensure};
use half::f16;
use std::fmt;

/// Relative difference of floats that count as equal. Compilers may reorder and fuse arithmetic, and halves have 11 bits.
const TOLERANCE: f32 = 2e-3;
/// Fraction of changed values that may differ by more: rounding moves some comparisons to the other side.
const OUTLIERS: f64 = 5e-4;
/// Difference of both halves of a word that counts as rounding: words hold packed numbers. Indices differ by as little if they are wrong,
/// so only a fraction of the changed values may.
const ROUNDING: u32 = 4;
const ROUNDED: f64 = 0.01;

/// Counts over all outputs.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Values that are not those before the pass.
    pub changed: usize,
    /// Words that differ by rounding.
    pub rounded: usize,
    /// Other values that differ between the translations.
    pub unequal: usize,
    /// The first of them.
    pub first: Option<String>,
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (changed, rounded, unequal) = (self.changed, self.rounded, self.unequal);
        write!(formatter, "changed={changed}\trounded={rounded}\tunequal={unequal}")?;
        self.first
            .iter()
            .try_for_each(|first| write!(formatter, "\tfirst={first}"))
    }
}

impl Verdict {
    /// Compares outputs, in the order of the pass's resources.
    pub fn add(&mut self, pass: &Pass, native: &[Vec<u8>], returned: &[Vec<u8>]) -> Result<()> {
        let outputs = pass.resources.iter().filter(|resource| resource.is_output);
        for ((resource, native), returned) in outputs.zip(native).zip(returned) {
            let component = match resource.kind {
                Kind::Image(image) => image.texel.1,
                _ => Component::Integer,
            };
            let before = values(&resource.contents, component);
            let (native, returned) = (values(native, component), values(returned, component));
            ensure!(native.len() == returned.len(), "{} has two sizes", resource.name);
            for (index, ((before, native), returned)) in before.zip(native).zip(returned).enumerate() {
                self.changed += usize::from(before != native || before != returned);
                if are_equal(native, returned, component) {
                    continue;
                }
                if component == Component::Integer && differ_by_rounding(native, returned) {
                    self.rounded += 1;
                    continue;
                }
                self.unequal += 1;
                self.first
                    .get_or_insert_with(|| format!("{}[{index}]: {native:#x} and {returned:#x}", resource.name));
            }
        }
        Ok(())
    }

    /// Judges the counts of all runs: a pass must write something, and few values can differ.
    pub fn judge(self) -> Result<Self> {
        ensure!(self.changed > 0, "the pass writes nothing with these inputs");
        let changed = self.changed as f64;
        ensure!(
            self.unequal as f64 <= OUTLIERS * changed,
            "{} of {} values differ, the first at {}",
            self.unequal,
            self.changed,
            self.first.unwrap_or_default()
        );
        ensure!(
            self.rounded as f64 <= ROUNDED * changed,
            "{} of {} words differ a little",
            self.rounded,
            self.changed
        );
        Ok(self)
    }
}

fn differ_by_rounding(a: u32, b: u32) -> bool {
    [0, 16]
        .iter()
        .all(|half| ((a >> half) & 0xffff).abs_diff((b >> half) & 0xffff) <= ROUNDING)
}

/// The components of texels, or the words of a buffer.
fn values(bytes: &[u8], component: Component) -> impl ExactSizeIterator<Item = u32> {
    let size = if component == Component::Half { 2 } else { 4 };
    bytes.chunks_exact(size).map(|bytes| {
        let mut word = [0; 4];
        word[..bytes.len()].copy_from_slice(bytes);
        u32::from_le_bytes(word)
    })
}

fn are_equal(a: u32, b: u32, component: Component) -> bool {
    if a == b {
        return true;
    }
    match component {
        Component::Float => are_close(f32::from_bits(a), f32::from_bits(b)),
        Component::Half => {
            let [a, b] = [a, b].map(|bits| f16::from_bits(bits as u16).to_f32());
            are_close(a, b)
        }
        // Words can hold floats. Integers are too small for normal ones.
        Component::Integer => {
            let (a, b) = (f32::from_bits(a), f32::from_bits(b));
            a.is_normal() && b.is_normal() && (a - b).abs() <= 1e-5 * a.abs().max(b.abs())
        }
    }
}

fn are_close(a: f32, b: f32) -> bool {
    (a.is_nan() && b.is_nan()) || a == b || (a - b).abs() <= TOLERANCE * a.abs().max(b.abs()).max(1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_told_apart_from_other_values() {
        let float = |a: f32, b: f32| are_equal(a.to_bits(), b.to_bits(), Component::Float);
        assert!(float(1.0, 1.001) && float(f32::NAN, -f32::NAN) && float(0.0, 1e-6));
        assert!(!float(1.0, 1.01) && !float(1.0, f32::NAN) && !float(1.0, -1.0));
        let word = |a: u32, b: u32| are_equal(a, b, Component::Integer);
        assert!(word(7, 7) && word(1.0f32.to_bits(), 1.0f32.to_bits() + 3));
        assert!(!word(7, 8) && !word(0x100, 0x101) && !word(1.0f32.to_bits(), 1.1f32.to_bits()));
        assert!(are_equal(0x3c00, 0x3c01, Component::Half) && !are_equal(0x3c00, 0x3c10, Component::Half));
    }

    const SOURCE: &str = "
        @group(0) @binding(0) var<storage, read_write> words: array<u32, 400>;
        @compute @workgroup_size(1) fn main() { words[0] = 1u; }";

    #[test]
    fn few_outliers_pass() {
        let source = SOURCE.replace("400", "10000");
        let pass = Pass::read(&source, "main", 0).unwrap();
        let outputs = |changed: u32, wrong: u32, by: u32| {
            let mut bytes = pass.resources[0].contents.clone();
            for (index, word) in bytes.chunks_exact_mut(4).enumerate() {
                let index = index as u32;
                if index < changed {
                    word.copy_from_slice(&(0x200 + index + if index < wrong { by } else { 0 }).to_le_bytes());
                }
            }
            vec![bytes]
        };
        let judge = |changed, wrong, by| {
            let mut verdict = Verdict::default();
            verdict.add(&pass, &outputs(changed, 0, by), &outputs(changed, wrong, by))?;
            verdict.judge()
        };
        let few = judge(10000, 5, 0x100).unwrap();
        assert_eq!((few.changed, few.rounded, few.unequal), (10000, 0, 5));
        let error = judge(10000, 6, 0x100).unwrap_err().to_string();
        assert_eq!(
            error,
            "6 of 10000 values differ, the first at words[0]: 0x200 and 0x300"
        );
        assert_eq!(judge(10000, 100, 1).unwrap().rounded, 100);
        assert!(judge(10000, 101, 1).is_err());
        assert!(judge(0, 0, 0).unwrap_err().to_string().contains("writes nothing"));
    }
}
