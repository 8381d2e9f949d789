//! Charts of error against time, as SVG and as PNG.

use crate::{
    drawing::{Stroke, Words, linear_ticks, log_ticks, plain, rgb, text_width},
    picture::Picture,
    raster::Raster,
    rows::Row,
    stats::pareto_front,
};
use plotters_backend::{
    BackendColor, DrawingBackend, DrawingErrorKind,
    text_anchor::{HPos, VPos},
};
use plotters_svg::SVGBackend;

/// Width and height of a chart in pixels.
pub const SIZE: (u32, u32) = (1200, 750);

const LEFT: i32 = 96;
const RIGHT: i32 = 40;
const TOP: i32 = 96;
const BOTTOM: i32 = 78;

/// What kind of technique a point is; it decides the colour. The colours can be told apart by people who see few of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// What the paper compares.
    Paper,
    /// A preset, or our own heuristic.
    Own,
    /// What others offer.
    Other,
}

impl Family {
    /// The family of a technique by name.
    #[must_use]
    pub fn of(technique: &str) -> Self {
        match technique {
            "reference" | "quarter" | "quarter-inline" | "vrs-roughness" | "vrs-grazing" | "paper" => Self::Paper,
            "ssr" | "solari" | "off" => Self::Other,
            _ => Self::Own,
        }
    }

    fn color(self) -> BackendColor {
        rgb(match self {
            Self::Paper => (0, 114, 178),
            Self::Own => (213, 94, 0),
            Self::Other => (110, 110, 110),
        })
    }

    fn name(self) -> &'static str {
        match self {
            Self::Paper => "the paper's techniques",
            Self::Own => "presets and our heuristics",
            Self::Other => "others",
        }
    }
}

/// One technique in a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Its name.
    pub label: String,
    /// Milliseconds, above 0.
    pub time: f64,
    /// The confidence interval of the time.
    pub time_range: Option<(f64, f64)>,
    /// The error, at least 0.
    pub error: f64,
    /// The error in the best and in the worst view.
    pub error_range: Option<(f64, f64)>,
    /// Its kind.
    pub family: Family,
}

/// A chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// The first line.
    pub title: String,
    /// The second line.
    pub subtitle: String,
    /// What the error is.
    pub error_name: String,
    /// The techniques.
    pub points: Vec<Point>,
    /// Errors of what takes no time, drawn as lines across.
    pub levels: Vec<(String, f64)>,
}

/// The chart of one scene, or `None` if no row has both a time and the error.
#[must_use]
pub fn chart(
    title: &str,
    subtitle: &str,
    error_name: &str,
    rows: &[&Row],
    error: fn(&Row) -> Option<f64>,
    error_range: fn(&Row) -> Option<(f64, f64)>,
) -> Option<Chart> {
    let mut chart = Chart {
        title: title.to_owned(),
        subtitle: subtitle.to_owned(),
        error_name: error_name.to_owned(),
        points: Vec::new(),
        levels: Vec::new(),
    };
    for row in rows {
        let Some(value) = error(row).filter(|value| value.is_finite()) else {
            continue;
        };
        match row.total_ms {
            Some(time) if time > 0.0 && time.is_finite() => chart.points.push(Point {
                label: row.label(),
                time,
                time_range: row.total_low_ms.zip(row.total_high_ms),
                error: value,
                error_range: error_range(row),
                family: Family::of(&row.technique),
            }),
            _ if row.technique == "off" => chart.levels.push((row.label(), value)),
            _ => {}
        }
    }
    (!chart.points.is_empty()).then_some(chart)
}

/// The chart as an SVG document.
///
/// # Errors
///
/// If it can't be drawn, which doesn't happen.
pub fn svg(chart: &Chart) -> Result<String, String> {
    let mut text = String::new();
    {
        let mut backend = SVGBackend::with_string(&mut text, SIZE);
        draw(&mut backend, chart).map_err(|error| error.to_string())?;
        backend.present().map_err(|error| error.to_string())?;
    }
    Ok(text)
}

/// The chart as a picture.
///
/// # Errors
///
/// If it can't be drawn, which doesn't happen.
pub fn png(chart: &Chart) -> Result<Picture, String> {
    let mut raster = Raster::new(SIZE.0, SIZE.1);
    draw(&mut raster, chart).map_err(|error| error.to_string())?;
    Ok(raster.into_picture())
}

/// From values to pixels.
struct Frame {
    time: (f64, f64),
    error: f64,
}

impl Frame {
    fn new(chart: &Chart) -> Self {
        let times = chart.points.iter().flat_map(|point| {
            let (low, high) = point.time_range.unwrap_or((point.time, point.time));
            [point.time, low, high]
        });
        let positive = times.filter(|time| time.is_finite() && *time > 0.0);
        let (low, high) = positive.fold((f64::INFINITY, 0.0f64), |(low, high), time| {
            (low.min(time), high.max(time))
        });
        let levels = chart.levels.iter().map(|level| level.1);
        let errors = chart.points.iter().map(|point| point.error).chain(levels);
        let error = errors.fold(0.0f64, f64::max);
        Self {
            // Room for the labels, most of all on the right.
            time: (low / 1.35, high * 1.8),
            error: if error > 0.0 { error * 1.12 } else { 1.0 },
        }
    }

    fn x(&self, time: f64) -> i32 {
        let (low, high) = (self.time.0.ln(), self.time.1.ln());
        let share = ((time.max(1e-9).ln() - low) / (high - low)).clamp(0.0, 1.0);
        LEFT + (share * f64::from(SIZE.0 as i32 - LEFT - RIGHT)).round() as i32
    }

    fn y(&self, error: f64) -> i32 {
        let share = (error / self.error).clamp(0.0, 1.0);
        let bottom = SIZE.1 as i32 - BOTTOM;
        bottom - (share * f64::from(bottom - TOP)).round() as i32
    }
}

type Drawn<B> = Result<(), DrawingErrorKind<<B as DrawingBackend>::ErrorType>>;

fn draw<B: DrawingBackend>(backend: &mut B, chart: &Chart) -> Drawn<B> {
    let frame = Frame::new(chart);
    let (width, height) = (SIZE.0 as i32, SIZE.1 as i32);
    backend.draw_rect((0, 0), (width, height), &rgb((255, 255, 255)), true)?;
    axes(backend, &frame, chart)?;
    for (label, level) in &chart.levels {
        let y = frame.y(*level);
        for x in (LEFT..width - RIGHT).step_by(12) {
            let end = (x + 6).min(width - RIGHT);
            backend.draw_line((x, y), (end, y), &Stroke(rgb((110, 110, 110)), 1))?;
        }
        let words = Words::new(13.0, rgb((90, 90, 90)), HPos::Left, VPos::Bottom);
        backend.draw_text(&format!("{label}: no time"), &words, (LEFT + 6, y - 4))?;
    }
    let places: Vec<(f64, f64)> = chart.points.iter().map(|point| (point.time, point.error)).collect();
    let front = pareto_front(&places);
    let step = Stroke(rgb((0, 158, 115)), 2);
    for pair in front.windows(2) {
        let corner = |time: f64, error: f64| (frame.x(time), frame.y(error));
        let ((t0, e0), (t1, e1)) = (places[pair[0]], places[pair[1]]);
        backend.draw_line(corner(t0, e0), corner(t1, e0), &step)?;
        backend.draw_line(corner(t1, e0), corner(t1, e1), &step)?;
    }
    for (i, point) in chart.points.iter().enumerate() {
        marker(backend, &frame, point, front.contains(&i))?;
    }
    labels(backend, &frame, chart)?;
    legend(backend, chart)
}

fn axes<B: DrawingBackend>(backend: &mut B, frame: &Frame, chart: &Chart) -> Drawn<B> {
    let (width, height) = (SIZE.0 as i32, SIZE.1 as i32);
    let (right, bottom) = (width - RIGHT, height - BOTTOM);
    let (ink, pale) = (rgb((40, 40, 40)), Stroke(rgb((226, 226, 226)), 1));
    for tick in log_ticks(frame.time.0, frame.time.1) {
        let x = frame.x(tick);
        backend.draw_line((x, TOP), (x, bottom), &pale)?;
        let words = Words::new(13.0, ink, HPos::Center, VPos::Top);
        backend.draw_text(&plain(tick), &words, (x, bottom + 8))?;
    }
    for tick in linear_ticks(0.0, frame.error) {
        let y = frame.y(tick);
        backend.draw_line((LEFT, y), (right, y), &pale)?;
        let words = Words::new(13.0, ink, HPos::Right, VPos::Center);
        backend.draw_text(&plain(tick), &words, (LEFT - 8, y))?;
    }
    let axis = Stroke(ink, 1);
    backend.draw_line((LEFT, TOP), (LEFT, bottom), &axis)?;
    backend.draw_line((LEFT, bottom), (right, bottom), &axis)?;
    let mut title = Words::new(20.0, ink, HPos::Left, VPos::Top);
    title.bold = true;
    backend.draw_text(&chart.title, &title, (LEFT, 18))?;
    let words = Words::new(13.0, rgb((90, 90, 90)), HPos::Left, VPos::Top);
    backend.draw_text(&chart.subtitle, &words, (LEFT, 48))?;
    let words = Words::new(14.0, ink, HPos::Center, VPos::Top);
    let middle = (LEFT + right) / 2;
    backend.draw_text("GPU time per frame, ms (logarithmic)", &words, (middle, bottom + 38))?;
    let mut words = Words::new(14.0, ink, HPos::Center, VPos::Top);
    words.upward = true;
    backend.draw_text(&chart.error_name, &words, (22, (TOP + bottom) / 2))
}

fn marker<B: DrawingBackend>(backend: &mut B, frame: &Frame, point: &Point, on_front: bool) -> Drawn<B> {
    let (x, y) = (frame.x(point.time), frame.y(point.error));
    let whisker = Stroke(
        BackendColor {
            alpha: 0.45,
            ..point.family.color()
        },
        1,
    );
    if let Some((low, high)) = point.error_range {
        backend.draw_line((x, frame.y(low)), (x, frame.y(high)), &whisker)?;
    }
    if let Some((low, high)) = point.time_range {
        backend.draw_line((frame.x(low), y), (frame.x(high), y), &whisker)?;
    }
    let color = point.family.color();
    if on_front {
        backend.draw_circle((x, y), 7, &color, true)
    } else {
        backend.draw_circle((x, y), 6, &rgb((255, 255, 255)), true)?;
        backend.draw_circle((x, y), 6, &Stroke(color, 2), false)
    }
}

/// A rectangle: left, top, right, bottom.
type Rectangle = (i32, i32, i32, i32);

fn overlap(a: Rectangle, b: Rectangle) -> i32 {
    let width = a.2.min(b.2) - a.0.max(b.0);
    let height = a.3.min(b.3) - a.1.max(b.1);
    width.max(0) * height.max(0)
}

/// Names beside their points, where they cover the least of anything else.
fn labels<B: DrawingBackend>(backend: &mut B, frame: &Frame, chart: &Chart) -> Drawn<B> {
    const PIXELS: f64 = 14.0;
    let markers = chart
        .points
        .iter()
        .map(|point| (frame.x(point.time), frame.y(point.error)));
    let mut taken: Vec<Rectangle> = markers.map(|(x, y)| (x - 9, y - 9, x + 9, y + 9)).collect();
    let inside = (LEFT, TOP - 14, SIZE.0 as i32 - 4, SIZE.1 as i32 - BOTTOM);
    for point in &chart.points {
        let (x, y) = (frame.x(point.time), frame.y(point.error));
        let (width, half) = (text_width(&point.label, PIXELS), 9);
        // Right, left, above, below, then farther away.
        let spots = [0, 20, -20, 40, -40, 60, -60].into_iter().flat_map(|dy| {
            [
                (x + 13, y + dy),
                (x - 13 - width, y + dy),
                (x - width / 2, y + dy - 20),
                (x - width / 2, y + dy + 20),
            ]
        });
        let area = |(left, middle): (i32, i32)| (left, middle - half, left + width, middle + half);
        let cost = |&spot: &(i32, i32)| {
            let area = area(spot);
            let covered: i32 = taken.iter().map(|other| overlap(area, *other)).sum();
            let outside = width * 2 * half - overlap(area, inside);
            4 * (covered + outside) + (spot.1 - y).abs()
        };
        let Some(spot) = spots.min_by_key(cost) else {
            continue;
        };
        taken.push(area(spot));
        if (spot.1 - y).abs() > 24 {
            let near = (spot.0.max(x.min(spot.0 + width)), spot.1);
            backend.draw_line((x, y), near, &Stroke(rgb((190, 190, 190)), 1))?;
        }
        let words = Words::new(PIXELS, point.family.color(), HPos::Left, VPos::Center);
        backend.draw_text(&point.label, &words, spot)?;
    }
    Ok(())
}

fn legend<B: DrawingBackend>(backend: &mut B, chart: &Chart) -> Drawn<B> {
    const Y: i32 = 76;
    let mut x = LEFT;
    for family in [Family::Paper, Family::Own, Family::Other] {
        if !chart.points.iter().any(|point| point.family == family) {
            continue;
        }
        backend.draw_circle((x + 6, Y), 5, &family.color(), true)?;
        let words = Words::new(13.0, rgb((60, 60, 60)), HPos::Left, VPos::Center);
        backend.draw_text(family.name(), &words, (x + 16, Y))?;
        x += 46 + text_width(family.name(), 13.0);
    }
    backend.draw_line((x, Y), (x + 26, Y), &Stroke(rgb((0, 158, 115)), 2))?;
    let words = Words::new(13.0, rgb((60, 60, 60)), HPos::Left, VPos::Center);
    let text = "Pareto front (filled): nothing is both faster and closer";
    backend.draw_text(text, &words, (x + 34, Y))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<Row> {
        let row = |technique: &str, time: f64, error: f64| Row {
            scene: "atrium".into(),
            technique: technique.into(),
            total_ms: Some(time),
            total_low_ms: Some(time * 0.98),
            total_high_ms: Some(time * 1.02),
            flip_final_converged: Some(error),
            ..Row::default()
        };
        vec![
            row("off", 0.0, 0.09),
            row("reference", 1.363, 0.01),
            row("quarter", 0.971, 0.02),
            row("vrs-roughness", 0.677, 0.024),
            row("low", 0.6, 0.03),
            row("ssr", 0.9, 0.06),
        ]
    }

    fn example() -> Chart {
        let rows = rows();
        let rows: Vec<&Row> = rows.iter().collect();
        chart(
            "atrium",
            "a <GPU> & more",
            "mean FLIP",
            &rows,
            |row| row.flip_final_converged,
            |_| None,
        )
        .unwrap()
    }

    #[test]
    fn a_chart_names_every_technique() {
        let chart = example();
        assert_eq!((chart.points.len(), chart.levels.len()), (5, 1));
        let text = svg(&chart).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
        for name in [
            "reference",
            "quarter",
            "vrs-roughness",
            "low",
            "ssr",
            "off",
            "Pareto",
            "&lt;GPU&gt; &amp; more",
        ] {
            assert!(text.contains(name), "{name}");
        }
        let picture = png(&chart).unwrap();
        assert_eq!((picture.width, picture.height), SIZE);
        let inked = picture.rgb.chunks_exact(3).filter(|pixel| pixel[0] < 200).count();
        assert!(inked > 2000, "{inked}");
    }

    #[test]
    fn without_times_there_is_no_chart() {
        let mut rows = rows();
        rows.iter_mut().for_each(|row| row.total_ms = None);
        let rows: Vec<&Row> = rows.iter().collect();
        assert_eq!(chart("", "", "", &rows, |row| row.flip_final_converged, |_| None), None);
    }

    #[test]
    fn a_single_point_can_be_drawn() {
        let mut chart = example();
        chart.points.truncate(1);
        chart.levels.clear();
        chart.points[0].error = 0.0;
        assert!(svg(&chart).is_ok() && png(&chart).is_ok());
    }
}
