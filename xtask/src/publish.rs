//! Results of the evaluation that the repository shows.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::progress;

/// The folder for results that the README shows; the tool writes links to it.
const FOLDER: &str = "docs/evaluation";
/// Begins the part of the README that the tool writes.
const BEGIN: &str = "<!-- evaluation:begin -->";
/// Ends that part.
const END: &str = "<!-- evaluation:end -->";

/// Copies the summary, the table and the charts of a folder of results into the repository, and its tables into the README.
pub fn publish(out: &Path, root: &Path) -> Result<()> {
    let named = |file: &Path| file.display().to_string();
    let read = |file: &Path| fs::read_to_string(file).with_context(|| named(file));
    let readme = root.join("README.md");
    let text = splice(&read(&readme)?, &read(&out.join("readme.md"))?)?;
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
    fs::write(&readme, text).with_context(|| named(&readme))?;
    progress::note(readme.display());
    Ok(())
}

/// The README with a text between its markers.
fn splice(readme: &str, text: &str) -> Result<String> {
    let parts = readme.split_once(BEGIN).and_then(|(before, rest)| {
        let (_, after) = rest.split_once(END)?;
        Some((before, after))
    });
    let (before, after) = parts.with_context(|| {
        format!("README.md has no line `{BEGIN}` with a line `{END}` below it: add both where the tables should be")
    })?;
    Ok(format!("{before}{BEGIN}\n\n{}\n\n{END}{after}", text.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_take_the_place_of_older_ones() {
        let readme = format!("# Title\n\n{BEGIN}\nold\n{END}\n\nThe end.\n");
        let new = splice(&readme, "new\n").unwrap();
        assert_eq!(new, format!("# Title\n\n{BEGIN}\n\nnew\n\n{END}\n\nThe end.\n"));
        assert_eq!(splice(&new, "new").unwrap(), new);
        for wrong in ["", "no markers", &format!("{END} {BEGIN}")] {
            assert!(splice(wrong, "new").unwrap_err().to_string().contains(BEGIN));
        }
    }

    #[test]
    fn results_are_put_into_the_repository() {
        let folder = tempfile::tempdir().unwrap();
        let (out, root) = (folder.path().join("out"), folder.path().join("root"));
        fs::create_dir_all(out.join("charts")).unwrap();
        fs::create_dir_all(&root).unwrap();
        for (file, text) in [
            ("out/readme.md", "| a | b |"),
            ("out/summary.md", "summary"),
            ("out/results.csv", "scene,technique"),
            ("out/charts/atrium.picture.svg", "<svg/>"),
            ("out/charts/atrium.picture.png", "png"),
            (
                "root/README.md",
                "before <!-- evaluation:begin --><!-- evaluation:end --> after",
            ),
        ] {
            fs::write(folder.path().join(file), text).unwrap();
        }
        publish(&out, &root).unwrap();
        let readme = fs::read_to_string(root.join("README.md")).unwrap();
        assert!(readme.starts_with("before ") && readme.contains("\n\n| a | b |\n\n") && readme.ends_with(" after"));
        for file in ["summary.md", "results.csv", "charts/atrium.picture.svg"] {
            assert!(root.join(FOLDER).join(file).exists(), "{file}");
        }
        assert!(!root.join(FOLDER).join("charts/atrium.picture.png").exists());
        assert!(publish(&root, &root).is_err(), "there are no results");
    }
}
