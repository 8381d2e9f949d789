//! Columns of a view that each of its debug views covers.

use crate::settings::{ReflectionDebugView, ViewDebug};
use core::ops::Range;

/// Columns of a view that show a debug view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Side {
    pub view: ReflectionDebugView,
    pub columns: Range<u32>,
    /// Columns of the dividing line.
    pub line: Range<u32>,
}

/// The two sides of a frame of this width. The right side draws the line; without a view there, the left one does.
pub(super) fn sides(debug: ViewDebug, width: u32) -> impl Iterator<Item = Side> {
    let divider = ((debug.position * width as f32).round() as u32).min(width);
    let line = if divider == 0 || divider == width {
        0..0
    } else if debug.right == ReflectionDebugView::Off {
        divider.saturating_sub(2)..divider
    } else {
        divider..(divider + 2).min(width)
    };
    let sides = [(debug.left, 0..divider), (debug.right, divider..width)];
    sides
        .into_iter()
        .filter(|(view, columns)| *view != ReflectionDebugView::Off && !columns.is_empty())
        .map(move |(view, columns)| Side {
            view,
            columns,
            line: line.clone(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::ReflectionDebugSplit;

    #[test]
    fn a_divided_view_covers_what_it_should() {
        let side = |view, columns, line| Side { view, columns, line };
        let of = |view: ReflectionDebugView, split: Option<ReflectionDebugSplit>| -> Vec<_> {
            sides(ViewDebug::new(Some(&view), split.as_ref(), false), 100).collect()
        };
        let split = |position, left| Some(ReflectionDebugSplit { position, left });
        let (off, rates, rays) = (
            ReflectionDebugView::Off,
            ReflectionDebugView::ShadingRates,
            ReflectionDebugView::RawRays,
        );
        assert!(of(off, None).is_empty());
        assert_eq!(of(rates, None), [side(rates, 0..100, 0..0)]);
        assert_eq!(of(rates, split(0.25, off)), [side(rates, 25..100, 25..27)]);
        assert_eq!(of(off, split(f32::NAN, rays)), [side(rays, 0..50, 48..50)]);
        assert_eq!(
            of(rates, split(0.999, rays)),
            [side(rays, 0..100, 0..0)],
            "the line would lie outside"
        );
        assert!(of(rates, split(7.0, off)).is_empty());
        assert_eq!(
            of(rates, split(0.5, rays)),
            [side(rays, 0..50, 50..52), side(rates, 50..100, 50..52)]
        );
    }
}
