//! The two columns that `tsdfuse info` prints.

use std::fmt::Display;

use glam::DVec3;

/// The size of a box, and where it lies.
pub(super) fn extent_line(low: DVec3, high: DVec3) -> String {
    let side = |axis: usize| format!("{:.1} to {:.1}", low[axis], high[axis]);
    let DVec3 { x, y, z } = high - low;
    let [from_x, from_y, from_z] = [side(0), side(1), side(2)];
    format!("{x:.1} x {y:.1} x {z:.1} m: x {from_x}, y {from_y}, z {from_z} m")
}

/// A table of two columns.
#[derive(Default)]
pub(super) struct Rows(String);

impl Rows {
    pub(super) fn add(&mut self, name: &str, value: impl Display) {
        self.0 += &format!("{name:<11} {value}\n");
    }

    pub(super) fn finish(self) -> String {
        self.0
    }
}
