//! What can be done with whole maps: regions out and in, parts, other grids.

#![allow(clippy::unwrap_used)] // test helpers

#[path = "../common/mod.rs"]
mod common;
mod crop;
mod memory;
mod query;
mod reach;
mod region;
mod warp;
