//! What charts are drawn with: styles of lines and letters, and round numbers for axes.

use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, FontFamily, FontStyle, FontTransform,
    text_anchor::{HPos, Pos, VPos},
};
use std::fmt;

/// An opaque colour.
pub(crate) fn rgb(rgb: (u8, u8, u8)) -> BackendColor {
    BackendColor { alpha: 1.0, rgb }
}

/// A line of some width.
pub(crate) struct Stroke(pub BackendColor, pub u32);

impl BackendStyle for Stroke {
    fn color(&self) -> BackendColor {
        self.0
    }

    fn stroke_width(&self) -> u32 {
        self.1
    }
}

/// How a text looks.
pub(crate) struct Words {
    pixels: f64,
    color: BackendColor,
    anchor: Pos,
    pub bold: bool,
    /// Read from below.
    pub upward: bool,
}

impl Words {
    pub fn new(pixels: f64, color: BackendColor, h_pos: HPos, v_pos: VPos) -> Self {
        Self {
            pixels,
            color,
            anchor: Pos::new(h_pos, v_pos),
            bold: false,
            upward: false,
        }
    }
}

impl BackendTextStyle for Words {
    type FontError = fmt::Error;

    fn color(&self) -> BackendColor {
        self.color
    }

    fn size(&self) -> f64 {
        // The SVG backend divides by this.
        self.pixels * 1.24
    }

    fn transform(&self) -> FontTransform {
        if self.upward {
            FontTransform::Rotate270
        } else {
            FontTransform::None
        }
    }

    fn style(&self) -> FontStyle {
        if self.bold { FontStyle::Bold } else { FontStyle::Normal }
    }

    fn anchor(&self) -> Pos {
        self.anchor
    }

    fn family(&self) -> FontFamily<'_> {
        FontFamily::SansSerif
    }

    fn layout_box(&self, text: &str) -> Result<((i32, i32), (i32, i32)), fmt::Error> {
        Ok(((0, 0), (text_width(text, self.pixels), self.pixels as i32)))
    }

    fn draw<E, F: FnMut(i32, i32, BackendColor) -> Result<(), E>>(
        &self,
        _: &str,
        _: BackendCoord,
        _: F,
    ) -> Result<Result<(), E>, fmt::Error> {
        // Both backends have letters of their own.
        Ok(Ok(()))
    }
}

/// About as wide as a text is in a sans-serif font.
pub(crate) fn text_width(text: &str, pixels: f64) -> i32 {
    (text.chars().count() as f64 * 0.6 * pixels).ceil() as i32
}

/// Round numbers between two values: 1, 2 and 5 times powers of ten, or equal steps where those are few.
pub(crate) fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let ticks: Vec<f64> = decades
        .flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade)))
        .filter(|tick| (low..=high).contains(tick))
        .collect();
    if ticks.len() >= 3 {
        return ticks;
    }
    linear_ticks(low, high)
}

/// Multiples of a round step between two values.
pub(crate) fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let raw = (high - low).max(1e-12) / 6.0;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|digit| digit * power)
        .find(|step| *step >= raw)
        .unwrap_or(raw);
    // A hair of room, since steps aren't exact.
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A number without trailing zeros.
pub(crate) fn plain(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text.is_empty() || text == "-" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(log_ticks(0.3, 6.0), [0.5, 1.0, 2.0, 5.0]);
        assert_eq!(log_ticks(1.1, 1.6).first().copied().map(plain), Some("1.1".to_owned()));
        assert_eq!(
            linear_ticks(0.0, 0.1).into_iter().map(plain).collect::<Vec<_>>(),
            ["0", "0.02", "0.04", "0.06", "0.08", "0.1"]
        );
        assert_eq!(plain(100.0), "100");
    }
}
