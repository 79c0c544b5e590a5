//! Methods of fusing side by side on a log, and this machine in numbers.
//!
//! - [`Contest`] names methods and a log.
//! - [`Evaluation`] fuses the log with each of the methods, and measures each: the distance of its mesh to a reference, how well its
//!   map predicts held-out scans, its speed and memory. The [`Results`] become [`tables`], [`plots`] and a [`page`] with
//!   pictures.
//! - [`Tuning`] searches the method, voxel size and truncation that predict held-out scans best.
//! - [`bench::Bench`] tells what each stage takes on this machine, and how far that is from what its memory allows.
//! - [`trajectories`] shows how two trajectories compare.
//! - [`mod@reference`], [`colored`] and [`figures`] read what one mesh is compared with, and show how it compares.
//!
//! ```no_run
//! use tsdfuse_evaluate::{Contest, Evaluation, Form, in_this_process, tables};
//!
//! let forms = Form::chosen(&["patch", "raycast"], &[])?;
//! let evaluation = Evaluation::of(Contest { forms, ..Contest::of("pandaset/002") });
//! let found = evaluation.run(&mut in_this_process(), &mut |_| {})?;
//! for table in tables::of(&found.results) {
//!     println!("{}", table.text());
//! }
//! # Ok::<(), tsdfuse_evaluate::Error>(())
//! ```
//!
//! Nothing is printed: what happens meanwhile is told as [`Progress`]. Methods are fused by [`tsdfuse_run`], each by a
//! [`tsdfuse_run::Job`] that the caller runs: in this process ([`in_this_process`]), or in one of its own, so that its memory
//! is its own.

pub mod bench;
pub mod colored;
pub mod command;
mod contest;
mod error;
mod evaluation;
pub mod figures;
mod folder;
mod form;
mod held_out;
mod html;
pub mod page;
pub mod pictures;
mod placed;
pub mod plots;
mod pose_noise;
mod progress;
mod raster;
pub mod reference;
pub mod results;
mod scan_poses;
mod side_by_side;
mod style;
pub mod table;
pub mod tables;
pub mod trajectories;
mod truth;
mod tune;
mod tuned;

pub use contest::Contest;
pub use error::{Error, Result};
pub use evaluation::{Evaluated, Evaluation, Runner, in_this_process};
pub use form::Form;
pub use pose_noise::PoseNoise;
pub use progress::{Progress, Watch};
pub use results::Results;
pub use scan_poses::ScanPoses;
pub use truth::{Comparing, Truth};
pub use tune::Tuning;
pub use tuned::{Score, Tuned};
