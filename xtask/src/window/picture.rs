//! Pictures of a display, and what differs between them.

use std::ops::Range;

/// A rectangle of the picture.
pub struct Region {
    /// Columns.
    pub x: Range<usize>,
    /// Rows.
    pub y: Range<usize>,
}

impl Region {
    /// The share of its pixels for which something is true.
    fn share(&self, holds: impl Fn(usize, usize) -> bool) -> f64 {
        let rows = self.y.clone();
        let count: usize = rows.map(|y| self.x.clone().filter(|&x| holds(x, y)).count()).sum();
        count as f64 / (self.x.len() * self.y.len()) as f64
    }
}

/// Differences of channels that count.
const STEP: u8 = 12;

/// What a display shows, three bytes a pixel.
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Picture {
    /// Reads a binary PPM.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(b"P6")?;
        let mut numbers = [0; 3];
        for number in &mut numbers {
            let begin = rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
            rest = &rest[begin..];
            let end = rest.iter().position(|byte| !byte.is_ascii_digit())?;
            *number = std::str::from_utf8(&rest[..end]).ok()?.parse::<usize>().ok()?;
            rest = &rest[end..];
        }
        let [width, height, 255] = numbers else { return None };
        // One white space ends the header.
        let pixels = rest.get(1..)?.to_vec();
        (pixels.len() == 3 * width * height).then_some(Self { width, height, pixels })
    }

    /// Black outside.
    fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        if x >= self.width || y >= self.height {
            return [0; 3];
        }
        let first = 3 * (y * self.width + x);
        [0, 1, 2].map(|channel| self.pixels[first + channel])
    }

    /// The share of a region that isn't black.
    pub fn lit(&self, region: &Region) -> f64 {
        region.share(|x, y| self.pixel(x, y).iter().any(|value| *value > STEP))
    }

    /// The share of a region that isn't as it was.
    pub fn changed(&self, before: &Self, region: &Region) -> f64 {
        self.changed_at(before, region, (0, 0))
    }

    /// The same, with what was in the region before looked for elsewhere.
    fn changed_at(&self, before: &Self, region: &Region, (dx, dy): (isize, isize)) -> f64 {
        region.share(|x, y| {
            let now = self.pixel(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            now.into_iter()
                .zip(before.pixel(x, y))
                .any(|(now, before)| now.abs_diff(before) > STEP)
        })
    }

    /// Whether what was in the region is now so far away, give or take a few pixels.
    pub fn moved(&self, before: &Self, region: &Region, (dx, dy): (i32, i32)) -> bool {
        const SLACK: i32 = 8;
        let is_there = |x: i32, y: i32| self.changed_at(before, region, (x as isize, y as isize)) < 0.02;
        (dy - SLACK..=dy + SLACK).any(|y| (dx - SLACK..=dx + SLACK).any(|x| is_there(x, y)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Black but for a white square of 4x4 at a place.
    fn picture(x: usize, y: usize) -> Picture {
        let mut bytes = b"P6\n64 32\n255\n".to_vec();
        let header = bytes.len();
        bytes.resize(header + 3 * 64 * 32, 0);
        for row in y..y + 4 {
            let first = header + 3 * (row * 64 + x);
            bytes[first..first + 12].fill(255);
        }
        Picture::parse(&bytes).unwrap()
    }

    #[test]
    fn what_changed_is_found() {
        let region = Region { x: 0..16, y: 0..16 };
        let (before, after) = (picture(4, 4), picture(34, 10));
        assert_eq!(before.lit(&region), 16.0 / 256.0);
        assert_eq!(after.changed(&before, &region), 16.0 / 256.0);
        assert_eq!(before.changed(&picture(4, 4), &region), 0.0);
        assert!(after.moved(&before, &region, (30, 6)));
        assert!(after.moved(&before, &region, (27, 4)));
        let square = Region { x: 4..8, y: 4..8 };
        assert!(!after.moved(&before, &square, (10, 6)));
    }

    #[test]
    fn what_is_no_picture_is_none() {
        for bytes in [
            &b""[..],
            b"P6",
            b"P6 1 1 255",
            b"P6 1 1 255 12",
            b"P5 1 1 255 123",
            b"P6 1 1 100 123",
        ] {
            assert!(Picture::parse(bytes).is_none(), "{bytes:?}");
        }
        assert!(Picture::parse(b"P6 1 1 255 123").is_some());
    }
}
