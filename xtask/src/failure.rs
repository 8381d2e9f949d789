//! The one error type: a sentence that tells the user what to do.

use std::fmt;

/// A failure, told in one sentence.
#[derive(Debug)]
pub struct Failure(String);

/// The result of a command or of one of its steps.
pub type Result<T = ()> = std::result::Result<T, Failure>;

impl Failure {
    /// A failure with this sentence.
    pub fn new(sentence: impl Into<String>) -> Self {
        Self(sentence.into())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}
