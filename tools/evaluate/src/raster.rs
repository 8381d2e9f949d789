//! A drawing surface that becomes a PNG: shapes are drawn several times too large and shrunk, letters come from a built-in
//! bitmap font, so that charts look the same on machines without fonts.

use crate::picture::Picture;
use embedded_graphics::{
    Drawable, Pixel,
    draw_target::DrawTarget,
    geometry::{OriginDimensions, Point, Size},
    mono_font::{
        MonoFont, MonoTextStyle,
        ascii::{FONT_7X13, FONT_7X13_BOLD, FONT_8X13, FONT_9X15, FONT_9X15_BOLD, FONT_10X20},
    },
    pixelcolor::BinaryColor,
    text::{Baseline, Text},
};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontStyle,
    text_anchor::{HPos, VPos},
};
use std::convert::Infallible;

/// Samples per pixel in each direction.
const FINENESS: i32 = 3;

/// What can go wrong: nothing.
type Outcome = Result<(), DrawingErrorKind<Infallible>>;

/// The enlarged picture.
struct Surface {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Surface {
    fn blend(&mut self, (x, y): BackendCoord, color: BackendColor) {
        let inside = x >= 0 && y >= 0 && (x as u32) < self.width && (y as u32) < self.height;
        if !inside {
            return;
        }
        let at = 3 * (y as usize * self.width as usize + x as usize);
        let (red, green, blue) = color.rgb;
        for (byte, new) in self.rgb[at..at + 3].iter_mut().zip([red, green, blue]) {
            let old = f64::from(*byte);
            *byte = (old + (f64::from(new) - old) * color.alpha.clamp(0.0, 1.0)).round() as u8;
        }
    }
}

impl DrawingBackend for Surface {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn ensure_prepared(&mut self) -> Outcome {
        Ok(())
    }

    fn present(&mut self) -> Outcome {
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Outcome {
        self.blend(point, color);
        Ok(())
    }
}

/// A style whose lines are as much wider as the picture is larger.
struct Enlarged {
    color: BackendColor,
    width: u32,
}

impl Enlarged {
    fn new<S: BackendStyle>(style: &S) -> Self {
        Self {
            color: style.color(),
            width: style.stroke_width() * FINENESS as u32,
        }
    }
}

impl BackendStyle for Enlarged {
    fn color(&self) -> BackendColor {
        self.color
    }

    fn stroke_width(&self) -> u32 {
        self.width
    }
}

/// The lit pixels of a line of text, with the top left corner at the origin.
struct Glyphs(Vec<(i32, i32)>);

impl OriginDimensions for Glyphs {
    fn size(&self) -> Size {
        Size::new(1 << 16, 64)
    }
}

impl DrawTarget for Glyphs {
    type Color = BinaryColor;
    type Error = Infallible;

    fn draw_iter<I>(&mut self, pixels: I) -> Result<(), Infallible>
    where
        I: IntoIterator<Item = Pixel<BinaryColor>>,
    {
        let lit = pixels.into_iter().filter(|pixel| pixel.1 == BinaryColor::On);
        self.0.extend(lit.map(|pixel| (pixel.0.x, pixel.0.y)));
        Ok(())
    }
}

/// The font that comes nearest to a size. Sizes are those of the SVG backend, which draws letters of `size / 1.24` pixels.
fn font(size: f64, bold: bool) -> &'static MonoFont<'static> {
    match (size / 1.24, bold) {
        (pixels, _) if pixels > 17.5 => &FONT_10X20,
        (pixels, true) if pixels > 14.5 => &FONT_9X15_BOLD,
        (pixels, false) if pixels > 14.5 => &FONT_9X15,
        (_, true) => &FONT_7X13_BOLD,
        (pixels, false) if pixels > 12.5 => &FONT_8X13,
        _ => &FONT_7X13,
    }
}

/// Width and height of a line of text in pixels.
fn extent(font: &MonoFont, text: &str) -> (i32, i32) {
    let advance = font.character_size.width + font.character_spacing;
    let count = text.chars().count() as i32;
    (count * advance as i32, font.character_size.height as i32)
}

struct Label {
    pixels: Vec<(i32, i32)>,
    color: BackendColor,
}

/// A backend that draws into a picture.
pub struct Raster {
    surface: Surface,
    labels: Vec<Label>,
}

impl Raster {
    /// A white surface.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width * FINENESS as u32, height * FINENESS as u32);
        Self {
            surface: Surface {
                width,
                height,
                rgb: vec![255; 3 * width as usize * height as usize],
            },
            labels: Vec::new(),
        }
    }

    /// What was drawn.
    #[must_use]
    pub fn into_picture(self) -> Picture {
        let fineness = FINENESS as usize;
        let (width, height) = self.get_size();
        let row = 3 * self.surface.width as usize;
        let mut rgb = Vec::with_capacity(3 * width as usize * height as usize);
        for y in 0..height as usize {
            for at in (0..width as usize).flat_map(|x| (0..3).map(move |channel| 3 * x * fineness + channel)) {
                let samples = (0..fineness * fineness)
                    .map(|i| self.surface.rgb[(y * fineness + i / fineness) * row + at + 3 * (i % fineness)]);
                let sum: u32 = samples.map(u32::from).sum();
                rgb.push((sum / (fineness * fineness) as u32) as u8);
            }
        }
        // Letters have the size of the picture.
        let mut fine = Surface { width, height, rgb };
        for label in &self.labels {
            for &pixel in &label.pixels {
                fine.blend(pixel, label.color);
            }
        }
        Picture {
            width,
            height,
            rgb: fine.rgb,
        }
    }
}

fn enlarge((x, y): BackendCoord) -> BackendCoord {
    // The middle of the pixel.
    (x * FINENESS + FINENESS / 2, y * FINENESS + FINENESS / 2)
}

impl DrawingBackend for Raster {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (
            self.surface.width / FINENESS as u32,
            self.surface.height / FINENESS as u32,
        )
    }

    fn ensure_prepared(&mut self) -> Outcome {
        Ok(())
    }

    fn present(&mut self) -> Outcome {
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Outcome {
        self.draw_rect(point, point, &color, true)
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Outcome {
        self.surface
            .draw_line(enlarge(from), enlarge(to), &Enlarged::new(style))
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        upper_left: BackendCoord,
        bottom_right: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Outcome {
        if !fill {
            let ((left, top), (right, bottom)) = (upper_left, bottom_right);
            let corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
            return corners
                .windows(2)
                .try_for_each(|side| self.draw_line(side[0], side[1], style));
        }
        for y in upper_left.1 * FINENESS..(bottom_right.1 + 1) * FINENESS {
            for x in upper_left.0 * FINENESS..(bottom_right.0 + 1) * FINENESS {
                self.surface.blend((x, y), style.color());
            }
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(&mut self, center: BackendCoord, radius: u32, style: &S, fill: bool) -> Outcome {
        let (x, y) = enlarge(center);
        let half = if fill {
            0.0
        } else {
            f64::from(style.stroke_width()) / 2.0
        };
        let scale = f64::from(FINENESS);
        let outer = (f64::from(radius) + half) * scale;
        let inner = if fill { -1.0 } else { (f64::from(radius) - half) * scale };
        let reach = outer.ceil() as i32;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let distance = f64::from(dx * dx + dy * dy).sqrt();
                if distance <= outer && distance >= inner {
                    self.surface.blend((x + dx, y + dy), style.color());
                }
            }
        }
        Ok(())
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> Outcome {
        let path: Vec<BackendCoord> = path.into_iter().map(enlarge).collect();
        self.surface.fill_polygon(path, style)
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, (x, y): BackendCoord) -> Outcome {
        let font = font(style.size(), matches!(style.style(), FontStyle::Bold));
        // The font has ASCII only.
        let text: String = text.chars().map(|c| if c.is_ascii() { c } else { '?' }).collect();
        let (width, height) = extent(font, &text);
        let dx = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Center => -width / 2,
            HPos::Right => -width,
        };
        let dy = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let mut glyphs = Glyphs(Vec::new());
        let letters = MonoTextStyle::new(font, BinaryColor::On);
        // Neither drawing nor collecting can fail.
        let _ = Text::with_baseline(&text, Point::zero(), letters, Baseline::Top).draw(&mut glyphs);
        let turn = style.transform();
        let place = |(u, v): (i32, i32)| {
            let (u, v) = turn.transform(u + dx, v + dy);
            (x + u, y + v)
        };
        self.labels.push(Label {
            pixels: glyphs.0.into_iter().map(place).collect(),
            color: style.color(),
        });
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        style: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let (width, height) = extent(font(style.size(), matches!(style.style(), FontStyle::Bold)), text);
        Ok((width as u32, height as u32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: BackendColor = BackendColor {
        alpha: 1.0,
        rgb: (0, 0, 0),
    };

    fn at(picture: &Picture, x: u32, y: u32) -> u8 {
        picture.rgb[3 * (y * picture.width + x) as usize]
    }

    #[test]
    fn shapes_appear_where_they_were_drawn() {
        let mut raster = Raster::new(40, 30);
        raster.draw_rect((5, 5), (9, 9), &BLACK, true).unwrap();
        raster.draw_circle((25, 15), 6, &BLACK, true).unwrap();
        raster.draw_line((0, 28), (39, 28), &BLACK).unwrap();
        let picture = raster.into_picture();
        assert_eq!((picture.width, picture.height), (40, 30));
        assert_eq!(
            (at(&picture, 5, 5), at(&picture, 9, 9), at(&picture, 10, 10)),
            (0, 0, 255)
        );
        assert_eq!((at(&picture, 25, 15), at(&picture, 33, 15)), (0, 255));
        assert!(at(&picture, 20, 28) < 128);
        // Edges are smooth.
        assert!(picture.rgb.iter().any(|&byte| byte != 0 && byte != 255));
        // What lies outside is cut off.
        let mut raster = Raster::new(4, 4);
        raster.draw_rect((-5, -5), (20, 20), &BLACK, true).unwrap();
        assert!(raster.into_picture().rgb.iter().all(|&byte| byte == 0));
    }
}
