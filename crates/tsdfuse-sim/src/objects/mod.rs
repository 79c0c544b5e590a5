//! Things that stand in scenes, each in its own frame: x forward or along, y left, z up, the ground at z = 0, metres.
//!
//! What stands on the ground reaches a little below it, so that nothing floats on a slope.

mod building;
mod fixtures;
mod furniture;
mod goods;
mod parts;
mod plants;
mod vehicles;

pub(crate) use building::{Building, building};
pub(crate) use fixtures::*;
pub(crate) use furniture::*;
pub(crate) use goods::*;
pub(crate) use parts::{Opening, Parts, Rng, pick};
pub(crate) use plants::{conifer, hedge, tree};
pub(crate) use vehicles::{car, forklift, van};
