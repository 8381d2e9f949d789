//! Sections of the summary that compare all rows: error against the paper, bias of the frame and of the reflected light.

use super::{
    paper,
    rows::{Row, number},
};
use crate::{
    compare::reflected_light::MARGIN,
    protocol::{Protocol, STATIC_FRAMES},
    techniques::is_variable,
};
use std::fmt::Write;

/// Biases of the reflected light beyond these many percent are called out.
const MOST_LIGHT_BIAS: f64 = 1.0;
const MOST_STATIC_LIGHT_BIAS: f64 = 0.5;

/// The techniques with a rate per tile.
pub const HEURISTICS: [&str; 4] = ["vrs-roughness", "vrs-grazing", "vrs-combined", "vrs-adaptive"];

/// Size of the paper's images.
const PAPER_SIZE: (u32, u32) = (1920, 1080);

/// All of these sections, as Markdown.
pub fn sections(rows: &[Row], protocol: &Protocol) -> String {
    let mut text = String::new();
    against_paper(rows, protocol, &mut text);
    bias(rows, &mut text);
    light_bias(rows, &mut text);
    text
}

/// The paper's largest error of a variable rate in the scene that corresponds to ours, with that scene's name.
pub fn paper_limit(scene: &str) -> Option<(&'static str, f64)> {
    let index = paper::SCENES.iter().position(|(_, ours)| *ours == scene)?;
    let variable = paper::TECHNIQUES
        .iter()
        .filter(|technique| HEURISTICS.contains(&technique.ours));
    let errors = variable.filter_map(|technique| Some(technique.errors?[0][index]));
    errors.reduce(f64::max).map(|limit| (paper::SCENES[index].0, limit))
}

fn against_paper(rows: &[Row], protocol: &Protocol, text: &mut String) {
    let mut table = String::new();
    let (mut above, mut counted) = (Vec::new(), 0);
    for row in rows.iter().filter(|row| row.is_ok() && is_variable(&row.technique)) {
        let (Some((theirs, limit)), Some(error)) = (paper_limit(&row.scene), row.flip_reflection_reference) else {
            continue;
        };
        let is_technique = row.technique.starts_with("vrs-");
        let kind = if is_technique { "" } else { " (preset)" };
        let holds = error <= limit;
        let _ = writeln!(
            table,
            "| {} | {}{kind} | {} | {error:.4} | *{limit:.3}* ({theirs}) | {} |",
            row.scene,
            row.label(),
            row.tracer,
            if holds { "yes" } else { "**no**" }
        );
        if is_technique {
            counted += 1;
            if !holds {
                above.push(format!("{} in {}", row.label(), row.scene));
            }
        }
    }
    if table.is_empty() {
        return;
    }
    text.push_str(
        "## Is the error of a variable rate at most the paper's?\n\nMean FLIP of the reflection alone against `reference`, and the \
         largest that *the paper* has for a variable rate in the scene of the same kind.\n\n\
         | scene | technique | tracer | ours | *the paper's* | |\n|---|---|---|---:|---:|---|\n",
    );
    text.push_str(&table);
    text.push('\n');
    if counted > 0 {
        let _ = if above.is_empty() {
            writeln!(text, "All {counted} variable-rate techniques hold this limit.")
        } else {
            writeln!(
                text,
                "**{} of {counted} variable-rate techniques are above it**: {}.",
                above.len(),
                above.join(", ")
            )
        };
    }
    text.push_str("Presets are no part of that: they differ from `reference` in more than their rate.\n");
    if (protocol.width, protocol.height) != PAPER_SIZE {
        let (width, height) = PAPER_SIZE;
        let _ = writeln!(
            text,
            "The paper's pictures have {width}x{height} pixels, these {}x{}: in small pictures errors are larger.",
            protocol.width, protocol.height
        );
    }
    text.push('\n');
}

fn bias(rows: &[Row], text: &mut String) {
    let measured = rows.iter().filter(|row| row.is_ok() && row.bias_percent.is_some());
    let mut table = String::new();
    for row in measured {
        let percent = row.bias_percent.unwrap_or(0.0);
        let _ = writeln!(
            table,
            "| {} | {} | {} | {percent:+.2} % | {} |",
            row.scene,
            row.label(),
            row.tracer,
            number(row.bias, 5)
        );
    }
    if table.is_empty() {
        return;
    }
    let _ = write!(
        text,
        "## How much too bright or too dark is the picture?\n\nMean signed error of the picture's linear luminance against the ground \
         truth, over all views.\n\n| scene | technique | tracer | of the ground truth's luminance | of white |\n\
         |---|---|---|---:|---:|\n{table}\n"
    );
}

/// Returns whether a bias of the reflected light is clearly above its limit, with all of its interval if there is one.
fn is_above(percent: f64, interval: Option<(f64, f64)>, limit: f64) -> bool {
    let (low, high) = interval.unwrap_or((percent, percent));
    low > limit || high < -limit
}

fn light_bias(rows: &[Row], text: &mut String) {
    let mut table = String::new();
    let mut above = Vec::new();
    for row in rows.iter().filter(|row| row.is_ok()) {
        let Some(moving) = row.light_bias_percent else { continue };
        let cell = |percent: Option<f64>, interval: Option<(f64, f64)>| {
            let percent = percent.map_or_else(|| "-".to_owned(), |percent| format!("{percent:+.2} %"));
            let interval = interval.map_or_else(|| "-".to_owned(), |(low, high)| format!("{low:+.2} to {high:+.2}"));
            format!("{percent} | {interval}")
        };
        let _ = writeln!(
            table,
            "| {} | {} | {} | {} | {} | {} |",
            row.scene,
            row.label(),
            row.tracer,
            cell(Some(moving), row.light_interval()),
            cell(row.static_light_bias_percent, row.static_light_interval()),
            row.truth_halves_percent
                .map_or_else(|| "-".to_owned(), |percent| format!("{percent:+.2} %"))
        );
        if row.tracer == "-" || row.technique == "paper" {
            continue;
        }
        let name = format!("{} in {}", row.label(), row.scene);
        if is_above(moving, row.light_interval(), MOST_LIGHT_BIAS) {
            above.push(format!("{name} ({moving:+.1} % in motion)"));
        }
        if let Some(percent) = row.static_light_bias_percent
            && is_above(percent, row.static_light_interval(), MOST_STATIC_LIGHT_BIAS)
        {
            above.push(format!("{name} ({percent:+.1} % static)"));
        }
    }
    if table.is_empty() {
        return;
    }
    let _ = write!(
        text,
        "## How much reflected light is too much or missing?\n\nBias of the light that reflections add to the frame, in percent of that light \
         by the ground truth: from linear radiance before tone mapping, over pixels that reflect, {MARGIN} pixels away from \
         outlines, over all views. In motion, and after {STATIC_FRAMES} static frames. The intervals are 95 % sure and hold the noise of \
         technique and truth; the last column is how far two halves of the ground truth are apart.\n\n\
         | scene | technique | tracer | in motion | 95 % sure | static | 95 % sure | halves of the truth |\n\
         |---|---|---|---:|---:|---:|---:|---:|\n{table}\n"
    );
    let _ = if above.is_empty() {
        writeln!(
            text,
            "Nothing that traces is clearly above {MOST_LIGHT_BIAS} % in motion or {MOST_STATIC_LIGHT_BIAS} % static; `paper` isn't held to \
             that.\n"
        )
    } else {
        writeln!(
            text,
            "**Clearly above {MOST_LIGHT_BIAS} % in motion or {MOST_STATIC_LIGHT_BIAS} % static** (`paper` isn't held to that): {}. Presets \
             count what they leave to the environment map.\n",
            above.join(", ")
        )
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scene: &str, technique: &str, time: f64, error: f64) -> Row {
        Row {
            flip_reflection_converged: Some(error),
            flip_reflection_reference: Some(error),
            bias: Some(-0.002),
            bias_percent: Some(-1.234),
            ..Row::example(scene, technique, time, error / 5.0)
        }
    }

    fn rows() -> Vec<Row> {
        vec![
            row("atrium", "reference", 2.0, 0.040),
            row("atrium", "quarter", 1.0, 0.050),
            row("atrium", "vrs-roughness", 0.7, 0.060),
            row("atrium", "vrs-grazing", 1.2, 0.055),
            row("atrium", "vrs-combined", 0.8, 0.051),
            row("atrium", "medium", 0.8, 0.090),
        ]
    }

    fn text(rows: &[Row]) -> String {
        sections(rows, &Protocol::new(false, false))
    }

    #[test]
    fn the_limits_are_the_papers() {
        assert_eq!(paper_limit("atrium"), Some(("Sponza", 0.072)));
        assert_eq!(paper_limit("temple"), Some(("Sun Temple", 0.046)));
        assert_eq!(paper_limit("street"), Some(("Bistro", 0.086)));
        assert_eq!(paper_limit("demo"), None);
    }

    #[test]
    fn techniques_are_held_against_the_paper() {
        let good = text(&rows());
        assert!(
            good.contains("| atrium | vrs-roughness | bvh | 0.0600 | *0.072* (Sponza) | yes |"),
            "{good}"
        );
        assert!(
            good.contains("All 3 variable-rate techniques hold this limit."),
            "{good}"
        );
        // A preset is shown and doesn't count; a fixed rate isn't even shown.
        assert!(good.contains("| atrium | medium (preset) | bvh | 0.0900 | *0.072* (Sponza) | **no** |"));
        assert!(!good.contains("| atrium | quarter | bvh | 0.0500 | *"));
        assert!(!good.contains("in small pictures"), "{good}");
        let mut rows = rows();
        rows[2].flip_reflection_reference = Some(0.0721);
        let bad = sections(&rows, &Protocol::new(true, true));
        assert!(bad.contains("**1 of 3 variable-rate techniques are above it**: vrs-roughness in atrium."));
        assert!(bad.contains("these 128x72"), "{bad}");
    }

    #[test]
    fn bias_has_a_sign_and_a_share() {
        let text = text(&rows());
        assert!(
            text.contains("| atrium | quarter | bvh | -1.23 % | -0.00200 |"),
            "{text}"
        );
    }

    #[test]
    fn biases_of_the_light_are_called_out_beyond_their_noise() {
        let with = |technique: &str, percent: f64, half: f64| Row {
            light_bias_percent: Some(percent),
            light_bias_low: Some(percent - half),
            light_bias_high: Some(percent + half),
            static_light_bias_percent: Some(0.2),
            truth_halves_percent: Some(-0.04),
            ..row("atrium", technique, 1.0, 0.05)
        };
        let calm = text(&[
            with("reference", 0.9, 0.1),
            with("quarter", -1.5, 0.6),
            with("paper", 4.0, 0.1),
        ]);
        assert!(
            calm.contains("| atrium | quarter | bvh | -1.50 % | -2.10 to -0.90 | +0.20 % | - | -0.04 % |"),
            "{calm}"
        );
        assert!(calm.contains("Nothing that traces is clearly above 1 %"), "{calm}");
        let mut dark = with("quarter", -1.5, 0.4);
        dark.static_light_bias_percent = Some(0.6);
        let loud = text(&[dark]);
        let expected = "quarter in atrium (-1.5 % in motion), quarter in atrium (+0.6 % static).";
        assert!(loud.contains(expected), "{loud}");
        assert!(!text(&rows()).contains("How much reflected light"));
    }
}
