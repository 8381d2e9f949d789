//! Holds no code; `Cargo.toml` says why this package exists.
