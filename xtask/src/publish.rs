//! Results of the evaluation in the repository's pages.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::progress;

/// The folder of these results.
const FOLDER: &str = "docs/evaluation";
/// The table of a run of held-out scenes, which has its own page.
const HELD_OUT: &str = "held_out.md";
/// The page with all techniques.
const PAGE: &str = "docs/performance.md";
/// The page with only the presets.
const README: &str = "README.md";
/// The presets of the README, with their rays per pixel.
const PRESETS: [(&str, &str); 4] = [
    ("low", "1/32 to 1/4"),
    ("medium", "1/32 to 1/4, the default"),
    ("high", "1/16 to 1/4"),
    ("ultra", "1"),
];

/// Copies the summary, the table and the charts of a folder of results into the repository, and updates the tables of its pages. Copies
/// only the table of held-out scenes if the folder has one.
pub fn publish(out: &Path, root: &Path) -> Result<()> {
    let named = |file: &Path| file.display().to_string();
    if out.join(HELD_OUT).exists() {
        let to = root.join(FOLDER).join(HELD_OUT);
        fs::copy(out.join(HELD_OUT), &to).with_context(|| named(&to))?;
        progress::note(to.display());
        return Ok(());
    }
    let read = |file: &Path| fs::read_to_string(file).with_context(|| named(file));
    let tables = read(&out.join("readme.md"))?;
    let pages = [
        (PAGE, splice(&read(&root.join(PAGE))?, "evaluation", &tables)?),
        (
            README,
            splice(&read(&root.join(README))?, "presets", &presets(&tables)?)?,
        ),
    ];
    let mut files: Vec<PathBuf> = ["summary.md", "results.csv"].map(PathBuf::from).into();
    let charts = out.join("charts");
    for entry in fs::read_dir(&charts).with_context(|| named(&charts))? {
        let name = PathBuf::from(entry?.file_name());
        if name.extension().is_some_and(|end| end == "svg") {
            files.push(Path::new("charts").join(name));
        }
    }
    files.sort();
    let folder = root.join(FOLDER);
    fs::create_dir_all(folder.join("charts")).with_context(|| named(&folder))?;
    for file in files {
        let to = folder.join(&file);
        fs::copy(out.join(&file), &to).with_context(|| named(&to))?;
        progress::note(to.display());
    }
    for (page, text) in pages {
        let file = root.join(page);
        fs::write(&file, text).with_context(|| named(&file))?;
        progress::note(file.display());
    }
    Ok(())
}

/// Replaces the text between a page's markers.
fn splice(page: &str, marker: &str, text: &str) -> Result<String> {
    let (begin, end) = (format!("<!-- {marker}:begin -->"), format!("<!-- {marker}:end -->"));
    let parts = page.split_once(&begin).and_then(|(before, rest)| {
        let (_, after) = rest.split_once(&end)?;
        Some((before, after))
    });
    let (before, after) = parts.with_context(|| {
        format!("the page has no line `{begin}` with a line `{end}` below it: add both where the tables belong")
    })?;
    Ok(format!("{before}{begin}\n\n{}\n\n{end}{after}", text.trim()))
}

/// The cells of a row of a Markdown table.
fn cells(line: &str) -> Vec<&str> {
    line.trim().trim_matches('|').split('|').map(str::trim).collect()
}

/// The times of the presets, from the table of all techniques.
fn presets(tables: &str) -> Result<String> {
    let header = tables.lines().find(|line| line.contains(": ms |"));
    let header = cells(header.context("the results have no column of milliseconds")?);
    let times: Vec<(usize, &str)> = (0..)
        .zip(&header)
        .filter_map(|(column, cell)| Some((column, cell.strip_suffix(": ms")?)))
        .collect();
    let scenes: String = times.iter().map(|(_, scene)| format!(" {scene} |")).collect();
    let mut text = format!(
        "| Preset | Rays per pixel |{scenes}\n| --- | --- |{}\n",
        " ---: |".repeat(times.len())
    );
    for (preset, rays) in PRESETS {
        let row = tables.lines().find(|line| line.starts_with(&format!("| `{preset}` |")));
        let row = cells(row.with_context(|| format!("the results have no preset `{preset}`"))?);
        let times = times
            .iter()
            .map(|(column, _)| format!(" {} |", row.get(*column).unwrap_or(&"-")));
        text += &format!("| `{preset}` | {rays} |{}\n", times.collect::<String>());
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLES: &str = "| | atrium: ms | FLIP | temple: ms | FLIP |\n|---|---:|---:|---:|---:|\n| `low` | 1.004 | 0.02 ★ | 1.1 | 0.03 |\n\
                          | `medium` | 2 | 0 | 2 | 0 |\n| `high` | 3 | 0 | 3 | 0 |\n| `ultra` | 4 | 0 | - | - |\n";

    #[test]
    fn results_take_the_place_of_older_ones() {
        let (begin, end) = ("<!-- evaluation:begin -->", "<!-- evaluation:end -->");
        let page = format!("# Title\n\n{begin}\nold\n{end}\n\nThe end.\n");
        let new = splice(&page, "evaluation", "new\n").unwrap();
        assert_eq!(new, format!("# Title\n\n{begin}\n\nnew\n\n{end}\n\nThe end.\n"));
        assert_eq!(splice(&new, "evaluation", "new").unwrap(), new);
        for wrong in ["", "no markers", &format!("{end} {begin}")] {
            let error = splice(wrong, "evaluation", "new").unwrap_err();
            assert!(error.to_string().contains(begin));
        }
    }

    #[test]
    fn presets_are_those_of_the_table() {
        let text = presets(TABLES).unwrap();
        assert!(
            text.starts_with("| Preset | Rays per pixel | atrium | temple |\n"),
            "{text}"
        );
        assert!(text.contains("\n| `low` | 1/32 to 1/4 | 1.004 | 1.1 |\n"), "{text}");
        assert!(text.ends_with("\n| `ultra` | 1 | 4 | - |\n"), "{text}");
        assert!(presets("| a | b |").is_err());
    }

    #[test]
    fn the_readme_agrees_with_the_page() {
        let read = |page| fs::read_to_string(crate::cargo::workspace_root().join(page)).unwrap();
        let (page, readme) = (read(PAGE), read(README));
        assert!(readme.contains(presets(&page).unwrap().trim()));
    }

    #[test]
    fn results_are_put_into_the_repository() {
        let folder = tempfile::tempdir().unwrap();
        let (out, root) = (folder.path().join("out"), folder.path().join("root"));
        fs::create_dir_all(out.join("charts")).unwrap();
        fs::create_dir_all(root.join("docs")).unwrap();
        for (file, text) in [
            ("out/readme.md", TABLES),
            ("out/summary.md", "summary"),
            ("out/results.csv", "scene,technique"),
            ("out/charts/atrium.picture.svg", "<svg/>"),
            ("out/charts/atrium.picture.png", "png"),
            (
                "root/README.md",
                "before <!-- presets:begin --><!-- presets:end --> after",
            ),
            (
                "root/docs/performance.md",
                "before <!-- evaluation:begin --><!-- evaluation:end --> after",
            ),
        ] {
            fs::write(folder.path().join(file), text).unwrap();
        }
        publish(&out, &root).unwrap();
        for (page, part) in [(PAGE, TABLES.trim()), (README, "| `high` | 1/16 to 1/4 | 3 | 3 |")] {
            let text = fs::read_to_string(root.join(page)).unwrap();
            assert!(
                text.starts_with("before ") && text.contains(part) && text.ends_with(" after"),
                "{text}"
            );
        }
        for file in ["summary.md", "results.csv", "charts/atrium.picture.svg"] {
            assert!(root.join(FOLDER).join(file).exists(), "{file}");
        }
        assert!(!root.join(FOLDER).join("charts/atrium.picture.png").exists());
        assert!(publish(&root, &root).is_err(), "there are no results");
        // Held-out scenes leave the other results alone.
        fs::write(out.join(HELD_OUT), "held out").unwrap();
        fs::write(out.join("summary.md"), "of held-out scenes").unwrap();
        publish(&out, &root).unwrap();
        let published = |file| fs::read_to_string(root.join(FOLDER).join(file)).unwrap();
        assert_eq!(
            (published(HELD_OUT), published("summary.md")),
            ("held out".into(), "summary".into())
        );
    }
}
