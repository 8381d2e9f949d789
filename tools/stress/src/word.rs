//! Command-line words of enum variants.

use clap::ValueEnum;

/// The word of a value on the command line, such as `long-run`.
pub fn word(value: &impl ValueEnum) -> String {
    let value = value.to_possible_value();
    value.map_or_else(String::new, |value| value.get_name().to_owned())
}
