//! The manual. It contains no code: each chapter is a module, and its text is a file of `src/manual/`.
//!
#![doc = include_str!("manual/contents.md")]

#[doc = include_str!("manual/how_it_works.md")]
pub mod how_it_works {}

#[doc = include_str!("manual/requirements.md")]
pub mod requirements {}

#[doc = include_str!("manual/settings.md")]
pub mod settings {}

#[doc = include_str!("manual/performance.md")]
pub mod performance {}

#[doc = include_str!("manual/interactions.md")]
pub mod interactions {}

#[doc = include_str!("manual/limitations.md")]
pub mod limitations {}

#[doc = include_str!("manual/troubleshooting.md")]
pub mod troubleshooting {}

#[doc = include_str!("manual/measurements.md")]
pub mod measurements {}

#[doc = include_str!("manual/questions.md")]
pub mod questions {}

#[cfg(test)]
mod tests {
    use crate::{RayTracedReflections, ReflectionDebugView, ReflectionDenoiser, ReflectionPreset, TECHNIQUE_NAMES};
    use std::{fs, path::Path};

    const SETTINGS: &str = include_str!("manual/settings.md");
    const CHAPTERS: [&str; 4] = [
        SETTINGS,
        include_str!("manual/performance.md"),
        include_str!("manual/troubleshooting.md"),
        include_str!("manual/measurements.md"),
    ];

    /// Text with single spaces instead of line breaks.
    fn flowing(text: &str) -> String {
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    fn manual() -> String {
        flowing(&CHAPTERS.join("\n"))
    }

    /// Name and text of all files with messages for the log or the status, without their tests. Messages of the panel are on screen.
    fn sources(folder: &Path, found: &mut Vec<(String, String)>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if name != "ui" {
                    sources(&path, found);
                }
            } else if name.ends_with(".rs") && !name.contains("test") && name != "manual.rs" {
                let text = fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
                found.push((name, code.to_owned()));
            }
        }
    }

    /// The string literals of Rust code, each with its position. Raw ones don't count.
    fn literals(code: &str) -> Vec<(usize, String)> {
        let mut found = Vec::new();
        let mut characters = code.char_indices().peekable();
        while let Some((place, character)) = characters.next() {
            match character {
                '/' if code[place..].starts_with("//") => while characters.next_if(|(_, c)| *c != '\n').is_some() {},
                '\'' => {
                    // Characters have an end, lifetimes don't.
                    let mut ahead = code[place + 1..].chars();
                    let rest = match (ahead.next(), ahead.next()) {
                        (Some('\\'), _) => 3,
                        (_, Some('\'')) => 2,
                        _ => 0,
                    };
                    for _ in 0..rest {
                        characters.next();
                    }
                }
                '"' => {
                    let mut text = String::new();
                    while let Some((_, character)) = characters.next() {
                        match character {
                            '"' => break,
                            '\\' => match characters.next() {
                                Some((_, '\n')) => while characters.next_if(|(_, c)| c.is_whitespace()).is_some() {},
                                Some((_, escaped)) => text.push(escaped),
                                None => {}
                            },
                            _ => text.push(character),
                        }
                    }
                    found.push((place, text));
                }
                _ => {}
            }
        }
        found
    }

    /// Returns whether a literal is a sentence for users, or a part of one. Lists of names, reasons for the compiler and code of shaders aren't.
    fn is_message(before: &str, text: &str) -> bool {
        let words = text.split_whitespace().count();
        let listed = text.split_whitespace().filter(|word| word.ends_with(',')).count();
        let other = ["reason =", "must_use =", "panic!(", "source:"];
        words >= 4 && 2 * listed <= words && !other.iter().any(|end| before.trim_end().ends_with(end))
    }

    /// Returns the parts of a message between its placeholders, as far as they are recognizable.
    fn parts(message: &str) -> Vec<String> {
        message
            .split('{')
            .map(|part| flowing(part.split_once('}').map_or(part, |(_, rest)| rest)))
            .filter(|part| part.split(' ').count() >= 3)
            .collect()
    }

    fn all_sources() -> Vec<(String, String)> {
        let mut found = Vec::new();
        sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
        assert!(found.len() > 30, "only {} sources", found.len());
        found
    }

    #[test]
    fn every_message_is_explained() {
        let manual = manual();
        let (mut known, mut missing) = (0, Vec::new());
        for (file, code) in all_sources() {
            for (place, text) in literals(&code) {
                if is_message(&code[..place], &text) {
                    known += 1;
                    let unknown = parts(&text).into_iter().filter(|part| !manual.contains(part.as_str()));
                    missing.extend(unknown.map(|part| format!("{file}: {part}")));
                }
            }
        }
        assert!(known > 40, "only {known} messages were found");
        assert!(
            missing.is_empty(),
            "src/manual/troubleshooting.md explains none of these:\n{}",
            missing.join("\n")
        );
    }

    #[test]
    fn every_diagnostic_is_listed() {
        let manual = manual();
        let mut known = 0;
        for (file, code) in all_sources() {
            for (_, text) in literals(&code) {
                let path = if text.starts_with("reflection_") {
                    format!("`render/{text}`")
                } else if text.starts_with("glint/") || text.starts_with("render/") {
                    format!("`{text}`")
                } else {
                    continue;
                };
                known += 1;
                assert!(
                    manual.contains(&path),
                    "src/manual/measurements.md lacks {path} of {file}"
                );
            }
        }
        assert!(known > 10, "only {known} diagnostics were found");
    }

    #[test]
    fn names_and_defaults_are_those_of_the_code() {
        let manual = manual();
        for name in TECHNIQUE_NAMES.split(", ") {
            assert!(manual.contains(&format!("`{name}`")), "{name}");
        }
        for name in ReflectionPreset::ALL.map(ReflectionPreset::name) {
            assert!(SETTINGS.contains(&format!("| `{name}` |")), "{name}");
        }
        for name in ReflectionDebugView::ALL.map(ReflectionDebugView::name) {
            assert!(manual.contains(&format!("| `{name}` |")), "{name}");
        }
        let (reflections, denoiser) = (RayTracedReflections::default(), ReflectionDenoiser::default());
        for (name, default) in [
            ("technique", format!("`{:?}`", reflections.technique)),
            ("backend", format!("`{:?}`", reflections.backend)),
            ("sampling", format!("`{:?}`", reflections.sampling)),
            (
                "full_resolution_mirrors",
                reflections.full_resolution_mirrors.to_string(),
            ),
            ("roughness_cutoff", reflections.roughness_cutoff.to_string()),
            ("roughness_fade", reflections.roughness_fade.to_string()),
            ("max_ray_length", reflections.max_ray_length.to_string()),
            ("max_bounces", reflections.max_bounces.to_string()),
            (
                "bounce_roughness_cutoff",
                reflections.bounce_roughness_cutoff.to_string(),
            ),
            ("screen_traces", format!("`{:?}`", reflections.screen_traces)),
            ("shadow_rays", reflections.shadow_rays.to_string()),
            ("texture_mip", format!("`{:?}`", reflections.texture_mip)),
            ("reset", reflections.reset.to_string()),
            ("samples", denoiser.samples.to_string()),
            ("temporal", denoiser.temporal.to_string()),
            ("max_history", denoiser.max_history.to_string()),
            ("virtual_history", denoiser.virtual_history.to_string()),
            ("clip_sigma", denoiser.clip_sigma.to_string()),
            ("suppress_fireflies", denoiser.suppress_fireflies.to_string()),
            ("follow_light_changes", denoiser.follow_light_changes.to_string()),
            ("half_resolution", denoiser.half_resolution.to_string()),
            ("converge_static_views", denoiser.converge_static_views.to_string()),
            ("blur_radius", denoiser.blur_radius.to_string()),
        ] {
            let start = format!("| `{name}` |");
            let row = SETTINGS.lines().find(|line| line.starts_with(&start));
            let last = row.and_then(|row| row.trim_end_matches('|').rsplit('|').next());
            assert_eq!(last.map(str::trim), Some(default.as_str()), "default of {name}");
        }
    }

    #[test]
    fn messages_are_recognized() {
        let code =
            "warn!(\"more than {} of \\\n    these were seen\"); // \"not this\"\nlet c = ['\"', '\\''];\nx(\"a\")";
        let found = literals(code);
        let texts: Vec<_> = found.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["more than {} of these were seen", "a"]);
        assert!(is_message("warn!(", texts[0]));
        assert!(!is_message("reason = ", texts[0]));
        assert!(!is_message("", "low, medium, high, ultra"));
        assert_eq!(parts(texts[0]), ["of these were seen"]);
    }
}
