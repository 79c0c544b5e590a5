//! A LiDAR log in, a map out.
//!
//! [`Session`] is the loop: it reads scans ahead, drops invalid returns, fuses by any method, on the CPU or a GPU, in memory, paged
//! or with a store that survives a crash, and tells an [`Observer`] what happens. [`Job`] is a run as data: it can be stored, sent to
//! another machine, and gone on with; the command `tsdfuse fuse` makes one of its arguments and prints what it observes.
//!
//! ```text
//!   Job ─▶ Log + Setup ─▶ Session: step, step, … finish ─▶ mesh, map, picture, Report
//!                            │ Event                │
//!                            ▼                      ▼
//!                         Observer        Backend: memory · paged · gpu
//! ```
//!
//! Nothing is printed, and nothing ends the process. A scan that cannot be used is a [`BadScan`], the only trouble that
//! [`Setup::skip_bad`] skips; all else is another [`RunError`] and ends the run.
//!
//! The types to know: [`Session`], [`Setup`], [`Event`], [`Stop`]; [`RunConfig`] and its [`Settings`] in layers; [`Job`], [`Report`].

mod backend;
mod checkpoint;
mod config;
mod device;
mod error;
mod event;
pub mod export;
pub mod eye;
#[cfg_attr(not(feature = "gpu"), path = "no_gpu.rs")]
mod gpu;
pub mod intensity;
mod job;
mod labels;
pub mod layer;
mod layers;
#[cfg(feature = "live")]
mod live;
mod load;
pub mod log_info;
mod loops;
mod machine;
pub mod map_info;
mod memory;
pub mod movie;
pub mod operation;
mod outputs;
mod paged;
pub mod paint;
mod poses_from;
mod recording;
pub mod report;
mod run;
pub mod saved;
pub mod scene;
mod session;
mod settings;
mod setup;
pub mod surface;
mod tracking;
pub mod view;

pub use checkpoint::Checkpoint;
pub use config::{MovingSettings, RunConfig};
pub use device::Device;
pub use error::{BadScan, Result, RunError};
pub use event::{Both, Event, Observer, Silent, Stop};
#[cfg(feature = "gpu")]
pub use gpu::pool;
pub use job::{Input, Job};
pub use layers::{Colors, Layers};
#[cfg(feature = "live")]
pub use live::LiveRun;
pub use loops::LoopsReport;
pub use machine::{Machine, cpu_secs, peak_memory_bytes};
pub use outputs::{Outputs, check as check_outputs, check_file};
pub use poses_from::PosesFrom;
pub use recording::Recording;
pub use report::Report;
pub use run::Resumed;
pub use session::Session;
pub use settings::Settings;
pub use setup::{Placing, Setup};
pub use tracking::{Track, TrackedScan, refine, track, write_poses, write_sensor};
pub use tsdfuse_loops::{Closure, LoopConfig};
pub use tsdfuse_odometry::{ImuReport, OdometryConfig, Quality, common_shift};

/// The examples of the README, compiled.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
