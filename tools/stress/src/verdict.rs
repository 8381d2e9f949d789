//! The result of a case.

/// The result of a case.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Everything is correct; a remark, which can be empty.
    Passed(String),
    /// Something is wrong.
    Failed(Vec<String>),
    /// Bevy fails the same way without the library.
    Upstream(Vec<String>),
    /// This machine cannot run the case.
    Skipped(String),
    /// The case is inconclusive.
    Undecided(String),
}
