//! The chart of times under a budget with a changing target.

use plotters::prelude::*;

const SIZE: (u32, u32) = (1200, 500);
const INK: RGBColor = RGBColor(40, 40, 40);
const PALE: RGBColor = RGBColor(226, 226, 226);
/// Colours that colour-blind people can distinguish.
const TIME: RGBColor = RGBColor(0, 114, 178);
const TARGET: RGBColor = RGBColor(213, 94, 0);
/// Width of the band around the target to each side, as a fraction of it.
const BAND: f64 = 0.1;

/// A target, and the milliseconds of its frames.
pub struct Step {
    pub target: f64,
    pub times: Vec<f64>,
}

/// Draws the times of all frames with their targets, as SVG.
///
/// # Errors
///
/// If it can't be drawn.
pub fn draw_steps(title: &str, steps: &[Step]) -> Result<String, String> {
    let mut svg = String::new();
    draw(&mut svg, title, steps).map_err(|error| format!("the chart can't be drawn: {error}"))?;
    Ok(svg)
}

fn draw(svg: &mut String, title: &str, steps: &[Step]) -> Result<(), Box<dyn core::error::Error>> {
    let frames: usize = steps.iter().map(|step| step.times.len()).sum();
    let largest = steps
        .iter()
        .flat_map(|step| step.times.iter().copied().chain([step.target * (1.0 + BAND)]))
        .fold(0.0, f64::max);
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 20, &INK))
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..frames as f64, 0.0..1.1 * largest)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(PALE)
        .x_desc("frame")
        .y_desc("GPU ms; band: the target and 10 % to each side")
        .label_style(("sans-serif", 15, &INK))
        .draw()?;
    let mut first = 0.0;
    for Step { target, times } in steps {
        let last = first + times.len() as f64;
        let band = [(first, target * (1.0 - BAND)), (last, target * (1.0 + BAND))];
        chart.draw_series([Rectangle::new(band, TARGET.mix(0.2).filled())])?;
        chart.draw_series([PathElement::new(
            [(first, *target), (last, *target)],
            TARGET.stroke_width(2),
        )])?;
        let line = times
            .iter()
            .enumerate()
            .map(|(frame, time)| (first + frame as f64, *time));
        chart.draw_series(LineSeries::new(line, TIME.stroke_width(2)))?;
        first = last;
    }
    root.present()?;
    Ok(())
}
