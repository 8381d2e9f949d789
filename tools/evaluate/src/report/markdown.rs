//! Markdown tables, and the texts of their cells.

use super::rows::Keyed;

/// A column of a table: its name, and its cell for a row.
pub type Column<T> = (&'static str, fn(&T) -> String);

/// A table with one line for each row and a title above it. The first columns are the scene, the technique and the tracer. Empty without
/// rows.
pub fn section<'a, T: Keyed + 'a>(title: &str, rows: impl IntoIterator<Item = &'a T>, columns: &[Column<T>]) -> String {
    let line = |row: &T| {
        let [scene, _, _, tracer] = row.key();
        let cells = columns.iter().map(|(_, cell)| cell(row));
        let first = [scene.to_owned(), row.label(), tracer.to_owned()];
        first.into_iter().chain(cells).collect()
    };
    let lines: Vec<Vec<String>> = rows.into_iter().map(line).collect();
    if lines.is_empty() {
        return String::new();
    }
    let names = columns.iter().map(|(name, _)| *name);
    let names: Vec<&str> = ["scene", "technique", "tracer"].into_iter().chain(names).collect();
    format!("## {title}\n\n{}\n", table(&names, &lines))
}

/// A table. Columns with numbers are aligned to the right.
pub fn table(names: &[impl AsRef<str>], lines: &[Vec<String>]) -> String {
    let is_number = |cell: &String| {
        cell.trim_start_matches(['+', '-', '*'])
            .starts_with(|c: char| c.is_ascii_digit())
    };
    let rule = (0..names.len()).map(|column| {
        let numbers = lines.iter().filter_map(|line| line.get(column)).any(is_number);
        if numbers { "---:|" } else { "---|" }
    });
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    let mut text = format!("| {} |\n|{}\n", names.join(" | "), rule.collect::<String>());
    for line in lines {
        text += &format!("| {} |\n", line.join(" | "));
    }
    // Empty cells.
    text.replace("|  ", "| ")
}

/// A number with this number of decimals, or a dash.
pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A number with its sign and two decimals, or a dash.
pub fn signed(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:+.2}"))
}

/// A number with its unit; a dash has none.
pub fn percent(number: String) -> String {
    if number == "-" { number } else { number + " %" }
}

/// The ends of an interval, or a dash.
pub fn range(interval: Option<(f64, f64)>, text: impl Fn(Option<f64>) -> String) -> String {
    interval.map_or_else(
        || "-".to_owned(),
        |(low, high)| format!("{} to {}", text(Some(low)), text(Some(high))),
    )
}

#[cfg(test)]
mod tests {
    use super::{super::rows::Row, *};

    #[test]
    fn tables_have_a_line_for_each_row() {
        let rows = [Row::example("atrium", "low", 1.5, 0.02), Row::default()];
        let columns: [Column<Row>; 2] = [
            ("ms", |row| number(row.total_ms, 2)),
            ("bias", |row| signed(row.bias_percent)),
        ];
        let text = section("Times", &rows, &columns);
        let head = "## Times\n\n| scene | technique | tracer | ms | bias |\n|---|---|---|---:|---|\n";
        assert_eq!(
            text,
            head.to_owned() + "| atrium | low | bvh | 1.50 | - |\n| | | | - | - |\n\n"
        );
        assert_eq!(section("Times", &rows[..0], &columns), "");
        assert_eq!(range(Some((-1.0, 2.0)), signed), "-1.00 to +2.00");
    }
}
