//! Charts of error against time, as SVG.

use super::{
    dominance::range_of_views,
    rows::{Keyed, Row, of_scene, scenes, significant},
    tables::Results,
};
use crate::{files::write_text, stats::pareto_front};
use plotters::{
    coord::{
        Shift,
        combinators::{LogCoord, WithKeyPoints},
        ranged1d::Ranged,
        types::RangedCoordf64,
    },
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};
use std::{collections::BTreeMap, io};
use strum::Display;

/// Charts of each scene: a title, and a path from the folder of results.
pub type ChartFiles = BTreeMap<String, Vec<(String, String)>>;

/// Width and height of a chart in pixels.
const SIZE: (u32, u32) = (1200, 750);

const LEFT: i32 = 96;
const RIGHT: i32 = 40;
const TOP: i32 = 96;
const BOTTOM: i32 = 78;
/// Room outside of the axes' names.
const MARGIN: i32 = 20;

const INK: RGBColor = RGBColor(40, 40, 40);
const GRAY: RGBColor = RGBColor(90, 90, 90);
const PALE: RGBColor = RGBColor(226, 226, 226);
const FRONT: RGBColor = RGBColor(0, 158, 115);
/// Height of the letters of a label in pixels.
const LABEL: f64 = 14.0;

/// The kind of a technique, which decides its colour. Colour-blind people can distinguish the colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Display)]
enum Family {
    #[strum(to_string = "the paper's techniques")]
    Paper,
    #[strum(to_string = "presets and our heuristics")]
    Own,
    #[strum(to_string = "others")]
    Other,
}

impl Family {
    /// The family of a technique by name.
    fn of(technique: &str) -> Self {
        match technique {
            "reference" | "quarter" | "quarter-inline" | "vrs-roughness" | "vrs-grazing" | "paper" => Self::Paper,
            "ssr" | "solari" | "off" => Self::Other,
            _ => Self::Own,
        }
    }

    fn color(self) -> RGBColor {
        match self {
            Self::Paper => RGBColor(0, 114, 178),
            Self::Own => RGBColor(213, 94, 0),
            Self::Other => RGBColor(110, 110, 110),
        }
    }
}

/// One technique in a chart.
struct Point<'a> {
    row: &'a Row,
    /// Milliseconds, above 0.
    time: f64,
    /// The error, at least 0.
    error: f64,
}

impl Point<'_> {
    fn family(&self) -> Family {
        Family::of(&self.row.technique)
    }
}

/// A chart of one scene.
struct Chart<'a> {
    title: String,
    subtitle: String,
    kind: &'a Kind,
    points: Vec<Point<'a>>,
    /// Errors of techniques that take no time, drawn as horizontal lines.
    levels: Vec<(String, f64)>,
}

/// The error of a chart.
struct Kind {
    /// A word for the title and the file.
    word: &'static str,
    name: &'static str,
    error: fn(&Row) -> Option<f64>,
    /// The error in the best and in the worst view, or the confidence interval of a single one.
    range: fn(&Row) -> Option<(f64, f64)>,
    /// True if techniques are dominated by this error: another one is both faster and closer to the truth, beyond the intervals.
    dominates: bool,
}

const KINDS: [Kind; 2] = [
    Kind {
        word: "picture",
        name: "picture",
        error: |row| row.flip_final_converged,
        range: |row| row.flip_final_converged_min.zip(row.flip_final_converged_max),
        dominates: false,
    },
    Kind {
        word: "reflection",
        name: "reflection alone",
        error: |row| row.flip_reflection_converged,
        range: range_of_views,
        dominates: true,
    },
];

/// Draws two charts per scene: of the image and of the reflection alone.
pub fn write_charts(results: &Results) -> Result<ChartFiles, String> {
    let (protocol, adapter) = (results.protocol, &results.machine.adapter);
    let subtitle = format!("{}x{}, {adapter}", protocol.width, protocol.height);
    let rows = &results.tables.rows;
    let mut files = ChartFiles::new();
    for scene in scenes(rows) {
        for kind in &KINDS {
            if let Some(chart) = Chart::new(scene, &subtitle, kind, &of_scene(rows, scene)) {
                let file = format!("charts/{scene}.{}.svg", kind.word);
                write_text(&results.out.join(&file), &svg(&chart)?)?;
                files.entry(scene.to_owned()).or_default().push((chart.title, file));
            }
        }
    }
    Ok(files)
}

impl<'a> Chart<'a> {
    /// `None` if no row has both a time and the error.
    fn new(scene: &str, subtitle: &str, kind: &'a Kind, rows: &[&'a Row]) -> Option<Self> {
        let (mut points, mut levels) = (Vec::new(), Vec::new());
        for &row in rows {
            let Some(error) = (kind.error)(row).filter(|value| value.is_finite()) else {
                continue;
            };
            match row.total_ms {
                Some(time) if time > 0.0 && time.is_finite() => points.push(Point { row, time, error }),
                _ if row.technique == "off" => levels.push((row.label(), error)),
                _ => {}
            }
        }
        (!points.is_empty()).then(|| Self {
            title: format!("{scene}: error of the {} against GPU time", kind.word),
            subtitle: subtitle.to_owned(),
            kind,
            points,
            levels,
        })
    }

    fn is_dominated(&self, point: &Point) -> bool {
        self.kind.dominates && point.row.is_dominated()
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Plot<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<WithKeyPoints<LogCoord<f64>>, RangedCoordf64>>;
type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

/// The chart as an SVG document.
fn svg(chart: &Chart) -> Result<String, String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
    draw(&area, chart).map_err(|error| format!("a chart can't be drawn: {error}"))?;
    drop(area);
    Ok(text)
}

/// The largest error and the range of times of a chart.
struct Frame {
    time: (f64, f64),
    error: f64,
}

impl Frame {
    fn new(chart: &Chart) -> Self {
        let times = chart.points.iter().flat_map(|point| {
            let (low, high) = point.row.time_interval().unwrap_or((point.time, point.time));
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
            // Space for the labels, mostly on the right.
            time: (low / 1.35, high * 1.8),
            error: if error > 0.0 { error * 1.12 } else { 1.0 },
        }
    }

    /// Round times: 1, 2 and 5 times powers of ten, or equal steps if there are few of these.
    fn times(&self) -> Vec<f64> {
        let (low, high) = self.time;
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let ticks: Vec<f64> = decades
            .flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade)))
            .filter(|tick| (low..=high).contains(tick))
            .collect();
        if ticks.len() >= 3 {
            ticks
        } else {
            RangedCoordf64::from(low..high).key_points(8)
        }
    }
}

/// Letters of a height in pixels.
fn letters(pixels: f64, color: &RGBColor, h_pos: HPos, v_pos: VPos) -> TextStyle<'static> {
    // The SVG backend divides by this.
    let font = (FontFamily::SansSerif, pixels * 1.24).into_font();
    font.color(color).pos(Pos::new(h_pos, v_pos))
}

fn draw(area: &Area<'_>, chart: &Chart) -> Drawn {
    area.fill(&WHITE)?;
    let mut title = letters(20.0, &INK, HPos::Left, VPos::Top);
    title.font = title.font.style(FontStyle::Bold);
    area.draw_text(&chart.title, &title, (LEFT, 18))?;
    let subtitle = letters(13.0, &GRAY, HPos::Left, VPos::Top);
    area.draw_text(&chart.subtitle, &subtitle, (LEFT, 48))?;
    legend(area, chart)?;
    let frame = Frame::new(chart);
    let (low, high) = frame.time;
    let times = (low..high).log_scale().with_key_points(frame.times());
    let mut plot = ChartBuilder::on(area)
        .margin_top(TOP)
        .margin_right(RIGHT)
        .margin_bottom(MARGIN)
        .margin_left(MARGIN)
        .x_label_area_size(BOTTOM - MARGIN)
        .y_label_area_size(LEFT - MARGIN)
        .build_cartesian_2d(times, 0.0..frame.error)?;
    let short = |value: &f64| significant(*value, 4).to_string();
    plot.configure_mesh()
        .bold_line_style(PALE)
        .x_max_light_lines(0)
        .y_max_light_lines(0)
        .axis_style(INK)
        .set_all_tick_mark_size(4)
        .y_labels(8)
        .x_label_formatter(&short)
        .y_label_formatter(&short)
        .label_style(letters(13.0, &INK, HPos::Center, VPos::Center))
        .axis_desc_style(letters(14.0, &INK, HPos::Center, VPos::Center))
        .x_desc("GPU time per frame, ms (logarithmic)")
        .y_desc(format!("mean FLIP of the {} against the ground truth", chart.kind.name))
        .draw()?;
    for (label, level) in &chart.levels {
        let line = [(low, *level), (high, *level)];
        plot.draw_series(DashedLineSeries::new(line, 6, 6, Family::Other.color().into()))?;
        let (x, y) = plot.backend_coord(&line[0]);
        let style = letters(13.0, &GRAY, HPos::Left, VPos::Bottom);
        area.draw_text(&format!("{label}: no time"), &style, (x + 6, y - 4))?;
    }
    points(&mut plot, &frame, chart)?;
    labels(area, &plot, chart)
}

/// The points with their intervals, and a line along the Pareto front.
fn points<'a>(plot: &mut Plot<'a>, frame: &Frame, chart: &Chart) -> Drawn {
    let places: Vec<(f64, f64)> = chart.points.iter().map(|point| (point.time, point.error)).collect();
    let front = pareto_front(&places);
    let steps = front.windows(2).flat_map(|pair| {
        let (from, to) = (places[pair[0]], places[pair[1]]);
        [from, (to.0, from.1), to]
    });
    plot.draw_series(LineSeries::new(steps, FRONT.stroke_width(2)))?;
    for (index, point) in chart.points.iter().enumerate() {
        let (time, error, color) = (point.time, point.error, point.family().color());
        let errors = (chart.kind.range)(point.row).map(|range| {
            let inside = |error: f64| error.clamp(0.0, frame.error);
            [(time, inside(range.0)), (time, inside(range.1))]
        });
        let times = point.row.time_interval().map(|range| {
            let inside = |time: f64| time.clamp(frame.time.0, frame.time.1);
            [(inside(range.0), error), (inside(range.1), error)]
        });
        let intervals = errors.into_iter().chain(times);
        plot.draw_series(intervals.map(|line| PathElement::new(line, color.mix(0.45))))?;
        let circles = if front.contains(&index) {
            vec![Circle::new((time, error), 7, color.filled())]
        } else {
            let inside = Circle::new((time, error), 6, WHITE.filled());
            vec![inside, Circle::new((time, error), 6, color.stroke_width(2))]
        };
        plot.draw_series(circles)?;
        if chart.is_dominated(point) {
            plot.draw_series([Cross::new((time, error), 10, color.stroke_width(2))])?;
        }
    }
    Ok(())
}

/// A rectangle: left, top, right, bottom.
type Rectangle = (i32, i32, i32, i32);

fn overlap(a: Rectangle, b: Rectangle) -> i32 {
    let width = a.2.min(b.2) - a.0.max(b.0);
    let height = a.3.min(b.3) - a.1.max(b.1);
    width.max(0) * height.max(0)
}

/// Names beside their points, at the place with the least overlap.
fn labels(area: &Area<'_>, plot: &Plot<'_>, chart: &Chart) -> Drawn {
    let markers: Vec<(i32, i32)> = chart
        .points
        .iter()
        .map(|point| plot.backend_coord(&(point.time, point.error)))
        .collect();
    let mut taken: Vec<Rectangle> = markers.iter().map(|(x, y)| (x - 9, y - 9, x + 9, y + 9)).collect();
    let inside = (LEFT, TOP - 14, SIZE.0 as i32 - 4, SIZE.1 as i32 - BOTTOM);
    for (point, &(x, y)) in chart.points.iter().zip(&markers) {
        let style = letters(LABEL, &point.family().color(), HPos::Left, VPos::Center);
        let label = point.row.label();
        let (width, half) = (area.estimate_text_size(&label, &style)?.0 as i32, 9);
        // Right, left, above, below, then farther away.
        let spots = [0, 20, -20, 40, -40, 60, -60].into_iter().flat_map(|dy| {
            [
                (x + 13, y + dy),
                (x - 13 - width, y + dy),
                (x - width / 2, y + dy - 20),
                (x - width / 2, y + dy + 20),
            ]
        });
        let around = |(left, middle): (i32, i32)| (left, middle - half, left + width, middle + half);
        let cost = |&spot: &(i32, i32)| {
            let own = around(spot);
            let covered: i32 = taken.iter().map(|other| overlap(own, *other)).sum();
            let outside = width * 2 * half - overlap(own, inside);
            4 * (covered + outside) + (spot.1 - y).abs()
        };
        let Some(spot) = spots.min_by_key(cost) else {
            continue;
        };
        taken.push(around(spot));
        if (spot.1 - y).abs() > 24 {
            let near = (spot.0.max(x.min(spot.0 + width)), spot.1);
            area.draw(&PathElement::new([(x, y), near], RGBColor(190, 190, 190)))?;
        }
        area.draw_text(&label, &style, spot)?;
    }
    Ok(())
}

/// One row above the plot, so that it covers nothing.
fn legend(area: &Area<'_>, chart: &Chart) -> Drawn {
    const Y: i32 = 76;
    let style = letters(13.0, &GRAY, HPos::Left, VPos::Center);
    let mut x = LEFT;
    for family in [Family::Paper, Family::Own, Family::Other] {
        if !chart.points.iter().any(|point| point.family() == family) {
            continue;
        }
        area.draw(&Circle::new((x + 6, Y), 5, family.color().filled()))?;
        area.draw_text(&family.to_string(), &style, (x + 16, Y))?;
        x += 46 + area.estimate_text_size(&family.to_string(), &style)?.0 as i32;
    }
    area.draw(&PathElement::new([(x, Y), (x + 26, Y)], FRONT.stroke_width(2)))?;
    let text = "Pareto front (filled): nothing is both faster and closer";
    area.draw_text(text, &style, (x + 34, Y))?;
    if chart.points.iter().any(|point| chart.is_dominated(point)) {
        x += 52 + area.estimate_text_size(text, &style)?.0 as i32;
        area.draw(&Cross::new((x, Y), 6, GRAY.stroke_width(2)))?;
        area.draw_text("dominated", &style, (x + 12, Y))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<Row> {
        let row = |(technique, time, error): (&str, f64, f64)| Row {
            total_low_ms: Some(time * 0.98),
            total_high_ms: Some(time * 1.02),
            ..Row::example("atrium", technique, time, error)
        };
        let rows = [("off", 0.0, 0.09), ("reference", 1.363, 0.01), ("quarter", 0.971, 0.02)];
        let others = [("vrs-roughness", 0.677, 0.024), ("low", 0.6, 0.03), ("ssr", 0.9, 0.06)];
        rows.into_iter().chain(others).map(row).collect()
    }

    fn chart(rows: &[Row]) -> Option<Chart<'_>> {
        let rows: Vec<&Row> = rows.iter().collect();
        Chart::new("atrium", "a <GPU> & more", &KINDS[0], &rows)
    }

    #[test]
    fn a_chart_names_every_technique() {
        let rows = rows();
        let chart = chart(&rows).unwrap();
        assert_eq!((chart.points.len(), chart.levels.len()), (5, 1));
        let text = svg(&chart).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
        for name in "reference quarter vrs-roughness low ssr off Pareto &lt;GPU&gt;".split(' ') {
            assert!(text.contains(name), "{name}");
        }
        // On the front are three of the techniques: filled circles, besides those of the legend.
        assert_eq!(
            (text.matches("r=\"7\"").count(), text.matches("r=\"5\"").count()),
            (4, 3)
        );
    }

    #[test]
    fn without_times_there_is_no_chart() {
        let mut rows = rows();
        rows.iter_mut().for_each(|row| row.total_ms = None);
        assert!(chart(&rows).is_none());
    }

    #[test]
    fn a_single_point_can_be_drawn() {
        let rows = rows();
        let mut chart = chart(&rows).unwrap();
        chart.points.truncate(1);
        chart.levels.clear();
        chart.points[0].error = 0.0;
        assert!(svg(&chart).is_ok());
    }

    #[test]
    fn ticks_are_round() {
        let frame = |time| Frame { time, error: 1.0 };
        let times = |low, high| frame((low, high)).times();
        assert_eq!(times(0.3, 6.0), [0.5, 1.0, 2.0, 5.0]);
        assert_eq!(times(1.1, 1.6)[0], 1.1);
    }
}
