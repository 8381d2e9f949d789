//! `cargo xtask words`: counts habits of speech in comments and documentation, so that they don't come back.

use std::fs;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use crate::{cargo, file_sizes, progress};

/// Options of `words`.
#[derive(Args, Default)]
pub struct Options {
    /// Count in these folders instead of `src`.
    folders: Vec<PathBuf>,
    /// Print each place of a pattern, such as `may`.
    #[arg(long)]
    list: Option<String>,
}

/// A habit of speech: its name, the occurrences per 1,000 lines of comments to aim at, and sequences of words in lower case, any of which
/// counts. A sequence that begins with `^` counts only at the start of a comment.
type Pattern = (&'static str, Option<f64>, &'static [&'static str]);

const PATTERNS: [Pattern; 10] = [
    // "What it is" as an object: name the thing.
    ("what", Some(4.0), &["what"]),
    // Split the sentence.
    ("whose", Some(5.0), &["whose", "of which", "thereof"]),
    // Data is, lies or is stored.
    ("stand", Some(1.0), &["stand", "stands", "stood"]),
    // Can, might.
    ("may", Some(8.0), &["may"]),
    // Name the caller.
    ("nobody", Some(0.0), &["nobody", "somebody", "anybody", "whoever"]),
    // Repeat the noun.
    (
        "those that",
        None,
        &["those that", "those of", "those which", "those whose"],
    ),
    // Image, frame.
    ("picture", None, &["picture", "pictures"]),
    // Documentation is read out of order.
    ("the same for", None, &["^ the same"]),
    // Static, converged.
    ("at rest", None, &["at rest"]),
    // A number.
    ("so many", None, &["so many"]),
];

/// Prints the counts, or the places of one pattern.
pub fn run(options: &Options) -> Result<()> {
    let root = cargo::workspace_root();
    let default = [PathBuf::from("src")];
    let is_default = options.folders.is_empty();
    let folders = if is_default { &default[..] } else { &options.folders };
    let (mut lines, mut counts) = (0, [0; PATTERNS.len()]);
    for folder in folders {
        for file in file_sizes::sources(&root.join(folder)) {
            let comments = comments(&fs::read_to_string(&file)?);
            lines += comments.iter().map(|comment| comment.lines).sum::<usize>();
            for comment in &comments {
                for ((name, _, sequences), total) in PATTERNS.iter().zip(&mut counts) {
                    let found = count(sequences, &comment.text);
                    *total += found;
                    if found > 0 && options.list.as_deref() == Some(name) {
                        let file = file.strip_prefix(&root).unwrap_or(&file).display();
                        progress::result(format_args!("{file}:{}: {}", comment.line, comment.text));
                    }
                }
            }
        }
    }
    progress::result(format_args!("{lines} lines of comments\n{}", table(lines, &counts)));
    Ok(())
}

/// One row per pattern: count, count per 1,000 lines, limit.
fn table(lines: usize, counts: &[usize]) -> String {
    let mut text = String::from("pattern       count  per 1,000  aim\n");
    for ((name, limit, _), count) in PATTERNS.iter().zip(counts) {
        let rate = 1000.0 * *count as f64 / lines.max(1) as f64;
        let limit = limit.map_or(String::new(), |limit| {
            format!("{limit:4}{}", if rate > limit { "  above" } else { "" })
        });
        text += format!("{:<13} {count:>5}  {rate:>9.1} {limit}", name).trim_end();
        text.push('\n');
    }
    text
}

/// Counts these sequences of words in a comment.
fn count(sequences: &[&str], text: &str) -> usize {
    // Code isn't prose.
    let prose: String = text.split('`').step_by(2).collect::<Vec<_>>().join(" ` ");
    let mut words = " ^ ".to_owned();
    for word in prose.split_whitespace() {
        let word = word.trim_matches(|letter: char| !letter.is_alphanumeric() && letter != '`');
        words += &format!(" {} ", word.to_lowercase());
    }
    let found = |sequence: &&str| words.matches(&format!(" {} ", sequence.replace(' ', "  "))).count();
    sequences.iter().map(found).sum()
}

/// Consecutive lines of comment.
#[derive(Debug, PartialEq)]
struct Comment {
    /// The first line, from 1.
    line: usize,
    lines: usize,
    text: String,
}

/// The comments of a file of Rust or WESL.
fn comments(code: &str) -> Vec<Comment> {
    let mut comments: Vec<Comment> = Vec::new();
    for (line, text) in (1..).zip(code.lines()) {
        // `https://` and strings begin no comment.
        let begins = |(place, _): &(usize, &str)| {
            let before = &text[..*place];
            !before.ends_with(':') && before.matches('"').count() % 2 == 0
        };
        let Some((place, _)) = text.match_indices("//").find(begins) else {
            continue;
        };
        let (before, text) = text.split_at(place);
        let text = text.trim_start_matches(['/', '!']).trim();
        match comments.last_mut() {
            Some(last)
                if before.trim().is_empty()
                    && last.line + last.lines == line
                    && !text.is_empty()
                    && !last.text.is_empty() =>
            {
                last.lines += 1;
                last.text = format!("{} {text}", last.text);
            }
            _ => comments.push(Comment {
                line,
                lines: 1,
                text: text.to_owned(),
            }),
        }
    }
    comments
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_are_joined() {
        let code = "//! One\n//! two.\n\nlet a = \"https://x.org\"; // three\nlet b = 1; // four\n///\n/// five\n";
        let texts: Vec<_> = comments(code)
            .into_iter()
            .map(|comment| (comment.line, comment.text))
            .collect();
        let expected = [(1, "One two."), (4, "three"), (5, "four"), (6, ""), (7, "five")];
        assert_eq!(texts, expected.map(|(line, text)| (line, text.to_owned())));
    }

    #[test]
    fn patterns_are_counted() {
        let count = |name: &str, text| {
            let (_, _, sequences) = PATTERNS.iter().find(|pattern| pattern.0 == name).unwrap();
            count(sequences, text)
        };
        assert_eq!(count("what", "Stores what it is, and what rays hit. Whatever."), 2);
        assert_eq!(count("whose", "of\nwhich none; whose, wholesome"), 2);
        assert_eq!(count("stand", "It stands. A stand-in. `stand`"), 1);
        assert_eq!(count("may", "It May be. `may` maybe"), 1);
        assert_eq!(count("the same for", "The same for b."), 1);
        assert_eq!(count("the same for", "Has the same for b."), 0);
    }

    #[test]
    fn links_of_the_guides_lead_somewhere() {
        let root = cargo::workspace_root();
        let mut pages: Vec<PathBuf> = ["README.md", "CONTRIBUTING.md", "examples/README.md"]
            .map(PathBuf::from)
            .into();
        for folder in ["docs", "docs/architecture"] {
            let entries = fs::read_dir(root.join(folder))
                .unwrap()
                .map(|entry| entry.unwrap().path());
            pages.extend(entries.filter(|path| path.extension().is_some_and(|end| end == "md")));
        }
        let (mut count, mut missing) = (0, Vec::new());
        for page in pages {
            let page = root.join(page);
            for link in fs::read_to_string(&page).unwrap().split("](").skip(1) {
                let link = link.split([')', '#']).next().unwrap_or_default();
                if !link.is_empty() && !link.contains(':') {
                    count += 1;
                    if !page.parent().unwrap().join(link).exists() {
                        missing.push(format!("{}: {link}", page.display()));
                    }
                }
            }
        }
        assert!(count > 50, "only {count} links were found");
        assert!(missing.is_empty(), "{missing:#?}");
    }
}
