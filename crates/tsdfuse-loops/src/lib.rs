#![doc = include_str!("../README.md")]

mod align;
mod blocks;
mod closer;
mod features;
mod graph;
mod local_map;
mod places;
mod world;

pub use align::{Alignment, Mapped, align};
pub use closer::{Closer, Closure, LoopConfig};
pub use graph::{Edge, Optimized, PoseGraph, Position, Upright};
pub use local_map::LocalMap;
pub use places::{Found, Places};
pub use world::{Anchoring, Fix};
