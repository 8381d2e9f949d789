//! Version numbers of compilers and packages.

use std::fmt;

/// The leading numbers of a version; what follows them (`-nightly`, `~bpo12+1`) doesn't matter here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version(pub [u32; 3]);

impl Version {
    /// Reads `1.97.1`, `1.97`, `1.96.0-nightly` or a Debian version such as `1:25.0.7-2~bpo12+1`.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        let text = text.split_once(':').map_or(text, |(_epoch, rest)| rest);
        let end = text
            .find(|c: char| !c.is_ascii_digit() && c != '.')
            .unwrap_or(text.len());
        let mut numbers = [0; 3];
        let mut count = 0;
        for (slot, part) in numbers.iter_mut().zip(text[..end].split('.')) {
            if part.is_empty() {
                break;
            }
            *slot = part.parse().ok()?;
            count += 1;
        }
        (count > 0).then_some(Self(numbers))
    }
}

impl fmt::Display for Version {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [major, minor, patch] = self.0;
        write!(formatter, "{major}.{minor}.{patch}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_parse_and_compare() {
        let version = |text| Version::parse(text).unwrap();
        assert_eq!(version("1.97.1"), Version([1, 97, 1]));
        assert_eq!(version("1.97"), Version([1, 97, 0]));
        assert_eq!(version("1.98.0-nightly"), Version([1, 98, 0]));
        assert_eq!(version("1:25.0.7-2~bpo12+1"), Version([25, 0, 7]));
        assert_eq!(version("24.2.8-1ubuntu1~24.04.1\n"), Version([24, 2, 8]));
        assert!(version("22.3.6-1+deb12u1") < version("24.1"));
        assert!(version("1.95.0") < version("1.97.1"));
        assert!(version("1.100.0") > version("1.97.1"));
    }

    #[test]
    fn what_is_no_version_is_none() {
        for text in ["", "(none)", "v1", ".", "99999999999"] {
            assert_eq!(Version::parse(text), None, "{text}");
        }
    }
}
