//! The command end to end, as a user runs it.

#![allow(clippy::unwrap_used)] // the setting for tests does not reach their helpers

mod bad_input;
mod bags;
mod bench;
mod browser;
mod convert;
mod eval;
mod evaluate;
mod fuse;
#[cfg(feature = "gpu")]
mod gpu;
mod help;
mod info;
mod layers;
mod map;
mod page;
mod paging;
mod ply;
mod poses;
mod readers;
mod render;
mod rgbd;
mod run;
#[cfg(any(feature = "serve", feature = "view"))]
mod serving;
mod simulate;
#[cfg(feature = "tiles")]
mod tiles;
#[cfg(feature = "view")]
mod view;
