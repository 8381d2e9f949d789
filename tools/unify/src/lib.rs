//! Contains no code; `Cargo.toml` explains this package.
