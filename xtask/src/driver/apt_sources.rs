//! The package sources of a Debian machine: finding the one that serves the release, and deriving its backports.

/// One source of packages, in either of apt's two formats.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Source {
    uris: String,
    suites: Vec<String>,
    components: Vec<String>,
    /// Options that a derived source must keep (`Signed-By`, `Trusted`, …), each as whole lines of a stanza.
    options: Vec<String>,
}

/// Reads a file in the deb822 format (`*.sources`).
pub fn parse_stanzas(text: &str) -> Vec<Source> {
    let mut sources = Vec::new();
    let mut fields: Vec<(String, String)> = Vec::new();
    // A closing empty line ends the last stanza.
    for line in text.lines().chain([""]) {
        if line.starts_with('#') {
            continue;
        }
        if line.trim().is_empty() {
            sources.extend(from_fields(&std::mem::take(&mut fields)));
        } else if line.starts_with([' ', '\t']) {
            if let Some((_, value)) = fields.last_mut() {
                value.push('\n');
                value.push_str(line);
            }
        } else if let Some((key, value)) = line.split_once(':') {
            fields.push((key.trim().to_ascii_lowercase(), value.trim().to_owned()));
        }
    }
    sources
}

fn from_fields(fields: &[(String, String)]) -> Option<Source> {
    let field = |name: &str| {
        fields
            .iter()
            .find(|(key, _)| key == name)
            .map(|(_, value)| value.as_str())
    };
    let words = |name: &str| {
        field(name)
            .unwrap_or_default()
            .split_whitespace()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let is_off = matches!(field("enabled"), Some("no" | "false" | "0"));
    if is_off || !words("types").iter().any(|kind| kind == "deb") {
        return None;
    }
    let kept = [
        ("signed-by", "Signed-By"),
        ("trusted", "Trusted"),
        ("architectures", "Architectures"),
    ];
    let options = kept
        .iter()
        .filter_map(|(key, name)| field(key).map(|value| format!("{name}: {value}")))
        .collect();
    Some(Source {
        uris: words("uris").join(" "),
        suites: words("suites"),
        components: words("components"),
        options,
    })
}

/// Reads a file in the one-line format (`sources.list`, `*.list`).
pub fn parse_lines(text: &str) -> Vec<Source> {
    text.lines().filter_map(parse_line).collect()
}

/// Reads `deb [signed-by=/key arch=amd64] URI SUITE COMPONENT…`.
fn parse_line(line: &str) -> Option<Source> {
    let line = line.split('#').next().unwrap_or_default();
    let rest = line.trim().strip_prefix("deb")?;
    if !rest.starts_with([' ', '\t', '[']) {
        return None;
    }
    let rest = rest.trim_start();
    let (options, rest) = match rest.strip_prefix('[') {
        Some(inner) => inner.split_once(']')?,
        None => ("", rest),
    };
    let options = options
        .split_whitespace()
        .filter_map(|option| {
            let (key, value) = option.split_once('=')?;
            let name = match key.to_ascii_lowercase().as_str() {
                "signed-by" => "Signed-By",
                "trusted" => "Trusted",
                "arch" => "Architectures",
                _ => return None,
            };
            Some(format!("{name}: {}", value.replace(',', " ")))
        })
        .collect();
    let mut words = rest.split_whitespace().map(str::to_owned);
    let uris = words.next()?;
    let suites = vec![words.next()?];
    Some(Source {
        uris,
        suites,
        components: words.collect(),
        options,
    })
}

/// Whether some source already serves the suite.
pub fn serves(sources: &[Source], suite: &str) -> bool {
    sources
        .iter()
        .any(|source| source.suites.iter().any(|name| name == suite))
}

/// A deb822 stanza for the backports of a release, from the same mirror that serves the release itself.
pub fn backports(sources: &[Source], codename: &str) -> Option<String> {
    let release = sources.iter().find(|source| {
        !source.uris.is_empty()
            && !source.uris.starts_with("cdrom:")
            && source.suites.iter().any(|suite| suite == codename)
            && source.components.iter().any(|component| component == "main")
    })?;
    let mut stanza = format!(
        "Types: deb\nURIs: {}\nSuites: {codename}-backports\nComponents: main\n",
        release.uris
    );
    for option in &release.options {
        stanza.push_str(option);
        stanza.push('\n');
    }
    Some(stanza)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STANZAS: &str = "Types: deb\n# a comment\nURIs: https://mirror.invalid/debian\nSuites: bookworm bookworm-updates\n\
        Components: main\nSigned-By: /usr/share/keyrings/debian.gpg\n\nTypes: deb\nURIs: https://mirror.invalid/security\n\
        Suites: bookworm-security\nComponents: main\n";

    #[test]
    fn stanzas_give_backports_of_the_same_mirror() {
        let sources = parse_stanzas(STANZAS);
        assert_eq!(sources.len(), 2);
        assert!(serves(&sources, "bookworm-updates"));
        assert!(!serves(&sources, "bookworm-backports"));
        assert_eq!(
            backports(&sources, "bookworm").as_deref(),
            Some(
                "Types: deb\nURIs: https://mirror.invalid/debian\nSuites: bookworm-backports\nComponents: main\n\
                 Signed-By: /usr/share/keyrings/debian.gpg\n"
            )
        );
    }

    #[test]
    fn lines_give_backports_of_the_same_mirror() {
        let text = "# deb https://old.invalid bookworm main\ndeb-src https://mirror.invalid/debian bookworm main\n\
            deb [arch=amd64,arm64 signed-by=/key.gpg] https://mirror.invalid/debian bookworm main contrib # primary\n";
        let sources = parse_lines(text);
        assert_eq!(sources.len(), 1);
        assert_eq!(
            backports(&sources, "bookworm").as_deref(),
            Some(
                "Types: deb\nURIs: https://mirror.invalid/debian\nSuites: bookworm-backports\nComponents: main\n\
                 Architectures: amd64 arm64\nSigned-By: /key.gpg\n"
            )
        );
    }

    #[test]
    fn keys_inside_a_stanza_are_kept_whole() {
        let text = "Types: deb\nURIs: https://mirror.invalid/debian\nSuites: bookworm\nComponents: main\n\
            Signed-By:\n -----BEGIN PGP PUBLIC KEY BLOCK-----\n .\n abc\n -----END PGP PUBLIC KEY BLOCK-----\n";
        let stanza = backports(&parse_stanzas(text), "bookworm").unwrap();
        assert!(stanza.ends_with(
            "Signed-By: \n -----BEGIN PGP PUBLIC KEY BLOCK-----\n .\n abc\n -----END PGP PUBLIC KEY BLOCK-----\n"
        ));
    }

    #[test]
    fn sources_that_do_not_serve_the_release_give_nothing() {
        let off = STANZAS.replace("Types: deb\n#", "Enabled: no\nTypes: deb\n#");
        assert_eq!(backports(&parse_stanzas(&off), "bookworm"), None);
        assert_eq!(backports(&parse_stanzas(STANZAS), "trixie"), None);
        assert_eq!(
            backports(&parse_lines("deb cdrom:[Debian 12]/ bookworm main"), "bookworm"),
            None
        );
        assert_eq!(backports(&[], "bookworm"), None);
    }
}
