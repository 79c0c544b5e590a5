//! Scenes: unions of solids, and the named ones.

mod named;
mod solids;

pub use named::{by_name, names};
pub use solids::{Hit, Scene};
