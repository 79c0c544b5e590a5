//! This machine in numbers: what each stage takes, and how far that is from what its memory allows.

mod changes;
mod compare;
mod drive;
mod drive_table;
#[cfg(feature = "gpu")]
mod gpu;
mod limits;
mod live;
mod long_drive;
mod long_track;
mod pieces;
mod results;
mod run;
mod street;
mod table;

pub use changes::Changes;
pub use compare::Bench;
#[cfg(feature = "gpu")]
pub use gpu::{GpuResults, Kernel, MeasuredGpu, on_gpu};
pub use limits::Limits;
pub use live::{Live, LiveResults, Stages, Sweep};
pub use long_drive::{LongDrive, LongDriveResults, Pass, Stored};
pub use long_track::{Lap, LongTrack, LongTrackResults};
pub use results::{Data, Measured, Results};
pub use run::Run;
pub use street::STREET;
