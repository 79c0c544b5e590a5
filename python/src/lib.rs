//! The Python module `tsdfuse._core`: it translates between Python and the engine, and does nothing else. One file for each concept
//! that Python sees.
#![expect(clippy::needless_pass_by_value, reason = "pyo3 hands arguments over by value")]
#![expect(clippy::type_complexity, reason = "Python takes tuples of arrays")]

mod arrays;
mod cells;
mod config;
mod data;
mod error;
mod evaluate;
mod job;
mod log;
mod map;
mod mesh;
mod odometry;
mod piece;
mod plan;
mod program;
mod reach;
mod render;
mod scan;
mod sensor;
mod session;
mod simulate;
mod store;
mod trajectory;
mod watch;

use pyo3::prelude::*;

/// The engine of tsdfuse.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::cells::{checksum, write_cells};
    #[pymodule_export]
    use super::config::Config;
    #[pymodule_export]
    use super::evaluate::{compare, compare_trajectories, evaluate};
    #[pymodule_export]
    use super::job::{resume, run};
    #[pymodule_export]
    use super::log::{Log, Scans};
    #[pymodule_export]
    use super::map::{Changes, Fused, Map, Nearby};
    #[pymodule_export]
    use super::mesh::Mesh;
    #[pymodule_export]
    use super::odometry::{Odometry, track};
    #[pymodule_export]
    use super::plan::{Esdf, Moving, Occupancy, ground};
    #[pymodule_export]
    use super::program::{command, set_threads, threads, version};
    #[pymodule_export]
    use super::reach::Reach;
    #[pymodule_export]
    use super::render::View;
    #[pymodule_export]
    use super::scan::Scan;
    #[pymodule_export]
    use super::sensor::{sensor, sensors};
    #[pymodule_export]
    use super::session::Session;
    #[pymodule_export]
    use super::simulate::Simulation;
    #[pymodule_export]
    use super::store::Store;
    #[pymodule_export]
    use super::trajectory::Trajectory;
}
